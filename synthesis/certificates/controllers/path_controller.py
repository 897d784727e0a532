"""Controllers that follow nominal paths: ``u_t = ubar_t + K (x_t - xbar_t)``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....envs.simulation import Dynamics, Worlds
from ....envs.systems.agents import LinearAgent, wrapped
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
        Agents with a start that is a point, or along nonlinear paths a box.
    paths : tuple of (inputs, gain, states)
        Nominal inputs (S, m) of every agent, feedback (m, d) or (S, m, d), and along a nonlinear path nominal states
        (S + 1, d); None for those that the inputs lead a linear agent to.
    """

    information = "own state, time"

    problem: Problem
    paths: tuple[tuple[FloatArray, FloatArray, FloatArray | None], ...]

    def __repr__(self) -> str:
        rows = [("agents", len(self.paths)), ("steps", len(self.paths[0][0]))]
        return tree_text(f"PathController of {self.problem.name!r}", rows)

    @cached_property
    def nominal(self) -> tuple[FloatArray, ...]:
        """Nominal states (S + 1, d) of every agent (rounded)."""
        pairs = zip(self.problem.agents, self.paths, strict=True)
        return tuple(
            nominal_states(agent, inputs) if states is None else states  # type: ignore[arg-type]
            for agent, (inputs, _, states) in pairs
        )

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
        own, (inputs, gain, _) = self.problem.agents[agent], self.paths[agent]
        t = min(time, len(inputs) - 1)
        feedback = gain[t] if gain.ndim == 3 else gain
        deviation = states - self.nominal[agent][t][:, None]
        if own.angles:
            # Nominal angles may be turns away: what counts is the nearest of all that the angle stands for.
            deviation[own.wrapped_axes] = wrapped(deviation[own.wrapped_axes], -np.pi)
        wanted = inputs[t][:, None] + feedback @ deviation
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


def nominal_states(agent: LinearAgent, inputs: FloatArray) -> FloatArray:
    """Return the states (S + 1, d) of an agent without noise under inputs (S, m), from its start (rounded)."""
    states = np.empty((len(inputs) + 1, agent.n_states))
    states[0] = agent.initial.low
    for t, u in enumerate(inputs):
        states[t + 1] = agent.A @ states[t] + agent.B @ u + agent.offset
    return states


def covariances_of(agent: LinearAgent, gain: FloatArray, steps: int) -> FloatArray:
    """Return the covariances (S + 1, d, d) of the deviations from a nominal path under a feedback (rounded)."""
    closed = agent.A + agent.B @ gain
    result = np.zeros((steps + 1, agent.n_states, agent.n_states))
    for t in range(steps):
        result[t + 1] = closed @ result[t] @ closed.T + agent.noise_covariance
    return result
