"""Controllers that follow nominal paths: ``u_t = ubar_t + K (x_t - xbar_t)``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....envs.simulation import Dynamics, Worlds
from ....envs.systems.agents import wrapped
from ....envs.systems.arguments import tree_text
from ....envs.tasks.problem import Problem
from ...relations.grids import FloatArray
from .communicated import told
from .predicting import Predicting


@dataclass(frozen=True, eq=False, repr=False)
class PathController(Predicting):
    """Controllers of all agents along their nominal paths; after the end of a path its last input is repeated.

    Agents see their own state and the time.

    Parameters
    ----------
    problem : Problem
    paths : tuple of (inputs, gains, states)
        Nominal inputs (S, m) of every agent, feedbacks (S, m, d), and nominal states (S + 1, d).
    """

    information = "own state, time"

    problem: Problem
    paths: tuple[tuple[FloatArray, FloatArray, FloatArray], ...]

    def __repr__(self) -> str:
        rows = [("agents", len(self.paths)), ("steps", len(self.paths[0][0]))]
        return tree_text(f"PathController of {self.problem.name!r}", rows)

    @property
    def nominal(self) -> tuple[FloatArray, ...]:
        """Nominal states (S + 1, d) of every agent."""
        return tuple(states for _, _, states in self.paths)

    def reset(
        self, observations: Mapping[str, Any], infos: Mapping[str, Any] | None = None, seed: int | None = None
    ) -> None:
        """Begin an episode; nothing is remembered and nothing is drawn. Noisy sensors are refused (ValueError)."""
        for name in observations:
            told(infos, name)

    def act(self, observations: Mapping[str, Any], infos: Mapping[str, Any] | None = None) -> dict[str, FloatArray]:
        """Return the action of every agent observed: name -> (m,) float64.

        State and time are read from ``infos[agent]`` if that is given, else from the observation.
        """
        actions = {}
        numbers = {name: i for i, name in enumerate(self.problem.agent_names)}
        for name, observation in observations.items():
            i, info = numbers[name], told(infos, name)
            d = self.problem.agents[i].n_states
            if info is not None:
                state, time = np.asarray(info["state"], dtype=float), int(info["time"])
            else:
                own = np.asarray(observation, dtype=float)
                state, time = own[:d], round((1.0 - float(own[-1])) * self.problem.horizon)
            actions[name] = self.inputs(i, state[:, None], np.zeros(1, dtype=int), time)[:, 0]
        return actions

    def inputs(self, agent: int, states: FloatArray, q: NDArray[Any], time: int) -> FloatArray:
        """Return the inputs (m, M) of an agent at states (d, M), within its box, whatever the automaton states are."""
        own, (inputs, gains, nominal) = self.problem.agents[agent], self.paths[agent]
        t = min(time, len(inputs) - 1)
        deviation = states - nominal[t][:, None]
        if own.angles:
            # Nominal angles may be turns away: what counts is the nearest of all that the angle stands for.
            deviation[own.wrapped_axes] = wrapped(deviation[own.wrapped_axes], -np.pi)
        wanted = inputs[t][:, None] + gains[t] @ deviation
        return np.clip(wanted, own.input_low[:, None], own.input_high[:, None])

    def batch(self, dynamics: Dynamics) -> BatchPaths:
        """Return the same controllers for batched rollouts of ``dynamics``."""
        return BatchPaths(self, tuple(block.agents for block in dynamics.blocks))


@dataclass(frozen=True, eq=False)
class BatchPaths:
    """Path controllers, or networks in their place, arranged for batches."""

    controller: PathController
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
