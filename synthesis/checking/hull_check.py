"""Convex sets of starts, once more: every corner by the check of paths, and what lets the rest follow from them.

Between corners distances to limits are concave in the start and the nominal inputs. The logarithm of
``2 Phi(d / sigma) - 1`` is concave and rises with d, and tails are convex as long as the nominal value is on the right
side of the limit: so the larger failure of two corners bounds what is between them, for either of the two bounds.
"""

from __future__ import annotations

import math
from itertools import product

import numpy as np

from ...envs.agents import LinearAgent
from ..certificates import StartHull
from .path_check import both_failures, wrong_paths

MOST_LETTERS = 1024
"""First letters that are looked at."""


def wrong_hull(hull: StartHull) -> list[str]:
    """Return what is wrong with a convex set of starts; empty if its claim holds.

    Raises nothing: whatever does not fit is told.
    """
    problem, n = hull.problem, len(hull.corners)
    agent = problem.agents[0]
    if problem.n_agents != 1 or not isinstance(agent, LinearAgent):
        return ["it is not about one linear agent"]
    if hull.corners.shape != (n, agent.n_states) or hull.inputs.shape[:1] != (n,) or n == 0:
        return ["its corners and inputs do not fit"]
    if not np.all((agent.state_low <= hull.corners) & (hull.corners <= agent.state_high)):
        return ["a corner is outside of the workspace"]
    if not _one_first_state(hull, agent):
        return ["where the automaton is after the first letter depends on the start"]
    boole = correlated = 0.0
    for i in range(n):
        corner = hull.corner(i)
        failures, _ = wrong_paths(corner)
        if failures:
            return [f"corner {i}: {failure}" for failure in failures]
        first, second = both_failures(corner)
        boole, correlated = max(boole, first), max(correlated, second)
    if min(boole, correlated) > hull.failure:
        return [f"its probability of failing is {min(boole, correlated):.6g}, not {hull.failure:.6g}"]
    return []


def _one_first_state(hull: StartHull, agent: LinearAgent) -> bool:
    """Whether the first letter leads to the same state from all starts, letters that no start may have included."""
    automaton, regions = hull.problem.automaton, hull.problem.propositions
    outputs = hull.corners @ agent.output_matrix.T
    low, high = outputs.min(axis=0), outputs.max(axis=0)
    spare = 1e-9 * (1.0 + np.abs(outputs).max(axis=0))  # far above the rounding of outputs
    values: list[tuple[bool, ...]] = []
    for name in automaton.propositions:
        region = regions[name]
        if np.all((region.low <= low - spare) & (high + spare <= region.high)):
            values.append((True,))
        elif np.any((high + spare < region.low) | (low - spare > region.high)):
            values.append((False,))
        else:
            values.append((False, True))
    if math.prod(map(len, values)) > MOST_LETTERS:
        return False
    letters = (np.array(letter, dtype=bool) for letter in product(*values))
    return len({int(automaton.next_state(automaton.initial, letter)) for letter in letters}) == 1
