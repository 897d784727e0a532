"""The observation "neighbours": where the nearest other agents are from an agent's own place.

Near is what has a small Euclidean distance between outputs (for most agents, positions); among equals the first agent
of the problem counts as the nearest. Agents that differ in their numbers of outputs or states are compared, and shown,
by the first components that all agents have. An observation lists the neighbours from the nearest on, so an entry may
belong to different agents at different times.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ..systems.agents import AnyAgent
from ..systems.arguments import checked_count
from ..systems.backends import concatenated, namespace
from ..tasks.problem import Problem
from .observation import Bounds

NEIGHBOURS = 2
"""Neighbours that are shown if nobody says how many: enough to see both sides, in teams that have so many others."""


def checked_neighbours(problem: Problem, observation: str, value: Any) -> int:
    """Return how many neighbours an observation shows, or raise ValueError."""
    others = problem.n_agents - 1
    if value is None:
        return min(NEIGHBOURS, others)
    if observation != "neighbours":
        raise ValueError(f'`neighbours`: expected only with the observation "neighbours", got {value!r}')
    return checked_count(value, "neighbours", most=others)


def common_sizes(problem: Problem) -> tuple[int, int]:
    """Return how many states and outputs all agents have."""
    agents = problem.agents
    return min(agent.n_states for agent in agents), min(agent.n_outputs for agent in agents)


def nearest_bounds(problem: Problem, agent: AnyAgent, count: int) -> Bounds:
    """Return between which numbers the entries of `count` neighbours lie, as seen by an agent."""
    d, others = common_sizes(problem)[0], [other for other in problem.agents if other is not agent]
    if count == 0:
        return np.zeros(0), np.zeros(0)
    # Any other agent may be in any entry.
    low = np.min([other.state_low[:d] for other in others], axis=0) - agent.state_high[:d]
    high = np.max([other.state_high[:d] for other in others], axis=0) - agent.state_low[:d]
    return np.tile(low, count), np.tile(high, count)


def nearest_seen(states: np.ndarray, outputs: np.ndarray, i: int, count: int) -> np.ndarray:
    """Return where the nearest `count` agents are from agent i: (count * d, M), from the nearest on.

    Parameters
    ----------
    states, outputs : (n, d, M) and (n, p, M) arrays
        Of all agents, their common components.
    i, count : int
        An agent, and a number of neighbours less than n.
    """
    xp = namespace(states)
    distance = ((outputs - outputs[i]) ** 2).sum(axis=1)
    away = xp.full_like(distance[0], np.inf)
    distance, seen = xp.stack([away if k == i else row for k, row in enumerate(distance)]), [states[i][:0]]
    for _ in range(count):
        # `argmin` returns the first of equals; what was found is out of reach in the next round.
        found = xp.argmin(distance, axis=0)
        chosen = xp.stack([found == k for k in range(len(distance))])
        seen.append(xp.where(chosen[:, None], states, 0.0).sum(axis=0) - states[i])
        distance = xp.where(chosen, away, distance)
    return concatenated(seen)
