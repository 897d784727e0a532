"""Value iteration on tensor trains: for teams whose value needs too many products, and cells with targets.

A *train* is a function of the joint cell, ``C_1(s_1) C_2(s_2) .. C_I(s_I)``: a matrix for each agent and cell. One step
earlier, in automaton state q,

    V_q(t) = (P_1 x .. x P_I) W_q,    W_q = sum over guards from q of (sets of the guard) V_target(t + 1).

**Theorem.** Let a train be within ``error`` of the value everywhere. Then so is the train that this recursion makes of
it, with what is added here; so the value at the start is at least the train's, less the error.

*Proof.* Guards are disjoint, so that W_q is within the largest error of its terms; kernels are contractions. A cut
replaces a matrix by a product of two smaller ones; what it discards, D, is formed, and changes the function by at most
``a |D(s)| b``, a and b bounds on entries of rows before and of columns behind it, at the cell s where that is largest.
So the bound holds however the factors were found. Rounding is bounded in the same way, entry by entry. Tables hold all
but ``lack`` of each probability, and targets are off by their rests: both act on a function of at most 1 + error. QED

Reference: docs/theory/tree.md, "Uniting terms".
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from .cells import DENSITY, Cells
from .fields import Refused
from .rigorous import Array, Truth, U
from .tree import Team, finished

SUMS = 8  # sums of rows, for each column, from which the directions of a cut are taken
MORE = 1.0 + 1e-9  # factor on bounds that are sums of products of fewer than a million numbers


@dataclass(frozen=True, eq=False)
class Train:
    """Cores (r_i, S_i, r_(i+1)), the first and last with one row and one column; and how far it is from the value."""

    cores: tuple[Array, ...]
    error: float


def value_at_start(team: Team, tolerance: float) -> float:
    """Return a lower bound on the probability that the task is satisfied; cuts may cost ``tolerance``."""
    value, total = trains_at_start(team, tolerance), 0.0
    for target, sets in zip(team.start.target.tolist(), team.start.sets, strict=True):
        if (train := value[target]) is not None:
            total += _mean(train, [cells.start[own] for cells, own in zip(team.agents, sets, strict=True)])
    return min(1.0, max(0.0, total * (1.0 - 8.0 * U * (len(team.start.target) + 4.0))))


def trains_at_start(team: Team, tolerance: float) -> list[Train | None]:
    """Return the value at time 0 by automaton state, at every joint cell; None where it is 0."""
    if any(cells.kernel.inputs or cells.kernel.corners for cells in team.agents):
        raise Refused("tensor trains are for cells with targets")
    ones = Train(tuple(np.ones((1, cells.kernel.places, 1)) for cells in team.agents), 0.0)
    done, value = finished(team.automaton), [ones if accepts else None for accepts in team.automaton.accepting]
    for t in range(team.horizon - 1, -1, -1):
        # All sums first: each of them reads the values of several states.
        summed = [None if end else _masked_sum(team, value, q, tolerance / team.horizon) for q, end in enumerate(done)]
        back = [None if own is None else _taken_back(own, team.agents, t, q) for q, own in enumerate(summed)]
        value = [ones if end else own for end, own in zip(done, back, strict=True)]
    return value


def _masked_sum(team: Team, value: Sequence[Train | None], q: int, tolerance: float) -> Train | None:
    """Return W_q with few columns; None if no guard leads to a state with a value."""
    rows, target = np.flatnonzero(team.guards.source == q).tolist(), team.guards.target.tolist()
    trains = {target[g]: train for g in rows if (train := value[target[g]]) is not None}
    if not trains:
        return None
    # From the last agent to the first, and then the same function from the first to the last.
    masks = [cells.sets[:, None, :, None] for cells in team.agents]
    terms = [(target[g], *team.guards.sets[g].tolist()) for g in rows if target[g] in trains]
    cores, error = _swept({key: train.cores for key, train in trains.items()}, terms, masks, tolerance)
    whole = [np.ones((1, 1, 1, 1), dtype=bool)] * len(cores)
    back, more = _swept({0: _reversed(cores)}, [(0,) * (len(cores) + 1)], whole, tolerance)
    return Train(_reversed(back), (error + more + max(train.error for train in trains.values())) * MORE)


def _reversed(cores: Sequence[Array]) -> tuple[Array, ...]:
    """Return the cores of the same function, its agents in the opposite order."""
    return tuple(np.ascontiguousarray(core.transpose(2, 1, 0)) for core in cores[::-1])


# A train by its number, and its masks from some agent on: terms that agree in them share what is computed from there.
Term = tuple[int, ...]


def _swept(
    trains: Mapping[int, Sequence[Array]], terms: Sequence[Term], masks: Sequence[Truth], tolerance: float
) -> tuple[list[Array], float]:
    """Return the sum of terms, trains cut to masks, with few rows from the last agent to the first; and the change."""
    share, heads = tolerance / max(1, 2 * (len(masks) - 1)), {key: _entries(own) for key, own in trains.items()}
    behind: dict[Term, Array] = {(key,): np.ones((1, 1)) for key in trains}
    tail, error, cores = np.ones(1), 0.0, list[Array]()
    for i in range(len(masks) - 1, -1, -1):
        blocks: dict[Term, Array] = {}
        for key, *chosen in terms:
            first, *rest = chosen[i:]
            if (key, first, *rest) not in blocks:
                core, columns = trains[key][i], behind[key, *rest]
                blocks[key, first, *rest] = np.tensordot(core * masks[i][first], columns, axes=1)
                error += (core.shape[2] + 2) * 2 * U * _largest(heads[key][i], core, np.abs(columns) @ tail)
        if i == 0:
            # what is left is added up, with a rounding for each sum
            cores.append(np.sum([*blocks.values()], axis=0))
            sizes = sum(_largest(np.ones(1), block, tail) for block in blocks.values())
            return cores[::-1], error + 2 * U * (len(blocks) - 1) * sizes
        whole = np.concatenate([*blocks.values()])  # (sum of r, S, kept)
        before = np.concatenate([heads[key][i] for key, *_ in blocks])
        core, carry, lost = _cut(whole.transpose(2, 1, 0), share, tail, before)
        error += lost
        cores.append(np.ascontiguousarray(core.transpose(2, 1, 0)))
        tail = _entries([core], tail)[-1]
        pieces = np.split(carry.T, np.cumsum([len(block) for block in blocks.values()])[:-1])
        behind = dict(zip(blocks, pieces, strict=True))
    return cores, error


def _cut(whole: Array, share: float, head: Array, tail: Array) -> tuple[Array, Array, float]:
    """Return ``whole ~ core . carry`` with few columns, and a bound on the change between ``head`` and ``tail``."""
    r, n, columns = whole.shape
    matrix = np.ascontiguousarray(whole).reshape(r * n, columns)
    # directions of few sums of rows with signs: what they miss is seen in the bound, which asks the matrix itself
    sums = min(r * n, SUMS * columns)
    padded = np.zeros((-(-r * n // sums) * sums, columns))
    padded[: r * n] = matrix * np.random.default_rng(0).choice((-1.0, 1.0), (r * n, 1))
    right = np.linalg.svd(np.linalg.qr(padded.reshape(-1, sums, columns).sum(axis=0), mode="r"))[2]
    turned = matrix @ right.T
    # what each direction weighs at each cell, and all from one on: directions that weigh less than the share are cut
    sizes = np.einsum("r,rnk->kn", head, np.abs(turned.reshape(r, n, -1))) * (np.abs(right) @ tail)[:, None]
    rest = np.cumsum(sizes[::-1], axis=0)[::-1].max(axis=1, initial=0.0)
    few = max(1, int(np.sum(rest > 0.9 * share)))
    core, carry = np.ascontiguousarray(turned[:, :few]), right[:few]
    # what is discarded is formed: how the factors were found does not matter
    lost = _largest(head, (matrix - core @ carry).reshape(whole.shape), tail)
    core = core.reshape(r, n, few)
    lost += (few + 4) * 2 * U * (_largest(head, whole, tail) + _largest(head, core, np.abs(carry) @ tail))
    return core, carry, lost


def _taken_back(train: Train, agents: Sequence[Cells], t: int, q: int) -> Train:
    """Return the mean of a train one step earlier, at every cell; 0 where nothing is chosen."""
    cores, operations, off = [], 4, 0.0
    for core, cells in zip(train.cores, agents, strict=True):
        kernel, policy = cells.kernel, cells.policy_at(t, q)
        rows = kernel.means(core.transpose(0, 2, 1).reshape(-1, core.shape[1]))
        operations += sum(table.shape[1] + 4 for table in kernel.tables)
        moved = rows.reshape(len(rows), -1)[:, np.maximum(policy, 0)] * (policy >= 0)
        cores.append(moved.reshape(core.shape[0], core.shape[2], -1).transpose(0, 2, 1))
        operations += core.shape[2]
        off += kernel.lack + float(np.sum(kernel.target_rest * DENSITY / kernel.deviations))
    rounded = operations * 2 * U * float(_entries(train.cores)[-1][0])
    return Train(tuple(cores), (train.error + rounded + 2.0 * off * (1.0 + train.error)) * MORE)


def _mean(train: Train, shares: Sequence[Array]) -> float:
    """Return a lower bound on the mean of the value under a product of weights (S_i,) of cells."""
    row, mass = np.ones(1), 1.0
    for core, share in zip(train.cores, shares, strict=True):
        row, mass = row @ np.tensordot(core, share, axes=(1, 0)), mass * float(share.sum())
    operations = sum(sum(core.shape) for core in train.cores) + 2 * len(train.cores)
    error = (train.error + operations * 2 * U * float(_entries(train.cores)[-1][0])) * mass * MORE
    return max(0.0, float(row[0]) - error)


def _largest(head: Array, core: Array, tail: Array) -> float:
    """Return an upper bound on ``|row core(s) column|`` for rows and columns nowhere larger than head and tail."""
    return float(((np.abs(core) @ tail).T @ head).max(initial=0.0)) * MORE


def _entries(cores: Sequence[Array], head: Array | None = None) -> list[Array]:
    """Return upper bounds on the entries of rows before each core and after the last: products, from ``head``."""
    rows = [np.ones(1) if head is None else head]
    for core in cores:
        rows.append(np.tensordot(rows[-1], np.abs(core), axes=1).max(axis=0, initial=0.0) * MORE)
    return rows
