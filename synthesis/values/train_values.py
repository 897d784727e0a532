"""Value functions of all automaton states as tensor trains, and the steps from one time to the one before."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .devices import UNIT
from .tensor_train import Cells, Core, Diagram, Train, diagram, frobenius_sup, rounded
from .terms import Guards, Occupancy


def counted_as_failed(
    points: Sequence[NDArray[np.integer]], smooth: Sequence[Smooth], n_cells: Sequence[int], here: Cells, there: Cells
) -> Train | None:
    """Probability, per joint cell, of what a lower bound counts as failed in one step; None if there is none.

    Parameters
    ----------
    points : sequence of (S_i,) int arrays
        Lattice points that the choices lead to; -1 where there is none.
    smooth : sequence of callables
        Expected values of rows (n, S_i) at every lattice point.
    n_cells : sequence of int
    here, there : Cells
        Visited cells now, which the result covers, and one step later.
    """
    own = list(points) if here is None else [p[cells] for p, cells in zip(points, here, strict=True)]
    columns: list[list[NDArray[np.float64]]] = []
    if any(np.any(p < 0) for p in own):
        valid = [(p >= 0).astype(float) for p in own]
        columns += [[np.ones(len(p)) for p in own], [-valid[0], *valid[1:]]]
    if there is not None and any(len(cells) < n for cells, n in zip(there, n_cells, strict=True)):
        rates = []
        for p, push, n, cells in zip(own, smooth, n_cells, there, strict=True):
            rows = np.ones((2, n))
            rows[1] = 0.0
            rows[1, cells] = 1.0
            rates.append(np.where(p >= 0, push(rows)[:, np.maximum(p, 0)], 0.0))
        columns += [[anywhere for anywhere, _ in rates], [-rates[0][1], *(visited for _, visited in rates[1:])]]
    if not columns:
        return None
    operations = 4 * len(columns) * (len(own) + 2 * sum(n_cells))
    cores = tuple(_diagonal([column[i] for column in columns], i, len(own)) for i in range(len(own)))
    return Train(cores, operations * UNIT, here)


def _diagonal(rows: list[NDArray[np.float64]], i: int, n_agents: int) -> Core:
    """Core of agent i of a sum of products with factors ``rows``."""
    core = np.zeros((len(rows), len(rows[0]), len(rows)))
    core[np.arange(len(rows)), :, np.arange(len(rows))] = np.asarray(rows, dtype=float)
    core = core.sum(axis=0, keepdims=True) if i == 0 else core
    return core.sum(axis=2, keepdims=True) if i == n_agents - 1 else core


def start_above(start: Occupancy, value: Trains) -> float:
    """Upper bound on ``sum_q <mu_0,q , U_q>``, where U is 1 outside the cells that its trains cover."""
    inside = outside = 0.0
    for q, rows in enumerate(start.terms.index):
        train = value.states[q]
        for row in rows if train is not None else ():
            weights = [own[k] for own, k in zip(start.terms.factors, row, strict=True)]
            whole = float(np.prod([own.sum() for own in weights]))
            if train is not None and train.cells is not None:
                weights = [own[cells] for own, cells in zip(weights, train.cells, strict=True)]
            covered = float(np.prod([own.sum() for own in weights]))
            inside += covered
            outside += max(0.0, whole - covered) + 1e-14
    return float(start_value(start, value) + value.error * inside * (1 + 1e-12) + outside)


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


def arrival(value: Trains, successors: Sequence[tuple[int, Diagram]], tolerance: float) -> Train | None:
    """Value of arriving in each joint cell, its letter read: the masked sum of the successors, rounded."""
    parts = [(train, d) for p, d in successors if (train := value.states[p]) is not None]
    return rounded(parts, tolerance) if parts else None


def assembled(arriving: Train, cores: Sequence[Core], shapes: Sequence[Sequence[int]], cells: Cells) -> Train:
    """Train of expected cores, charged with the rounding of sums over ``shapes[i]`` cells per axis of each agent."""
    operations = 4 + sum(sum(shape) + 4 * len(shape) for shape in shapes)
    operations += sum(core.shape[2] for core in arriving.cores)
    scale = float(np.prod([frobenius_sup(core) for core in arriving.cores]))
    return Train(tuple(cores), arriving.error + 2.0 * operations * UNIT * scale, cells)


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


def start_value(start: Occupancy, value: Trains) -> float:
    """``sum_q <mu_0,q , V_q>`` as computed; within ``value.error`` of the truth, since the masses sum to 1."""
    total = 0.0
    for q, rows in enumerate(start.terms.index):
        train = value.states[q]
        if train is not None:
            for row in rows:
                total += train.total([own[k] for own, k in zip(start.terms.factors, row, strict=True)])
    return total
