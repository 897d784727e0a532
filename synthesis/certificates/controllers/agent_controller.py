"""Per-agent finite-memory controllers that carry out a policy on the continuous system.

Each agent sees its own state, the shared automaton state and the time (docs/theory/setting.md, "Policies").

``exact``   the cell of its state decides the target mean, and the input puts the mean of the next state on it.
``linear``  the cell of its state decides an affine map, and the input puts the mean of the next state where it says.
``boxes``   the cell of its state decides an input, and what is fed back of the state inside the cell.
``paper``   the agent remembers an abstract state xhat (``abstract_state``), whose cell decides the input uhat; the
            interface adds ``K (x - xhat)``.

Controllers are total: outside the workspace, in states and at times that no certificate speaks of, the input is that of
the nearest cell, and always admissible.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....envs.systems.arguments import tree_text
from ...relations.grids import FloatArray, Grid, cell_finder, shape_text
from ...relations.kinds import BoxRelation, MapRelation, Relation
from .abstract_state import Memory, Tracker, moved_into
from .steering import BoxSteering, MapSteering, MenuSteering, PolicyTable, TargetSteering

STEERINGS = {MapRelation: MapSteering, BoxRelation: BoxSteering}
"""What carries choices out, by relation; those of all others are targets."""


@dataclass(frozen=True, eq=False, repr=False)
class AgentController:
    """Controller of one agent, or of n agents that share grid and relation.

    Parameters
    ----------
    name : str
    grid : Grid
    lattice : tuple of (Z_k,) arrays
        Means per axis.
    relation : Relation
    policy : (T, Q, S) int32 array, or (n, T, Q, S) for n agents
        Choice in each cell by time and automaton state; -1 where there is none. After time T - 1 the last row is
        repeated.
    menu : (S, A) int32 array or None
        Lattice point that each input of each cell leads to (coupled agents).
    """

    name: str
    grid: Grid
    lattice: tuple[FloatArray, ...]
    relation: Relation
    policy: NDArray[np.int32]
    input_set: NDArray[np.int32] | None = None

    def __repr__(self) -> str:
        *agents, times, states, cells = self.policy.shape
        several = f"{agents[0]} agents, " if agents else ""
        rows = [
            ("grid", self.grid),
            ("policy", f"{several}{times} times, {states} automaton states, {cells} cells"),
            ("lattice", f"{shape_text([len(axis) for axis in self.lattice])} means"),
            ("memory", "an abstract state" if self.is_coupled else "none"),
        ]
        return tree_text(f"AgentController {self.name!r}: {self.relation.kind} relation", rows)

    def __getstate__(self) -> dict[str, Any]:
        """Leave out what is computed on first use: it holds functions, which are not pickled."""
        return {field.name: getattr(self, field.name) for field in fields(self)}

    @property
    def is_coupled(self) -> bool:
        """Whether it remembers an abstract state."""
        return self.relation.has_memory

    @cached_property
    def tracker(self) -> Tracker | None:
        """What moves the abstract state along; None for agents that remember nothing."""
        return Tracker(self.relation, self.grid) if self.relation.has_memory else None  # type: ignore[arg-type]

    @property
    def draws(self) -> bool:
        """Whether it takes auxiliary draws: its relation has a coupling F."""
        return self.tracker is not None and self.tracker.is_coupled

    def begin(self, states: FloatArray) -> Memory | None:
        """Return the memory at time 0 for states (d, n, M): the cells of the states; None if nothing is remembered."""
        return None if self.tracker is None else self.tracker.begin(states)

    def act(
        self,
        states: FloatArray,
        q: NDArray[Any],
        time: int,
        memory: Memory | None,
        uniform: FloatArray | None = None,
        beside: FloatArray | None = None,
    ) -> tuple[FloatArray, Memory | None]:
        """Return inputs (m, n, M) at states (d, n, M) and automaton states (M,), and the memory for the next step.

        The bits are the same for any number of worlds. Agents with a coupling F take ``uniform`` (n, M), one auxiliary
        draw per step; those that name others take their states, ``beside`` (l, n, M); inputs are no numbers there.
        """
        if memory is not None and self.tracker is not None:
            # The memory holds the last step from the first action on: only then there is one to follow.
            if memory.means is not None:
                memory = self.tracker.follow(memory, states, uniform)
            return self._menu_steering.inputs(memory, states, q, time)
        points = self.project(states)
        steering, cells = self._target_steering, self._cell_of(points)
        return steering.inputs(cells, points, q, time, beside), None

    def project(self, states: FloatArray) -> FloatArray:
        """Return states, moved into the grid if they are outside; NaN goes to the low edge."""
        return moved_into(self.grid, states)

    @cached_property
    def _table(self) -> PolicyTable:
        return PolicyTable(self.policy if self.policy.ndim == 4 else self.policy[None])

    @cached_property
    def _target_steering(self) -> TargetSteering | BoxSteering | MapSteering:
        steering: Any = STEERINGS.get(type(self.relation), TargetSteering)
        return steering(self._table, self.grid, self.lattice, self.relation)

    @cached_property
    def _menu_steering(self) -> MenuSteering:
        assert self.input_set is not None
        return MenuSteering(self._table, self.lattice, self.relation, self.input_set)  # type: ignore[arg-type]

    @cached_property
    def _cell_of(self) -> Callable[[FloatArray], NDArray[np.int64]]:
        return cell_finder(self.grid)
