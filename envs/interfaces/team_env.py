"""The batched environment of a team: one array per agent, M worlds in one step, for learners with loops of their own.

Worlds, rewards and ends are those of `ProblemVectorEnv`, which makes one array of all agents. Here each agent gets an
array of its own, in the form that networks like, and nothing is made that a learner does not read; so a step costs
little more than the dynamics.

A world that ends begins anew in the same step: the observations are those of the new episode, `terminated`, `truncated`
and `satisfied` speak of the old one. The horizon is an end like any other, since agents see the time left; a learner
needs no value of what comes after it, and so no last observation.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..simulation import Dynamics
from ..simulation import batch_simulator as core
from ..tasks.problem import Problem
from .team_views import TeamViews
from .vector_env import ProblemVectorEnv


@dataclass(frozen=True, eq=False)
class TeamStep:
    """What a step of M worlds returns.

    Parameters
    ----------
    observations : dict from agent name to (M, k) float32 array
        Of the episodes that go on or have just begun.
    rewards : (M,) array
        One for the team.
    terminated, truncated, satisfied : (M,) bool arrays
        Whether an episode has ended by a verdict, or at the horizon; and whether an ended one satisfied its task.
    automaton_state, time_left : (M,) int arrays
        Of the episodes that go on or have just begun; time in control steps.
    """

    observations: dict[str, np.ndarray]
    rewards: np.ndarray
    terminated: np.ndarray
    truncated: np.ndarray
    satisfied: np.ndarray
    automaton_state: np.ndarray
    time_left: np.ndarray

    @property
    def ended(self) -> np.ndarray:
        """Whether an episode has ended in this step, (M,) bool."""
        return self.terminated | self.truncated


class TeamEnv:
    """A batch of worlds with one array per agent; see the module docstring.

    Parameters
    ----------
    problem : Problem
        Ids and files are taken by `certigym.team_env`.
    num_envs : int
        Number of worlds M.
    observation : "own", "joint" or "neighbours"
        The state of the agent itself (what certified policies see); the states of all agents in order; or the own state
        and where the nearest other agents are from it (see `nearest`).
    neighbours : int, optional
        How many neighbours an agent sees; by default two, or all others in smaller teams.
    scale : "unit" or "raw"
        States moved into the workspace and scaled to [-1, 1], or as they are.
    automaton : "one-hot", "number" or "hidden"
        How the automaton state stands in an observation.
    reward, discount, actions, sensor_noise
        As for `vector_env`.

    Examples
    --------
    >>> import certigym as cg
    >>> team = TeamEnv(cg.make_problem("reach-avoid-v0"), 1000)
    >>> first = team.reset(seed=0)
    >>> step = team.step({name: np.zeros((1000, 1)) for name in team.agents})
    >>> step.observations["agent_0"].shape, step.rewards.shape
    ((1000, 5), (1000,))
    """

    def __init__(
        self,
        problem: Problem,
        num_envs: int = 1,
        *,
        observation: str = "own",
        neighbours: int | None = None,
        scale: str = "unit",
        automaton: str = "one-hot",
        actions: str = "unit",
        **options: Any,
    ) -> None:
        self._batch = ProblemVectorEnv(problem, num_envs, autoreset_mode="SameStep", actions=actions, **options)
        self.problem, self.num_envs, self.agents = self._batch.problem, num_envs, tuple(problem.agent_names)
        self.options = {
            "observation": observation,
            "neighbours": neighbours,
            "scale": scale,
            "automaton": automaton,
            "actions": actions,
            **options,
        }
        self._dynamics = Dynamics.of(self.problem)
        self._views = TeamViews(self._dynamics, observation, neighbours, scale, automaton, actions)

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> TeamStep:
        """Begin episodes in all worlds; seed and options are those of `vector_env`."""
        self._batch.reset(seed=seed, options=options)
        nothing = np.zeros(self.num_envs, dtype=bool)
        return self._told(np.zeros(self.num_envs), (nothing, nothing, nothing))

    def step(self, actions: Mapping[str, Any]) -> TeamStep:
        """Advance all worlds one control step, with actions (M, m) for each agent by name.

        Raises
        ------
        RuntimeError
            Before the first `reset`.
        ValueError
            If actions are missing, have the wrong shape or are not finite.
        """
        rewards, terminated, truncated = self._batch.advance(self._views.inputs(actions, self.num_envs))
        ended = terminated | truncated
        satisfied = ended
        if np.count_nonzero(ended):
            satisfied = ended & np.asarray(core.satisfied(self._dynamics, self._batch.worlds))
            self._batch.renew()
        if not self._batch.sensors.is_exact:  # a reset has read the states already
            self._batch.read()
        return self._told(rewards, (terminated, truncated, satisfied))

    def _told(self, rewards: np.ndarray, ends: tuple[np.ndarray, np.ndarray, np.ndarray]) -> TeamStep:
        """Return the record of a step."""
        worlds = self._batch.worlds
        time = np.asarray(worlds.time)
        read = worlds.states
        if not self._batch.sensors.is_exact:
            read = core.split_joint(self._dynamics, self._batch.readings)
        return TeamStep(
            self._views.observations(worlds, read), rewards, *ends, worlds.q.copy(), self.problem.horizon - time
        )
