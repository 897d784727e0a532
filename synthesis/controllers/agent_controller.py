"""Per-agent finite-memory controllers that carry out a policy on the continuous system.

Each agent sees its own state, the shared automaton state and the time (THEORY section 6).

``exact``   the cell of its state decides the target mean, and the input puts the mean of the next state on it.
coupled     (``paper``, ``tube``, ``ellipsoid``) the agent remembers an abstract state xhat (``abstract_state``), whose
            cell decides the input uhat; the interface adds ``K (x - xhat)``.

Controllers are total: outside the workspace, in states and at times that no certificate speaks of, the input is the one
of the nearest cell, and always admissible.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..cells import FloatArray, Grid, cell_finder
from ..relations import CoupledRelation, ExactRelation, Relation, Row, product, rows_of
from .abstract_state import Memory, Tracker, moved_into

MOST_AIMS = 1 << 22
"""Most numbers that the lattice points of a policy, looked up once for all, may take."""


@dataclass(frozen=True, eq=False)
class AgentController:
    """Controller of one agent, or of n agents that share grid and relation.

    Parameters
    ----------
    name : str
    grid : Grid
    lattice : tuple of (Z_k,) arrays
        Means per axis, in grid coordinates.
    relation : Relation
    policy : (T, Q, S) int32 array, or (n, T, Q, S) for n agents
        Choice in each cell by time and automaton state; -1 where there is none. The last time's goes on for ever.
    menu : (S, A) int32 array or None
        Lattice point that each input of each cell leads to (coupled agents).
    """

    name: str
    grid: Grid
    lattice: tuple[FloatArray, ...]
    relation: Relation
    policy: NDArray[np.int32]
    menu: NDArray[np.int32] | None = None

    @property
    def is_coupled(self) -> bool:
        """Whether it remembers an abstract state."""
        return isinstance(self.relation, CoupledRelation)

    @cached_property
    def _policies(self) -> NDArray[np.int32]:
        return self.policy if self.policy.ndim == 4 else self.policy[None]

    @cached_property
    def tracker(self) -> Tracker | None:
        """What moves the abstract state along; None for agents that remember nothing."""
        return Tracker(self.relation, self.grid) if isinstance(self.relation, CoupledRelation) else None

    @property
    def draws(self) -> bool:
        """Whether it takes auxiliary draws: its relation has a coupling F."""
        return self.tracker is not None and self.tracker.is_coupled

    def begin(self, states: FloatArray) -> Memory | None:
        """Memory at time 0 for states (d, n, M): the cells of the states."""
        return None if self.tracker is None else self.tracker.begin(self.tracker.points(states))

    def act(
        self, states: FloatArray, q: NDArray[Any], time: int, memory: Memory | None, uniform: FloatArray | None = None
    ) -> tuple[FloatArray, Memory | None]:
        """Inputs (m, n, M) at states (d, n, M) and automaton states (M,), the same bits for any number of worlds.

        Agents with a coupling F take ``uniform`` (n, M), one auxiliary draw per step.
        """
        if memory is not None and self.tracker is not None:
            points = self.tracker.points(states)
            if memory.means is not None:
                memory = self.tracker.follow(memory, points, uniform)
            return self._coupled(self.tracker, memory, points, q, time)
        points = self.project(states)
        return self._towards(self._places(self._cell_of(points), q, time), points, time), None

    def _places(self, cells: NDArray[Any], q: NDArray[Any], time: int) -> NDArray[np.int64]:
        """Places (n, M) in the flat policies for cells (n, M) and automaton states (M,)."""
        n, n_times, n_states, n_cells = self._policies.shape
        rows = q.astype(np.intp)
        rows += min(time, n_times - 1) * n_states
        rows *= n_cells
        places = cells + rows
        if n > 1:
            places += self._first_places
        return places

    @cached_property
    def _first_places(self) -> NDArray[np.int64]:
        """Where the policy of each agent begins in the flat policies, (n, 1)."""
        return np.arange(0, self._policies.size, self._policies[0].size)[:, None]

    def _towards(self, places: NDArray[Any], points: FloatArray, time: int) -> FloatArray:
        """Inputs that put the mean of the next state where the policies say, from points (d, n, M) of the grid."""
        assert isinstance(self.relation, ExactRelation)
        aims = [own.take(places) for own in self._aims] if self._aims else self._aims_of(self._policies.take(places))
        inputs = self.relation.inputs(aims, points)
        if self._idles[min(time, len(self._idles) - 1)]:
            inputs[:, np.isnan(aims[0])] = self.relation.input_centre[:, None]
        return inputs

    @cached_property
    def _aims(self) -> list[FloatArray]:
        """``_aims_of`` all policies, flat; empty if there were too many."""
        return [] if self._policies.size > MOST_AIMS else self._aims_of(self._policies.reshape(-1))

    def _aims_of(self, choices: NDArray[np.int32]) -> list[FloatArray]:
        """Per axis, what ``ExactRelation.inputs`` takes for choices; not a number where there is none."""
        assert isinstance(self.relation, ExactRelation)
        aims = self.relation.aims(_means(self.lattice, np.maximum(choices, 0)))
        aims[0, choices < 0] = np.nan
        return list(aims)

    @cached_property
    def _idles(self) -> NDArray[np.bool_]:
        """Whether there are, at each time, cells without a choice."""
        return np.asarray((self._policies < 0).any(axis=(0, 2, 3)))

    def _coupled(
        self, tracker: Tracker, memory: Memory, points: FloatArray, q: NDArray[Any], time: int
    ) -> tuple[FloatArray, Memory]:
        """Inputs ``uhat + K e`` and the memory of this step.

        The input is admissible by the relation; only where the relation is lost it is moved into the input box.
        """
        relation, error = tracker.relation, memory.error
        choices = self._policies.take(self._places(memory.cells, q, time))
        if self._idles[min(time, len(self._idles) - 1)]:
            np.maximum(choices, 0, out=choices)  # the first input where there is no choice
        abstract, means = self._reaction(choices, memory.cells)
        inputs = product(self._feedback, error)
        inputs += abstract
        gone = np.flatnonzero(memory.lost)
        if len(gone):
            there, uhat = (own.reshape(len(own), -1).take(gone, axis=1) for own in (error, abstract))
            reach, low, high = (own[:, None] for own in (relation.reach, relation.input_low, relation.input_high))
            asked = uhat + product(self._feedback, np.clip(there, -reach, reach))
            inputs.reshape(len(inputs), -1)[:, gone] = np.clip(asked, low, high)
        return inputs, Memory(memory.cells, error, memory.lost, points, inputs, means)

    def _reaction(self, choices: NDArray[np.int32], cells: NDArray[Any]) -> tuple[FloatArray, FloatArray]:
        """Abstract inputs (m, n, M) and means of the successor (d, n, M) of choices in cells (n, M)."""
        assert isinstance(self.relation, CoupledRelation) and self.menu is not None
        places = cells * self.menu.shape[1]
        places += choices
        if self._menu_means is None:
            means = _means(self.lattice, self.menu.take(places))
        else:
            means = looked_up(self._menu_means, places)
        return looked_up(self._inputs, choices.astype(np.intp)), means

    @cached_property
    def _inputs(self) -> FloatArray:
        """Abstract inputs (m, A)."""
        assert isinstance(self.relation, CoupledRelation)
        return np.ascontiguousarray(self.relation.inputs.T)

    @cached_property
    def _menu_means(self) -> FloatArray | None:
        """Means of the successor (d, S A) of each input of each cell; None if there were too many."""
        assert self.menu is not None
        small = self.menu.size * len(self.lattice) <= MOST_AIMS
        return _means(self.lattice, self.menu.ravel()) if small else None

    @cached_property
    def _feedback(self) -> tuple[Row, ...]:
        assert isinstance(self.relation, CoupledRelation)
        return rows_of(self.relation.feedback)

    @cached_property
    def _cell_of(self) -> Callable[[FloatArray], NDArray[np.int64]]:
        return cell_finder(self.grid)

    def project(self, states: FloatArray) -> FloatArray:
        """Grid coordinates of the states, moved into the grid where they are outside; NaN goes to the low edge."""
        return moved_into(self.grid, states if self._in_state_coordinates else self.relation.to_grid(states))

    @cached_property
    def _in_state_coordinates(self) -> bool:
        return self.relation.has_state_coordinates


def looked_up(tables: FloatArray, places: NDArray[Any]) -> FloatArray:
    """Entries (k, ...) at places (...) of tables (k, L)."""
    found = np.empty((len(tables), *places.shape))
    for table, own in zip(tables, found, strict=True):
        table.take(places, out=own, mode="clip")  # all places are in range; other modes would make a copy first
    return found


def _means(lattice: tuple[FloatArray, ...], flat: NDArray[Any]) -> FloatArray:
    """Lattice points (d, ...) by their flat numbers (...)."""
    shape = tuple(len(axis) for axis in lattice)
    if math.prod(shape) <= flat.size:
        return looked_up(np.stack([axis.ravel() for axis in np.meshgrid(*lattice, indexing="ij")]), flat)
    return np.stack([axis.take(own) for axis, own in zip(lattice, np.unravel_index(flat, shape), strict=True)])
