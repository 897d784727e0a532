"""Controllers of all agents of a problem, in an environment or in batches."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from ..envs.dynamics import Dynamics
from ..envs.problem import Problem
from .agent_controller import AgentController
from .batch_controller import BatchController
from .grid import FloatArray


@dataclass(frozen=True, eq=False)
class Controller:
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
            If the agents are not those of the controller's problem.
        """
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
        """Action of every agent observed: name -> (m,) float64.

        The state is read from the observation, or from ``infos[agent]`` (keys ``state``, ``automaton_state``, ``time``)
        where that is given: it survives wrappers that round or rescale observations.
        """
        actions = {}
        for name, observation in observations.items():
            if name not in self._by_name:
                raise ValueError(
                    f"`observations`: expected agents of problem {self.problem.name!r}, got {name!r}; act in its own "
                    "environment"
                )
            agent = self._by_name[name]
            info = infos.get(name) if infos is not None else None
            if info is not None and "state" in info:
                state, q, time = info["state"], int(info["automaton_state"]), int(info["time"])
            else:
                state, q, time = self._read(agent, np.asarray(observation, dtype=float))
            actions[name] = self._act_one(agent, np.asarray(state, dtype=float)[:, None, None], q, time)
        return actions

    def _act_one(self, agent: AgentController, state: FloatArray, q: int, time: int) -> FloatArray:
        """Action of one agent, its memory kept between calls of one episode."""
        if not agent.is_coupled:
            return np.ascontiguousarray(agent.act(state, np.array([q]), time, None)[0][:, 0, 0])
        memories, rng = self._episode.setdefault("memory", {}), self._episode.setdefault("rng", np.random.default_rng())
        if time == 0 or agent.name not in memories:
            memories[agent.name] = agent.begin(state)
        uniform = rng.random((1, 1)) if agent.draws else None
        inputs, memories[agent.name] = agent.act(state, np.array([q]), time, memories[agent.name], uniform)
        return np.ascontiguousarray(inputs[:, 0, 0])

    def _read(self, agent: AgentController, observation: FloatArray) -> tuple[FloatArray, int, int]:
        """State, automaton state and time in an observation (own state, one-hot automaton state, fraction left)."""
        d, n_q = len(agent.grid.edges), self.problem.automaton.n_states
        if observation.shape != (d + n_q + 1,):
            raise ValueError(
                f"`observations`: expected {d + n_q + 1} numbers for agent `{agent.name}` (state, automaton state, "
                f"time left), got shape {observation.shape}"
            )
        q = int(np.argmax(observation[d : d + n_q]))
        return observation[:d], q, round((1.0 - float(observation[-1])) * self.problem.horizon)

    def batch(self, dynamics: Dynamics) -> BatchController:
        """The same controllers for batched rollouts of ``dynamics``."""
        return BatchController.of(self.agents, dynamics)
