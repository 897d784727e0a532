"""Occupancy-weighted coordinate ascent on tensor trains, for tasks whose value trees grow too many terms.

The same best response as in ``ascent``: with the alive mass at time t in state q as a train M and the value of arriving
as a train W, agent i's objective at cell s is linear in its own core of W,

    sum_{c,d} omega_cd(s) (P_u W_i[c, ., d])(s),    omega_cd(s) = sum_{a,b} L[a, c] M_i[a, s, b] R[b, d] ,

with L and R the contractions of M with the expected W of the agents before and after i. Trains that only steer the
search carry no certificate: the mass is cut at ``MASS``, the objectives at ``COLUMNS`` combinations per agent. What is
reported comes from ``train_value.evaluate`` with the policies frozen.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from ..cells import FloatArray
from ..models import AgentModel, JointModel, Policies, StepPolicy
from ..values import (
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
from .best_response import best_choices
from .train_backward import backward, expected

MASS = 1e-4
"""Share of the root mean square of the alive mass at which its bonds are cut."""

MASS_RANK = 30
"""Most columns of the alive mass."""

COLUMNS = 48
"""Most combinations of objectives that an agent's decision is made with."""

MET = 1e-7
"""Share of the largest marginal mass from which a cell counts as met."""

Masses = tuple[Train | None, ...]
"""Alive mass per automaton state; None where there is none."""


@dataclass(frozen=True, eq=False)
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

    @property
    def dropped(self) -> float:
        """Upper bound on what rounding took from ``value`` or added to it; cells that were left out do not count."""
        return self.terms.error


def sweep_trains(
    joint: JointModel,
    policies: Policies,
    start: Occupancy,
    tolerance: float,
    *,
    improve: bool,
    weighted: bool = True,
    share: float = 1e-6,
    margin: int = 0,
    watch: Callable[[float], None] | None = None,
) -> TrainSweep:
    """One pass: alive mass forward under ``policies``, value backward, every agent answering on the way if ``improve``.

    Parameters
    ----------
    joint : JointModel
    policies : Policies
    start : Occupancy
    tolerance : float
        What rounding may change of the value in all, in the sup norm.
    improve : bool
        Whether the agents answer; otherwise the policies stay as they are.
    weighted : bool
        Whether answers are weighed by the alive mass; otherwise all joint cells count alike.
    share : float
        Share of the mass of each step that may lie on cells which are left out.
    margin : int
        Cells around the others that are not left out either.
    watch : callable, optional
        Told, for every time and automaton state, what one agent alone could gain there (``gain``).
    """
    ways = routes(joint.guards, joint.masks, joint.n_states)
    masses: list[Masses] = [(None,) * joint.n_states] * joint.horizon
    visited: list[Cells] | None = None
    if weighted:
        masses, found = forward_trains(joint, ways, policies, start, share)
        visited = [_around(joint.models, own, margin) for own in found]
    better = tuple(policy.copy() for policy in policies) if improve else policies
    ranks = [0]

    def choose(t: int, q: int, arriving: Train) -> Sequence[StepPolicy]:
        own = [policy[t, q] for policy in better]
        if improve:
            own = answers(joint.models, arriving, masses[t][q], own)
            for policy, one in zip(better, own, strict=True):
                policy[t, q] = one
        here = masses[t][q]
        if watch is not None and here is not None:
            watch(gain(joint.models, arriving, here, own))
        return own

    value = backward(joint, ways, choose, tolerance, lambda t, each: ranks.append(each.rank), visited)
    everywhere: list[Cells] = [None] * (joint.horizon + 1)
    rounding = Rounding(tolerance, tuple(everywhere if visited is None else visited))
    return TrainSweep(better, start_value(start, value), value, max(ranks), rounding)


def forward_trains(
    joint: JointModel, ways: Routes, policies: Policies, start: Occupancy, share: float
) -> tuple[list[Masses], list[Cells]]:
    """Alive mass at times 0 .. T - 1, and the cells that hold all but ``share`` of where agents arrive, 0 .. T."""
    masses: Masses = tuple(_of_terms(start, q) for q in range(joint.n_states))
    cells = _holding([m for m in masses if m is not None], joint.n_cells, share)
    masses = tuple(None if m is None else _restricted(m, cells) for m in masses)
    found: list[Masses] = [masses]
    visited: list[Cells] = [cells]
    for t in range(joint.horizon):
        arriving = {}
        for q, train in enumerate(found[-1]):
            if train is not None and not joint.absorbing[q]:
                arriving[q] = _pushed(train, joint.models, [policy[t, q] for policy in policies])
        cells = _holding(list(arriving.values()), joint.n_cells, share)
        visited.append(cells)
        if t == joint.horizon - 1:
            break
        parts: list[list[tuple[Train, Diagram]]] = [[] for _ in masses]
        for q, pushed in arriving.items():
            here = _restricted(pushed, cells)
            for p, d in ways[q]:
                if not joint.absorbing[p]:
                    parts[p].append((here, d))
        found.append(tuple(rounded(own, 0.0, MASS, MASS_RANK) if own else None for own in parts))
    return found, visited


def _pushed(train: Train, models: Sequence[AgentModel], policies: Sequence[StepPolicy]) -> Train:
    """Mass one step later, before its letter is read, over all cells."""
    cores = []
    for i, (core, model, policy) in enumerate(zip(train.cores, models, policies, strict=True)):
        spread = model.kernel.push(core_rows(train, i, model.n_cells), model.choices.points(policy))
        cores.append(np.ascontiguousarray(np.moveaxis(spread.reshape(core.shape[0], core.shape[2], -1), 2, 1)))
    return Train(tuple(cores))


def _holding(trains: Sequence[Train], n_cells: Sequence[int], share: float) -> tuple[NDArray[Any], ...]:
    """Cells of each agent that hold all but ``share`` of its mass, summed over trains."""
    marginals = [np.zeros(n) for n in n_cells]
    for train in trains:
        after = [np.ones(1)]
        for core in reversed(train.cores[1:]):
            after.append(core.sum(axis=1) @ after[-1])
        before = np.ones(1)
        for own, core, rest in zip(marginals, train.cores, after[::-1], strict=True):
            own += np.abs(np.tensordot(before, core, axes=1) @ rest)
            before = before @ core.sum(axis=1)
    cells = []
    for own in marginals:
        order = np.argsort(own, kind="stable")
        few = int(np.sum(np.cumsum(own[order]) <= share * own.sum()))
        cells.append(np.sort(order[min(few, len(own) - 1) :]))
    return tuple(cells)


def _around(models: Sequence[AgentModel], cells: Cells, margin: int) -> Cells:
    """Cells within ``margin`` cells of the given ones."""
    if cells is None or margin == 0:
        return cells
    found = []
    for model, own in zip(models, cells, strict=True):
        near = np.zeros(model.n_cells, dtype=bool)
        near[own] = True
        near = ndimage.maximum_filter(near.reshape(model.grid.shape), size=2 * margin + 1)
        found.append(np.flatnonzero(near))
    return tuple(found)


def _restricted(train: Train, cells: tuple[NDArray[Any], ...]) -> Train:
    """A train over all cells, on some of them."""
    cores = tuple(np.ascontiguousarray(core[:, own]) for core, own in zip(train.cores, cells, strict=True))
    return Train(cores, train.error, cells)


def answers(
    models: Sequence[AgentModel], arriving: Train, mass: Train | None, policies: Sequence[StepPolicy]
) -> list[StepPolicy]:
    """Laws of all agents for one time and automaton state, each agent answering once, in order.

    Cells that the mass does not meet are weighed as if the other agents might be anywhere.
    """
    policies = list(policies)
    cores = [
        expected(arriving, i, model, policy) for i, (model, policy) in enumerate(zip(models, policies, strict=True))
    ]
    after, rest = _after(cores, mass)
    before, first = np.ones((1, 1)), np.ones(1)
    for i, model in enumerate(models):
        table = core_rows(arriving, i, model.n_cells)
        weights = np.broadcast_to(np.outer(first, rest[i]).ravel(), (model.n_cells, len(table)))
        policies[i] = best_choices(
            model.choices, np.ones((model.n_cells, 1)), model.kernel.smooth(weights[:1] @ table), policies[i]
        )
        if mass is not None:
            met, seen = _seen(mass, i, before, after[i])
            if len(met):
                policies[i] = _answer(model, met, seen, table, policies[i])
        cores[i] = expected(arriving, i, model, policies[i])
        first = first @ cores[i].mean(axis=1)
        if mass is not None:
            onward = np.tensordot(before, _read_at(mass, i, cores[i]), axes=(1, 0))
            before = np.tensordot(mass.cores[i], onward, axes=((0, 1), (0, 1)))
    return policies


def gain(models: Sequence[AgentModel], arriving: Train, mass: Train, policies: Sequence[StepPolicy]) -> float:
    """Most that one agent alone could add to the value at the start by other choices at one time and automaton state.

    As exact as the mass is, which is cut at ``MASS``.
    """
    cores = [
        expected(arriving, i, model, policy) for i, (model, policy) in enumerate(zip(models, policies, strict=True))
    ]
    after, _ = _after(cores, mass)
    before, most = np.ones((1, 1)), 0.0
    for i, (model, policy) in enumerate(zip(models, policies, strict=True)):
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
    """Per agent, what the agents after it contribute: with the mass (b, d), and averaged over all cells (d,)."""
    after, rest = [np.ones((1, 1))], [np.ones(1)]
    for i in reversed(range(1, len(cores))):
        rest.append(cores[i].mean(axis=1) @ rest[-1])
        if mass is not None:
            onward = np.tensordot(_read_at(mass, i, cores[i]), after[-1], axes=(2, 1))
            after.append(np.tensordot(mass.cores[i], onward, axes=((1, 2), (1, 2))))
    return after[::-1], rest[::-1]


def _read_at(mass: Train, i: int, core: Core) -> Core:
    """Matrices of agent i at the cells that the mass covers."""
    return core if mass.cells is None else core[:, mass.cells[i]]


def _seen(mass: Train, i: int, before: FloatArray, after: FloatArray) -> tuple[NDArray[np.int64], FloatArray]:
    """Cells (n,) that the mass meets, and the weights (n, c d) of the objectives there, scaled to length 1."""
    weights = np.tensordot(np.tensordot(before, mass.cores[i], axes=(0, 0)), after, axes=(2, 0))
    weights = np.moveaxis(weights, 1, 0).reshape(mass.cores[i].shape[1], -1)
    size = np.linalg.norm(weights, axis=1)
    met = np.flatnonzero(size > MET * size.max(initial=0.0))
    seen = weights[met] / size[met, None]
    return (met if mass.cells is None else mass.cells[i][met]), seen


def _answer(
    model: AgentModel, met: NDArray[np.int64], seen: FloatArray, table: FloatArray, policy: StepPolicy
) -> StepPolicy:
    """Best choices at the met cells, the others as they are."""
    if seen.shape[1] > COLUMNS:
        draws = np.random.default_rng(20251106).standard_normal((len(seen), min(len(seen), COLUMNS)))
        basis, _ = np.linalg.qr(seen.T @ (seen @ (seen.T @ draws)))
        seen, table = seen @ basis, basis.T @ table
    weights = np.zeros((model.n_cells, seen.shape[1]))
    weights[met] = seen
    better = best_choices(model.choices, weights, model.kernel.smooth(table), policy)
    answer = policy.copy()
    answer[met] = better[met]
    return answer


def _of_terms(occupancy: Occupancy, q: int) -> Train | None:
    """The alive mass of one state as a train: one column per term."""
    rows = occupancy.terms.index[q]
    if not len(rows):
        return None
    columns = [own[rows[:, i]] for i, own in enumerate(occupancy.terms.factors)]
    cores = []
    for i, own in enumerate(columns):
        core = np.zeros((len(rows), own.shape[1], len(rows)))
        core[np.arange(len(rows)), :, np.arange(len(rows))] = own
        core = core.sum(axis=0, keepdims=True) if i == 0 else core
        cores.append(core.sum(axis=2, keepdims=True) if i == len(columns) - 1 else core)
    return Train(tuple(cores))
