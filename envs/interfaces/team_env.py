"""The batched environment of a team: one array per agent, M worlds in one step, for learners with loops of their own.

Worlds, rewards and ends are those of `ProblemVectorEnv`, which makes one array of all agents. Here each agent gets an
array of its own, in the form that networks like, and nothing is made that a learner does not read; so a step costs
little more than the dynamics.

A world that ends begins anew in the same step: the observations are those of the new episode, `terminated`, `truncated`
and `satisfied` speak of the old one. The horizon is an end like any other, since agents see the time left; a learner
needs no value of what comes after it, and so no last observation.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..dynamics import Dynamics
from ..dynamics import worlds as core
from ..problem import Problem
from .nearest import checked_neighbours, common_sizes, nearest_bounds, nearest_seen
from .observation import AUTOMATON, SCALES, checked_option, projected_rows, scaled, shared_rows
from .vector_env import ProblemVectorEnv

OBSERVATIONS = ("own", "joint", "neighbours")


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
    reward, discount, actions, spread, sensor_noise
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
        self._observation = checked_option(observation, "observation", OBSERVATIONS)
        self._scale = checked_option(scale, "scale", SCALES)
        self._automaton = checked_option(automaton, "automaton", AUTOMATON)
        self._neighbours = checked_neighbours(problem, self._observation, neighbours)
        self._bounds = [nearest_bounds(problem, agent, self._neighbours) for agent in problem.agents]
        self._is_unit = actions == "unit"
        self._dynamics = Dynamics.of(self.problem)
        # Where an agent stands: its block, and its place in the block.
        places = {int(i): (b, k) for b, block in enumerate(self._dynamics.blocks) for k, i in enumerate(block.agents)}
        self._places = [places[i] for i in range(problem.n_agents)]

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
        rewards, terminated, truncated = self._batch.advance(self._inputs(actions))
        ended = terminated | truncated
        satisfied = ended
        if ended.any():
            satisfied = ended & np.asarray(core.satisfied(self._dynamics, self._batch.worlds))
            self._batch.renew()
        if not self._batch.sensors.is_exact:  # a reset has read the states already
            self._batch.read()
        return self._told(rewards, (terminated, truncated, satisfied))

    def _inputs(self, actions: Mapping[str, Any]) -> tuple[np.ndarray, ...]:
        """Return the inputs (m, n, M) per block, clipped to the input boxes."""
        result = [np.empty((*block.input_low.shape[:2], self.num_envs)) for block in self._dynamics.blocks]
        for name, (block, place) in zip(self.agents, self._places, strict=True):
            given = np.asarray(actions.get(name, ()), dtype=np.float64)
            shape = (self.num_envs, result[block].shape[0])
            if given.shape != shape:
                raise ValueError(f"`actions`: expected numbers of shape {shape} for {name!r}, got {given.shape}")
            result[block][:, place] = given.T
        for box, u in zip(self._dynamics.blocks, result, strict=True):
            if not np.isfinite(u).all():
                raise ValueError("`actions`: expected finite numbers")
            if self._is_unit:
                np.clip(u, -1.0, 1.0, out=u)
                u *= 0.5 * box.input_high - 0.5 * box.input_low
                u += 0.5 * box.input_low + 0.5 * box.input_high
            np.clip(u, box.input_low, box.input_high, out=u)
        return tuple(result)

    def _told(self, rewards: np.ndarray, ends: tuple[np.ndarray, np.ndarray, np.ndarray]) -> TeamStep:
        """Return the record of a step."""
        worlds = self._batch.worlds
        time = np.broadcast_to(np.asarray(worlds.time), (self.num_envs,))
        return TeamStep(self._observed(), rewards, *ends, worlds.q.copy(), self.problem.horizon - time)

    def _observed(self) -> dict[str, np.ndarray]:
        """Return the observations: states, automaton state, share of time left."""
        worlds, read = self._batch.worlds, self._batch.worlds.states
        if not self._batch.sensors.is_exact:
            read = core.split_joint(self._dynamics, self._batch.readings)
        tail = shared_rows(self.problem, worlds, self._automaton).astype(np.float32)
        states = [self._scaled(block, x) for block, x in zip(self._dynamics.blocks, read, strict=True)]
        own = [states[block][:, place] for block, place in self._places]
        if self._observation == "joint":
            common = np.concatenate([*own, tail]).T
            return dict.fromkeys(self.agents, common)
        parts = zip(own, self._nearest(read)) if self._observation == "neighbours" else ((x,) for x in own)
        # Worlds are the last axis in memory: each array is a transposed view of one that is written row by row.
        return {name: np.concatenate([*part, tail]).T for name, part in zip(self.agents, parts, strict=True)}

    def _nearest(self, read: tuple[np.ndarray, ...]) -> Iterator[np.ndarray]:
        """Yield where the nearest others are from the place of every agent, (k, M) float32."""
        d, p = common_sizes(self.problem)
        blocks = self._dynamics.blocks
        inside = [projected_rows(x, block.state_low, block.state_high) for block, x in zip(blocks, read, strict=True)]
        outputs = [block.outputs(x) for block, x in zip(blocks, inside, strict=True)]
        states = np.stack([inside[block][:d, place] for block, place in self._places])
        places = np.stack([outputs[block][:p, place] for block, place in self._places])
        for i, (low, high) in enumerate(self._bounds):
            seen = nearest_seen(states, places, i, self._neighbours)
            if self._scale == "unit":
                seen = scaled(seen, (low[:, None], high[:, None]))
            yield seen.astype(np.float32)

    def _scaled(self, block: Any, x: np.ndarray) -> np.ndarray:
        """Return the states (d, n, M) of a block as observations show them, float32."""
        if self._scale == "raw":
            return x.astype(np.float32)
        low, high = block.state_low, block.state_high
        seen = (x - low) * (2.0 / (high - low)) - 1.0
        # NaN counts as the lower corner, as in all observations.
        return np.fmin(np.fmax(seen, -1.0), 1.0).astype(np.float32)
