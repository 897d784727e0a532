"""What a model sees and how it answers: the rows of an environment, made again for states that rollouts ask about.

A row holds states (``scope``), then the automaton state, then the share of time left, then perhaps which agent asks:

    own         the state of the agent itself (with ``padded``, filled up with zeros to that of the largest agent)
    full        its own state, then those of the other agents in order
    relative    its own state, then those of the others less its own
    neighbours  its own state, then where the nearest others are
    joint       the states of all agents in order

These are the observations of `parallel_env`, `central_env`, `vector_env`, `team_env`, and of the worlds for
Stable-Baselines3 (`shared_vec_env`, `central_vec_env`), with the same options.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...envs.interfaces import (
    Bounds,
    checked_neighbours,
    common_sizes,
    joint_bounds,
    nearest_bounds,
    nearest_seen,
    relative_bounds,
)
from ...envs.systems.agents import AnyAgent
from ...envs.tasks.problem import Problem

Array = NDArray[Any]

SEES = {
    "own": "own state",
    "full": "states of all agents, its own first",
    "relative": "own state, and where all others are from it",
    "neighbours": "own state, and where the nearest others are from it",
    "joint": "states of all agents",
}
"""States that a scope shows, in words."""


@dataclass(frozen=True)
class ObservationMap:
    """What a model sees, and what its actions are.

    Parameters
    ----------
    maker : str
        How an environment is made that shows this, for messages: `parallel_env(scale="unit")`.
    scope : "own", "full", "relative", "neighbours" or "joint"
    scale : "raw" or "unit"
        States in their units, or each component mapped from its range to [-1, 1].
    automaton : "one-hot", "number" or "hidden"
    actions : "unit" or "input"
        Whether actions in [-1, 1] stand for the input box, or are inputs.
    padded : bool
        Whether own states are filled up with zeros, before what follows.
    told : bool
        Whether a row ends with which agent asks (one-hot).
    central : bool
        Whether one answer moves all agents.
    neighbours : int, optional
        How many; None for as many as the environment shows by default.
    spaces_are_unit : bool
        Whether the space of observations is [-1, 1] throughout, as that of the worlds for Stable-Baselines3.
    """

    maker: str
    scope: str = "own"
    scale: str = "raw"
    automaton: str = "one-hot"
    actions: str = "input"
    padded: bool = False
    told: bool = False
    central: bool = False
    neighbours: int | None = None
    spaces_are_unit: bool = False

    @property
    def information(self) -> str:
        """What a model sees, in words."""
        task = "time" if self.automaton == "hidden" else "automaton state, time"
        return f"{SEES[self.scope]}, {task}"

    def is_own(self, problem: Problem) -> bool:
        """Whether a model sees no state but that of the agent that it moves."""
        return problem.n_agents == 1 or (self.scope == "own" and not self.central)

    def size(self, problem: Problem, i: int) -> int:
        """Return the numbers of a row for agent i."""
        return len(self.space(problem, i)[0])

    def n_actions(self, problem: Problem, i: int) -> int:
        """Return the numbers of an answer for agent i."""
        if self.central:
            return problem.n_inputs
        return max(a.n_inputs for a in problem.agents) if self.padded else problem.agents[i].n_inputs

    def space(self, problem: Problem, i: int) -> Bounds:
        """Return between which numbers (n,) the rows of agent i lie, as the environment says."""
        low, high = (np.full_like(end, sign * np.inf) for end, sign in zip(self._range(problem, i), (-1.0, 1.0)))
        if self.scale == "unit":
            low, high = np.full_like(low, -1.0), np.full_like(high, 1.0)
        states, others = problem.automaton.n_states, problem.n_agents if self.told else 0
        tops = {"one-hot": [1.0] * states, "number": [states - 1.0], "hidden": []}[self.automaton]
        tail = np.array([*tops, 1.0, *[1.0] * others])
        foot = np.full_like(tail, -1.0 if self.spaces_are_unit else 0.0)
        return np.concatenate([low, foot]), np.concatenate([high, tail])

    def rows(self, problem: Problem, i: int, states: Sequence[Array], q: Array, time: int) -> Array:
        """Return the rows (N, n) of agent i, float64, for states (d_j, N) of all agents and automaton states (N,).

        With the scope "own" the states of others are not looked at.
        """
        seen, n = self._seen(problem, i, states), len(q)
        if self.scale == "unit":
            seen = _to_unit(seen, self._range(problem, i))
        told = np.zeros((problem.n_agents if self.told else 0, n))
        if self.told:
            told[i] = 1.0
        known = {"one-hot": q == np.arange(problem.automaton.n_states)[:, None], "number": q[None]}
        left = np.full((1, n), 1.0 - time / problem.horizon)
        return np.concatenate([seen, known.get(self.automaton, np.zeros((0, n))), left, told]).T

    def affine(self, problem: Problem, i: int) -> tuple[Array, Array] | None:
        """Return a matrix (k, D) and an offset (k,): what agent i sees of the joint state; None if it is not so."""
        if self.scope == "neighbours" and problem.n_agents > 2:
            return None  # the nearest ones change places
        rows = np.eye(problem.n_states)
        matrix = self._seen(problem, i, [rows[columns] for columns in problem.columns])
        low, high = self._range(problem, i)
        if self.scale == "raw":
            return matrix, np.zeros(len(matrix))
        return 2.0 * matrix / (high - low)[:, None], -2.0 * low / (high - low) - 1.0

    def _range(self, problem: Problem, i: int) -> Bounds:
        """Return the range of the states that are seen, as environments scale them."""
        agent = problem.agents[i]
        if self.scope == "joint":
            return joint_bounds(problem.agents)
        low, high = joint_bounds([agent])
        if self.padded:
            spare = max(other.n_states for other in problem.agents) - agent.n_states
            return np.concatenate([low, np.full(spare, -1.0)]), np.concatenate([high, np.ones(spare)])
        more = {
            "full": lambda: joint_bounds([agent, *self._others(problem, agent)]),
            "relative": lambda: _beside(low, high, relative_bounds(problem, agent)),
            "neighbours": lambda: _beside(low, high, nearest_bounds(problem, agent, self._count(problem))),
        }
        return more[self.scope]() if self.scope in more else (low, high)

    def _seen(self, problem: Problem, i: int, states: Sequence[Array]) -> Array:
        """Return the states (k, N) that agent i sees, in their units."""
        if self.scope == "joint":
            return np.concatenate(list(states))
        mine, others = states[i], [x for k, x in enumerate(states) if k != i]
        if self.scope == "full":
            return np.concatenate([mine, *others])
        if self.scope == "relative":
            return np.concatenate([mine, *(x[: len(mine)] - mine[: len(x)] for x in others)])
        if self.scope == "neighbours":
            d, p = common_sizes(problem)
            places = [agent.outputs(x)[:p] for agent, x in zip(problem.agents, states, strict=True)]
            near = nearest_seen(np.stack([x[:d] for x in states]), np.stack(places), i, self._count(problem))
            return np.concatenate([mine, near])
        width = len(self._range(problem, i)[0])
        return np.concatenate([mine, np.zeros((width - len(mine), mine.shape[1]))])

    @staticmethod
    def _others(problem: Problem, agent: AnyAgent) -> list[AnyAgent]:
        return [other for other in problem.agents if other is not agent]

    def _count(self, problem: Problem) -> int:
        return checked_neighbours(problem, self.scope, self.neighbours)


def _beside(low: Array, high: Array, more: Bounds) -> Bounds:
    """Return bounds followed by more of them."""
    return np.concatenate([low, more[0]]), np.concatenate([high, more[1]])


def _to_unit(numbers: Array, bounds: Bounds) -> Array:
    """Return numbers (k, N) moved into their range and scaled to [-1, 1], rounded as in ``relations.networks``."""
    low, high = (end[:, None] for end in bounds)
    return np.asarray(2.0 * (np.clip(numbers, low, high) - low) / (high - low) - 1.0)
