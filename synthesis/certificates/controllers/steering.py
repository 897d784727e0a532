"""From policies to inputs: the choice of each cell is looked up and turned into an input.

``TargetSteering``  the choice is a target mean (``exact`` relation): the input puts the mean of the next state on it.
``MapSteering``     the choice is an input, or a target mean (``linear``).
``BoxSteering``     the choice is an input, and what is fed back of the state inside its cell (``boxes``).
``MenuSteering``    the choice is an abstract input uhat (coupled agents): the interface adds ``K e``.

All work on n agents that share grid and relation and on M worlds at once, with the same bits for any number of worlds.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...relations.grids import FloatArray, Grid
from ...relations.kinds import (
    BoxRelation,
    CoupledRelation,
    ExactRelation,
    MapRelation,
    Row,
    SymbolicTargets,
    product,
    rows_of,
)
from .abstract_state import Memory

MOST_AIMS = 1 << 22
"""Most lattice points that are looked up once for a whole policy or menu, instead of at every step: 32 MB per axis."""


@dataclass(frozen=True, eq=False)
class PolicyTable:
    """Policies of n agents, read at their cells.

    Parameters
    ----------
    policies : (n, T, Q, S) int32 array
        Choice in each cell by time and automaton state; -1 where there is none. After time T - 1 the last row is
        repeated.
    """

    policies: NDArray[np.int32]

    def places(self, cells: NDArray[Any], q: NDArray[Any], time: int) -> NDArray[np.int64]:
        """Return places (n, M) in the flat policies for cells (n, M) and automaton states (M,)."""
        n, n_times, n_states, n_cells = self.policies.shape
        rows = q.astype(np.intp)
        rows += min(time, n_times - 1) * n_states
        rows *= n_cells
        places = cells + rows
        if n > 1:
            places += self._first_places
        return places

    def choices(self, places: NDArray[Any]) -> NDArray[np.int32]:
        """Return the choices at places."""
        return self.policies.take(places)

    def has_idle_cells(self, time: int) -> bool:
        """Return whether some cell has no choice at a time."""
        return bool(self._idles[min(time, len(self._idles) - 1)])

    @cached_property
    def _first_places(self) -> NDArray[np.int64]:
        """Where the policy of each agent begins in the flat policies, (n, 1)."""
        return np.arange(0, self.policies.size, self.policies[0].size)[:, None]

    @property
    def flat(self) -> NDArray[np.int32] | None:
        """All policies in one row; None if they are too many to look something up for each."""
        return self.policies.reshape(-1) if self.policies.size <= MOST_AIMS else None

    @cached_property
    def _idles(self) -> NDArray[np.bool_]:
        """Whether there are, at each time, cells without a choice."""
        return np.asarray((self.policies < 0).any(axis=(0, 2, 3)))


@dataclass(frozen=True, eq=False)
class TargetSteering:
    """Inputs that put the mean of the next state where policies say.

    Parameters
    ----------
    table : PolicyTable
    grid : Grid
    lattice : tuple of (Z_k,) arrays
        Means per axis.
    relation : ExactRelation or WrittenTargets
    """

    table: PolicyTable
    grid: Grid
    lattice: tuple[FloatArray, ...]
    relation: ExactRelation | SymbolicTargets

    def inputs(
        self, cells: NDArray[Any], points: FloatArray, q: NDArray[Any], time: int, beside: FloatArray | None = None
    ) -> FloatArray:
        """Return inputs (m, n, M) at points (d, n, M) of the grid, which lie in cells (n, M).

        ``beside`` (l, n, M) are the states of others that the dynamics name, if there are any.
        """
        places = self.table.places(cells, q, time)
        mean_targets = (
            [axis.take(places) for axis in self._aims] if self._aims else self._aims_of(self.table.choices(places))
        )
        inputs = self.relation.inputs(mean_targets, points, beside)
        # Cells without a choice get the central input.
        if self.table.has_idle_cells(time):
            inputs[:, np.isnan(mean_targets[0])] = self.relation.input_centre[:, None]
        return inputs

    @cached_property
    def _aims(self) -> list[FloatArray]:
        """``_aims_of`` all policies, flat; empty if there were too many."""
        return [] if self.table.flat is None else self._aims_of(self.table.flat)

    def _aims_of(self, choices: NDArray[np.int32]) -> list[FloatArray]:
        """Return, per axis, what ``ExactRelation.inputs`` takes for choices; not a number where there is none."""
        mean_targets = self.relation.mean_targets(lattice_means(self.lattice, np.maximum(choices, 0)))
        mean_targets[0, choices < 0] = np.nan
        return list(mean_targets)


@dataclass(frozen=True, eq=False)
class _OnCells:
    """What inputs are looked up in, which depend on the cell and on the place in it.

    Parameters
    ----------
    table : PolicyTable
    grid : Grid
    lattice : tuple of (Z_k,) arrays
        Means per axis; for boxes axes on which they are read, on which no input depends.
    """

    table: PolicyTable
    grid: Grid
    lattice: tuple[FloatArray, ...]
    relation: Any

    @cached_property
    def _menu(self) -> FloatArray:
        """Inputs (m, A + 1)."""
        input_set = self.relation.input_set
        return np.ascontiguousarray(np.concatenate([input_set, input_set.mean(axis=0, keepdims=True)]).T)


@dataclass(frozen=True, eq=False)
class MapSteering(_OnCells):
    """Inputs of a menu, and those that put the mean of the next state on targets (relation ``linear``)."""

    relation: MapRelation

    def inputs(
        self, cells: NDArray[Any], points: FloatArray, q: NDArray[Any], time: int, beside: FloatArray | None = None
    ) -> FloatArray:
        """Return inputs (m, n, M) at points (d, n, M) of the grid, which lie in cells (n, M).

        ``beside`` (l, n, M) are the states of others that the dynamics name, if there are any.
        """
        choices, n_inputs = self.table.choices(self.table.places(cells, q, time)), len(self.relation.input_set)
        # The last column of the table is for cells without a choice: the mean of all inputs.
        columns = np.where(choices < 0, n_inputs, np.minimum(choices, n_inputs - 1))
        inputs = looked_up(self._menu, columns.astype(np.intp))
        network, mean_targets = self.relation.network, self.relation.mean_targets
        if network is not None:
            return network.replaced(choices, points, (q, time), inputs)
        aimed = choices >= n_inputs
        if mean_targets is None or not aimed.any():
            return inputs
        targets = mean_targets.mean_targets(lattice_means(self.lattice, np.where(aimed, choices - n_inputs, 0)))
        targets[0, ~aimed] = np.nan
        wanted = mean_targets.inputs(list(targets), points, beside)
        return np.where(aimed, wanted, inputs)


@dataclass(frozen=True, eq=False)
class BoxSteering(_OnCells):
    """Inputs that keep the mean of the next state in the box of a choice (relation ``boxes``)."""

    relation: BoxRelation

    def inputs(
        self, cells: NDArray[Any], points: FloatArray, q: NDArray[Any], time: int, beside: FloatArray | None = None
    ) -> FloatArray:
        """Return inputs (m, n, M) at points (d, n, M) of the grid, which lie in cells (n, M).

        ``beside`` (l, n, M) are the states of others that the dynamics name, if there are any.
        """
        choices = self.table.choices(self.table.places(cells, q, time))
        chosen = np.maximum(choices, 0).astype(np.intp)
        inputs = self.relation.inputs(chosen)
        # Cells without a choice get the mean of all inputs.
        if self.table.has_idle_cells(time):
            inputs[:, choices < 0] = self.relation.input_set.mean(axis=0)[:, None]
        return inputs


@dataclass(frozen=True, eq=False)
class MenuSteering:
    """Inputs ``uhat + K e`` of coupled agents.

    Parameters
    ----------
    table : PolicyTable
    lattice : tuple of (Z_k,) arrays
        Means per axis.
    relation : CoupledRelation
    menu : (S, A) int32 array
        Lattice point that each input of each cell leads to.
    """

    table: PolicyTable
    lattice: tuple[FloatArray, ...]
    relation: CoupledRelation
    input_set: NDArray[np.int32]

    def inputs(self, memory: Memory, points: FloatArray, q: NDArray[Any], time: int) -> tuple[FloatArray, Memory]:
        """Return the inputs (m, n, M) at points (d, n, M) of the grid, and the memory of this step.

        An input is admissible by the relation; only where the relation is lost it is moved into the input box.
        """
        choices = self.table.choices(self.table.places(memory.cells, q, time))
        # Cells without a choice take the first input of the menu.
        if self.table.has_idle_cells(time):
            np.maximum(choices, 0, out=choices)
        abstract, means = self._reaction(choices, memory.cells)
        inputs = product(self._feedback, memory.error)
        inputs += abstract
        lost = np.flatnonzero(memory.lost)
        if len(lost):
            inputs.reshape(len(inputs), -1)[:, lost] = self._clipped(memory.error, abstract, lost)
        return inputs, Memory(memory.cells, memory.error, memory.lost, points, inputs, means)

    def _clipped(self, error: FloatArray, abstract: FloatArray, lost: NDArray[np.int64]) -> FloatArray:
        """Return admissible inputs (m, N) where the relation is lost: error and input are moved into their boxes."""
        relation = self.relation
        there, uhat = (array.reshape(len(array), -1).take(lost, axis=1) for array in (error, abstract))
        reach, low, high = (bound[:, None] for bound in (relation.reach, relation.input_low, relation.input_high))
        asked = uhat + product(self._feedback, np.clip(there, -reach, reach))
        return np.asarray(np.clip(asked, low, high))

    def _reaction(self, choices: NDArray[np.int32], cells: NDArray[Any]) -> tuple[FloatArray, FloatArray]:
        """Return abstract inputs (m, n, M) and means of the successor (d, n, M) of choices in cells (n, M)."""
        places = cells * self.input_set.shape[1]
        places += choices
        if self._menu_means is None:
            means = lattice_means(self.lattice, self.input_set.take(places))
        else:
            means = looked_up(self._menu_means, places)
        return looked_up(self._abstract_inputs, choices.astype(np.intp)), means

    @cached_property
    def _abstract_inputs(self) -> FloatArray:
        """Abstract inputs (m, A)."""
        return np.ascontiguousarray(self.relation.inputs.T)

    @cached_property
    def _menu_means(self) -> FloatArray | None:
        """Means of the successor (d, S A) of each input of each cell; None if there were too many."""
        is_small = self.input_set.size * len(self.lattice) <= MOST_AIMS
        return lattice_means(self.lattice, self.input_set.ravel()) if is_small else None

    @cached_property
    def _feedback(self) -> tuple[Row, ...]:
        """Rows of K as plain numbers."""
        return rows_of(self.relation.feedback)


def looked_up(tables: FloatArray, places: NDArray[Any]) -> FloatArray:
    """Return the entries (k, ...) at places (...) of tables (k, L)."""
    entries = np.empty((len(tables), *places.shape))
    for table, row in zip(tables, entries, strict=True):
        table.take(places, out=row, mode="clip")  # all places are in range; other modes would make a copy first
    return entries


def lattice_means(lattice: tuple[FloatArray, ...], flat: NDArray[Any]) -> FloatArray:
    """Return lattice points (d, ...) by their flat numbers (...)."""
    shape = tuple(len(axis) for axis in lattice)
    # Few points and many numbers: a table of all points first.
    if math.prod(shape) <= flat.size:
        return looked_up(np.stack([axis.ravel() for axis in np.meshgrid(*lattice, indexing="ij")]), flat)
    return np.stack([axis.take(k) for axis, k in zip(lattice, np.unravel_index(flat, shape), strict=True)])
