"""What learners call: ``predict``, as policies of Stable-Baselines3 have it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....envs.tasks.problem import Problem


class Predicting:
    """Controllers that act, and so predict actions."""

    problem: Problem

    def act(self, observations: Mapping[str, Any], infos: Mapping[str, Any] | None = None) -> dict[str, Any]:
        """Return the action of every agent observed: name -> (m,) float64."""
        raise NotImplementedError

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[Any, Any]:
        """Return the actions at an observation, and ``state`` as it came.

        What Stable-Baselines3 has besides is taken and not looked at: certified controllers remember nothing that they
        are not told, and draw nothing for an action.

        Parameters
        ----------
        observation : mapping, or array, shape (n,) or (1, n)
            Observations of ``parallel_env`` by agents, which give actions by agents; or one of ``make`` with its usual
            options, which gives its action: inputs of all agents, each mapped to [-1, 1].

        Raises
        ------
        ValueError
            If an array has another shape.
        """
        if isinstance(observation, Mapping):
            return self.act(observation), state
        row, agents = np.asarray(observation, dtype=float), self.problem.agents
        d = sum(agent.n_states for agent in agents)
        n = d + self.problem.automaton.n_states + 1
        if row.shape not in ((n,), (1, n)):
            raise ValueError(
                f"`observation`: expected a mapping by agents, or {n} numbers (states of all agents, automaton state, "
                f"time left), got shape {row.shape}; `rollout` simulates many worlds at once"
            )
        states, rest = np.split(row.reshape(n), [d])
        own = np.split(states, np.cumsum([agent.n_states for agent in agents])[:-1])
        acted = self.act({agent.name: np.concatenate([x, rest]) for agent, x in zip(agents, own, strict=True)})
        units = [_in_unit(acted[agent.name], agent.input_low, agent.input_high) for agent in agents]
        return np.concatenate(units).astype(np.float32).reshape((*row.shape[:-1], -1)), state


def _in_unit(inputs: NDArray[Any], low: NDArray[Any], high: NDArray[Any]) -> NDArray[Any]:
    """Return inputs as shares of their box, from -1 to 1; 0 where the box is flat."""
    width = np.where(high > low, high - low, 1.0)
    return np.where(high > low, 2.0 * (inputs - low) / width - 1.0, 0.0)
