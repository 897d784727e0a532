"""The PettingZoo environment of a problem: a thin view of one episode.

Everything below holds for any problem; the pages of the suite add the numbers of each.

- **Actions**: one `Box` per agent, its input box, float64; or [-1, 1], float32, with `actions="unit"`. Actions outside
  are clipped.
- **Observations**: the state of the agent itself (projected onto the workspace after an exit), with
  `observation="full"` also the states of the other agents; then the automaton state one-hot and the fraction of time
  left.
- **Rewards**: cooperative: every agent gets 1 once, when the task is satisfied, else 0; the undiscounted return *is*
  satisfaction. For `reward="shaped"` see `shaping`.
- **Episode ends**: see `episode`.
- **Infos**, per agent: numbers and arrays of fixed shape: `automaton_state` (int), `satisfied` (bool), `state` (the
  agent's true state, float64), `time` (int); with `infos="words"` also `letter` (names of the propositions that hold;
  empty after a failure, when no letter is read).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium import spaces
from gymnasium.utils import seeding
from pettingzoo import ParallelEnv

from ..dynamics import Behaviour
from ..problem import Problem
from .episode import RENDER_MODES, Episode
from .observation import (
    ACTIONS,
    PRECISIONS,
    SCOPES,
    action_space,
    checked_option,
    input_of,
    observation_space,
    projected,
    relative_space,
    shared,
)

Observations = dict[str, np.ndarray]
Infos = dict[str, dict[str, Any]]


class ProblemEnv(ParallelEnv):  # type: ignore[misc, type-arg, unused-ignore]
    """Parallel environment of a problem; see the module docstring for spaces, rewards and episode ends.

    Parameters
    ----------
    problem : Problem
    render_mode : None, "ansi", "rgb_array" or "human"
        A line of text, or a picture (see `rendering`).
    observation : "local", "full" or "relative"
    reward : "sparse", "shaped" or "progress"
    discount : float
        Discount factor of the learner, for the shaped reward.
    dtype : "float64" or "float32"
        Type of the observations.
    actions : "input" or "unit"
    infos : "numbers" or "words"
    caption : str
        A line shown in pictures.
    disturbance : "zero", "random", "periodic" or a function
        How bounded disturbances behave.
    """

    metadata: dict[str, Any]

    # Many parameters: environments take flat keywords, which makers and learners hand on by name.
    def __init__(
        self,
        problem: Problem,
        render_mode: str | None = None,
        *,
        observation: str = "local",
        reward: str = "sparse",
        discount: float = 1.0,
        dtype: str = "float64",
        actions: str = "input",
        infos: str = "numbers",
        caption: str = "",
        disturbance: Behaviour = "zero",
    ) -> None:
        self.metadata = {
            "name": problem.name.replace("-", "_"),
            "render_modes": list(RENDER_MODES),
            "render_fps": 4,
            "is_parallelizable": True,
        }
        self.problem = problem
        self.render_mode = render_mode
        self.options = {
            "observation": observation,
            "reward": reward,
            "discount": discount,
            "dtype": dtype,
            "actions": actions,
            "infos": infos,
            "caption": caption,
        }
        self.possible_agents = list(problem.agent_names)
        self.agents: list[str] = []
        self._episode = Episode(problem, reward, discount, render_mode, caption, infos, disturbance)
        self._rng: np.random.Generator | None = None
        self._scope = checked_option(observation, "observation", SCOPES)
        self._dtype = checked_option(dtype, "dtype", PRECISIONS)
        self._actions = checked_option(actions, "actions", ACTIONS)
        members = problem.agents
        # An agent sees itself first, and with the scope "full" the other agents in order.
        seen = {a.name: [a] + [b for b in members if b is not a and self._scope == "full"] for a in members}
        self._observation_spaces = {name: observation_space(problem, agents, dtype) for name, agents in seen.items()}
        if self._scope == "relative":
            self._observation_spaces = {agent.name: relative_space(problem, agent, dtype) for agent in members}
        self._action_spaces = {agent.name: action_space([agent], actions) for agent in members}
        self.state_space = observation_space(problem, members, dtype)

    def observation_space(self, agent: str) -> spaces.Space[Any]:
        """Return the space of one agent's observations (the same object each time)."""
        return self._observation_spaces[agent]

    def action_space(self, agent: str) -> spaces.Space[Any]:
        """Return the space of one agent's actions (the same object each time)."""
        return self._action_spaces[agent]

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Observations, Infos]:
        """Begin an episode.

        Parameters
        ----------
        seed : int, optional
            Seed of a new generator; without it the current one continues.
        options : dict, optional
            `initial_state`: a start in place of the problem's, in the forms that `Problem.replace` takes. Other keys
            are refused.
        """
        if seed is not None or self._rng is None:
            self._rng, _ = seeding.np_random(seed)
        self._episode.begin(self._rng, options)
        self.agents = list(self.possible_agents)
        return self._observations(), self._infos()

    def step(
        self, actions: dict[str, Any]
    ) -> tuple[Observations, dict[str, float], dict[str, bool], dict[str, bool], Infos]:
        """Advance one control step; actions are clipped to the action spaces.

        Raises
        ------
        RuntimeError
            Before the first `reset`.
        ValueError
            If an action is missing, of the wrong shape or not finite.
        """
        if self._rng is None:
            raise RuntimeError("call `reset` before `step`")
        if not self.agents:  # the episode is over: PettingZoo expects empty answers
            return {}, {}, {}, {}, {}
        # All agents end together: the task is one.
        ended = self.agents
        reward, terminated, truncated = self._episode.step(self._inputs(actions), self._rng)
        if terminated or truncated:
            self.agents = []
        return (
            self._observations(),
            dict.fromkeys(ended, reward),
            dict.fromkeys(ended, terminated),
            dict.fromkeys(ended, truncated),
            self._infos(),
        )

    @property
    def is_settled(self) -> bool:
        """Whether the verdict is final."""
        return self._episode.one_world.settled(self._episode.world)

    @property
    def potential(self) -> float:
        """Current potential, whose differences are the shaped rewards; 0 with sparse rewards."""
        return self._episode.level

    def state(self) -> np.ndarray:
        """Return the joint state (projected onto the workspace), automaton state one-hot and fraction of time left."""
        world, numbers = self._episode.world, self._episode.one_world.agents
        tail = shared(self.problem, world.q, world.time)
        return np.array(projected(world.states, numbers) + tail, dtype=self._dtype)

    def render(self) -> str | np.ndarray | None:
        """Return a line of text ("ansi"), a picture ("rgb_array"), or None."""
        return self._episode.render()

    def close(self) -> None:
        """Close the window of the render mode "human"."""
        self._episode.close()

    def _observations(self) -> Observations:
        """Return the observation of every agent."""
        world, numbers, dtype = self._episode.world, self._episode.one_world.agents, self._dtype
        tail = shared(self.problem, world.q, world.time)
        states = [projected((x,), (agent,)) for x, agent in zip(world.states, numbers)]
        if self._scope == "local":
            return {name: np.array(x + tail, dtype=dtype) for name, x in zip(self.possible_agents, states)}
        result = {}
        for i, name in enumerate(self.possible_agents):
            others = [number for k, x in enumerate(states) if k != i for number in self._seen(states[i], x)]
            result[name] = np.array(states[i] + others + tail, dtype=dtype)
        return result

    def _seen(self, own: list[float], other: list[float]) -> list[float]:
        """Return what an agent sees of another one: its state, or where it is from the agent's own place."""
        return other if self._scope == "full" else [b - a for a, b in zip(own, other)]

    def _infos(self) -> Infos:
        common = self._episode.info()
        states = zip(self.possible_agents, self._episode.world.states)
        return {name: {**common, "state": np.array(x)} for name, x in states}

    def _inputs(self, actions: dict[str, Any]) -> list[list[float]]:
        """Return the inputs for the actions of all agents; raise ValueError if one is missing, wrong or unknown."""
        inputs = []
        # With one action for every agent, a stranger shows by the number of actions.
        if len(actions) > len(self.possible_agents):
            stranger = next(name for name in actions if name not in self.possible_agents)
            raise ValueError(f"`actions`: expected agents of the problem, got {stranger!r}; leave it out")
        for name, agent in zip(self.possible_agents, self._episode.one_world.agents):
            if name not in actions:
                raise ValueError(f"`actions`: expected one for every agent, got none for {name!r}")
            inputs.append(input_of(actions[name], agent, self._actions, f"actions[{name!r}]"))
        return inputs
