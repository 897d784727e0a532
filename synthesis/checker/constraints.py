"""Chance constraints along a trajectory: an upper bound on the probability that one of them fails.

Each constraint is about a linear form g of the noise, of mean 0: ``-low <= g <= high``, and, where a tube needs it,
``|g| <= width``. V is an upper bound on its variance, or on that of what is above the noise (``distributions``).

**Theorem.** For normal noise, any choice of strips ``|g_j| <= d_j`` and of tails beyond them,

    P(a constraint fails) <= 1 - prod_j (1 - P(|g_j| > d_j)) + sum of tails.

*Proof.* Strips hold together at least as probably as if the numbers were independent (Sidak, Journal of the American
Statistical Association 62, 1967: each strip is about one normal number). What is left of a constraint beyond its strip
is one tail, taken off by the union bound. A larger variance only makes each bound larger. QED

Where the size of normal noise depends on the past, g is a Brownian motion read at a random time of at most V: it
exceeds d with at most twice the tail of a normal number with the variance V (reflection principle). Other noise has the
tails of its exponential moments. In both cases all tails are added up.

Constraints whose forms are made of disjoint sources of noise are independent: probabilities of keeping all of one
component are multiplied.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from . import rigorous
from .distributions import LIGHT, NORMAL, STOPPED
from .intervals import down, up
from .rigorous import Array, U


@dataclass(frozen=True, eq=False)
class Forms:
    """Linear forms of noise, of mean 0: upper bounds on their variances (J,) and on what one step adds to them (J,).

    ``sources`` (J, W) says of which sources of noise they are made.
    """

    variance: Array
    largest: Array
    sources: NDArray[np.bool_]

    def joined(self, other: Forms) -> Forms:
        """Return these forms and others after them."""
        pairs = zip((self.variance, self.largest, self.sources), (other.variance, other.largest, other.sources))
        return Forms(*(np.concatenate(pair) for pair in pairs))

    def at(self, places: NDArray[np.bool_]) -> Forms:
        """Return some of these forms."""
        return Forms(self.variance[places], self.largest[places], self.sources[places])


SHARES = (1.0, 0.8, 0.6, 0.4, 0.2)
"""Guesses of the product, for each of which strips or tails are chosen by what they cost; any choice is a bound."""

ROUNDED = 1.0 + 2.0**-40
"""More than sums and products of 8,000 numbers of one sign are rounded by; longer sums count it once per 8,000."""


class Constraints:
    """Distances from 0 at which constraints end, and their forms, as they are asked for.

    ``kinds`` (W,) are those of the sources of noise; ``lost`` is a probability of noise that is given up.
    """

    def __init__(self, kinds: NDArray[np.int64]) -> None:
        self.kinds, self.lost = kinds, 0.0
        self.rows: list[Array] = []
        self.sources: list[NDArray[np.bool_]] = []
        self.labels: list[str] = []

    def add(self, low: Array, high: Array, width: Array, forms: Forms, labels: Sequence[str]) -> None:
        """Ask for ``-low <= g <= high`` and ``|g| <= width`` (J,); what is nan is not kept at all."""
        low, high, width = (np.where(np.isnan(end), -np.inf, end) for end in (low, high, width))
        self.rows.append(np.stack([low, high, width, forms.variance, forms.largest]))
        self.sources.append(forms.sources)
        self.labels += labels

    def failure(self) -> float:
        """Return an upper bound on the probability that one of them fails."""
        rows, sources = np.concatenate(self.rows, axis=1), np.concatenate(self.sources)
        # A form is of the heaviest kind among its sources; forms that share none are independent.
        component, kinds = _components(sources), np.where(sources, self.kinds, NORMAL).max(axis=1, initial=NORMAL)
        members = [component == k for k in range(int(component.max(initial=-1)) + 1)]
        each = [_failure_of(rows[:, here], kinds[here]) for here in members]
        return min(1.0, (_union(np.array(each)) + self.lost) * ROUNDED)

    def likeliest(self) -> str:
        """Return which constraint fails most probably, in words."""
        low, high, width, variance, _ = np.concatenate(self.rows, axis=1)
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


def _failure_of(rows: Array, kinds: NDArray[np.int64]) -> float:
    """Return an upper bound on the probability that one of some constraints, rows (5, J), fails."""
    low, high, width, variance, largest = rows
    if np.any(kinds != NORMAL):
        ends = (np.minimum(end, width) for end in (low, high))
        total = sum(float(np.sum(_tails_by_kind(end, variance, largest, kinds))) for end in ends)
        return min(1.0, total * _rounded(2 * len(low)))
    # As a strip: both tails beyond the nearest end. Or the strip of the tube, and tails beyond it.
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


def _tails_by_kind(distance: Array, variance: Array, largest: Array, kinds: NDArray[np.int64]) -> Array:
    """Return upper bounds (J,) on P(g > distance), whatever the noise is made of."""
    # How many deviations there are to the end, from below.
    z = _in_deviations(distance, variance)
    # normal noise whose size depends on the past is sub-Gaussian, too
    normal, light = tails(distance, variance), _light_tail(z)
    stopped, long = np.minimum(np.minimum(2.0 * normal, light), 1.0), _long_tail(z, variance, largest)
    return np.select([kinds == NORMAL, kinds == STOPPED, kinds == LIGHT], [normal, stopped, light], long)


def _in_deviations(distance: Array, variance: Array) -> Array:
    """Return lower bounds (J,) on distances in deviations; infinite ends for what is kept, or not, for sure."""
    with np.errstate(all="ignore"):
        distance = np.where(np.isnan(variance), -np.inf, distance)
        z = distance / np.sqrt(variance)
        # root and quotient round by U each, and a smaller z has a larger tail
        z = z - 8 * U * np.minimum(np.abs(z), 1e300)
        z = np.where(variance > 0, z, np.where(distance > 0, np.inf, -np.inf))
        return np.where(np.isnan(z), -np.inf, z)


def tails(distance: Array, variance: Array) -> Array:
    """Return upper bounds (J,) on P(g > distance) for normal g of mean 0 and a variance of at most this.

    Without noise a distance is kept if it is positive. Distances or variances of which nothing is known are not kept.
    """
    z = _in_deviations(distance, variance)
    with np.errstate(all="ignore"):
        low, high = rigorous.tail(np.minimum(np.abs(z), 37.0))
        tail = np.where(z >= 0, high, up(1.0 - low))
    return np.where(z == -np.inf, 1.0, np.where(z == np.inf, 0.0, tail))


def _light_tail(z: Array) -> Array:
    """Return exp(-z^2 / 2) from above, and 1 where z <= 0."""
    size = np.clip(z, 0.0, 1e3)
    tail = rigorous.exp(-0.5 * size * size * (1.0 - 4.0 * U))[1]
    return np.where(z <= 0.0, 1.0, np.where(z == np.inf, 0.0, np.minimum(tail, 1.0)))


def _long_tail(z: Array, variance: Array, largest: Array) -> Array:
    """Return ((1 + r)/2 exp(1 - r))^n from above, where n = V/v and r^2 = 1 + 2 z^2 / n; 1 where z <= 0."""
    with np.errstate(all="ignore"):
        # any v will do that is at least what one step adds: n may be smaller than it is
        n = np.clip(np.nan_to_num(variance / largest, nan=1.0) * (1.0 - 4.0 * U), 1.0, 1e4)
        size = np.clip(z, 0.0, 1e6)
        r = down(np.sqrt(1.0 + 2.0 * (size * size / n) * (1.0 - 8.0 * U)))
        exponent = n * (rigorous.log(up(0.5 + 0.5 * r))[1] + up(1.0 - r))
        exponent = np.minimum(exponent + 8.0 * U * n * (1.0 + r), 0.0)
        tail = rigorous.exp(exponent)[1]
    return np.where(z <= 0.0, 1.0, np.where(z == np.inf, 0.0, np.minimum(tail, 1.0)))
