"""Permissive certificates: menus of choices within which any behaviour keeps a success probability.

A certificate has one choice per cell, automaton state and time; a permission has a menu of them. Whoever chooses from
the menus, by any rule, with any memory and for any reason but the noise of the step, succeeds with a probability of at
least ``lower_bound`` (docs/theory/shields.md, "Permissive certificates"). A choice is what it is in the relation of the
agent: a target mean on the lattice (``exact``), an input of the relation's menu (``boxes``), or one of these, inputs
first (``linear``).
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
from ..certificates import OnGrid, rounded_down
from ..controllers import AgentController
from ..masses import AgentPart


@dataclass(frozen=True, eq=False, repr=False)
class Menus:
    """Menus of one agent.

    Parameters
    ----------
    counts : (T, Q, S) int32 array
        Choices on the menu of each cell, by time and automaton state.
    choices : (sum of counts,) int32 array
        Numbers of choices, menu by menu in C order of (time, automaton state, cell), increasing in each.
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

    def layers(self, time: int, q: int) -> NDArray[np.int32]:
        """Return the menus of one time and automaton state as policies (K, S): the k-th choice of each cell, or -1."""
        return in_layers(*self.of_step(time, q), self.counts.shape[2])


def in_layers(cells: NDArray[np.int64], choices: NDArray[Any], n_cells: int) -> NDArray[np.int32]:
    """Return pairs of cells (N,), which do not fall, and choices (N,) as policies (K, S), -1 where a cell has fewer."""
    number = np.arange(len(cells)) - np.searchsorted(cells, cells, side="left")
    layers = np.full((int(number.max(initial=-1)) + 1, n_cells), -1, dtype=np.int32)
    layers[number, cells] = choices
    return layers


def count_of_choices(part: AgentPart) -> int:
    """Return how many choices an agent has: inputs of its menu, and targets on its lattice."""
    targets = int(np.prod(part.lattice_shape))
    if part.relation["kind"] == "exact":
        return targets
    return len(part.relation["menu"]) + (targets if part.relation.get("aims") else 0)


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

    certificate: OnGrid
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
        """Return which choices (M, C) are on the menus at states (M, d), automaton states (M,) and a time.

        Choices are numbered as in the relation: lattice points in C order (``exact``), inputs of its menu, or both, the
        inputs first (``linear``). Where the certificate has no choice the value is 0 and the menu is empty: any input
        will do.
        """
        i, controller = self._agent(agent)
        points = np.atleast_2d(np.asarray(states, dtype=float)).T
        cells = controller.grid.cell_of(controller.project(points))
        menus = self.menus[i]
        allowed = np.zeros((points.shape[1], count_of_choices(self.certificate.proof.agents[i])), dtype=bool)
        states_q = np.broadcast_to(np.asarray(q, dtype=np.int64), cells.shape)
        _, n_states, n_cells = menus.counts.shape
        for m, (cell, state) in enumerate(zip(cells.tolist(), states_q.tolist(), strict=True)):
            place = (time * n_states + state) * n_cells + cell
            end = int(menus.ends[place])
            allowed[m, menus.choices[end - int(menus.counts[time, state, cell]) : end]] = True
        return allowed

    def inputs(
        self, agent: str, states: Any, choices: Any, beside: Any = None, q: Any = 0, time: int = 0
    ) -> FloatArray:
        """Return the inputs (M, m) by which an agent carries out choices (M,) at states (M, d).

        ``beside`` (M, l) are the states of others that the dynamics of an agent with expressions name. Automaton states
        ``q`` (M,) and ``time`` are asked for by networks alone.
        """
        points = np.atleast_2d(np.asarray(states, dtype=float)).T[:, None]
        others = None if beside is None else np.atleast_2d(np.asarray(beside, dtype=float)).T[:, None]
        chosen = np.asarray(choices).reshape(1, -1)
        states_q = np.broadcast_to(np.asarray(q, dtype=np.int64), chosen.shape[1:])
        return self._agent(agent)[1].carried_out(chosen, points, states_q, time, others)[:, 0].T

    def _agent(self, name: str) -> tuple[int, AgentController]:
        """Return number and controller of an agent; raise ValueError if there is none of this name."""
        if name not in self.problem.agent_names:
            raise ValueError(f"`agent`: expected one of {', '.join(self.problem.agent_names)}, got {name!r}")
        i = self.problem.agent_names.index(name)
        return i, self.certificate.controller.agents[i]
