"""Controllers of all agents of a problem, in an environment or in batches."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from hashlib import sha256
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....envs.simulation import Draws, Dynamics, Worlds, neighbours
from ....envs.systems.agents import place_of
from ....envs.systems.arguments import counted, tree_text
from ....envs.tasks.problem import Problem
from ...relations.grids import FloatArray, alike_text, shape_text
from .abstract_state import Memory
from .agent_controller import AgentController
from .communicated import told
from .predicting import Predicting


@dataclass(frozen=True, eq=False, repr=False)
class Controller(Predicting):
    """Controllers of all agents of a problem, usable in a PettingZoo loop and in batched rollouts.

    The information structure is that of the certificate: own state, shared automaton state, time, and per coupled
    agent its abstract state.

    Parameters
    ----------
    problem : Problem
    agents : tuple of AgentController
    """

    problem: Problem
    agents: tuple[AgentController, ...]
    _episode: dict[str, Any] = field(default_factory=dict, init=False, repr=False)

    def __repr__(self) -> str:
        times, states = self.agents[0].policy.shape[:2]
        rows = [
            ("agents", counted(len(self.agents), "agent")),
            ("relation", alike_text(agent.relation.kind for agent in self.agents)),
            ("cells", alike_text(shape_text(agent.grid.shape) for agent in self.agents)),
            ("policies", f"{counted(times, 'time')}, {counted(states, 'automaton state')}"),
            ("memory", counted(sum(agent.is_coupled for agent in self.agents), "abstract state")),
        ]
        return tree_text(f"Controller of {self.problem.name!r}", rows)

    @cached_property
    def _by_name(self) -> dict[str, AgentController]:
        return {agent.name: agent for agent in self.agents}

    def reset(
        self, observations: Mapping[str, Any], infos: Mapping[str, Any] | None = None, seed: int | None = None
    ) -> None:
        """Begin an episode with the observations of ``env.reset``.

        ``seed`` fixes the auxiliary draws of agents with a coupling F; others draw nothing.

        Raises
        ------
        ValueError
            If the agents are not those of the controller's problem, or the environment has noisy sensors.
        """
        for name in observations:
            told(infos, name)
        strangers = sorted(set(observations) ^ set(self._by_name))
        if strangers:
            raise ValueError(
                f"`observations`: expected exactly the agents of problem {self.problem.name!r}, got a mismatch at "
                f"{', '.join(strangers[:5])}; reset the controller of this environment's own problem"
            )
        if seed is not None or "rng" not in self._episode:
            self._episode["rng"] = np.random.default_rng(seed)
        self._episode["memory"] = {}

    def act(self, observations: Mapping[str, Any], infos: Mapping[str, Any] | None = None) -> dict[str, FloatArray]:
        """Return the action of every agent observed: name -> (m,) float64.

        The state is read from the observation, or from ``infos[agent]`` (keys ``state``, ``automaton_state``, ``time``)
        if that is given: it survives wrappers that round or rescale observations. Infos also say whether the
        environment has noisy sensors, which is refused (ValueError).
        """
        actions, seen = {}, dict[str, tuple[FloatArray, int, int]]()
        for name, observation in observations.items():
            if name not in self._by_name:
                raise ValueError(
                    f"`observations`: expected agents of problem {self.problem.name!r}, got {name!r}; act in its own "
                    "environment"
                )
            agent = self._by_name[name]
            info = told(infos, name)
            if info is not None:
                state, q, time = info["state"], int(info["automaton_state"]), int(info["time"])
            else:
                state, q, time = self._read(agent, np.asarray(observation, dtype=float))
            seen[name] = np.asarray(state, dtype=float), q, time
        for name, (state, q, time) in seen.items():
            agent, beside = self._by_name[name], self._beside(name, seen)
            actions[name] = self._act_one(agent, state[:, None, None], q, time, beside)
        return actions

    def _beside(self, name: str, seen: Mapping[str, tuple[FloatArray, int, int]]) -> FloatArray | None:
        """Return the states of others (l, 1, 1) that the dynamics of an agent name; None if they are not all seen.

        Inputs of others are no numbers: they are chosen in the same step.
        """
        agents = self.problem.agents
        model = agents[self.problem.agent_names.index(name)]
        if not model.others:
            return None
        places = [place_of(other, agents) for other in model.others]
        if any(agents[place.agent].name not in seen for place in places if not place.is_input):
            return None
        states = (np.nan if p.is_input else seen[agents[p.agent].name][0][p.component] for p in places)
        return np.array([*states])[:, None, None]

    def _act_one(
        self, agent: AgentController, state: FloatArray, q: int, time: int, beside: FloatArray | None
    ) -> FloatArray:
        """Return the action of one agent; its memory is kept between the calls of an episode."""
        if not agent.is_coupled:
            return np.ascontiguousarray(agent.act(state, np.array([q]), time, None, None, beside)[0][:, 0, 0])
        memories, rng = self._episode.setdefault("memory", {}), self._episode.setdefault("rng", np.random.default_rng())
        if time == 0 or agent.name not in memories:
            memories[agent.name] = agent.begin(state)
        uniform = rng.random((1, 1)) if agent.draws else None
        inputs, memories[agent.name] = agent.act(state, np.array([q]), time, memories[agent.name], uniform)
        return np.ascontiguousarray(inputs[:, 0, 0])

    def _read(self, agent: AgentController, observation: FloatArray) -> tuple[FloatArray, int, int]:
        """Return state, automaton state and time of an observation (own state, one-hot automaton state, time left)."""
        d, n_q = len(agent.grid.edges), self.problem.automaton.n_states
        if observation.shape != (d + n_q + 1,):
            raise ValueError(
                f"`observations`: expected {d + n_q + 1} numbers for agent `{agent.name}` (state, automaton state, "
                f"time left), got shape {observation.shape}"
            )
        q = int(np.argmax(observation[d : d + n_q]))
        return observation[:d], q, round((1.0 - float(observation[-1])) * self.problem.horizon)

    def batch(self, dynamics: Dynamics) -> BatchController:
        """Return the same controllers for batched rollouts of ``dynamics``."""
        return BatchController.of(self.agents, dynamics)


@dataclass(frozen=True, eq=False)
class ControllerGroup:
    """Agents of one block that share grid and relation: their places in the block, and their common controller."""

    members: NDArray[np.int64]
    controller: AgentController


@dataclass(frozen=True, eq=False)
class BatchMemory:
    """Memory of a batch: one entry per group of each block, and the generator of the auxiliary draws."""

    groups: tuple[tuple[Memory | None, ...], ...]
    rng: Draws

    @property
    def lost(self) -> NDArray[np.bool_] | None:
        """(M,) whether any agent's relation was ever lost; None if there is nothing to lose."""
        flags = [memory.lost.any(axis=0) for block in self.groups for memory in block if memory is not None]
        return np.logical_or.reduce(flags) if flags else None


@dataclass(frozen=True, eq=False)
class BatchController:
    """Controllers arranged for batches: agents with the same grid and relation act in one call."""

    blocks: tuple[tuple[ControllerGroup, ...], ...]
    shapes: tuple[tuple[int, int], ...]
    dynamics: Dynamics

    @classmethod
    def of(cls, agents: Sequence[AgentController], dynamics: Dynamics) -> BatchController:
        """Return the controllers of ``agents``, grouped within each block of ``dynamics``."""
        blocks, shapes = [], []
        for block in dynamics.blocks:
            groups: dict[object, list[int]] = {}
            for k, i in enumerate(block.agents):
                groups.setdefault(_signature(agents[i]), []).append(k)
            blocks.append(tuple(_group(agents, block.agents, members) for members in groups.values()))
            shapes.append((block.n_inputs, len(block.agents)))
        return cls(tuple(blocks), tuple(shapes), dynamics)

    def begin(self, worlds: Worlds, rng: Draws) -> BatchMemory:
        """Return the memory at time 0; agents with a coupling F take one draw per step and world from ``rng``."""
        pairs = zip(self.blocks, worlds.states, strict=True)
        memory = tuple(tuple(g.controller.begin(states[:, g.members]) for g in groups) for groups, states in pairs)
        return BatchMemory(memory, rng)

    def selected(self, memory: BatchMemory, which: NDArray[Any]) -> BatchMemory:
        """Return the memory of the worlds ``which`` alone, whole numbers in increasing order."""
        groups = (tuple(entry and entry.selected(which) for entry in block) for block in memory.groups)
        return BatchMemory(tuple(groups), memory.rng)

    def act(self, worlds: Worlds, memory: BatchMemory) -> tuple[tuple[FloatArray, ...], BatchMemory]:
        """Return inputs (m, n, M) per block, and the memory for the next step."""
        result, next_memory = [], []
        others = neighbours(self.dynamics, worlds.states)
        for groups, memories, (m, n), states, named in zip(
            self.blocks, memory.groups, self.shapes, worlds.states, others, strict=True
        ):
            inputs, remembered = [], []
            # The order of groups is that of the draws: it is part of what a seed means.
            for group, before in zip(groups, memories, strict=True):
                uniform = memory.rng.random((len(group.members), worlds.n_worlds)) if group.controller.draws else None
                here = states if len(groups) == 1 else states.take(group.members, axis=1)
                beside = None if named is None else named.take(group.members, axis=1)
                chosen, after = group.controller.act(here, worlds.q, worlds.time, before, uniform, beside)
                inputs.append(chosen)
                remembered.append(after)
            result.append(inputs[0] if len(groups) == 1 else _placed(groups, inputs, (m, n, worlds.n_worlds)))
            next_memory.append(tuple(remembered))
        return tuple(result), BatchMemory(tuple(next_memory), memory.rng)


def _placed(
    groups: Sequence[ControllerGroup], group_inputs: Sequence[FloatArray], shape: tuple[int, int, int]
) -> FloatArray:
    """Return the inputs (m, n, M) of a block, put together from those of its groups."""
    inputs = np.empty(shape)
    for group, members_inputs in zip(groups, group_inputs, strict=True):
        inputs[:, group.members] = members_inputs
    return inputs


def _signature(agent: AgentController) -> object:
    """Return what agents that act in one call have in common: all but their names and what their policies hold."""
    arrays = (*agent.grid.edges, *agent.lattice, *agent.relation.arrays)
    input_set = b"" if agent.input_set is None else sha256(agent.input_set.tobytes()).digest()
    return (agent.relation.kind, len(agent.policy), input_set, *(a.tobytes() for a in arrays))


def _group(agents: Sequence[AgentController], block: NDArray[Any], members: list[int]) -> ControllerGroup:
    """Return a group of some ``members`` of a block, with one controller that holds the policies of all."""
    first = agents[block[members[0]]]
    policy = np.stack([agents[block[k]].policy for k in members])
    shared = AgentController("", first.grid, first.lattice, first.relation, policy, first.input_set)
    return ControllerGroup(np.array(members), shared)
