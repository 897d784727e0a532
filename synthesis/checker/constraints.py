"""Chance constraints on numbers that are jointly normal: an upper bound on the probability that one of them fails.

Each constraint is about a normal number g of mean 0 with a variance of at most V: ``-low <= g <= high``, and, where a
tube needs it, ``|g| <= width``.

**Theorem.** For any choice of strips ``|g_j| <= d_j`` and of tails beyond them,

    P(a constraint fails) <= 1 - prod_j (1 - P(|g_j| > d_j)) + sum of tails.

*Proof.* Strips hold together at least as probably as if the numbers were independent (Sidak, Journal of the American
Statistical Association 62, 1967: each strip is about one normal number). What is left of a constraint beyond its strip
is one tail, taken off by the union bound. A larger variance only makes each bound larger. QED

Constraints whose numbers are made of disjoint sources of noise are independent: probabilities of keeping all of one
component are multiplied.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from . import rigorous
from .intervals import up
from .rigorous import Array, U


@dataclass(frozen=True, eq=False)
class Normal:
    """Normal numbers of mean 0: upper bounds on their variances (J,), and the sources (J, W) of which they are made."""

    variance: Array
    sources: NDArray[np.bool_]

    def joined(self, other: Normal) -> Normal:
        """Return these numbers and others after them."""
        return Normal(np.concatenate([self.variance, other.variance]), np.concatenate([self.sources, other.sources]))

    def at(self, places: NDArray[np.bool_]) -> Normal:
        """Return some of these numbers."""
        return Normal(self.variance[places], self.sources[places])


SHARES = (1.0, 0.8, 0.6, 0.4, 0.2)
"""Guesses of the product, for each of which strips or tails are chosen by what they cost; any choice is a bound."""

ROUNDED = 1.0 + 2.0**-40
"""More than sums and products of 8,000 numbers of one sign are rounded by; longer sums count it once per 8,000."""


class Constraints:
    """Distances from 0 at which constraints end, variances, and sources of noise, as they are asked for."""

    def __init__(self) -> None:
        self.rows: list[Array] = []
        self.sources: list[NDArray[np.bool_]] = []
        self.labels: list[str] = []

    def add(self, low: Array, high: Array, width: Array, normal: Normal, labels: Sequence[str]) -> None:
        """Ask for ``-low <= g <= high`` and ``|g| <= width`` (J,); what is nan is not kept at all."""
        low, high, width = (np.where(np.isnan(end), -np.inf, end) for end in (low, high, width))
        self.rows.append(np.stack([low, high, width, normal.variance]))
        self.sources.append(normal.sources)
        self.labels += labels

    def failure(self) -> float:
        """Return an upper bound on the probability that one of them fails."""
        rows, component = np.concatenate(self.rows, axis=1), _components(np.concatenate(self.sources))
        each = [_failure_of(*rows[:, component == k]) for k in range(int(component.max(initial=-1)) + 1)]
        return min(1.0, _union(np.array(each)))

    def likeliest(self) -> str:
        """Return which constraint fails most probably, in words."""
        low, high, width, variance = np.concatenate(self.rows, axis=1)
        each = tails(np.minimum(np.minimum(low, high), width), variance)
        return self.labels[int(np.argmax(each))]


def _components(sources: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Return the component (J,) of each constraint: those that share a source (J, W), at first or second hand."""
    component = np.arange(len(sources))
    for shared in sources.T:
        if np.any(shared):
            members = np.isin(component, component[shared])
            component[members] = component[members].min()
    return np.unique(component, return_inverse=True)[1].reshape(-1)


def _failure_of(low: Array, high: Array, width: Array, variance: Array) -> float:
    """Return an upper bound on the probability that one of some constraints (J,) fails."""
    both = np.minimum(2.0 * tails(np.minimum(np.minimum(low, high), width), variance), 1.0)
    inner = np.minimum(2.0 * tails(width, variance), 1.0)
    outer = np.where(low < width, tails(low, variance), 0.0) + np.where(high < width, tails(high, variance), 0.0)
    return min(1.0, *(_with_strips(share * both <= share * inner + outer, both, inner, outer) for share in SHARES))


def _with_strips(strip: NDArray[np.bool_], both: Array, inner: Array, outer: Array) -> float:
    """Return the bound in which some constraints are strips as a whole, and others strips and tails."""
    return _union(np.where(strip, both, inner)) + float(np.sum(np.where(strip, 0.0, outer))) * _rounded(len(outer))


def _union(each: Array) -> float:
    """Return an upper bound on the probability of any of some events that are independent, or better than that."""
    if np.any(each >= 1.0):
        return 1.0
    # 1 - prod (1 - p): logarithms of one sign, off by some units in the last place of themselves
    return float(-np.expm1(np.sum(np.log1p(-each)))) * _rounded(len(each))


def _rounded(count: int) -> float:
    """Return a factor beyond what sums and products of so many numbers of one sign are rounded by."""
    return float(ROUNDED ** (1 + count // 8000))


def tails(distance: Array, variance: Array) -> Array:
    """Return upper bounds (J,) on P(g > distance) for normal g of mean 0 and a variance of at most this.

    Without noise a distance is kept if it is positive. Distances or variances of which nothing is known are not kept.
    """
    with np.errstate(all="ignore"):
        distance = np.where(np.isnan(variance), -np.inf, distance)
        z = distance / np.sqrt(variance)
        # root and quotient round by U each, and the tail falls: a smaller z gives a larger one
        z = np.where(variance > 0, z - 8 * U * np.minimum(np.abs(z), 1e300), np.where(distance > 0, np.inf, -np.inf))
        size = np.minimum(np.abs(np.where(np.isnan(z), 0.0, z)), 37.0)
        low, high = rigorous.tail(size)
        tail = np.where(z >= 0, high, up(1.0 - low))
    return np.where(np.isnan(z) | (z == -np.inf), 1.0, np.where(z == np.inf, 0.0, tail))
