"""The controller of a team that was certified as one joint agent, carried out on the agents of the problem."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...envs.agents import tree_text
from ...envs.dynamics import Dynamics, Worlds, joint
from ...envs.problem import Problem
from ..cells import FloatArray


@dataclass(frozen=True, eq=False, repr=False)
class TeamController:
    """Controllers of all agents, each of which sees the states of all.

    Parameters
    ----------
    problem : Problem
        The problem with its agents.
    inner : Controller or PathController
        That of the joint agent, whose state is the joint state of the problem.
    """

    problem: Problem
    inner: Any

    def __repr__(self) -> str:
        rows = [("agents", self.problem.n_agents), ("sees", "the states of all agents")]
        return tree_text(f"TeamController of {self.problem.name!r}", rows)

    @cached_property
    def _name(self) -> str:
        return str(self.inner.problem.agent_names[0])

    def reset(
        self, observations: Mapping[str, Any], infos: Mapping[str, Any] | None = None, seed: int | None = None
    ) -> None:
        """Begin an episode with the observations of ``env.reset``; ``seed`` fixes the auxiliary draws.

        Raises
        ------
        ValueError
            If the agents are not those of the problem.
        """
        strangers = sorted(set(observations) ^ set(self.problem.agent_names))
        if strangers:
            raise ValueError(
                f"`observations`: expected exactly the agents of problem {self.problem.name!r}, got a mismatch at "
                f"{', '.join(strangers[:5])}; reset the controller of this environment's own problem"
            )
        self.inner.reset({self._name: None}, None, seed)

    def act(self, observations: Mapping[str, Any], infos: Mapping[str, Any] | None = None) -> dict[str, FloatArray]:
        """Return the action of every agent: name -> (m,) float64.

        All agents have to be observed. States are read from ``infos[agent]`` (keys ``state``, ``automaton_state``,
        ``time``) if that is given, else from the observations.
        """
        names, agents = self.problem.agent_names, self.problem.agents
        if missing := [name for name in names if name not in observations]:
            raise ValueError(
                f"`observations`: expected those of all agents, who see one another; {missing[0]!r} is missing"
            )
        states, q, time = [], 0, 0
        n_q = self.problem.automaton.n_states
        for name, agent in zip(names, agents, strict=True):
            info = infos.get(name) if infos is not None else None
            if info is not None and "state" in info:
                state, q, time = info["state"], int(info["automaton_state"]), int(info["time"])
            else:
                seen, d = np.asarray(observations[name], dtype=float), agent.n_states
                state, q = seen[:d], int(np.argmax(seen[-1 - n_q : -1]))
                time = round((1.0 - float(seen[-1])) * self.problem.horizon)
            states.append(np.asarray(state, dtype=float))
        told = {self._name: {"state": np.concatenate(states), "automaton_state": q, "time": time}}
        inputs = self.inner.act({self._name: None}, told)[self._name]
        return {name: inputs[columns] for name, columns in zip(names, self.problem.input_columns, strict=True)}

    def batch(self, dynamics: Dynamics) -> BatchTeam:
        """Return the same controllers for batched rollouts of ``dynamics``."""
        return BatchTeam(dynamics, self.inner.batch(Dynamics.of(self.inner.problem)))


@dataclass(frozen=True, eq=False)
class BatchTeam:
    """A team's controller arranged for batches."""

    dynamics: Dynamics
    inner: Any

    def begin(self, worlds: Worlds, rng: Any) -> Any:
        """Return the memory at time 0."""
        return self.inner.begin(self._joined(worlds), rng)

    def selected(self, memory: Any, which: NDArray[Any]) -> Any:
        """Return the memory of the worlds ``which`` alone."""
        return self.inner.selected(memory, which)

    def act(self, worlds: Worlds, memory: Any) -> tuple[tuple[FloatArray, ...], Any]:
        """Return inputs (m, n, M) per block, and the memory for the next step."""
        (inputs,), memory = self.inner.act(self._joined(worlds), memory)
        columns = self.dynamics.problem.input_columns
        blocks = [np.stack([inputs[columns[i], 0] for i in block.agents], axis=1) for block in self.dynamics.blocks]
        return tuple(blocks), memory

    def _joined(self, worlds: Worlds) -> Worlds:
        """Return the worlds with all agents as one."""
        states = np.ascontiguousarray(joint(self.dynamics, worlds).T)[:, None]
        return replace(worlds, states=(states,))
