"""The value function as tensor trains: the same recursion as ``value``, rounded to small rank with a certified error.

With W the masked sum of the successors' trains, ``W_q = sum_q' 1[the letter leads q to q'] V_q',t``, one step back is

    V_q,t+1 = (P_1^pi x .. x P_I^pi) W_q .

Kernels and gathers act on one core each and are contractions in the sup norm, so an error stays what it was:
``err_q,t+1 = max over successors q' of err_q',t + what rounding W_q changed`` (THEORY section 8), floating point
included. A certified value is the computed one less the error; in the exact case it is also at most that much below.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .abstraction import AgentModel
from .ascent import Laws
from .choices import Law
from .guards import Guards
from .joint import JointModel
from .kernel import UNIT
from .occupancy import Occupancy
from .train import Cells, Core, Diagram, Train, added, diagram, frobenius_sup, ones, rounded

ROWS = 256
"""Rows of a core that are smoothed at once."""

Smooth = Callable[[NDArray[np.float64]], NDArray[np.float64]]
"""Expected values (n, Z) of rows (n, S) at every lattice point."""


@dataclass(frozen=True, eq=False)
class Trains:
    """Value function of every automaton state as a train; None where it is 0.

    Parameters
    ----------
    states : tuple of Train or None
        Each holds a function f with ``|f - V_q| <= error``; reading it costs up to ``spread`` more.
    """

    states: tuple[Train | None, ...]

    @property
    def rank(self) -> int:
        """Largest number of columns of a bond."""
        return max((train.rank for train in self.states if train is not None), default=0)

    @property
    def error(self) -> float:
        """Largest error of a state, that of reading it included."""
        return max((train.error + train.spread for train in self.states if train is not None), default=0.0)

    def work(self, q: int) -> int:
        """Numbers held per joint cell in ``at``, which takes joint cells in parts itself."""
        return 1

    def at(self, q: int, cells: NDArray[np.integer]) -> NDArray[np.float64]:
        """Lower bounds (M,) on the value at joint cells (M, I): computed values less their error, at least 0."""
        train = self.states[q]
        if train is None:
            return np.zeros(len(cells))
        return np.maximum(0.0, train.at(cells) - (train.error + train.spread))


@dataclass(frozen=True, eq=False)
class Rounding:
    """How a value function was rounded, enough to grow it again.

    Parameters
    ----------
    tolerance : float
        What rounding may have changed in all, in the sup norm.
    visited : tuple of Cells
        Cells of each agent at times 0 .. T outside which a run counts as failed; None for all of them.
    """

    tolerance: float
    visited: tuple[Cells, ...]


@dataclass(frozen=True, eq=False)
class Unread:
    """Value before the first letter is read.

    Parameters
    ----------
    value : Trains
        Value function at time 0.
    target : (G,) int array
        Automaton state that each start guard leads to.
    mask : (G, I) int array
        Factor of each agent in each start guard.
    masks : tuple of (K_i, S_i) arrays
        Those factors.
    """

    value: Trains
    target: NDArray[np.integer]
    mask: NDArray[np.integer]
    masks: tuple[NDArray, ...]

    def work(self, q: int) -> int:
        """Numbers held per joint cell in ``at``."""
        return len(self.target)

    def total(self, q: int, weights: Sequence[NDArray]) -> float:
        """Lower bound on the mean value under weights (S_i,) per agent."""
        total = 0.0
        for target, mask in zip(self.target, self.mask, strict=True):
            train = self.value.states[int(target)]
            if train is not None:
                shares = [own[m] * w for own, m, w in zip(self.masks, mask, weights, strict=True)]
                mass = float(np.prod([own.sum() for own in shares]))
                total += max(0.0, train.total(shares) - (train.error + train.spread) * mass * (1 + 1e-12))
        return total

    def at(self, q: int, cells: NDArray[np.integer]) -> NDArray[np.float64]:
        """Lower bounds (M,) at joint cells (M, I)."""
        values = np.zeros(len(cells))
        for target, mask in zip(self.target, self.mask, strict=True):
            inside = np.ones(len(cells), dtype=bool)
            for i, own in enumerate(self.masks):
                inside &= own[mask[i]][cells[:, i]] > 0
            values[inside] = self.value.at(int(target), cells[inside])
        return values


Routes = tuple[tuple[tuple[int, Diagram], ...], ...]
"""Per automaton state: its successors, and the joint cells that lead to each."""


def routes(guards: Guards, masks: Sequence[NDArray], n_states: int) -> Routes:
    """Diagrams of the joint cells that lead from each automaton state to each of its successors."""
    found = []
    for q in range(n_states):
        own = guards.source == q
        targets = sorted({int(target) for target in guards.target[own]})
        found.append(tuple((p, diagram(masks, guards.mask[own & (guards.target == p)])) for p in targets))
    return tuple(found)


def terminal(joint: JointModel, cells: Cells = None) -> Trains:
    """Value with no step to go."""
    return Trains(tuple(ones(joint.n_cells, cells) if accepted else None for accepted in joint.accepting))


def arrival(value: Trains, successors: Sequence[tuple[int, Diagram]], tolerance: float) -> Train | None:
    """Value of arriving in each joint cell, its letter read: the masked sum of the successors, rounded."""
    parts = [(train, d) for p, d in successors if (train := value.states[p]) is not None]
    return rounded(parts, tolerance) if parts else None


def moved(arriving: Train, models: Sequence[AgentModel], laws: Sequence[Law], cells: Cells = None) -> Train:
    """Expected value one step before arriving, under one law per agent, at the given cells (all by default)."""
    where = [None] * len(models) if cells is None else cells
    cores = [expected(arriving, i, *own) for i, own in enumerate(zip(models, laws, where, strict=True))]
    return assembled(arriving, cores, [model.kernel.shape for model in models], cells)


def assembled(arriving: Train, cores: Sequence[Core], shapes: Sequence[Sequence[int]], cells: Cells) -> Train:
    """Train of expected cores, charged with the rounding of sums over ``shapes[i]`` cells per axis of each agent."""
    operations = 4 + sum(sum(shape) + 4 * len(shape) for shape in shapes)
    operations += sum(core.shape[2] for core in arriving.cores)
    scale = float(np.prod([frobenius_sup(core) for core in arriving.cores]))
    return Train(tuple(cores), arriving.error + 2.0 * operations * UNIT * scale, cells)


def expected(arriving: Train, i: int, model: AgentModel, law: Law, at: NDArray[np.integer] | None = None) -> Core:
    """Expected matrices (r, n, r') of agent i under a law (S,), at n cells; 0 where there is no choice."""
    points = model.choices.points(law)
    return smoothed_core(arriving, i, model.n_cells, points if at is None else points[at], model.kernel.smooth)


def smoothed_core(arriving: Train, i: int, n_cells: int, points: NDArray[np.integer], smooth: Smooth) -> Core:
    """Matrices (r, n, r') of agent i, ``smooth`` of its rows over all cells read at n points; 0 where there is none."""
    rows = core_rows(arriving, i, n_cells)
    values = np.empty((len(rows), len(points)))
    for first in range(0, len(rows), ROWS):
        values[first : first + ROWS] = smooth(rows[first : first + ROWS])[:, np.maximum(points, 0)]
    values[:, points < 0] = 0.0
    shape = (arriving.cores[i].shape[0], arriving.cores[i].shape[2], len(points))
    return np.ascontiguousarray(np.moveaxis(values.reshape(shape), 2, 1))


def core_rows(train: Train, i: int, n_cells: int) -> NDArray[np.float64]:
    """(r r', S) one row for each entry of agent i's matrices, over all cells."""
    core = np.moveaxis(train.cores[i], 1, 2)
    if train.cells is None:
        return np.ascontiguousarray(core).reshape(-1, n_cells)
    rows = np.zeros((core.shape[0] * core.shape[1], n_cells))
    rows[:, train.cells[i]] = core.reshape(len(rows), -1)
    return rows


Choose = Callable[[int, int, Train], Sequence[Law]]
"""Laws of all agents, given the time, the automaton state and the value of arriving."""


def backward(
    joint: JointModel,
    ways: Routes,
    choose: Choose,
    tolerance: float,
    each: Callable[[int, Trains], None] | None = None,
    visited: Sequence[Cells] | None = None,
    beside: Callable[[int, int], Train | None] | None = None,
) -> Trains:
    """Value function at time 0 under the laws that ``choose`` gives, rounded by at most ``tolerance`` in all.

    ``each(t, value)`` is called with the value function at every time t = T - 1 .. 0. With ``visited``, the cells at
    times 0 .. T, a run that leaves them counts as failed: a lower bound still, with far less to be rounded.
    ``beside(t, q)`` is added to the value of a step where acceptance can still be reached (see ``train_above``).
    """
    where = [None] * (joint.horizon + 1) if visited is None else visited
    value = terminal(joint, where[-1])
    share = tolerance / max(1, joint.horizon)
    for t in reversed(range(joint.horizon)):
        states: list[Train | None] = []
        for q in range(joint.n_states):
            if joint.absorbing[q]:
                states.append(ones(joint.n_cells, where[t]) if joint.accepting[q] else None)
                continue
            arriving = arrival(value, ways[q], share)
            if arriving is None:
                states.append(None)
                continue
            own = moved(arriving, joint.models, choose(t, q, arriving), where[t])
            states.append(added(own, None if beside is None else beside(t, q)))
        value = Trains(tuple(states))
        if each is not None:
            each(t, value)
    return value


def evaluate(
    joint: JointModel,
    laws: Laws,
    tolerance: float,
    each: Callable[[int, Trains], None] | None = None,
    visited: Sequence[Cells] | None = None,
) -> Trains:
    """Value function at time 0 of given policies; see ``backward``."""
    ways = routes(joint.guards, joint.masks, joint.n_states)
    return backward(joint, ways, lambda t, q, _: [law[t, q] for law in laws], tolerance, each, visited)


def start_value(start: Occupancy, value: Trains) -> float:
    """``sum_q <mu_0,q , V_q>`` as computed; within ``value.error`` of the truth, since the masses sum to 1."""
    total = 0.0
    for q, rows in enumerate(start.terms.index):
        train = value.states[q]
        if train is not None:
            for row in rows:
                total += train.total([own[k] for own, k in zip(start.terms.factors, row, strict=True)])
    return total
