"""Value functions of all automaton states as tensor trains, and the steps from one time to the one before."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .row_sums import UNIT
from .tensor_train import Cells, Core, Diagram, Train, diagram, frobenius_sup, rounded
from .terms import Guards, Occupancy

ROWS_AT_ONCE = 256
"""Rows of a core that are smoothed at once: enough for a fast product, few enough for memory."""

Backup = Callable[[NDArray[np.float64]], NDArray[np.float64]]
"""Expected values (n, Z) of rows (n, S) at every lattice point."""

Routes = tuple[tuple[tuple[int, Diagram], ...], ...]
"""Per automaton state: its successors, and the joint cells that lead to each."""


@dataclass(frozen=True, eq=False, repr=False)
class Trains:
    """Value function of every automaton state as a train; None where it is 0.

    Parameters
    ----------
    states : tuple of Train or None
        Each holds a function f with ``|f - V_q| <= error``; reading it costs up to ``spread`` more.
    """

    states: tuple[Train | None, ...]

    def __repr__(self) -> str:
        held = sum(train is not None for train in self.states)
        return f"Trains(automaton states: {len(self.states)}, not 0: {held}, rank {self.rank}, error {self.error:.2g})"

    @property
    def rank(self) -> int:
        """Largest number of columns of a bond."""
        return max((train.rank for train in self.states if train is not None), default=0)

    @property
    def error(self) -> float:
        """Upper bound on the error of reading any state: the largest error of a train, its spread included."""
        return max((train.error + train.spread for train in self.states if train is not None), default=0.0)

    def work(self, q: int) -> int:
        """Return how many numbers ``at`` holds per joint cell: 1, since trains cut long lists of cells themselves."""
        return 1

    def at(self, q: int, cells: NDArray[np.integer]) -> NDArray[np.float64]:
        """Return lower bounds (M,) at joint cells (M, I): computed values less their error, at least 0."""
        train = self.states[q]
        if train is None:
            return np.zeros(len(cells))
        return np.maximum(0.0, train.at(cells) - (train.error + train.spread))

    def total(self, q: int, weights: Sequence[NDArray]) -> float:
        """Return a lower bound on ``sum_s V_q(s) prod_i weights[i][s_i]``, at least 0, for weights (S_i,) per agent."""
        train = self.states[q]
        if train is None:
            return 0.0
        # The error holds at every joint cell, so that the sum is off by at most the error times the mass.
        mass = float(np.prod([weight.sum() for weight in weights]))
        return max(0.0, train.total(weights) - (train.error + train.spread) * mass * (1 + 1e-12))


@dataclass(frozen=True, eq=False, repr=False)
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

    def __repr__(self) -> str:
        return f"Rounding(tolerance {self.tolerance:.2g}, times: {len(self.visited)})"


@dataclass(frozen=True, eq=False, repr=False)
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

    def __repr__(self) -> str:
        return f"Unread(start guards: {len(self.target)}, value: {self.value!r})"

    @property
    def rank(self) -> int:
        """Largest number of columns of a bond."""
        return self.value.rank

    def work(self, q: int) -> int:
        """Return how many numbers ``at`` holds per joint cell."""
        return len(self.target)

    def total(self, q: int, weights: Sequence[NDArray]) -> float:
        """Return a lower bound on the value under weights (S_i,) per agent; ``q`` is ignored."""
        total = 0.0
        for target, mask in zip(self.target, self.mask, strict=True):
            shares = [factors[m] * w for factors, m, w in zip(self.masks, mask, weights, strict=True)]
            total += self.value.total(int(target), shares)
        return total

    def at(self, q: int, cells: NDArray[np.integer]) -> NDArray[np.float64]:
        """Return lower bounds (M,) at joint cells (M, I); ``q`` is ignored."""
        # Start guards are disjoint: a joint cell lies in at most one of them.
        values = np.zeros(len(cells))
        for target, mask in zip(self.target, self.mask, strict=True):
            inside = np.ones(len(cells), dtype=bool)
            for i, factors in enumerate(self.masks):
                inside &= factors[mask[i]][cells[:, i]] > 0
            values[inside] = self.value.at(int(target), cells[inside])
        return values


def routes(guards: Guards, masks: Sequence[NDArray], n_states: int) -> Routes:
    """Return diagrams of the joint cells that lead from each automaton state to each of its successors (exact)."""
    result = []
    for q in range(n_states):
        leaves = guards.source == q
        targets = sorted({int(target) for target in guards.target[leaves]})
        result.append(tuple((p, diagram(masks, guards.mask[leaves & (guards.target == p)])) for p in targets))
    return tuple(result)


def arrival(value: Trains, successors: Sequence[tuple[int, Diagram]], tolerance: float) -> Train | None:
    """Return the value of arriving in each joint cell: the masked sum of the successors, rounded; None where it is 0.

    This is ``W_q = sum_q' 1[the letter leads q to q'] V_q'``, within the error that it carries.
    """
    summands = [(train, d) for p, d in successors if (train := value.states[p]) is not None]
    return rounded(summands, tolerance) if summands else None


def assembled(arriving: Train, cores: Sequence[Core], shapes: Sequence[Sequence[int]], cells: Cells) -> Train:
    """Return the train of expected cores, charged with the rounding of sums over ``shapes[i]`` cells per axis.

    Rows of a kernel sum to at most 1, so that taking expectations does not enlarge the error of ``arriving``.
    """
    operations = 4 + sum(sum(shape) + 4 * len(shape) for shape in shapes)
    operations += sum(core.shape[2] for core in arriving.cores)
    scale = float(np.prod([frobenius_sup(core) for core in arriving.cores]))
    return Train(tuple(cores), arriving.error + 2.0 * operations * UNIT * scale, cells)


def core_backup(arriving: Train, i: int, n_cells: int, points: NDArray[np.integer], backup: Backup) -> Core:
    """Return matrices (r, n, r') of agent i, ``backup`` of its rows read at n points; 0 where the point is -1."""
    rows = core_rows(arriving, i, n_cells)
    values = np.empty((len(rows), len(points)))
    for first in range(0, len(rows), ROWS_AT_ONCE):
        values[first : first + ROWS_AT_ONCE] = backup(rows[first : first + ROWS_AT_ONCE])[:, np.maximum(points, 0)]
    values[:, points < 0] = 0.0
    shape = (arriving.cores[i].shape[0], arriving.cores[i].shape[2], len(points))
    return np.ascontiguousarray(np.moveaxis(values.reshape(shape), 2, 1))


def core_rows(train: Train, i: int, n_cells: int) -> NDArray[np.float64]:
    """Return one row (r r', S) for each entry of agent i's matrices, over all cells; 0 at cells not covered."""
    core = np.moveaxis(train.cores[i], 1, 2)
    if train.cells is None:
        return np.ascontiguousarray(core).reshape(-1, n_cells)
    rows = np.zeros((core.shape[0] * core.shape[1], n_cells))
    rows[:, train.cells[i]] = core.reshape(len(rows), -1)
    return rows


def counted_as_failed(
    points: Sequence[NDArray[np.integer]], backup: Sequence[Backup], n_cells: Sequence[int], here: Cells, there: Cells
) -> Train | None:
    """Return the probability, per joint cell, of what a lower bound counts as failed in one step; None if it is 0.

    These are the last two terms of ``U`` in docs/theory/bounds.md, "Upper bounds, and of what". The error covers
    floating point.

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
    choices = list(points) if here is None else [p[cells] for p, cells in zip(points, here, strict=True)]
    columns: list[list[NDArray[np.float64]]] = []
    # 1 - prod_i v_i: some agent has no choice.
    if any(np.any(p < 0) for p in choices):
        valid = [(p >= 0).astype(float) for p in choices]
        columns += [[np.ones(len(p)) for p in choices], [-valid[0], *valid[1:]]]
    # prod_i P_i 1[anywhere] - prod_i P_i 1[visited]: some agent leaves the visited cells inside its workspace.
    if there is not None and any(len(cells) < n for cells, n in zip(there, n_cells, strict=True)):
        rates = []
        for p, push, n, cells in zip(choices, backup, n_cells, there, strict=True):
            rows = np.ones((2, n))
            rows[1] = 0.0
            rows[1, cells] = 1.0
            rates.append(np.where(p >= 0, push(rows)[:, np.maximum(p, 0)], 0.0))
        columns += [[anywhere for anywhere, _ in rates], [-rates[0][1], *(visited for _, visited in rates[1:])]]
    if not columns:
        return None
    # Entries are at most 1 in size: the number of operations bounds the rounding in units.
    operations = 4 * len(columns) * (len(choices) + 2 * sum(n_cells))
    cores = tuple(_diagonal([column[i] for column in columns], i, len(choices)) for i in range(len(choices)))
    return Train(cores, operations * UNIT, here)


def _diagonal(rows: list[NDArray[np.float64]], i: int, n_agents: int) -> Core:
    """Return the core of agent i of a sum of products with factors ``rows``."""
    core = np.zeros((len(rows), len(rows[0]), len(rows)))
    core[np.arange(len(rows)), :, np.arange(len(rows))] = np.asarray(rows, dtype=float)
    core = core.sum(axis=0, keepdims=True) if i == 0 else core
    return core.sum(axis=2, keepdims=True) if i == n_agents - 1 else core


def start_value(start: Occupancy, value: Trains) -> float:
    """Return ``sum_q <mu_0,q , V_q>`` as computed; it is off by at most ``value.error``, since the masses sum to 1."""
    total = 0.0
    for q, rows in enumerate(start.terms.index):
        train = value.states[q]
        if train is not None:
            for row in rows:
                total += train.total([factors[k] for factors, k in zip(start.terms.factors, row, strict=True)])
    return total


def start_above(start: Occupancy, value: Trains) -> float:
    """Return an upper bound on ``sum_q <mu_0,q , U_q>``, where U is 1 outside the cells that its trains cover."""
    inside = outside = 0.0
    for q, rows in enumerate(start.terms.index):
        train = value.states[q]
        for row in rows if train is not None else ():
            weights = [factors[k] for factors, k in zip(start.terms.factors, row, strict=True)]
            whole = float(np.prod([weight.sum() for weight in weights]))
            if train is not None and train.cells is not None:
                weights = [weight[cells] for weight, cells in zip(weights, train.cells, strict=True)]
            covered = float(np.prod([weight.sum() for weight in weights]))
            inside += covered
            outside += max(0.0, whole - covered) + 1e-14  # a reserve for rounding
    return float(start_value(start, value) + value.error * inside * (1 + 1e-12) + outside)
