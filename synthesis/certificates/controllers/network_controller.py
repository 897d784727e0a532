"""Controllers that are networks, along the run that they take without noise, of own states or of those of all."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....envs.simulation import Dynamics, Worlds
from ...relations.grids import FloatArray
from ...relations.kinds import JointNetworkPolicy, NetworkPolicy, SymbolicPolicy
from .communicated import told_of_all
from .path_controller import BatchPaths, PathController


@dataclass(frozen=True, eq=False, repr=False)
class NetworkController(PathController):
    """Networks of all agents, as they were given; the paths of ``PathController`` are their runs without noise.

    Parameters
    ----------
    networks : tuple of NetworkPolicy or WrittenPolicy
        One for each agent, which sees its own state, the automaton state and the time.
    """

    information = "own state, automaton state, time"

    networks: tuple[NetworkPolicy | JointNetworkPolicy | SymbolicPolicy, ...]

    def act(self, observations: Mapping[str, Any], infos: Mapping[str, Any] | None = None) -> dict[str, FloatArray]:
        """Return the action of every agent observed: name -> (m,) float64; see ``PathController.act``."""
        seen = told_of_all(self.problem, observations, infos, self.problem.automaton.n_states)
        numbers = {name: i for i, name in enumerate(self.problem.agent_names)}
        return {
            name: self.inputs(numbers[name], np.asarray(state, dtype=float)[:, None], np.array([q]), time)[:, 0]
            for name, (state, q, time) in seen.items()
        }

    def inputs(self, agent: int, states: FloatArray, q: NDArray[Any], time: int) -> FloatArray:
        """Return the inputs (m, M) of an agent at states (d, M), automaton states (M,) and a time."""
        return self.networks[agent].inputs(states, q, min(time, self.problem.horizon - 1))


@dataclass(frozen=True, eq=False, repr=False)
class JointNetworkController(NetworkController):
    """Networks of which some see the states of all agents: these are told to each of them at every step."""

    information = "states of all agents, automaton state, time"

    def act(self, observations: Mapping[str, Any], infos: Mapping[str, Any] | None = None) -> dict[str, FloatArray]:
        """Return the action of every agent: name -> (m,) float64, from observations of all; see ``PathController``."""
        names, n_q = self.problem.agent_names, self.problem.automaton.n_states
        if set(observations) != set(names):
            raise ValueError("`observations`: expected those of all agents, whose states the networks see, got some")
        seen = told_of_all(self.problem, observations, infos, n_q)
        states = np.concatenate([np.asarray(seen[name][0], dtype=float) for name in names])[:, None]
        return {
            name: self.inputs(i, states, np.array([seen[name][1]]), seen[name][2])[:, 0] for i, name in enumerate(names)
        }

    def inputs(self, agent: int, states: FloatArray, q: NDArray[Any], time: int) -> FloatArray:
        """Return the inputs (m, M) of an agent at joint states (D, M), automaton states (M,) and a time."""
        network = self.networks[agent]
        own = states if network.sees_all else states[self.problem.columns[agent]]
        return network.inputs(own, q, min(time, self.problem.horizon - 1))

    def batch(self, dynamics: Dynamics) -> BatchJointNetworks:
        """Return the same controllers for batched rollouts of ``dynamics``."""
        return BatchJointNetworks(self, tuple(block.agents for block in dynamics.blocks), dynamics)


@dataclass(frozen=True, eq=False)
class BatchJointNetworks(BatchPaths):
    """Networks that see the states of all, arranged for batches."""

    dynamics: Dynamics

    def act(self, worlds: Worlds, memory: None) -> tuple[tuple[FloatArray, ...], None]:
        """Return inputs (m, n, M) per block."""
        time = worlds.time if isinstance(worlds.time, int) else int(np.max(worlds.time))
        states = np.concatenate([worlds.states[block][:, place] for block, place in self.dynamics.position])
        each = [self.controller.inputs(i, states, worlds.q, time) for i in range(self.dynamics.problem.n_agents)]
        return tuple(np.stack([each[i] for i in members], axis=1) for members in self.blocks), None
