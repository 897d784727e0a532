"""What learners call: ``predict``, as policies of Stable-Baselines3 have it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any


class Predicting:
    """Controllers that act, and so predict actions."""

    def act(self, observations: Mapping[str, Any], infos: Mapping[str, Any] | None = None) -> dict[str, Any]:
        """Return the action of every agent observed: name -> (m,) float64."""
        raise NotImplementedError

    def predict(
        self, observation: Mapping[str, Any], state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[dict[str, Any], Any]:
        """Return the actions at observations of ``parallel_env``, by agents, and ``state`` as it came.

        What Stable-Baselines3 has besides is taken and not looked at: certified controllers remember nothing that they
        are not told, and draw nothing for an action.
        """
        return self.act(observation), state
