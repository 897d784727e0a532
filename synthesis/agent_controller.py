"""Per-agent finite-memory controllers that carry out a policy on the continuous system.

Each agent sees its own state, the shared automaton state and the time (THEORY section 6).

``exact``   the cell of its state decides the target mean, and the input puts the mean of the next state on it.
coupled     (``paper``, ``tube``, ``ellipsoid``) the agent remembers an abstract state xhat (``abstract_state``), whose
            cell decides the input uhat; the interface adds ``K (x - xhat)``.

Controllers are total: outside the workspace, in states and at times that no certificate speaks of, the input is the one
of the nearest cell, and always admissible.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .abstract_state import Memory, follow, moved_into
from .abstraction import Relation
from .grid import FloatArray, Grid
from .lookup import cell_finder
from .relation_coupled import CoupledRelation
from .relation_exact import ExactRelation, apply

MOST_AIMS = 1 << 22
"""Largest law whose lattice points are looked up once for all."""


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
    law : (T, Q, S) int32 array, or (n, T, Q, S) for n agents
        Choice in each cell by time and automaton state; -1 where there is none. The last time's goes on for ever.
    menu : (S, A) int32 array or None
        Lattice point that each input of each cell leads to (coupled agents).
    """

    name: str
    grid: Grid
    lattice: tuple[FloatArray, ...]
    relation: Relation
    law: NDArray[np.int32]
    menu: NDArray[np.int32] | None = None

    @property
    def is_coupled(self) -> bool:
        """Whether it remembers an abstract state."""
        return isinstance(self.relation, CoupledRelation)

    @cached_property
    def _laws(self) -> NDArray[np.int32]:
        return self.law if self.law.ndim == 4 else self.law[None]

    def begin(self, states: FloatArray) -> Memory | None:
        """Memory at time 0 for states (d, n, M): the cells of the states."""
        if not self.is_coupled:
            return None
        nothing = np.zeros(states.shape)
        cells = self.grid.cell_of(self.project(states))
        return Memory(cells, nothing, nothing, nothing, np.zeros(cells.shape, dtype=bool))

    def act(
        self, states: FloatArray, q: NDArray[Any], time: int, memory: Memory | None, uniform: FloatArray | None = None
    ) -> tuple[FloatArray, Memory | None]:
        """Inputs (m, n, M) at states (d, n, M) and automaton states (M,), the same bits for any number of worlds.

        Coupled agents take ``uniform`` (n, M), one auxiliary draw per step.
        """
        if memory is not None and isinstance(self.relation, CoupledRelation):
            points = self.relation.to_grid(states)
            if time > 0 and uniform is not None:
                memory = follow(self.relation, self.grid, memory, points, uniform)
            return self._coupled(self.relation, memory, points, q, time)
        points = self.project(states)
        return self._towards(self._places(self._cell_of(points), q, time), points, time), None

    def _places(self, cells: NDArray[Any], q: NDArray[Any], time: int) -> NDArray[np.int64]:
        """Places (n, M) in the flat laws for cells (n, M) and automaton states (M,)."""
        n, n_times, n_states, n_cells = self._laws.shape
        rows = q.astype(np.intp)
        rows += min(time, n_times - 1) * n_states
        rows *= n_cells
        places = cells + rows
        if n > 1:
            places += self._first_places
        return places

    @cached_property
    def _first_places(self) -> NDArray[np.int64]:
        """Where the law of each agent begins in the flat laws, (n, 1)."""
        return np.arange(0, self._laws.size, self._laws[0].size)[:, None]

    def _choice(self, cells: NDArray[Any], q: NDArray[Any], time: int) -> NDArray[np.int32]:
        """Choices (n, M) in cells (n, M) and automaton states (M,)."""
        return self._laws.reshape(-1).take(self._places(cells, q, time))

    def _towards(self, places: NDArray[Any], points: FloatArray, time: int) -> FloatArray:
        """Inputs that put the mean of the next state where the laws say, from points (d, n, M) of the grid."""
        assert isinstance(self.relation, ExactRelation)
        aims = [own.take(places) for own in self._aims] if self._aims else self._aims_of(self._laws.take(places))
        inputs = self.relation.inputs(aims, points)
        if self._idles[min(time, len(self._idles) - 1)]:
            inputs[:, np.isnan(aims[0])] = self.relation.input_centre[:, None]
        return inputs

    @cached_property
    def _aims(self) -> list[FloatArray]:
        """``_aims_of`` all laws, flat; empty if there were too many."""
        return [] if self._laws.size > MOST_AIMS else self._aims_of(self._laws.reshape(-1))

    def _aims_of(self, choices: NDArray[np.int32]) -> list[FloatArray]:
        """Per axis, what ``ExactRelation.inputs`` takes for choices; not a number where there is none."""
        assert isinstance(self.relation, ExactRelation)
        aims = self.relation.aims(_means(self.lattice, np.maximum(choices, 0)))
        aims[0, choices < 0] = np.nan
        return list(aims)

    @cached_property
    def _idles(self) -> NDArray[np.bool_]:
        """Whether there are, at each time, cells without a choice."""
        return np.asarray((self._laws < 0).any(axis=(0, 2, 3)))

    def _coupled(
        self, relation: CoupledRelation, memory: Memory, points: FloatArray, q: NDArray[Any], time: int
    ) -> tuple[FloatArray, Memory]:
        """Inputs ``uhat + K e`` and the memory of this step.

        The input is admissible by the relation; only where the relation is lost it is moved into the input box.
        """
        assert self.menu is not None
        choice = np.maximum(self._choice(memory.cells, q, time), 0)
        shape = (-1, *[1] * memory.cells.ndim)
        reach = relation.reach.reshape(shape)
        error = np.nan_to_num(points - np.moveaxis(self._centres[memory.cells], -1, 0))
        lost = ~relation.related(error)
        inputs = np.moveaxis(relation.inputs[choice], -1, 0) + apply(relation.feedback, np.clip(error, -reach, reach))
        admissible = np.clip(inputs, relation.input_low.reshape(shape), relation.input_high.reshape(shape))
        inputs = np.where(lost | memory.lost, admissible, inputs)
        means = _means(self.lattice, self.menu[memory.cells, choice])
        return inputs, Memory(memory.cells, points, inputs, means, memory.lost)

    @cached_property
    def _centres(self) -> FloatArray:
        return self.grid.centres

    @cached_property
    def _cell_of(self) -> Callable[[FloatArray], NDArray[np.int64]]:
        return cell_finder(self.grid)

    def project(self, states: FloatArray) -> FloatArray:
        """Grid coordinates of the states, moved into the grid where they are outside; NaN goes to the low edge."""
        return moved_into(self.grid, states if self._in_state_coordinates else self.relation.to_grid(states))

    @cached_property
    def _in_state_coordinates(self) -> bool:
        return self.relation.has_state_coordinates


def _means(lattice: tuple[FloatArray, ...], flat: NDArray[Any]) -> FloatArray:
    """Lattice points (d, n, M) by their flat numbers (n, M)."""
    indices = np.unravel_index(flat, tuple(len(axis) for axis in lattice)) if len(lattice) > 1 else (flat,)
    return np.stack([axis.take(index) for axis, index in zip(lattice, indices, strict=True)])
