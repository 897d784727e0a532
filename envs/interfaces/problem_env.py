"""The PettingZoo environment of a problem: a thin view of one episode.

Everything below holds for any problem; the pages of the suite add the numbers of each.

- **Actions**: one `Box` per agent, its input box, float64; or [-1, 1], float32, with `actions="unit"`. Actions outside
  are clipped.
- **Observations**: the state of the agent itself as it is, outside of its workspace, too (spaces do not bound states),
  with `observation="full"` also the states of the other agents; then the automaton state one-hot and the fraction of
  time left. With `scale="unit"` workspaces are mapped to [-1, 1], and states outside count as their edges. See
  `observation` for other choices, `nearest` for the neighbours, and `sensors` for noisy ones.
- **Rewards**: cooperative: every agent gets 1 once, when the task is satisfied, else 0; the undiscounted return *is*
  satisfaction. For `reward="shaped"` see `shaping`.
- **Episode ends**: see `episode`.
- **Infos**, per agent: numbers and arrays of fixed shape: `automaton_state` (int), `satisfied` (bool), `state` (the
  agent's true state, float64), `time` (int); with `infos="words"` also `letter` (names of the propositions that hold;
  empty after a failure, when no letter is read), and with noisy sensors `reading` (what was read of the state).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium import spaces
from gymnasium.utils import seeding
from pettingzoo import ParallelEnv

from ..simulation import Behaviour
from ..systems.agents import AnyAgent
from ..tasks.problem import Problem
from .episode import RENDER_MODES, Episode
from .nearest import checked_neighbours, common_sizes, nearest_bounds, nearest_seen
from .observation import (
    ACTIONS,
    SCOPES,
    Bounds,
    Form,
    action_space,
    checked_option,
    in_form,
    input_of,
    joint_bounds,
    observation_space,
    relative_bounds,
    shared,
)
from .sensors import READING, Sensors

Observations = dict[str, np.ndarray]
Infos = dict[str, dict[str, Any]]


class ProblemEnv(ParallelEnv):  # type: ignore[misc, type-arg, unused-ignore]
    """Parallel environment of a problem; see the module docstring for spaces, rewards and episode ends.

    Parameters
    ----------
    problem : Problem
    render_mode : None, "ansi", "rgb_array" or "human"
        A line of text, or a picture (see `rendering`).
    observation : "local", "full", "relative" or "neighbours"
    neighbours : int, optional
        How many neighbours an agent sees; by default two, or all others in smaller teams.
    reward : "sparse", "shaped" or "progress"
    discount : float
        Discount factor of the learner, for the shaped reward.
    dtype : "float64" or "float32"
        Type of the observations.
    scale : "raw" or "unit"
        States as they are, or the range of each component mapped to [-1, 1]. Certified controllers need the infos then.
    automaton : "one-hot", "number" or "hidden"
        How the automaton state stands in an observation.
    sensor_noise : float or sequence of D floats
        Standard deviation of the errors with which states are read: one, or one for each component of the joint state.
        Certified controllers and shields refuse such environments.
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
        neighbours: int | None = None,
        scale: str = "raw",
        automaton: str = "one-hot",
        sensor_noise: Any = 0.0,
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
            "neighbours": neighbours,
            "scale": scale,
            "automaton": automaton,
            "sensor_noise": sensor_noise,
            "reward": reward,
            "discount": discount,
            "dtype": dtype,
            "actions": actions,
            "infos": infos,
            "caption": caption,
            "disturbance": disturbance,
        }
        self.possible_agents = list(problem.agent_names)
        self.agents: list[str] = []
        self._episode = Episode(problem, reward, discount, render_mode, caption, infos, disturbance)
        self._rng: np.random.Generator | None = None
        self._scope = checked_option(observation, "observation", SCOPES)
        self._form = Form(scale, automaton, dtype)
        self._actions = checked_option(actions, "actions", ACTIONS)
        self._neighbours = checked_neighbours(problem, self._scope, neighbours)
        self.sensors = Sensors(problem, sensor_noise)
        self._seen: tuple[Any, ...] = ()
        members = problem.agents
        self._bounds = {agent.name: self._bounds_of(agent) for agent in members}
        self._observation_spaces = {
            name: observation_space(problem, bounds, self._form) for name, bounds in self._bounds.items()
        }
        self._action_spaces = {agent.name: action_space([agent], actions) for agent in members}
        self._joint_bounds = joint_bounds(members)
        self.state_space = observation_space(problem, self._joint_bounds, self._form)

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
        return self._episode.single_simulator.settled(self._episode.world)

    @property
    def potential(self) -> float:
        """Current potential, whose differences are the shaped rewards; 0 with sparse rewards."""
        return self._episode.level

    def state(self) -> np.ndarray:
        """Return the true joint state, automaton state and fraction of time left."""
        joint = [number for x in self._episode.world.states for number in x]
        return self._told(joint, self._joint_bounds, self._tail())

    def render(self) -> str | np.ndarray | None:
        """Return a line of text ("ansi"), a picture ("rgb_array"), or None."""
        return self._episode.render()

    def close(self) -> None:
        """Close the window of the render mode "human"."""
        self._episode.close()

    def _bounds_of(self, agent: AnyAgent) -> Bounds:
        """Return between which numbers the states lie that an agent sees: its own first, then those of others."""
        others = [other for other in self.problem.agents if other is not agent]
        if self._scope == "full":
            return joint_bounds([agent, *others])
        seen = np.zeros(0), np.zeros(0)
        if self._scope == "relative":
            seen = relative_bounds(self.problem, agent)
        elif self._scope == "neighbours":
            seen = nearest_bounds(self.problem, agent, self._neighbours)
        low, high = joint_bounds([agent])
        return np.concatenate([low, seen[0]]), np.concatenate([high, seen[1]])

    def _observations(self) -> Observations:
        """Return the observation of every agent, from new readings of the states."""
        world = self._episode.world
        self._seen = world.states if self.sensors.is_exact else self._read(world.states)
        tail = self._tail()
        states = [list(x) for x in self._seen]
        if self._scope == "neighbours":
            others = self._nearest(states)
        else:
            others = [self._others(states, i) for i in range(len(states))]
        return {
            name: self._told(own + other, self._bounds[name], tail)
            for name, own, other in zip(self.possible_agents, states, others)
        }

    def _read(self, states: Any) -> tuple[Any, ...]:
        """Return what the sensors read of the states."""
        assert self._rng is not None
        joint = np.concatenate([np.asarray(x, dtype=float) for x in states])[None]
        reading = self.sensors.readings(joint, self._rng)[0]
        return tuple(reading[columns].tolist() for columns in self.problem.columns)

    def _others(self, states: list[list[float]], i: int) -> list[float]:
        """Return what an agent sees of the other ones: nothing, their states, or where they are from its own place."""
        if self._scope == "local":
            return []
        others = [x for k, x in enumerate(states) if k != i]
        if self._scope == "full":
            return [number for x in others for number in x]
        return [b - a for x in others for a, b in zip(states[i], x)]

    def _nearest(self, states: list[list[float]]) -> list[list[float]]:
        """Return where the nearest other agents are from the place of every agent."""
        d, p = common_sizes(self.problem)
        outputs = [agent.outputs(x)[:p] for agent, x in zip(self._episode.single_simulator.agents, states)]
        common, places = np.array([x[:d] for x in states])[..., None], np.array(outputs)[..., None]
        return [nearest_seen(common, places, i, self._neighbours)[:, 0].tolist() for i in range(len(states))]

    def _tail(self) -> list[float]:
        world = self._episode.world
        return shared(self.problem, world.q, world.time, self._form.automaton)

    def _told(self, states: list[float], bounds: Bounds, tail: list[float]) -> np.ndarray:
        """Return an observation: states in the form that was asked for, then automaton state and time left."""
        return np.array([*in_form(states, bounds, self._form).tolist(), *tail], dtype=self._form.dtype)

    def _infos(self) -> Infos:
        """Return the infos that belong to the last observations."""
        common, states = self._episode.info(), self._episode.world.states
        infos = {name: {**common, "state": np.array(x)} for name, x in zip(self.possible_agents, states)}
        if not self.sensors.is_exact:
            for name, x in zip(self.possible_agents, self._seen):
                infos[name][READING] = np.array(x)
        return infos

    def _inputs(self, actions: dict[str, Any]) -> list[list[float]]:
        """Return the inputs for the actions of all agents; raise ValueError if one is missing, wrong or unknown."""
        inputs = []
        # With one action for every agent, a stranger shows by the number of actions.
        if len(actions) > len(self.possible_agents):
            stranger = next(name for name in actions if name not in self.possible_agents)
            raise ValueError(f"`actions`: expected agents of the problem, got {stranger!r}; leave it out")
        for name, agent in zip(self.possible_agents, self._episode.single_simulator.agents):
            if name not in actions:
                raise ValueError(f"`actions`: expected one for every agent, got none for {name!r}")
            inputs.append(input_of(actions[name], agent, self._actions, f"actions[{name!r}]"))
        return inputs
