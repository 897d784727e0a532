"""Permissive certificates: menus of choices within which any behaviour keeps a success probability.

A certificate has one choice per cell, automaton state and time; a permission has a menu of them. Whoever chooses from
the menus, by any rule, with any memory and for any reason but the noise of the step, succeeds with a probability of at
least ``lower_bound`` (docs/theory/shields.md, "Permissive certificates"). Menus are for agents whose relation is
``exact``: a choice is a target mean on the lattice.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...envs.agents import tree_text
from ...envs.problem import Problem
from ..cells import FloatArray
from ..certificates import Certificate, rounded_down
from ..controllers import AgentController
from ..relations import ExactRelation, WrittenTargets


@dataclass(frozen=True, eq=False, repr=False)
class Menus:
    """Menus of one agent.

    Parameters
    ----------
    counts : (T, Q, S) int32 array
        Choices on the menu of each cell, by time and automaton state.
    choices : (sum of counts,) int32 array
        Lattice points, menu by menu in C order of (time, automaton state, cell), increasing in each.
    """

    counts: NDArray[np.int32]
    choices: NDArray[np.int32]

    def __repr__(self) -> str:
        return f"Menus({self.counts.size} menus, {len(self.choices)} choices, at most {int(self.counts.max())})"

    @cached_property
    def ends(self) -> NDArray[np.int64]:
        """Where the menus end in ``choices``, in C order."""
        return np.cumsum(self.counts.reshape(-1), dtype=np.int64)

    def of_step(self, time: int, q: int) -> tuple[NDArray[np.int64], NDArray[np.int32]]:
        """Return the cells (N,) and choices (N,) of all menus of one time and automaton state, cell by cell."""
        _, n_states, n_cells = self.counts.shape
        first = (time * n_states + q) * n_cells
        begin, end = (int(self.ends[k - 1]) if k else 0 for k in (first, first + n_cells))
        return np.repeat(np.arange(n_cells), self.counts[time, q]), self.choices[begin:end]


@dataclass(frozen=True, eq=False, repr=False)
class Permission:
    """Menus for all agents of a problem.

    Parameters
    ----------
    certificate : Certificate
        Grids, relations, guards and value tree; its own policies are on the menus.
    menus : tuple of Menus
        Per agent.
    lower_bound : float
        Lower bound on the success probability of every behaviour that keeps to the menus, from the problem's start.
    """

    certificate: Certificate
    menus: tuple[Menus, ...]
    lower_bound: float

    def __repr__(self) -> str:
        choices = sum(len(menus.choices) for menus in self.menus)
        asked = sum(int(np.count_nonzero(menus.counts)) for menus in self.menus)
        rows = [
            (
                "keeps",
                f"P(success) >= {rounded_down(self.lower_bound)} of {rounded_down(self.certificate.lower_bound)}",
            ),
            ("choices", f"{choices / max(1, asked):.1f} per menu on average"),
        ]
        return tree_text(f"Permission for {self.problem.name!r}", rows)

    @property
    def problem(self) -> Problem:
        """The problem."""
        return self.certificate.problem

    def mask(self, agent: str, states: Any, q: Any, time: int) -> NDArray[np.bool_]:
        """Return which lattice points (M, Z) are on the menus at states (M, d), automaton states (M,) and a time.

        Where the certificate has no choice the value is 0 and the menu is empty: any input will do.
        """
        i, controller = self._agent(agent)
        points = np.atleast_2d(np.asarray(states, dtype=float)).T
        cells = controller.grid.cell_of(controller.project(points))
        menus, size = self.menus[i], int(np.prod(self.certificate.agents[i].lattice_shape))
        allowed = np.zeros((points.shape[1], size), dtype=bool)
        states_q = np.broadcast_to(np.asarray(q, dtype=np.int64), cells.shape)
        _, n_states, n_cells = menus.counts.shape
        for m, (cell, state) in enumerate(zip(cells.tolist(), states_q.tolist(), strict=True)):
            place = (time * n_states + state) * n_cells + cell
            end = int(menus.ends[place])
            allowed[m, menus.choices[end - int(menus.counts[time, state, cell]) : end]] = True
        return allowed

    def inputs(self, agent: str, states: Any, choices: Any, beside: Any = None) -> FloatArray:
        """Return the inputs (M, m) that put the mean of the next state of an agent on lattice points (M,).

        ``beside`` (M, l) are the states of others that the dynamics of an agent with expressions name.
        """
        i, controller = self._agent(agent)
        relation, lattice = controller.relation, self.certificate.agents[i].lattice
        assert isinstance(relation, ExactRelation | WrittenTargets)
        index = np.unravel_index(np.asarray(choices, dtype=np.int64), tuple(len(axis) for axis in lattice))
        targets = np.stack([axis[k] for axis, k in zip(lattice, index, strict=True)])
        points = controller.project(np.atleast_2d(np.asarray(states, dtype=float)).T)
        if isinstance(relation, ExactRelation):
            return relation.inputs(relation.aims(targets), points).T
        others = None if beside is None else np.atleast_2d(np.asarray(beside, dtype=float)).T
        return relation.inputs(relation.aims(targets), points, others).T

    def _agent(self, name: str) -> tuple[int, AgentController]:
        """Return number and controller of an agent; raise ValueError if there is none of this name."""
        if name not in self.problem.agent_names:
            raise ValueError(f"`agent`: expected one of {', '.join(self.problem.agent_names)}, got {name!r}")
        i = self.problem.agent_names.index(name)
        return i, self.certificate.controller.agents[i]
