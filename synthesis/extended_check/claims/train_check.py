"""The value function of a certificate on tensor trains, computed again by a recursion that only the check uses.

One step back in automaton state q, with the policies of the certificate (``docs/theory/tree.md``),

    V_q,t  =  (P_1 x .. x P_I)  W_q ,      W_q = sum over guards (q -> p) of 1[guard] V_p,t+1 .

A *train* is a function of the joint cell, ``C_1(s_1) C_2(s_2) .. C_I(s_I)``, one matrix per agent and cell. The masked
sum ``W_q`` is written as one train and cut down to few columns in two passes, from the last agent to the first and
back. Each cut replaces a core by a product of two smaller ones; what it discards, D, is formed explicitly and changes
the function by at most

    (sups of the entries of the row of the agents before) |D(s)| (sups of those of the column of the agents behind) ,

at the cell s where that is largest. So the bound holds however accurate the factorisation was. Kernels are contractions
in the sup norm: an error stays what it was until the start. Nothing is shared with the recursion of the search but the
kernel's definition, and that is built from another special function here (``certificates.checked_kernel``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...certificates.cell_probabilities import BrokenTrainError, axis_tables, backup
from ...certificates.proofs import OnGrid
from ...relations.grids import FloatArray
from .forward_occupancy import mass_at_start

ROUNDOFF = 2.0**-52
"""Bound on the relative error of one operation in float64, twice what it is."""

CAREFUL = 0.04
"""Share of the certificate's tolerance that cuts may use: claims are lower by a tenth of it, for this recursion, whose
value may be too small by its error, which is taken off once more; the rest of the tenth is for floating point."""

ROWS_AT_ONCE = 256
"""Rows of a core that are smoothed at once, to bound the memory."""

Cells = tuple[NDArray[np.integer], ...] | None
"""Cells of each agent that a train covers, increasing; elsewhere it counts as 0. None: all of them."""


@dataclass(frozen=True, eq=False)
class ErrorBoundedTrain:
    """A function of the joint cell as a train, and how far it may be from the function it stands for.

    Parameters
    ----------
    cores : tuple of (r_i, n_i, r_{i+1}) arrays
        Over the covered cells of each agent.
    error : float
        Upper bound in the sup norm, floating point included.
    """

    cores: tuple[FloatArray, ...]
    error: float


Reader = list[NDArray[np.int64]]
"""A deterministic reader of a set of joint cells, agent by agent: per agent (N_i, n_i), the node of the next agent that
each node is led to by each covered cell, -1 where the joint cell is not in the set. It begins at node 0."""

Value = tuple[ErrorBoundedTrain | None, ...]
"""Value function at one time, by automaton state; None where it is 0."""


def regrown_trains(certificate: OnGrid, upper: bool = False) -> Value:
    """Compute the value function at time 0, with bounds on its errors.

    Parameters
    ----------
    certificate : Certificate
        With tensor trains.
    upper : bool
        If False, the value is the probability of satisfying the task. If True, it also counts meeting a cell without a
        choice and leaving the covered cells: the lower bound counts these as failures, but the continuous system may
        survive them.

    Raises
    ------
    BrokenTrainError
        If the certificate's rounding does not fit its horizon or its cells.
    """
    problem, agents, automaton = certificate.problem, certificate.proof.agents, certificate.problem.automaton
    visited = _covered(certificate)
    assert certificate.proof.rounding is not None
    tolerance = CAREFUL * certificate.proof.rounding.tolerance / problem.horizon
    memory: dict[tuple[bytes, ...], list[FloatArray]] = {}
    tables = [axis_tables(a, part, memory) for a, part in zip(problem.agents, agents, strict=True)]
    sizes = [part.grid.n_cells for part in agents]
    value: Value = tuple(_ones(sizes, visited[-1]) if accepted else None for accepted in automaton.accepting)
    for t in reversed(range(problem.horizon)):
        before: list[ErrorBoundedTrain | None] = []
        for q in range(automaton.n_states):
            if automaton.finished[q]:
                before.append(_ones(sizes, visited[t]))
                continue
            summed = _masked_sum(certificate, value, q, visited[t + 1], tolerance)
            if summed is None:
                before.append(None)
                continue
            points = [part.points(t, q) for part in agents]
            moved = _moved(summed, tables, points, sizes, visited[t], visited[t + 1])
            beside = _failed(tables, points, sizes, visited[t], visited[t + 1]) if upper else None
            before.append(moved if beside is None else _added(moved, beside))
        value = tuple(before)
    return value


def train_start_value(certificate: OnGrid, value: Value, upper: bool = False) -> float:
    """Compute a bound on the value at the start: a lower bound, or an upper bound if ``upper``.

    Parameters
    ----------
    certificate : Certificate
        With tensor trains.
    value : Value
        Of ``regrown_trains``, with the same ``upper``.
    upper : bool
        Whether to bound from above; then everything outside the covered cells counts as satisfied.
    """
    start = mass_at_start(certificate)
    total = 0.0
    for q, row in zip(start.states.tolist(), start.index, strict=True):
        shares = [factors[k] for factors, k in zip(start.factors, row, strict=True)]
        total += _averaged(value[q], shares, _covered(certificate)[0], upper)
    return total


def _averaged(train: ErrorBoundedTrain | None, shares: Sequence[FloatArray], cells: Cells, upper: bool) -> float:
    """Bound on the average of a train under a product of nonnegative shares (S_i,) of the cells of each agent."""
    if train is None:
        return 0.0
    weights = shares if cells is None else [share[own] for share, own in zip(shares, cells, strict=True)]
    whole, mass = (float(np.prod([own.sum() for own in each])) for each in (shares, weights))
    row, size = np.ones(1), float(_sups(train.cores)[-1][0])
    for core, weight in zip(train.cores, weights, strict=True):
        row = row @ np.tensordot(core, weight, axes=(1, 0))
    operations = sum(sum(core.shape) for core in train.cores) + 2 * len(train.cores)
    error = (train.error + operations * ROUNDOFF * size) * mass * (1 + 1e-12)
    if upper:
        return float(row[0]) + error + max(0.0, whole - mass) + 1e-14
    return max(0.0, float(row[0]) - error)


def _covered(certificate: OnGrid) -> tuple[Cells, ...]:
    """Return the covered cells at times 0 .. T, after checking that they are cells."""
    rounding, sizes = certificate.proof.rounding, [part.grid.n_cells for part in certificate.proof.agents]
    if rounding is None:
        raise BrokenTrainError("it has a value tree and no tensor trains")
    if len(rounding.visited) != certificate.problem.horizon + 1 or not 0 < rounding.tolerance < 1:
        raise BrokenTrainError("its rounding does not fit its horizon")
    for cells in rounding.visited:
        for own, size in zip(cells or (), sizes, strict=cells is not None):
            if len(own) == 0 or own[0] < 0 or own[-1] >= size or np.any(np.diff(own) <= 0):
                raise BrokenTrainError("the cells that its tensor trains cover are no cells")
    return rounding.visited


def _ones(sizes: Sequence[int], cells: Cells) -> ErrorBoundedTrain:
    """The train that is 1 on the covered cells."""
    lengths = sizes if cells is None else [len(own) for own in cells]
    return ErrorBoundedTrain(tuple(np.ones((1, n, 1)) for n in lengths), 0.0)


# --- the masked sum ------------------------------------------------------------------------------------------
def _masked_sum(certificate: OnGrid, value: Value, q: int, cells: Cells, tolerance: float) -> ErrorBoundedTrain | None:
    """``W_q`` over the covered cells, cut down to few columns; None if no successor has a value."""
    summands: list[tuple[ErrorBoundedTrain, Reader]] = []
    rows = np.flatnonzero(certificate.proof.guard_source == q)
    for p in np.unique(certificate.proof.guard_target[rows]):
        train = value[int(p)]
        if train is not None:
            cubes = certificate.proof.guard_mask[rows[certificate.proof.guard_target[rows] == p]]
            summands.append((train, _reader(certificate, cubes, cells)))
    if not summands:
        return None
    cores, error = _cut_backward(summands, tolerance)
    # guards are disjoint: at a joint cell one summand is read, and its error with it
    cores, more = _cut_forward(cores, tolerance)
    error += more + max(train.error for train, _ in summands)
    return ErrorBoundedTrain(tuple(cores), error * (1 + 1e-12))


def _reader(certificate: OnGrid, cubes: NDArray[np.integer], cells: Cells) -> Reader:
    """A reader of the union of disjoint cubes ``cubes`` (G, I), each a mask number per agent."""
    nodes: list[frozenset[int]] = [frozenset(range(len(cubes)))]
    following = []
    for i, part in enumerate(certificate.proof.agents):
        masks = part.masks if cells is None else part.masks[:, cells[i]]
        inside = masks[cubes[:, i]]  # (G, n): the cubes that go on at each cell
        patterns, pattern_of_cell = np.unique(inside, axis=1, return_inverse=True)
        # two nodes are one if the same things are asked of the agents that follow
        rest = [tuple(int(m) for m in cube[i + 1 :]) for cube in cubes]
        number: dict[frozenset[tuple[int, ...]], int] = {}
        members: list[frozenset[int]] = []
        table = np.full((len(nodes), patterns.shape[1]), -1, dtype=np.int64)
        for n, node in enumerate(nodes):
            for k in range(patterns.shape[1]):
                left = frozenset(g for g in node if patterns[g, k])
                if left:
                    asked = frozenset(rest[g] for g in left)
                    if asked not in number:
                        number[asked] = len(number)
                        members.append(left)
                    table[n, k] = number[asked]
        following.append(table[:, np.ravel(pattern_of_cell)])
        nodes = members or [frozenset()]
    return following


def _cut_backward(
    summands: Sequence[tuple[ErrorBoundedTrain, Reader]], tolerance: float
) -> tuple[list[FloatArray], float]:
    """Cores of the masked sum, from the last agent to the first, cut on the way; and an upper bound on the change."""
    n_agents = len(summands[0][0].cores)
    share = tolerance / max(1, 2 * (n_agents - 1))
    heads = [_sups(train.cores) for train, _ in summands]
    behind = [np.ones((1, 1, 1)) for _ in summands]  # per summand (nodes, columns of the train, kept columns)
    tail, error, cores = np.ones(1), 0.0, list[FloatArray]()
    for i in reversed(range(n_agents)):
        blocks = []
        for (train, following), columns, head in zip(summands, behind, heads, strict=True):
            core = train.cores[i]
            block = np.zeros((len(following[i]), core.shape[0], core.shape[1], columns.shape[2]))
            for node, matrix in enumerate(columns):
                product = np.tensordot(core, matrix, axes=1)
                for n, goes in enumerate(following[i] == node):
                    block[n][:, goes] = product[:, goes]
            blocks.append(block)
            # the joint cell is at one node of each summand
            after = np.abs(columns).max(axis=0, initial=0.0) @ tail
            error += (core.shape[2] + 2) * ROUNDOFF * _sup(head[i], core, after)
        if i == 0:
            cores.append(np.sum([block[0] for block in blocks], axis=0))
            error += ROUNDOFF * len(blocks) * sum(_sup(np.ones(1), block[0], tail) for block in blocks)
            break
        whole = np.concatenate([block.reshape(-1, *block.shape[2:]) for block in blocks])
        before = np.concatenate([np.tile(own[i], len(block)) for own, block in zip(heads, blocks, strict=True)])
        core, carry, lost = _cut(whole.transpose(2, 1, 0), share, tail, before)
        error += lost
        core = np.ascontiguousarray(core.transpose(2, 1, 0))
        cores.append(core)
        tail = _sups([core.transpose(2, 1, 0)], tail)[-1]
        pieces = np.split(carry.T, np.cumsum([block.shape[0] * block.shape[1] for block in blocks])[:-1])
        behind = [piece.reshape(*block.shape[:2], -1) for piece, block in zip(pieces, blocks, strict=True)]
    return cores[::-1], error


def _cut_forward(cores: Sequence[FloatArray], tolerance: float) -> tuple[list[FloatArray], float]:
    """The same function with fewer columns, from the first agent to the last; and an upper bound on the change."""
    share = tolerance / max(1, 2 * (len(cores) - 1))
    tails = _sups([core.transpose(2, 1, 0) for core in reversed(cores)])[-2::-1]
    head, error, finished, carry = np.ones(1), 0.0, list[FloatArray](), np.ones((1, 1))
    for core, tail in zip(cores, tails, strict=True):
        whole = np.tensordot(carry, core, axes=1)
        error += (carry.shape[1] + 2) * ROUNDOFF * _sup(head @ np.abs(carry), core, tail)
        if len(finished) == len(cores) - 1:
            finished.append(whole)
            break
        kept, carry, lost = _cut(whole, share, head, tail)
        error += lost
        finished.append(kept)
        head = _sups([kept], head)[-1]
    return finished, error


def _cut(whole: FloatArray, share: float, head: FloatArray, tail: FloatArray) -> tuple[FloatArray, FloatArray, float]:
    """``whole ~ core . carry`` with few columns, and an upper bound on what that changes between ``head`` and ``tail``.

    ``whole`` (r, n, c); ``share`` is about what it may change.
    """
    r, n, columns = whole.shape
    matrix = np.ascontiguousarray(whole).reshape(r * n, columns)
    basis, triangle = np.linalg.qr(matrix)
    turn, weights, right = np.linalg.svd(triangle, full_matrices=False)
    left = basis @ turn
    # what each column weighs in each slice, and all from k on
    sizes = np.einsum("r,rnk->kn", head, np.abs(left.reshape(r, n, -1))) * (weights * (np.abs(right) @ tail))[:, None]
    rest = np.cumsum(sizes[::-1], axis=0)[::-1].max(axis=1, initial=0.0)
    few = max(1, int(np.sum(rest > 0.9 * share)))
    core, carry = np.ascontiguousarray(left[:, :few]), weights[:few, None] * right[:few]
    lost = _sup(head, (matrix - core @ carry).reshape(whole.shape), tail)
    core = core.reshape(r, n, few)
    # the difference above was itself computed with rounding
    lost += (few + 4) * ROUNDOFF * (_sup(head, whole, tail) + _sup(head, core, np.abs(carry) @ tail))
    return core, carry, lost


# --- one step back -------------------------------------------------------------------------------------------
def _moved(
    train: ErrorBoundedTrain,
    tables: Sequence[list[FloatArray]],
    points: Sequence[NDArray[np.integer]],
    sizes: Sequence[int],
    here: Cells,
    there: Cells,
) -> ErrorBoundedTrain:
    """Expected value, one step before, at the cells ``here`` of a train over the cells ``there``."""
    cores, operations = [], 4
    for i, core in enumerate(train.cores):
        rows = np.zeros((core.shape[0] * core.shape[2], sizes[i]))
        rows[:, slice(None) if there is None else there[i]] = core.transpose(0, 2, 1).reshape(len(rows), -1)
        choice = points[i] if here is None else points[i][here[i]]
        expected = np.empty((len(rows), len(choice)))
        for first in range(0, len(rows), ROWS_AT_ONCE):
            part = slice(first, first + ROWS_AT_ONCE)
            expected[part] = backup(rows[part], tables[i])[:, np.maximum(choice, 0)]
        expected[:, choice < 0] = 0.0  # no choice counts as failure
        cores.append(expected.reshape(core.shape[0], core.shape[2], -1).transpose(0, 2, 1))
        operations += sum(table.shape[1] + 4 for table in tables[i]) + core.shape[2]
    return ErrorBoundedTrain(tuple(cores), train.error + operations * ROUNDOFF * float(_sups(train.cores)[-1][0]))


def _failed(
    tables: Sequence[list[FloatArray]],
    points: Sequence[NDArray[np.integer]],
    sizes: Sequence[int],
    here: Cells,
    there: Cells,
) -> ErrorBoundedTrain | None:
    """Probability that a lower bound counts as failed in one step, and that the system may survive; None if it is 0.

    No choice: ``1 - prod valid_i``. Leaving the covered cells inside the workspaces: ``prod P_i 1 - prod P_i 1[A]``.
    """
    choices = list(points) if here is None else [p[own] for p, own in zip(points, here, strict=True)]
    products: list[tuple[float, list[FloatArray]]] = []
    if any(np.any(choice < 0) for choice in choices):
        products.append((1.0, [np.ones(len(choice)) for choice in choices]))
        products.append((-1.0, [(choice >= 0).astype(float) for choice in choices]))
    if there is not None and any(len(own) < size for own, size in zip(there, sizes, strict=True)):
        anywhere, covered = [], []
        for table, choice, size, own in zip(tables, choices, sizes, there, strict=True):
            indicator = np.zeros(size)
            indicator[own] = 1.0
            rates = backup(np.stack([np.ones(size), indicator]), table)[:, np.maximum(choice, 0)] * (choice >= 0)
            anywhere.append(rates[0])
            covered.append(rates[1])
        products += [(1.0, anywhere), (-1.0, covered)]
    if not products:
        return None
    total = _product_train(*products[0])
    for sign, factors in products[1:]:
        total = _added(total, _product_train(sign, factors))
    operations = 4 * len(products) * (len(choices) + 2 * sum(sizes))
    return ErrorBoundedTrain(total.cores, total.error + operations * ROUNDOFF)


def _product_train(sign: float, factors: Sequence[FloatArray]) -> ErrorBoundedTrain:
    """A signed product over the agents as a train of one column."""
    cores = [factor.reshape(1, -1, 1) for factor in factors]
    return ErrorBoundedTrain((sign * cores[0], *cores[1:]), 0.0)


def _added(one: ErrorBoundedTrain, other: ErrorBoundedTrain) -> ErrorBoundedTrain:
    """Sum of two trains, with the columns of both."""
    error, last = one.error + other.error, len(one.cores) - 1
    if last == 0:
        total = one.cores[0] + other.cores[0]
        return ErrorBoundedTrain((total,), error + ROUNDOFF * float(_sups([total])[-1][0]))
    cores = []
    for i, (a, b) in enumerate(zip(one.cores, other.cores, strict=True)):
        if i == 0:
            cores.append(np.concatenate([a, b], axis=2))
        elif i == last:
            cores.append(np.concatenate([a, b], axis=0))
        else:
            core = np.zeros((a.shape[0] + b.shape[0], a.shape[1], a.shape[2] + b.shape[2]))
            core[: a.shape[0], :, : a.shape[2]] = a
            core[a.shape[0] :, :, a.shape[2] :] = b
            cores.append(core)
    return ErrorBoundedTrain(tuple(cores), error)


# --- sizes ---------------------------------------------------------------------------------------------------
def _sup(head: FloatArray, core: FloatArray, tail: FloatArray) -> float:
    """Upper bound on ``|row core[:, s] column|`` for rows and columns that are nowhere larger than head and tail."""
    return float(((np.abs(core) @ tail).T @ head).max(initial=0.0)) * (1 + 1e-12)


def _sups(cores: Sequence[FloatArray], head: FloatArray | None = None) -> list[FloatArray]:
    """Upper bounds on the entries of the rows before each core and after the last: products of slices, from ``head``.

    They hold of products of absolute values, too. Norms would charge every column with the largest one, and of teams
    of alike agents columns that weigh nearly nothing are the largest.
    """
    rows = [np.ones(1) if head is None else head]
    for core in cores:
        rows.append(np.tensordot(rows[-1], np.abs(core), axes=1).max(axis=0, initial=0.0) * (1 + 1e-12))
    return rows
