"""Controllers that are networks, along the run that they take without noise."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...relations.grids import FloatArray
from ...relations.kinds import NetworkPolicy, SymbolicPolicy
from .communicated import told_of_all
from .path_controller import PathController


@dataclass(frozen=True, eq=False, repr=False)
class NetworkController(PathController):
    """Networks of all agents, as they were given; the paths of ``PathController`` are their runs without noise.

    Parameters
    ----------
    networks : tuple of NetworkPolicy or WrittenPolicy
        One for each agent, which sees its own state, the automaton state and the time.
    """

    information = "own state, automaton state, time"

    networks: tuple[NetworkPolicy | SymbolicPolicy, ...]

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
