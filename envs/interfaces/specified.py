"""What Gymnasium calls the specification of an environment: its id, and how long episodes are."""

from __future__ import annotations

from dataclasses import replace

from gymnasium.envs.registration import EnvSpec

from ..tasks.problem import Problem


class Specified:
    """Has a specification with ``max_episode_steps``, the horizon of its problem, and a ``reward_threshold``.

    The registry has neither, because both depend on the arguments: Gymnasium would cut off episodes that are asked to
    be longer. No wrapper is needed: environments end at the horizon by themselves.
    """

    problem: Problem
    reward_threshold: float | None = None
    """Certified lower bound on the probability of success, where the return of an episode is 1 for success, else 0."""
    _specification: EnvSpec | None = None

    @property
    def spec(self) -> EnvSpec | None:
        """Its specification; None for problems of one's own."""
        return self._specification

    @spec.setter
    def spec(self, spec: EnvSpec | None) -> None:
        steps, threshold = self.problem.horizon, self.reward_threshold
        self._specification = spec and replace(spec, max_episode_steps=steps, reward_threshold=threshold)
