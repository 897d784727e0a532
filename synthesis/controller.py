"""Per-agent finite-memory controllers that carry out a policy on the continuous system.

Each agent sees its own state, the shared automaton state and the time, looks up the target mean of its cell and applies
the relation's input (THEORY section 6). Controllers are total: outside the workspace, in states and at times that no
certificate speaks of, the input is the one of the nearest cell, and always admissible.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..envs.dynamics import Dynamics, Worlds
from ..envs.problem import Problem
from .grid import FloatArray, Grid
from .relation import ExactRelation


@dataclass(frozen=True, eq=False)
class AgentController:
    """Controller of one agent: ``input = relation(target of (time, automaton state, cell), state)``.

    Parameters
    ----------
    name : str
    grid : Grid
    lattice : tuple of (Z_k,) arrays
        Target means per axis, in grid coordinates.
    relation : ExactRelation
    law : (T, Q, S) int32 array
        Target of each cell as a flat lattice index; -1 where no target is admissible.
    """

    name: str
    grid: Grid
    lattice: tuple[FloatArray, ...]
    relation: ExactRelation
    law: NDArray[np.int32]

    def act(self, state: FloatArray, q: int, time: int) -> FloatArray:
        """Input (m,) at one state (d,), automaton state and time."""
        inputs = self.inputs(np.asarray(state, dtype=float)[:, None], np.array([q]), time)
        return np.ascontiguousarray(inputs[:, 0])

    def inputs(self, states: FloatArray, q: NDArray[np.integer], time: int) -> FloatArray:
        """Inputs (m, M) at states (d, M) and automaton states (M,), the same bits for any M."""
        points = self.project(states)
        cells = self.grid.cell_of(points)
        return self.towards(self.law[min(time, len(self.law) - 1), q, cells], points)

    def towards(self, targets: NDArray[np.integer], points: FloatArray) -> FloatArray:
        """Inputs (m, M) that put the mean of the next state on lattice points (M,) from points (d, M) of the grid."""
        shape = tuple(len(axis) for axis in self.lattice)
        indices = np.unravel_index(np.maximum(targets, 0), shape)
        goal = np.stack([axis[index] for axis, index in zip(self.lattice, indices, strict=True)])
        inputs = self.relation.inputs(goal, points)
        idle = targets < 0
        if idle.any():
            inputs[:, idle] = self.relation.input_centre[:, None]
        return inputs

    def project(self, states: FloatArray) -> FloatArray:
        """Grid coordinates of the states, moved into the grid where they are outside; NaN goes to the low edge."""
        points = self.relation.to_grid(states)
        for k, edges in enumerate(self.grid.edges):
            points[k] = np.clip(np.nan_to_num(points[k], nan=edges[0]), edges[0], edges[-1])
        return points


@dataclass(frozen=True, eq=False)
class Controller:
    """Controllers of all agents of a problem, usable in a PettingZoo loop and in batched rollouts.

    The information structure is that of the certificate: own state, shared automaton state, time. There is no other
    memory, so ``reset`` only checks that the environment is the one the controller was made for.

    Parameters
    ----------
    problem : Problem
    agents : tuple of AgentController
    """

    problem: Problem
    agents: tuple[AgentController, ...]

    @cached_property
    def _by_name(self) -> dict[str, AgentController]:
        return {agent.name: agent for agent in self.agents}

    def reset(self, observations: Mapping[str, Any], infos: Mapping[str, Any] | None = None) -> None:
        """Begin an episode with the observations of ``env.reset``.

        Raises
        ------
        ValueError
            If the agents are not those of the controller's problem.
        """
        strangers = sorted(set(observations) ^ set(self._by_name))
        if strangers:
            raise ValueError(
                f"`observations`: expected exactly the agents of problem {self.problem.name!r}, got a mismatch at "
                f"{', '.join(strangers[:5])}; reset the controller of this environment's own problem"
            )

    def act(self, observations: Mapping[str, Any], infos: Mapping[str, Any] | None = None) -> dict[str, FloatArray]:
        """Action of every agent observed: name -> (m,) float64.

        The state is read from the observation, or from ``infos[agent]`` (keys ``state``, ``automaton_state``, ``time``)
        where that is given: it survives wrappers that round or rescale observations.
        """
        actions = {}
        for name, observation in observations.items():
            agent = self._by_name[name]
            info = infos.get(name) if infos is not None else None
            if info is not None and "state" in info:
                actions[name] = agent.act(info["state"], int(info["automaton_state"]), int(info["time"]))
            else:
                actions[name] = agent.act(*self._read(agent, np.asarray(observation, dtype=float)))
        return actions

    def _read(self, agent: AgentController, observation: FloatArray) -> tuple[FloatArray, int, int]:
        """State, automaton state and time in an observation (own state, one-hot automaton state, fraction left)."""
        d, n_q = len(agent.grid.edges), self.problem.automaton.n_states
        if observation.shape != (d + n_q + 1,):
            raise ValueError(
                f"`observations`: expected {d + n_q + 1} numbers for agent `{agent.name}` (state, automaton "
                f"state, time left), got shape {observation.shape}"
            )
        q = int(np.argmax(observation[d : d + n_q]))
        return observation[:d], q, round((1.0 - float(observation[-1])) * self.problem.horizon)

    def batch(self, dynamics: Dynamics) -> BatchController:
        """The same controllers for batched rollouts of ``dynamics``."""
        return BatchController.of(self, dynamics)


@dataclass(frozen=True, eq=False)
class _Group:
    """Agents of one block with the same grid and lattice, stacked; arrays as in ``envs.dynamics.Block``."""

    members: NDArray[np.int64]
    grid: Grid
    lattice: tuple[FloatArray, ...]
    relation: ExactRelation
    law: NDArray[np.int32]


@dataclass(frozen=True, eq=False)
class BatchController:
    """Controllers arranged for batches: agents with the same grid and relation act in one call."""

    blocks: tuple[tuple[_Group, ...], ...]
    shapes: tuple[tuple[int, int], ...]

    @classmethod
    def of(cls, controller: Controller, dynamics: Dynamics) -> BatchController:
        """Group the agents of each block of ``dynamics``."""
        blocks, shapes = [], []
        for block in dynamics.blocks:
            groups: dict[object, list[int]] = {}
            for k, i in enumerate(block.agents):
                groups.setdefault(_signature(controller.agents[i]), []).append(k)
            blocks.append(tuple(_group(controller.agents, block.agents, members) for members in groups.values()))
            shapes.append((block.B.shape[1], len(block.agents)))
        return cls(tuple(blocks), tuple(shapes))

    def begin(self, worlds: Worlds, rng: np.random.Generator) -> None:
        """Nothing is remembered: cell, automaton state and time are read off the worlds."""

    def act(self, worlds: Worlds, memory: None) -> tuple[tuple[FloatArray, ...], None]:
        """Inputs (m, n, M) per block."""
        result = []
        for groups, (m, n), states in zip(self.blocks, self.shapes, worlds.states, strict=True):
            inputs = np.empty((m, n, worlds.n_worlds))
            for group in groups:
                inputs[:, group.members] = _stacked_inputs(group, states[:, group.members], worlds.q, worlds.time)
            result.append(inputs)
        return tuple(result), None


def _signature(agent: AgentController) -> object:
    arrays = (*agent.grid.edges, *agent.lattice, *agent.relation.arrays)
    return tuple(a.tobytes() for a in arrays)


def _group(agents: Sequence[AgentController], block: NDArray[np.integer], members: list[int]) -> _Group:
    first = agents[block[members[0]]]
    law = np.stack([agents[block[k]].law for k in members])
    return _Group(np.array(members), first.grid, first.lattice, first.relation, law)


def _stacked_inputs(group: _Group, states: FloatArray, q: NDArray[np.integer], time: int) -> FloatArray:
    """Inputs (m, n, M) of agents that share grid and relation, at states (d, n, M)."""
    d, n, n_worlds = states.shape
    agent = AgentController("", group.grid, group.lattice, group.relation, group.law[0])
    points = agent.project(states.reshape(d, -1))
    cells = group.grid.cell_of(points).reshape(n, n_worlds)
    targets = group.law[np.arange(n)[:, None], min(time, group.law.shape[1] - 1), q[None, :], cells].reshape(-1)
    return agent.towards(targets, points).reshape(-1, n, n_worlds)
