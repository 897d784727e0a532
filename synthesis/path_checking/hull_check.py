"""Convex sets of starts, once more: every corner by the check of paths, and what lets the rest follow from them.

Between corners distances to limits are concave in the start and the nominal inputs. The logarithm of
``2 Phi(d / sigma) - 1`` is concave and rises with d, and tails are convex as long as the nominal value is on the right
side of the limit: so the larger failure of two corners bounds what is between them, for either of the two bounds.
"""

from __future__ import annotations

import math
from itertools import product

import numpy as np

from ...envs.agents import LinearAgent, Proposition
from ..certificates import Certificate, HullProof, corner
from .own_regions import RegionSpan
from .path_check import both_failures, wrong_paths

MOST_LETTERS = 1024
"""First letters that are looked at."""


def wrong_hull(hull: Certificate[HullProof]) -> tuple[list[str], float]:
    """What is wrong with a convex set of starts, and an upper bound on failing from any of them.

    Raises nothing: what does not fit is told.
    """
    failures = _wrong_corners(hull)
    if failures:
        return failures, 1.0
    boole = correlated = 0.0
    for i in range(len(hull.proof.corners)):
        path = corner(hull, i)
        failures, _ = wrong_paths(path)
        if failures:
            return [f"corner {i}: {failure}" for failure in failures], 1.0
        first, second = both_failures(path)
        boole, correlated = max(boole, first), max(correlated, second)
    failure = min(boole, correlated)
    if not failure <= hull.proof.failure:
        claimed = f"it says that starts fail with probability {hull.proof.failure:.6g} at most"
        return [f"{claimed}, but what was recomputed is {failure:.6g}"], failure
    return [], failure


def _wrong_corners(hull: Certificate[HullProof]) -> list[str]:
    """Return what is wrong with the agent, the corners, or where the first letter leads from them."""
    problem, n = hull.problem, len(hull.proof.corners)
    agent = problem.agents[0]
    if problem.n_agents != 1 or not isinstance(agent, LinearAgent) or not agent.initial.is_point:
        return ["it is not about one linear agent that starts from a point"]
    if hull.proof.corners.shape != (n, agent.n_states) or hull.proof.inputs.shape[:1] != (n,) or n == 0:
        return ["its corners and inputs do not fit"]
    # What a set says about states beyond its axes would not be seen in its share of the workspace.
    still = sorted(set(range(agent.n_states)) - set(hull.proof.axes))
    if len(still) + len(hull.proof.axes) != agent.n_states:
        return ["its axes are not different states of the agent"]
    if not np.all(hull.proof.corners[:, still] == agent.initial.low[still]):
        return ["corners differ from the start in states that are not among its axes"]
    if not np.all((agent.state_low <= hull.proof.corners) & (hull.proof.corners <= agent.state_high)):
        return ["a corner is outside of the workspace"]
    if not _one_first_state(hull, agent):
        return ["where the automaton is after the first letter depends on the start"]
    return []


def _one_first_state(hull: Certificate[HullProof], agent: LinearAgent) -> bool:
    """Whether the first letter leads to the same state from all starts, letters that no start may have included."""
    automaton, regions = hull.problem.automaton, hull.problem.propositions
    outputs = hull.proof.corners @ agent.output_matrix.T
    low, high = outputs.min(axis=0), outputs.max(axis=0)
    spare = 1e-9 * (1.0 + np.abs(outputs).max(axis=0))  # far above the rounding of outputs
    values: list[tuple[bool, ...]] = []
    for name in automaton.propositions:
        proposition = regions[name]
        assert isinstance(proposition, Proposition)
        region = RegionSpan.of(proposition, 0)
        if np.all((region.low[1] <= low - spare) & (high + spare <= region.high[0])):
            values.append((True,))
        elif np.any((high + spare < region.low[0]) | (low - spare > region.high[1])):
            values.append((False,))
        else:
            values.append((False, True))
    if math.prod(map(len, values)) > MOST_LETTERS:
        return False
    letters = (np.array(letter, dtype=bool) for letter in product(*values))
    return len({int(automaton.next_state(automaton.initial, letter)) for letter in letters}) == 1
