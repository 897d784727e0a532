"""The batched Gymnasium environment of a problem: M worlds of the centralised environment in one set of arrays.

Spaces, rewards and ends are those of `central_env`, world by world; with one world and one seed the numbers are the
same to the last bit. One generator serves all worlds: `reset(seed=...)` takes one seed (or a list, hashed into one).

Autoreset, declared in `metadata["autoreset_mode"]`:

- `NEXT_STEP` (default): the step after an end ignores the action and returns the new start, reward 0 and no end;
- `SAME_STEP`: the step with the end returns the new start; `final_obs` and `final_info` hold the end itself;
- `DISABLED`: the caller resets all worlds, or those of `options["reset_mask"]`; stepping an ended world is an error.

Infos are arrays over the worlds with masks `_name`, as in Gymnasium: `state` (M, D), `automaton_state`, `satisfied`,
`time`; with noisy sensors also `reading` (M, D).
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from ..simulation import Behaviour
from ..simulation import batch_simulator as core
from ..systems.arguments import checked_count
from ..tasks.problem import Problem, checked_problem
from .episode import checked_discount
from .observation import (
    ACTIONS,
    RESET_OPTIONS,
    Form,
    action_space,
    batch_inputs,
    checked_option,
    checked_reset,
    joint_bounds,
    joint_observations,
    observation_space,
)
from .rendering import Picture, checked_render_mode, verdict_text
from .sensors import READING, Sensors
from .shaping import REWARDS, Potential
from .specified import Specified

CREDITS = ("team", "own")

MOST_WORLDS = 10_000_000
"""Most worlds: gigabytes of states; a larger number is a slip of the keyboard."""

Step = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]


class ProblemVectorEnv(Specified, VectorEnv[np.ndarray, np.ndarray, np.ndarray]):
    """A batch of worlds of one problem; see the module docstring.

    Parameters
    ----------
    problem : Problem
        Ids and files are taken by `certigym.vector_env`.
    num_envs : int
        Number of worlds M.
    render_mode : None or "rgb_array"
    autoreset_mode : AutoresetMode or str
    reward, discount, dtype, actions, scale, automaton, sensor_noise
        As for `central_env`.

    Examples
    --------
    >>> import certigym as cg
    >>> envs = ProblemVectorEnv(cg.make_problem("reach-avoid-v0"), num_envs=1000)
    >>> observations, infos = envs.reset(seed=0)
    >>> observations.shape
    (1000, 6)
    """

    # Many parameters: `gymnasium.make_vec` hands them on as flat keywords.
    def __init__(
        self,
        problem: Problem,
        num_envs: int = 1,
        render_mode: str | None = None,
        *,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        reward: str = "sparse",
        discount: float = 1.0,
        dtype: str = "float64",
        actions: str = "unit",
        scale: str = "raw",
        automaton: str = "one-hot",
        sensor_noise: Any = 0.0,
        disturbance: Behaviour = "zero",
        credit: str = "team",
    ) -> None:
        self.problem = checked_problem(problem)
        self.num_envs = checked_count(num_envs, "num_envs", most=MOST_WORLDS)
        self.render_mode = checked_render_mode(render_mode, ("rgb_array",))
        self.autoreset_mode = AutoresetMode(autoreset_mode)
        self.metadata = {"render_modes": ["rgb_array"], "render_fps": 4, "autoreset_mode": self.autoreset_mode}
        self.discount = checked_discount(discount)
        self.options = {
            "autoreset_mode": self.autoreset_mode,
            "reward": reward,
            "discount": discount,
            "dtype": dtype,
            "actions": actions,
            "scale": scale,
            "automaton": automaton,
            "sensor_noise": sensor_noise,
            "disturbance": disturbance,
            "credit": credit,
        }
        self._form = Form(scale, automaton, dtype)
        self.sensors = Sensors(self.problem, sensor_noise)
        self._actions = checked_option(actions, "actions", ACTIONS)
        self._dynamics = core.Dynamics.of(self.problem, disturbance)
        self._absorbing = self.problem.automaton.absorbing
        self._reward = checked_option(reward, "reward", REWARDS)
        self._potential = None if reward == "sparse" else Potential.of(self._dynamics)
        self._has_own = checked_option(credit, "credit", CREDITS) == "own"
        # Disturbances that look at the worlds need them cut out one from the other. Whoever has `_begun` or `_moved` of
        # its own says so here: worlds that move all at once ask neither.
        self._is_plain = isinstance(disturbance, str)
        self.single_observation_space = observation_space(self.problem, joint_bounds(self.problem.agents), self._form)
        self.single_action_space = action_space(self.problem.agents, actions)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        # Whether a start may settle the task: such worlds rest for a step. No other world that goes on is settled.
        self._may_rest = not self._dynamics.begins_undecided
        self._worlds: core.Worlds | None = None
        self._judged: tuple[core.Worlds | None, np.ndarray] = None, np.zeros(0, dtype=bool)
        # True joint states and what is read of them, (M, D): new arrays in each step, so infos may hold them.
        self._joint = self.readings = np.zeros((self.num_envs, self.problem.n_states))
        self._everywhere, self._ended = np.ones(self.num_envs, dtype=bool), np.zeros(self.num_envs, dtype=bool)
        self._levels = np.zeros((self.problem.n_agents, self.num_envs) if self._has_own else self.num_envs)
        self._first_level: np.ndarray | None = None
        self.own_rewards = np.zeros((self.problem.n_agents, self.num_envs))
        self.care = 1.0  # the share of the loss that "progress" takes; learners begin with less
        # States at all times are stored only if pictures may be asked for.
        self._track = np.zeros((0, self.num_envs, self.problem.n_states))
        if self.render_mode is not None:
            self._track = np.zeros((self.problem.horizon + 1, self.num_envs, self.problem.n_states))

    def reset(
        self, *, seed: int | list[int] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begin episodes in all worlds.

        Parameters
        ----------
        seed : int or list of int, optional
            Seed of a new generator; without it the current one continues.
        options : dict, optional
            `initial_state` replaces the start of the worlds that are reset; `reset_mask`, bool (M,), selects them.
            Other keys are refused.
        """
        # Several seeds are hashed into one, since one generator serves all worlds.
        if isinstance(seed, list | tuple):
            self.np_random = np.random.default_rng(np.random.SeedSequence([int(s) for s in seed]))
        elif seed is not None:
            self._np_random, self._np_random_seed = seeding.np_random(seed)
        options = checked_reset(options, (*RESET_OPTIONS, "reset_mask"))
        start, dynamics = options.get("initial_state"), self._dynamics
        if start is not None:
            dynamics = core.Dynamics.of(self.problem.replace(initial_state=start), self._dynamics.disturbance)
            self._may_rest |= not dynamics.begins_undecided
        which = self._mask(options.get("reset_mask"))
        if self._worlds is None or which.all():
            # Worlds restart at different times later on, so each has a time from the beginning.
            worlds = core.initial(dynamics, self.np_random, self.num_envs)
            which[:] = True
            self._worlds = self._begun(replace(worlds, time=np.zeros(self.num_envs, dtype=np.int64)), which)
        else:
            self._worlds = self._begun(core.restart(dynamics, self._worlds, which, self.np_random), which)
        self._ended = self._ended & ~which
        self._relevel(which)
        return self._observations(), self._infos(which)

    def step(self, actions: Any) -> Step:
        """Advance all worlds one control step.

        Raises
        ------
        RuntimeError
            Before the first `reset`; in the mode `DISABLED`, if a world has ended.
        ValueError
            If the actions have the wrong shape or are not finite.
        """
        if self._worlds is None:
            raise RuntimeError("call `reset` before `step`")
        if np.ndim(actions) > 0 and len(actions) != self.num_envs:
            raise ValueError(f"`actions`: expected one row for each of {self.num_envs} worlds, got {len(actions)}")
        rewards, terminated, truncated = self.advance(batch_inputs(self._dynamics, actions, self._actions))
        observations, infos = self._observations(), self._infos(self._everywhere)
        if self.autoreset_mode is AutoresetMode.SAME_STEP and self._ended.any():
            last = self._last(self._ended, observations, infos)
            self.renew()
            observations = self._observations()
            infos = {**self._infos(self._everywhere), **last}
        return observations, rewards, terminated, truncated, infos

    def advance(self, inputs: tuple[np.ndarray, ...]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Advance all worlds with inputs (m, n, M) per block; return rewards, terminated and truncated, (M,) each.

        Observations and infos are made by `step`. With the autoreset "SameStep" the caller calls `renew` afterwards.
        """
        # Worlds that ended in the last step start anew, and do not move in this one.
        worlds, fresh = self._present(), self._ended
        if self.autoreset_mode is AutoresetMode.DISABLED and fresh.any():
            raise RuntimeError("a world has ended; reset it with `options={'reset_mask': ...}` before `step`")
        # Worlds that the start has settled do not move, but end in this step.
        if self._is_plain and not (self._may_rest and (self._settled(worlds) > fresh).any()):
            worlds = core.moved_or_begun(self._dynamics, worlds, inputs, fresh, self.np_random)
        else:
            if fresh.any():
                worlds = self._begun(core.restart(self._dynamics, worlds, fresh, self.np_random), fresh)
            worlds = self._moved(worlds, inputs, ~(fresh | self._settled(worlds)))
        # One Boolean is greater than another where it holds and the other does not.
        terminated = self._settled(worlds) > fresh
        truncated = (worlds.time >= self.problem.horizon) > terminated
        ended = terminated | truncated
        self._worlds, self._ended = worlds, ended
        return self._rewards(fresh, ended), terminated, truncated

    def renew(self) -> None:
        """Begin new episodes in the worlds that ended in the last step."""
        ended = self._ended
        self._worlds = self._begun(core.restart(self._dynamics, self._present(), ended, self.np_random), ended)
        self._ended = np.zeros(self.num_envs, dtype=bool)
        self._relevel(ended, begun=True)

    @property
    def worlds(self) -> core.Worlds:
        """The worlds as the dynamics hold them: states (d, n, M) per block, automaton states, times, ends."""
        return self._present()

    def render(self) -> tuple[np.ndarray, ...] | None:
        """Return one picture of every world in the render mode "rgb_array", else None."""
        if self.render_mode is None:
            return None
        worlds, picture = self._present(), Picture(self.problem)
        holds = core.letters(self._dynamics, worlds.states, worlds.time) & ~worlds.failed
        names, satisfied = self.problem.automaton.propositions, core.satisfied(self._dynamics, worlds)
        over = self._settled(worlds) | (worlds.time >= self.problem.horizon)
        frames = []
        for k in range(self.num_envs):
            letter = self.problem.told(names[p] for p in np.flatnonzero(holds[:, k]))
            verdict = verdict_text(bool(satisfied[k]), bool(worlds.failed[k]), bool(over[k]))
            frames.append(picture.frame(self._track[: worlds.time[k] + 1, k], int(worlds.q[k]), letter, verdict))
        return tuple(frames)

    def _moved(self, worlds: core.Worlds, inputs: tuple[np.ndarray, ...], moving: np.ndarray) -> core.Worlds:
        """Return the worlds after some of them have moved; noise is drawn for these alone."""
        if moving.all():
            return core.transition(self._dynamics, worlds, inputs, self._noise(moving))
        # Cut the moving worlds out, move them, and put them back.
        before = _cut(worlds, moving)
        after = core.transition(self._dynamics, before, tuple(u[..., moving] for u in inputs), self._noise(moving))
        states = tuple(x.copy() for x in worlds.states)
        for x, new in zip(states, after.states):
            x[..., moving] = new
        marks = {name: getattr(worlds, name).copy() for name in ("q", "time", "failed", "accepted")}
        for name, values in marks.items():
            values[moving] = getattr(after, name)
        return core.Worlds(states, **marks)

    def _noise(self, moving: np.ndarray) -> tuple[np.ndarray, ...]:
        return core.noise(self._dynamics, self.np_random, int(moving.sum()))

    def _settled(self, worlds: core.Worlds) -> np.ndarray:
        """Return whether the verdict is final, bool (M,)."""
        # Worlds are never written into, so a step need not ask again what the step before has asked at its end.
        if self._judged[0] is not worlds:
            self._judged = worlds, worlds.failed | self._absorbing.take(worlds.q)
        return self._judged[1]

    def _rewards(self, fresh: np.ndarray, ended: np.ndarray) -> np.ndarray:
        """Return the rewards of a step, 0 in fresh worlds, and note the levels."""
        worlds = self._present()
        rewards = (core.satisfied(self._dynamics, worlds) > fresh).astype(np.float64)
        if self._potential is not None:
            # Both pay differences of levels; that of "shaped" is 0 in ended worlds. Fresh worlds had nothing before,
            # which counts where a start may lose the task.
            is_any_fresh, before = fresh.any(), self._levels
            if is_any_fresh and self._may_rest:
                before = np.where(fresh, 0.0, before)
            self._levels = levels = self._leveled(worlds, before)
            after = np.where(ended, 0.0, levels) if self._reward == "shaped" else levels
            paid = self.discount * after - before
            rewards = rewards + (np.where(fresh, 0.0, paid) if is_any_fresh else paid)
        if self._has_own:
            # Half for what an agent has done itself, half for what the team has: their mean is the reward of the team.
            own = np.broadcast_to(rewards, self.own_rewards.shape)
            rewards = own.mean(axis=0)
            self.own_rewards = 0.5 * (own + rewards)
        return rewards

    def _leveled(self, worlds: core.Worlds, before: Any) -> np.ndarray:
        """Return the levels of worlds, (M,), or those of their agents, (n, M)."""
        assert self._potential is not None
        if self._reward == "shaped":
            return self._potential.at(worlds, self._has_own)
        return self._potential.progress(worlds, before, self._has_own, self.care)

    def _last(self, ended: np.ndarray, last: np.ndarray, infos: dict[str, Any]) -> dict[str, Any]:
        """Return the entries of infos that hold the last observations and infos of ended worlds."""
        # Gymnasium expects the last observations as an array of objects, None in worlds that go on.
        observations = np.full(self.num_envs, None, dtype=object)
        for k in np.flatnonzero(ended):
            observations[k] = last[k].copy()
        before = {name: values for name, values in infos.items() if not name.startswith("_")}
        masks = {f"_{name}": ended.copy() for name in before}
        return {
            "final_obs": observations,
            "_final_obs": ended.copy(),
            "final_info": {**before, **masks},
            "_final_info": ended.copy(),
        }

    def read(self) -> np.ndarray:
        """Let the sensors read the states, (M, D), and note that in `readings`; noisy ones draw new errors."""
        self._joint = core.joint_rows(self._dynamics, self._present()).T
        self.readings = self.sensors.readings(self._joint, self.np_random)
        return self.readings

    def _observations(self) -> np.ndarray:
        """Return the observations of all worlds, from new readings."""
        return joint_observations(self.problem, self._present(), self.read(), self._form)

    def _relevel(self, which: np.ndarray, begun: bool = False) -> None:
        """Note the levels of worlds that have just started; if they have `begun` by themselves, from the problem."""
        if self._potential is None:
            return
        worlds, places = self._present(), np.flatnonzero(which)
        if begun and self._dynamics.points is not None:  # all starts are one
            if self._first_level is None:
                self._first_level = self._leveled(_cut(worlds, places[:1]), 0.0)
            first = self._first_level
        else:
            first = self._leveled(_cut(worlds, places), 0.0)
        self._levels = self._levels.copy()
        self._levels[..., places] = first

    def _begun(self, worlds: core.Worlds, which: np.ndarray) -> core.Worlds:
        """Return the worlds of which those of `which` have just begun: a place for shields to look."""
        return worlds

    def _infos(self, which: np.ndarray) -> dict[str, Any]:
        """Return the infos with the mask `which`; where pictures are asked for, note the states for them as well."""
        worlds = self._present()
        if self.render_mode is not None:
            self._track[worlds.time, np.arange(self.num_envs)] = self._joint
        values = {
            "automaton_state": worlds.q.copy(),
            "satisfied": core.satisfied(self._dynamics, worlds).copy(),
            "time": worlds.time.copy(),
            "state": self._joint,
        }
        if not self.sensors.is_exact:
            values[READING] = self.readings.copy()
        masks = np.empty((len(values), self.num_envs), dtype=bool)
        masks[:] = which
        return {**values, **{f"_{name}": mask for name, mask in zip(values, masks)}}

    def _present(self) -> core.Worlds:
        """Return the worlds; raise RuntimeError before the first `reset`."""
        if self._worlds is None:
            raise RuntimeError("call `reset` first")
        return self._worlds

    def _mask(self, value: Any) -> np.ndarray:
        """Return a reset mask, by default of all worlds, or raise ValueError."""
        if value is None:
            return np.ones(self.num_envs, dtype=bool)
        mask = np.array(value)
        if mask.shape != (self.num_envs,) or mask.dtype != np.bool_ or not mask.any():
            raise ValueError(f"`reset_mask`: expected {self.num_envs} Booleans, one of them true, got {value!r}")
        return mask


def _cut(worlds: core.Worlds, which: np.ndarray) -> core.Worlds:
    """Return some of the worlds, which have times of their own."""
    states = tuple(x[..., which] for x in worlds.states)
    return core.Worlds(states, *(getattr(worlds, name)[which] for name in ("q", "time", "failed", "accepted")))
