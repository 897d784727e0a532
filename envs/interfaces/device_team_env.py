"""A batch of teams whose worlds stay on a device: the batched environment of `team_env` in torch, cupy or jax.

A step is computed by the same code as that of `TeamEnv`, on arrays of another library: states, automaton, rewards, ends
and observations are arrays on the device, and no number is fetched. Random numbers are made there, too. What differs:

- all worlds move in one piece, so a world that ends is drawn anew where others keep what they have; with one and the
  same noise, trajectories, rewards and ends are those of numpy to rounding;
- actions are not looked at: one that is not a number loses its world;
- laws of noise that have no quantile on devices (mixtures, Student's, scipy's) and disturbances that are functions
  are refused.

`advance` is a pure function from arrays to arrays, which `jax.jit` compiles; `step` keeps the arrays for it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from ..simulation import Behaviour, Dynamics, Worlds
from ..simulation import batch_simulator as core
from ..systems.arguments import checked_count
from ..systems.backends import LIBRARIES, Array, Numbers, device_put, namespace, numbers_beside
from ..tasks.problem import Problem, checked_problem
from .episode import checked_discount
from .observation import checked_option
from .sensors import checked_noise
from .shaping import REWARDS, Potential
from .team_env import TeamStep
from .team_views import TeamViews
from .vector_env import MOST_WORLDS


class TeamState(NamedTuple):
    """The worlds between two steps; arrays on the device.

    Parameters
    ----------
    states : tuple of (d, n, M) arrays
        Per block of agents, as in `Worlds`.
    q, time : (M,) int arrays
    failed, accepted : (M,) bool arrays
    levels : (M,) array
        Potentials of shaped rewards; zeros with sparse ones.
    """

    states: tuple[Array, ...]
    q: Array
    time: Array
    failed: Array
    accepted: Array
    levels: Array

    @property
    def worlds(self) -> Worlds:
        """The same worlds as the dynamics take them."""
        return Worlds(*self[:5])


class Drawn(NamedTuple):
    """The random numbers of one step.

    Parameters
    ----------
    normals : tuple of (d, n, M) arrays
        Noise, per block; more rows where disturbances are random.
    starts : tuple of (d, n, M) arrays
        Uniform numbers for new starts, per block whose starts are boxes.
    errors : tuple of (d, n, M) arrays
        Errors of noisy sensors, per block; none if sensors are exact.
    """

    normals: tuple[Array, ...]
    starts: tuple[Array, ...]
    errors: tuple[Array, ...]


class DeviceTeamEnv:
    """A batch of worlds on a device with one array per agent; see the module docstring.

    Parameters
    ----------
    problem : Problem
        Ids and files are taken by `certigym.team_env`.
    num_envs : int
        Number of worlds M.
    device : str
        "torch:cpu", "torch:cuda", "cupy" or "jax:cpu" (extra `device`, and the library itself).
    observation, neighbours, scale, automaton, actions, reward, discount, sensor_noise, disturbance
        As for `TeamEnv`.

    Raises
    ------
    ValueError
        If an option is wrong, the device is not there, or the problem has something that devices do not compute.
    """

    def __init__(
        self,
        problem: Problem,
        num_envs: int = 1,
        *,
        device: str,
        observation: str = "own",
        neighbours: int | None = None,
        scale: str = "unit",
        automaton: str = "one-hot",
        actions: str = "unit",
        reward: str = "sparse",
        discount: float = 1.0,
        sensor_noise: Any = 0.0,
        disturbance: Behaviour = "zero",
    ) -> None:
        self.problem = checked_problem(problem)
        _check_portable(self.problem, disturbance)
        self.num_envs, self.device = checked_count(num_envs, "num_envs", most=MOST_WORLDS), device
        self.agents = tuple(self.problem.agent_names)
        put = device_put(device, LIBRARIES)
        self._dynamics = Dynamics.of(self.problem, disturbance, put)
        self._views = TeamViews(self._dynamics, observation, neighbours, scale, automaton, actions)
        self._reward, self._discount = checked_option(reward, "reward", REWARDS), checked_discount(discount)
        self._potential = None if reward == "sparse" else Potential.of(self._dynamics)
        deviations = checked_noise(self.problem, sensor_noise)
        self._deviations = [put(deviations[np.asarray(c)][..., None]) for c in _columns(self.problem, self._dynamics)]
        self._is_exact = not deviations.any()
        self._absorbing = put(self.problem.automaton.absorbing)
        # One number that is zero, beside which all others are made.
        self._zero = put(np.zeros(1))
        self._numbers: Numbers | None = None
        self._state: TeamState | None = None

    def reset(self, seed: int | None = None) -> TeamStep:
        """Begin episodes in all worlds; without a seed the random numbers go on, or begin anywhere."""
        if seed is not None or self._numbers is None:
            self._numbers = numbers_beside(self._zero, seed)
        drawn = self.draw()
        self._state = self.begun(drawn)
        nothing = self._state.failed & False
        rewards = namespace(self._zero).zeros_like(self._state.levels)
        return self._told(self._state, drawn, rewards, (nothing, nothing, nothing))

    def step(self, actions: Mapping[str, Any]) -> TeamStep:
        """Advance all worlds one control step, with actions (M, m) on the device for each agent by name.

        Raises
        ------
        RuntimeError
            Before the first `reset`.
        ValueError
            If actions are missing or have the wrong shape.
        """
        self._state, step = self.advance(self.state, actions, self.draw())
        return step

    @property
    def state(self) -> TeamState:
        """The worlds as they are; RuntimeError before the first `reset`."""
        if self._state is None:
            raise RuntimeError("call `reset` first")
        return self._state

    def draw(self) -> Drawn:
        """Return the random numbers of one step."""
        if self._numbers is None:
            raise RuntimeError("call `reset` first")
        blocks, exact = self._dynamics.blocks, self._is_exact
        shapes = [(*block.initial_low.shape[:2], self.num_envs) for block in blocks]
        return Drawn(
            core.noise(self._dynamics, self._numbers, self.num_envs),
            tuple(self._numbers.random(s) for s, block in zip(shapes, blocks) if block.start_box is not None),
            () if exact else tuple(self._numbers.standard_normal(shape) for shape in shapes),
        )

    def begun(self, drawn: Drawn) -> TeamState:
        """Return worlds at time 0 (pure)."""
        states = core.starts(self._dynamics, _Given(drawn.starts), self.num_envs)
        worlds = core.begin(self._dynamics, states)
        zero = 0.0 * namespace(self._zero).zeros_like(states[0][0, 0])
        state = TeamState(states, worlds.q, 0 * worlds.q, worlds.failed, worlds.accepted, zero)
        return state if self._potential is None else state._replace(levels=self._leveled(state.worlds, zero))

    def advance(self, state: TeamState, actions: Mapping[str, Any], drawn: Drawn) -> tuple[TeamState, TeamStep]:
        """Return the worlds one control step later, and what is seen of them (pure)."""
        xp, before = namespace(self._zero), state.worlds
        inputs = self._views.inputs(actions, self.num_envs)
        after = core.moved_on(self._dynamics, before, inputs, drawn.normals)
        # Worlds that the start has settled do not move, but end in this step.
        after = _chosen(self._settled(before), before, after)
        terminated = self._settled(after)
        truncated = (after.time >= self.problem.horizon) & ~terminated
        ended = terminated | truncated
        satisfied = core.satisfied(self._dynamics, after)
        rewards, levels = self._rewards(after, state.levels, satisfied, ended)
        # A world that has ended begins anew.
        fresh = self.begun(drawn)
        worlds = _chosen(ended, fresh.worlds, after)
        following = TeamState(
            worlds.states, worlds.q, worlds.time, worlds.failed, worlds.accepted, xp.where(ended, fresh.levels, levels)
        )
        return following, self._told(following, drawn, rewards, (terminated, truncated, ended & satisfied))

    def _settled(self, worlds: Worlds) -> Array:
        """Return whether the verdict is final, bool (M,)."""
        return worlds.failed | self._absorbing[worlds.q]

    def _rewards(self, worlds: Worlds, before: Array, satisfied: Array, ended: Array) -> tuple[Array, Array]:
        """Return the rewards of a step and the potentials after it, (M,) each."""
        rewards = 0.0 * before + satisfied
        if self._potential is None:
            return rewards, before
        # Both pay differences of potentials; that of "shaped" is 0 in ended worlds.
        after = levels = self._leveled(worlds, before)
        if self._reward == "shaped":
            after = namespace(levels).where(ended, 0.0, levels)
        return rewards + self._discount * after - before, levels

    def _leveled(self, worlds: Worlds, before: Array) -> Array:
        """Return the potentials of worlds, (M,)."""
        assert self._potential is not None
        return self._potential.at(worlds) if self._reward == "shaped" else self._potential.progress(worlds, before)

    def _told(self, state: TeamState, drawn: Drawn, rewards: Array, ends: tuple[Array, Array, Array]) -> TeamStep:
        """Return the record of a step."""
        read: Sequence[Array] = state.states
        if not self._is_exact:
            read = [x + s * z for x, s, z in zip(read, self._deviations, drawn.errors, strict=True)]
        observations = self._views.observations(state.worlds, read)
        return TeamStep(observations, rewards, *ends, state.q, self.problem.horizon - state.time)


class _Given:
    """Numbers that have been drawn, handed out one array after the other."""

    def __init__(self, arrays: Sequence[Array]) -> None:
        self._arrays = iter(arrays)

    def random(self, size: tuple[int, ...], /) -> Array:
        return next(self._arrays)

    def standard_normal(self, size: tuple[int, ...], /) -> Array:
        return next(self._arrays)


def _chosen(which: Array, those: Worlds, others: Worlds) -> Worlds:
    """Return `those` worlds where `which`, bool (M,), holds, and `others` elsewhere."""
    where = namespace(which).where
    states = tuple(where(which, a, b) for a, b in zip(those.states, others.states, strict=True))
    marks = (where(which, getattr(those, m), getattr(others, m)) for m in ("q", "time", "failed", "accepted"))
    return Worlds(states, *marks)


def _columns(problem: Problem, dynamics: Dynamics) -> list[list[list[int]]]:
    """Return the positions in a joint state of the components (d, n) of every block."""
    found: list[list[list[int]]] = [[] for _ in dynamics.blocks]
    for i, (block, _) in sorted(enumerate(dynamics.position), key=lambda item: item[1]):
        columns = problem.columns[i]
        found[block].append(list(range(columns.start, columns.stop)))
    return [np.array(columns).T.tolist() for columns in found]


def _check_portable(problem: Problem, disturbance: Behaviour) -> None:
    """Raise ValueError if a problem has something that devices do not compute."""
    for agent in problem.agents:
        for law in agent.laws or ():
            if not law.is_portable:
                raise ValueError(f"`device`: expected noise with quantiles on devices, got {law.name} noise; use numpy")
    if not isinstance(disturbance, str):
        raise ValueError("`disturbance`: expected the name of a behaviour on a device, got a function; use numpy")
