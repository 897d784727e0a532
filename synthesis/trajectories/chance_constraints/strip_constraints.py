"""What has to hold along a path, as linear inequalities on deviations, and the probability that one of them fails.

With feedback K the deviation from the nominal path is ``e' = (A + B K) e + w``, so that a row c of states or inputs has
the variance ``c' S_t c``, ``S_t`` being the covariance of e. An inequality ``low <= c xbar_t + c e_t <= high`` fails
with the two tails of that variance. Of all of them together

- at least the product of ``2 Phi(d / sigma) - 1`` holds, d the distance to the nearer limit (Gaussian correlation
  inequality: strips around the nominal path are symmetric convex sets);
- at most the sum of the tails fails (Boole).

The smaller probability of failing counts.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from ....envs.systems.agents import LinearAgent, with_matrices
from ....envs.tasks.problem import Problem
from ...relations.grids import FloatArray
from .path_limits import without_far_ends

OUTWARD = 1.0 + 3e-9
"""Factor on deviations and on failure probabilities, far above the rounding of paths of a few hundred steps."""

SMALLEST = 1e-300
"""What stands for smaller tails, which floating point does not hold."""

NARROW = 1e-11
"""Share of their size by which limits have to be apart: what lies between nearer ones has no probability."""

INWARD = 1e-9
"""Share of the size of a number by which distances are shortened for rounding."""


Limit = tuple[int, FloatArray, float, float]
"""Time, row, low and high of an inequality."""


@dataclass(frozen=True, eq=False)
class StripConstraints:
    """Inequalities ``low <= row . z_t <= high`` on states or inputs of one agent.

    Parameters
    ----------
    times : (J,) int array
    rows : (J, d) or (J, m) array
    low, high : (J,) arrays
        Limits, possibly infinite.
    deviations : (J,) array
        Standard deviations of ``row . e_t`` (rounded up).
    """

    times: NDArray[np.int64]
    rows: FloatArray
    low: FloatArray
    high: FloatArray
    deviations: FloatArray

    @property
    def are_empty(self) -> NDArray[np.bool_]:
        """Whether inequalities (J,) leave no room but for rounding."""
        size = np.maximum(*(np.where(np.isfinite(end), np.abs(end), 0.0) for end in (self.low, self.high)))
        return np.asarray(self.high - self.low <= NARROW * size)

    def failure(self, nominal: FloatArray, size: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return both tails (J,) of each inequality from above, for nominal values (J,) that are off by ``size``."""
        tails = []
        for distance in (nominal - self.low, self.high - nominal):
            distance = distance - INWARD * size
            with np.errstate(divide="ignore", invalid="ignore"):
                z = np.where(self.deviations > 0.0, distance / np.maximum(self.deviations, 1e-300), np.inf)
            # Without noise only the nominal value itself counts.
            z = np.where((self.deviations <= 0.0) & (distance <= 0.0), -np.inf, z)
            tails.append(np.where(distance == np.inf, 0.0, np.minimum(1.0, ndtr(-z) * OUTWARD + 2.0 * SMALLEST)))
        return tails[0], tails[1]


def limits_of(problem: Problem, i: int, letters: NDArray[np.int8], faces: NDArray[np.int64]) -> list[Limit]:
    """Return time, row, low and high of every inequality on states of agent i, for letters (S + 1, P).

    Inequalities on the same row at the same time are one: its limits are the narrowest ones.
    """
    agent = with_matrices(problem.agents[i])
    limits: list[Limit] = []
    for t in range(1, len(letters)):
        narrowest: dict[bytes, Limit] = {}
        for row, low, high in _limits_at(problem, agent, letters[t], faces[t], t):
            key = (row + 0.0).tobytes()  # no negative zeros
            _, _, first, last = narrowest.get(key, (t, row, -np.inf, np.inf))
            narrowest[key] = (t, row, max(first, low), min(last, high))
        limits += narrowest.values()
    return limits


def _limits_at(
    problem: Problem, agent: LinearAgent, letter: NDArray[np.int8], face: NDArray[np.int64], t: int
) -> Iterator[tuple[FloatArray, float, float]]:
    """Yield row, low and high of every inequality on states of an agent at one time."""
    yield from zip(np.eye(agent.n_states), agent.state_low.tolist(), agent.state_high.tolist(), strict=True)
    for p, name in enumerate(problem.automaton.propositions):
        proposition = problem.propositions[name]
        if proposition.agent != agent.name or letter[p] == 0:
            continue
        region = proposition.at(t)
        if letter[p] > 0:
            corners = without_far_ends(agent, region.low, region.high)
            yield from zip(agent.output_matrix, *(corner.tolist() for corner in corners), strict=True)
            continue
        k, side = divmod(int(face[p]), 2)
        low, high = (float(region.high[k]), np.inf) if side else (-np.inf, float(region.low[k]))
        yield agent.output_matrix[k], low, high


def state_strips(limits: list[Limit], covariances: FloatArray) -> StripConstraints:
    """Return inequalities on states with their deviations, for covariances (S + 1, d, d)."""
    times = np.array([t for t, *_ in limits], dtype=np.int64)
    rows = np.array([row for _, row, *_ in limits])
    variances = np.empty(len(times))
    for t in np.unique(times):
        here = np.flatnonzero(times == t)
        variances[here] = np.sum((rows[here] @ covariances[t]) * rows[here], axis=1)
    low, high = (np.array([limit[k] for limit in limits], dtype=float) for k in (2, 3))
    return StripConstraints(times, rows, low, high, np.sqrt(np.maximum(variances, 0.0)) * OUTWARD)


def input_strips(agent: LinearAgent, gain: FloatArray, covariances: FloatArray, steps: int) -> StripConstraints:
    """Return the limits of inputs at all steps."""
    m = agent.n_inputs
    variances = np.sum((gain @ covariances[:steps]) * gain, axis=2)
    deviations = np.sqrt(np.maximum(variances, 0.0)).ravel() * OUTWARD
    times, rows = np.repeat(np.arange(steps), m), np.tile(np.eye(m), (steps, 1))
    return StripConstraints(times, rows, np.tile(agent.input_low, steps), np.tile(agent.input_high, steps), deviations)


def failure_of(pairs: list[tuple[FloatArray, FloatArray]]) -> float:
    """Return an upper bound on the probability that an inequality fails, from both tails of each."""
    below, above = (np.concatenate([pair[k] for pair in pairs]) for k in (0, 1))
    boole = float(np.sum(below + above))
    worse = np.maximum(below, above)
    if np.any(worse >= 0.5):
        return min(1.0, boole * OUTWARD)
    return min(1.0, OUTWARD * min(boole, float(-np.expm1(np.sum(np.log1p(-2.0 * worse))))))
