"""The centralised Gymnasium environment of a problem: one learner sees the joint state and moves all agents.

- **Action**: the inputs of all agents one after the other, scaled to [-1, 1], float32; with `actions="input"` the input
  boxes themselves, float64. Actions outside are clipped.
- **Observation**: the states of all agents as they are, outside of workspaces, too (the space does not bound them), the
  automaton state one-hot, the fraction of time left; with `scale="unit"` workspaces are mapped to [-1, 1], and states
  outside count as their edges.
- **Reward**: 1 once, when the task is satisfied, else 0; with `reward="shaped"` see `shaping`.
- **Episode ends**: see `episode`.
- **Info**: `automaton_state`, `satisfied`, `time` as in `parallel_env`, `state` (the true joint state, float64), and
  `is_success` in the last step; with `infos="words"` also `letter`, with noisy sensors also `reading`.
"""

from __future__ import annotations

from typing import Any, ClassVar

import gymnasium
import numpy as np

from ..simulation import Behaviour
from ..tasks.problem import Problem, checked_problem
from .episode import RENDER_MODES, Episode
from .observation import (
    ACTIONS,
    Form,
    action_space,
    checked_option,
    in_form,
    input_of,
    joint_bounds,
    observation_space,
    shared,
)
from .sensors import READING, Sensors
from .specified import Specified


class CentralEnv(Specified, gymnasium.Env[np.ndarray, np.ndarray]):
    """Centralised environment of a problem; see the module docstring.

    Parameters
    ----------
    problem : Problem
        Ids and files are taken by `certigym.central_env`.
    render_mode : None, "ansi", "rgb_array" or "human"
    reward : "sparse", "shaped" or "progress"
    discount : float
        Discount factor of the learner, for the shaped reward.
    dtype : "float64" or "float32"
        Type of the observations.
    actions : "unit" or "input"
    infos : "numbers" or "words"
    scale : "raw" or "unit"
        States as they are, or each component mapped from its workspace to [-1, 1].
    automaton : "one-hot", "number" or "hidden"
        How the automaton state stands in an observation.
    sensor_noise : float or sequence of D floats
        Standard deviation of the errors with which states are read (see `sensors`); certified controllers and shields
        refuse such environments.

    Examples
    --------
    >>> import certigym as cg
    >>> env = CentralEnv(cg.make_problem("reach-avoid-v0", horizon=7))
    >>> observation, info = env.reset(seed=0)
    >>> observation.shape, env.action_space.shape
    ((6,), (2,))
    """

    metadata: ClassVar[dict[str, Any]] = {"render_modes": list(RENDER_MODES), "render_fps": 4}  # type: ignore[misc]

    # Many parameters: `gymnasium.make` hands them on as flat keywords.
    def __init__(
        self,
        problem: Problem,
        render_mode: str | None = None,
        *,
        reward: str = "sparse",
        discount: float = 1.0,
        dtype: str = "float64",
        actions: str = "unit",
        infos: str = "numbers",
        scale: str = "raw",
        automaton: str = "one-hot",
        sensor_noise: Any = 0.0,
        disturbance: Behaviour = "zero",
    ) -> None:
        self.problem = checked_problem(problem)
        self.render_mode = render_mode
        self.options = {
            "reward": reward,
            "discount": discount,
            "dtype": dtype,
            "actions": actions,
            "infos": infos,
            "scale": scale,
            "automaton": automaton,
            "sensor_noise": sensor_noise,
            "disturbance": disturbance,
        }
        self._form = Form(scale, automaton, dtype)
        self.sensors = Sensors(self.problem, sensor_noise)
        self._reading = np.zeros(self.problem.n_states)
        self._actions = checked_option(actions, "actions", ACTIONS)
        self._episode = Episode(self.problem, reward, discount, render_mode, infos=infos, disturbance=disturbance)
        self._ended = False
        self._bounds = joint_bounds(self.problem.agents)
        self.observation_space = observation_space(self.problem, self._bounds, self._form)
        self.action_space = action_space(self.problem.agents, actions)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begin an episode; `options["initial_state"]` replaces the start; other keys are refused."""
        super().reset(seed=seed)
        self._episode.begin(self.np_random, options)
        self._ended = False
        return self._observation(), self._info()  # in this order: infos hold the readings of the observation

    def step(self, action: Any) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Advance one control step.

        Raises
        ------
        RuntimeError
            Before the first `reset`, and after the end of an episode.
        ValueError
            If the action has the wrong shape or is not finite.
        """
        if self._ended:
            raise RuntimeError("the episode has ended; call `reset` before `step`")
        joint_action = np.asarray(action)
        if joint_action.ndim == 0 and self.action_space.shape == (1,):  # some learners drop an axis of length 1
            joint_action = joint_action[None]
        if joint_action.shape != self.action_space.shape:
            raise ValueError(f"`action`: expected shape {self.action_space.shape}, got {joint_action.shape}")
        reward, terminated, truncated = self._episode.step(self._inputs(joint_action), self.np_random)
        self._ended = terminated or truncated
        observation, info = self._observation(), self._info()
        if self._ended:  # learners read the key in the last step alone
            info["is_success"] = info["satisfied"]
        return observation, reward, terminated, truncated, info

    def render(self) -> Any:
        """Return a line of text ("ansi"), a picture ("rgb_array"), or None."""
        return self._episode.render()

    def close(self) -> None:
        """Close the window of the render mode "human"."""
        self._episode.close()

    def _inputs(self, joint_action: np.ndarray) -> list[list[float]]:
        """Return the inputs of the agents: the joint action cut into theirs, each scaled or clipped."""
        return [
            input_of(joint_action[columns], agent, self._actions, "action")
            for columns, agent in zip(self.problem.input_columns, self._episode.single_simulator.agents)
        ]

    def _observation(self) -> np.ndarray:
        world, states = self._episode.world, self._episode.world.states
        if not self.sensors.is_exact:
            joint = np.concatenate([np.asarray(x, dtype=float) for x in states])[None]
            self._reading = self.sensors.readings(joint, self.np_random)[0]
            states = tuple(self._reading[columns].tolist() for columns in self.problem.columns)
        seen = in_form([number for x in states for number in x], self._bounds, self._form)
        tail = shared(self.problem, world.q, world.time, self._form.automaton)
        return np.array([*seen.tolist(), *tail], dtype=self._form.dtype)

    def _info(self) -> dict[str, Any]:
        """Return the info of the last observation."""
        joint = [number for x in self._episode.world.states for number in x]
        reading = {} if self.sensors.is_exact else {READING: self._reading.copy()}
        return {**self._episode.info(), "state": np.array(joint), **reading}
