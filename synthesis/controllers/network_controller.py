"""Controllers that are networks, along the run that they take without noise."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...envs.dynamics import Dynamics, Worlds
from ..cells import FloatArray
from ..relations import NetworkPolicy, WrittenPolicy
from .path_controller import PathController
from .told import told_of_all


@dataclass(frozen=True, eq=False, repr=False)
class NetworkController(PathController):
    """Networks of all agents, as they were given; the paths of ``PathController`` are their runs without noise.

    Parameters
    ----------
    networks : tuple of NetworkPolicy or WrittenPolicy
        One for each agent, which sees its own state, the automaton state and the time.
    """

    information = "own state, automaton state, time"

    networks: tuple[NetworkPolicy | WrittenPolicy, ...]

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

    def batch(self, dynamics: Dynamics) -> BatchNetworks:  # type: ignore[override]
        """Return the same controllers for batched rollouts of ``dynamics``."""
        return BatchNetworks(self, tuple(block.agents for block in dynamics.blocks))


@dataclass(frozen=True, eq=False)
class BatchNetworks:
    """Networks arranged for batches; nothing is remembered."""

    controller: NetworkController
    blocks: tuple[NDArray[np.int64], ...]

    def begin(self, worlds: Worlds, rng: Any) -> None:
        """Nothing is remembered."""

    def selected(self, memory: None, which: NDArray[Any]) -> None:
        """Nothing is remembered of any world."""

    def act(self, worlds: Worlds, memory: None) -> tuple[tuple[FloatArray, ...], None]:
        """Return inputs (m, n, M) per block."""
        time = worlds.time if isinstance(worlds.time, int) else int(np.max(worlds.time))
        blocks = []
        for members, states in zip(self.blocks, worlds.states, strict=True):
            each = [self.controller.inputs(int(i), states[:, k], worlds.q, time) for k, i in enumerate(members)]
            blocks.append(np.stack(each, axis=1))
        return tuple(blocks), None
