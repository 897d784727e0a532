"""Occupancy-weighted coordinate ascent on tensor trains, for tasks whose value trees grow too many terms.

The best response is that of ``ascent`` (docs/theory/tree.md, "Policies: occupancy-weighted ascent"). With the alive
mass at time t in state q as a train M and the value of arriving as a train W, agent i's objective at cell s is linear
in its own core of W,

    sum_{c,d} omega_cd(s) (P_u W_i[c, ., d])(s),    omega_cd(s) = sum_{a,b} L[a, c] M_i[a, s, b] R[b, d] ,

with L and R the contractions of M with the expected W of the agents before and after i. Trains that only steer the
search carry no certificate: the mass is cut at ``MASS_CUT``, the objectives at ``MOST_OBJECTIVES`` combinations per
agent. What is reported is the value of a sweep with frozen policies, which rests on neither.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from ....envs.systems.arguments import tree_text
from ...abstraction.models import AgentModel, JointModel, Policies, StepPolicy
from ...certificates.value_functions import (
    Cells,
    Core,
    Diagram,
    Occupancy,
    Rounding,
    Routes,
    Train,
    Trains,
    core_rows,
    rounded,
    routes,
    start_value,
)
from ...relations.grids import FloatArray
from .coordinate_ascent import policies_text
from .train_backward import backward, expected

MASS_CUT = 1e-4
"""Share of the root mean square of the alive mass at which its bonds are cut."""

MASS_RANK = 30
"""Most columns of the alive mass."""

MOST_OBJECTIVES = 48
"""Most combinations of objectives that an agent's decision is made with."""

MET_SHARE = 1e-7
"""Share of the largest weight of a cell from which a cell counts as met."""

SKETCH_SEED = 20251106
"""Seed of the random combinations from which the most important objectives are found."""

Masses = tuple[Train | None, ...]
"""Alive mass per automaton state; None where there is none."""


@dataclass(frozen=True, eq=False, repr=False)
class TrainSweep:
    """Policies and their value at the start.

    Parameters
    ----------
    policies : Policies
    value : float
        Value at the start, as computed: within ``terms.error`` of that of the abstraction.
    terms : Trains
        Value function at time 0.
    rank : int
        Largest number of columns of a bond at any time.
    rounding : Rounding
        What was left out, enough to evaluate the same policies again.
    stationary : bool
        Whether the policies are the same at all times, held once for all of them.
    """

    policies: Policies
    value: float
    terms: Trains
    rank: int
    rounding: Rounding
    stationary: bool = False

    def __repr__(self) -> str:
        rows: list[tuple[str, object]] = [
            ("error", f"at most {self.dropped:.2g}"),
            ("rank", self.rank),
            ("policies", policies_text(self.policies, self.stationary)),
            ("terms", self.terms),
            ("rounding", self.rounding),
        ]
        return tree_text(f"TrainSweep: value {self.value:.6g}, its error not taken off", rows)

    @property
    def dropped(self) -> float:
        """Upper bound on what rounding took from ``value`` or added to it; cells that were left out do not count."""
        return self.terms.error


@dataclass(frozen=True)
class TrainLimits:
    """How much a sweep over trains may change and leave out.

    Parameters
    ----------
    tolerance : float
        What rounding may change of the value in all, in the sup norm.
    share : float
        Share of the mass of each step that may lie on cells which are left out.
    margin : int
        Cells around the others that are not left out either.
    """

    tolerance: float
    share: float = 1e-6
    margin: int = 0


def sweep_trains(
    joint: JointModel,
    policies: Policies,
    start: Occupancy,
    limits: TrainLimits,
    *,
    improve: bool,
    watch: Callable[[float], None] | None = None,
) -> TrainSweep:
    """Make one pass: alive mass forward under ``policies``, value backward; every agent answers if ``improve``.

    The value is within its error of that of the abstraction, in which runs that leave the visited cells have failed.

    Parameters
    ----------
    joint : JointModel
    policies : Policies
    start : Occupancy
    limits : TrainLimits
    improve : bool
        Whether the agents answer; otherwise the policies stay as they are.
    watch : callable, optional
        Told, for every time and automaton state, what one agent alone could gain there (``gain``).
    """
    ways = routes(joint.guards, joint.masks, joint.n_states)
    # Forward: the mass that decisions are weighed with, and the cells that hold nearly all of it.
    masses, held = forward_trains(joint, ways, policies, start, limits.share)
    visited = [_around(joint.models, cells, limits.margin) for cells in held]
    improved = tuple(policy.copy() for policy in policies) if improve else policies
    ranks = [0]

    def choose(t: int, q: int, arriving: Train) -> Sequence[StepPolicy]:
        """Return the policies of a time and state, improved if they are to be."""
        current = [policy[t, q] for policy in improved]
        if improve:
            current = answers(joint.models, arriving, masses[t][q], current)
            for policy, answer in zip(improved, current, strict=True):
                policy[t, q] = answer
        here = masses[t][q]
        if watch is not None and here is not None:
            watch(gain(joint.models, arriving, here, current))
        return current

    # Backward: every answer becomes part of the value of the time before.
    value = backward(joint, ways, choose, limits.tolerance, lambda t, trains: ranks.append(trains.rank), visited)
    rounding = Rounding(limits.tolerance, tuple(visited))
    return TrainSweep(improved, start_value(start, value), value, max(ranks), rounding)


def forward_trains(
    joint: JointModel, ways: Routes, policies: Policies, start: Occupancy, share: float
) -> tuple[list[Masses], list[Cells]]:
    """Return the alive mass at times 0 .. T - 1, and cells that hold all but ``share`` of the arrivals, 0 .. T.

    The mass is cut to small rank and only steers the search; the cells are a choice that no bound depends on.
    """
    masses: Masses = tuple(_of_terms(start, q) for q in range(joint.n_states))
    cells = _holding([train for train in masses if train is not None], joint.n_cells, share)
    masses = tuple(None if train is None else _restricted(train, cells) for train in masses)
    by_time: list[Masses] = [masses]
    visited: list[Cells] = [cells]
    for t in range(joint.horizon):
        # Push the mass of every undecided state through the kernels.
        arriving = {}
        for q, train in enumerate(by_time[-1]):
            if train is not None and not joint.absorbing[q]:
                arriving[q] = _pushed(train, joint.models, [policy[t, q] for policy in policies])
        cells = _holding(list(arriving.values()), joint.n_cells, share)
        visited.append(cells)
        if t == joint.horizon - 1:
            break
        # Read the letters: the mass in p is the masked sum of what comes from all q, cut to small rank.
        summands: list[list[tuple[Train, Diagram]]] = [[] for _ in masses]
        for q, propagated in arriving.items():
            here = _restricted(propagated, cells)
            for p, d in ways[q]:
                if not joint.absorbing[p]:
                    summands[p].append((here, d))
        by_time.append(tuple(rounded(parts, 0.0, MASS_CUT, MASS_RANK) if parts else None for parts in summands))
    return by_time, visited


def _pushed(train: Train, models: Sequence[AgentModel], policies: Sequence[StepPolicy]) -> Train:
    """Return the mass one step later, before its letter is read, over all cells."""
    cores = []
    for i, (core, model, policy) in enumerate(zip(train.cores, models, policies, strict=True)):
        spread = model.kernel.propagate(core_rows(train, i, model.n_cells), model.choices.points(policy))
        cores.append(np.ascontiguousarray(np.moveaxis(spread.reshape(core.shape[0], core.shape[2], -1), 2, 1)))
    return Train(tuple(cores))


def _holding(trains: Sequence[Train], n_cells: Sequence[int], share: float) -> tuple[NDArray[Any], ...]:
    """Return the cells of each agent that hold all but ``share`` of its mass, summed over trains."""
    # Marginals: the other agents' cores summed over their cells, from both sides.
    marginals = [np.zeros(n) for n in n_cells]
    for train in trains:
        after = [np.ones(1)]
        for core in reversed(train.cores[1:]):
            after.append(core.sum(axis=1) @ after[-1])
        before = np.ones(1)
        for marginal, core, behind in zip(marginals, train.cores, after[::-1], strict=True):
            marginal += np.abs(np.tensordot(before, core, axes=1) @ behind)
            before = before @ core.sum(axis=1)
    cells = []
    for marginal in marginals:
        order = np.argsort(marginal, kind="stable")
        n_left_out = int(np.sum(np.cumsum(marginal[order]) <= share * marginal.sum()))
        cells.append(np.sort(order[min(n_left_out, len(marginal) - 1) :]))
    return tuple(cells)


def _around(models: Sequence[AgentModel], cells: Cells, margin: int) -> Cells:
    """Return the cells within ``margin`` cells of the given ones."""
    if cells is None or margin == 0:
        return cells
    widened = []
    for model, agent_cells in zip(models, cells, strict=True):
        near = np.zeros(model.n_cells, dtype=bool)
        near[agent_cells] = True
        near = ndimage.maximum_filter(near.reshape(model.grid.shape), size=2 * margin + 1)
        widened.append(np.flatnonzero(near))
    return tuple(widened)


def _restricted(train: Train, cells: tuple[NDArray[Any], ...]) -> Train:
    """Return a train over all cells, restricted to some of them."""
    cores = tuple(np.ascontiguousarray(core[:, kept]) for core, kept in zip(train.cores, cells, strict=True))
    return Train(cores, train.error, cells)


def answers(
    models: Sequence[AgentModel], arriving: Train, mass: Train | None, policies: Sequence[StepPolicy]
) -> list[StepPolicy]:
    """Return the policies of all agents for one time and automaton state, each agent answering once, in order.

    Cells that the mass does not meet are weighed as if the other agents might be anywhere.
    """
    policies = list(policies)
    agents = list(zip(models, policies, strict=True))
    cores = [expected(arriving, i, model, policy) for i, (model, policy) in enumerate(agents)]
    after, behind = _after(cores, mass)
    before, ahead = np.ones((1, 1)), np.ones(1)
    for i, model in enumerate(models):
        # First for all cells, the others averaged over all of theirs: a single objective.
        table = core_rows(arriving, i, model.n_cells)
        weights = np.broadcast_to(np.outer(ahead, behind[i]).ravel(), (model.n_cells, len(table)))
        backed_up = model.kernel.backup(weights[:1] @ table)
        policies[i] = model.choices.best(np.ones((model.n_cells, 1)), backed_up, policies[i])
        # Then again for the cells that the mass meets, with omega.
        if mass is not None:
            met, seen = _seen(mass, i, before, after[i])
            if len(met):
                policies[i] = _answer(model, met, seen, table, policies[i])
        # The next agents answer to what this one does now.
        cores[i] = expected(arriving, i, model, policies[i])
        ahead = ahead @ cores[i].mean(axis=1)
        if mass is not None:
            onward = np.tensordot(before, _read_at(mass, i, cores[i]), axes=(1, 0))
            before = np.tensordot(mass.cores[i], onward, axes=((0, 1), (0, 1)))
    return policies


def gain(models: Sequence[AgentModel], arriving: Train, mass: Train, policies: Sequence[StepPolicy]) -> float:
    """Return the largest increase of the start value if one agent changes its choices here (an estimate).

    It is as exact as the mass, which is cut at ``MASS_CUT``.
    """
    agents = list(zip(models, policies, strict=True))
    cores = [expected(arriving, i, model, policy) for i, (model, policy) in enumerate(agents)]
    after, _ = _after(cores, mass)
    before, most = np.ones((1, 1)), 0.0
    for i, (model, policy) in enumerate(agents):
        met, seen = _seen(mass, i, before, after[i])
        if len(met):
            better = _answer(model, met, seen, core_rows(arriving, i, model.n_cells), policy)
            added = _read_at(mass, i, expected(arriving, i, model, better) - cores[i])
            weights = np.tensordot(np.tensordot(before, mass.cores[i], axes=(0, 0)), after[i], axes=(2, 0))
            most = max(most, float(np.sum(np.moveaxis(weights, 1, 0) * np.moveaxis(added, 1, 0))))
        onward = np.tensordot(before, _read_at(mass, i, cores[i]), axes=(1, 0))
        before = np.tensordot(mass.cores[i], onward, axes=((0, 1), (0, 1)))
    return most


def _after(cores: Sequence[Core], mass: Train | None) -> tuple[list[FloatArray], list[FloatArray]]:
    """Return, per agent, what the agents after it contribute: with the mass (b, d), and averaged over cells (d,)."""
    after, behind = [np.ones((1, 1))], [np.ones(1)]
    for i in reversed(range(1, len(cores))):
        behind.append(cores[i].mean(axis=1) @ behind[-1])
        if mass is not None:
            onward = np.tensordot(_read_at(mass, i, cores[i]), after[-1], axes=(2, 1))
            after.append(np.tensordot(mass.cores[i], onward, axes=((1, 2), (1, 2))))
    return after[::-1], behind[::-1]


def _read_at(mass: Train, i: int, core: Core) -> Core:
    """Return the matrices of agent i at the cells that the mass covers."""
    return core if mass.cells is None else core[:, mass.cells[i]]


def _seen(mass: Train, i: int, before: FloatArray, after: FloatArray) -> tuple[NDArray[np.int64], FloatArray]:
    """Return the cells (n,) that the mass meets, and the weights (n, c d) of the objectives there, of length 1."""
    weights = np.tensordot(np.tensordot(before, mass.cores[i], axes=(0, 0)), after, axes=(2, 0))
    weights = np.moveaxis(weights, 1, 0).reshape(mass.cores[i].shape[1], -1)
    size = np.linalg.norm(weights, axis=1)
    met = np.flatnonzero(size > MET_SHARE * size.max(initial=0.0))
    seen = weights[met] / size[met, None]
    return (met if mass.cells is None else mass.cells[i][met]), seen


def _answer(
    model: AgentModel, met: NDArray[np.int64], seen: FloatArray, table: FloatArray, policy: StepPolicy
) -> StepPolicy:
    """Return the policy with the best choices at the met cells, and the others as they are."""
    # Too many objectives: keep the combinations that the weights span most of, found by a randomised factorisation
    # with one power iteration.
    if seen.shape[1] > MOST_OBJECTIVES:
        draws = np.random.default_rng(SKETCH_SEED).standard_normal((len(seen), min(len(seen), MOST_OBJECTIVES)))
        basis, _ = np.linalg.qr(seen.T @ (seen @ (seen.T @ draws)))
        seen, table = seen @ basis, basis.T @ table
    weights = np.zeros((model.n_cells, seen.shape[1]))
    weights[met] = seen
    better = model.choices.best(weights, model.kernel.backup(table), policy)
    answer = policy.copy()
    answer[met] = better[met]
    return answer


def _of_terms(occupancy: Occupancy, q: int) -> Train | None:
    """Return the alive mass of one state as a train with one column per term (exact)."""
    rows = occupancy.terms.index[q]
    if not len(rows):
        return None
    columns = [factors[rows[:, i]] for i, factors in enumerate(occupancy.terms.factors)]
    cores = []
    for i, masses in enumerate(columns):
        core = np.zeros((len(rows), masses.shape[1], len(rows)))
        core[np.arange(len(rows)), :, np.arange(len(rows))] = masses
        core = core.sum(axis=0, keepdims=True) if i == 0 else core
        cores.append(core.sum(axis=2, keepdims=True) if i == len(columns) - 1 else core)
    return Train(tuple(cores))
