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
from typing import Any, NamedTuple

import numpy as np

from . import rigorous
from .distributions import LIGHT, NORMAL, STOPPED
from .intervals import down, up
from .rigorous import Array, Truth, U, Whole


class Forms(NamedTuple):
    """Linear forms of noise, of mean 0: upper bounds on their variances (J,) and on what one step adds to them (J,).

    ``sources`` (J, W) says of which sources of noise they are made.
    """

    variance: Array
    largest: Array
    sources: Truth

    def at(self, places: Truth) -> Forms:
        """Return some of these forms."""
        return Forms(self.variance[places], self.largest[places], self.sources[places])


# Guesses of the product, for each of which strips or tails are chosen by what they cost; any choice is a bound.
SHARES = (1.0, 0.8, 0.6, 0.4, 0.2)
# More than sums and products of 8,000 numbers of one sign are rounded by; longer sums count it once per 8,000.
ROUNDED = 1.0 + 2.0**-40


class Constraints:
    """Distances from 0 at which constraints end, and their forms, as they are asked for.

    ``kinds`` (W,) are those of the sources of noise; ``lost`` is a probability of noise that is given up.
    """

    def __init__(self, kinds: Whole) -> None:
        self.kinds, self.lost = kinds, 0.0
        self.rows: list[Array] = []
        self.sources: list[Truth] = []
        self.labels: list[str] = []

    def add(self, low: Any, high: Any, width: Any, forms: Forms, labels: Sequence[str]) -> None:
        """Ask for ``-low <= g <= high`` and ``|g| <= width`` (J,); what is nan is not kept at all."""
        limits = (np.where(np.isnan(end), -np.inf, end) for end in (low, high, width))
        self.rows.append(np.stack(np.broadcast_arrays(*limits, forms.variance, forms.largest)))
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

    def nearest(self) -> dict[int, tuple[float, str]]:
        """Return, by times, how many deviations the nearest end of a constraint is away (from below), and of which."""
        low, high, width, variance, _ = np.concatenate(self.rows, axis=1)
        away, found = _in_deviations(np.minimum(np.minimum(low, high), width), variance), dict[int, tuple[float, str]]()
        for k in np.argsort(away, kind="stable"):
            found.setdefault(int(self.labels[k].rpartition(" ")[2]), (float(away[k]), self.labels[k]))
        return found


def _components(sources: Truth) -> Whole:
    """Return the component (J,) of each constraint: those that share a source (J, W), at first or second hand."""
    component = np.arange(len(sources))
    for shared in sources.T:
        if np.any(shared):
            members = np.isin(component, component[shared])
            component[members] = component[members].min()
    return np.unique(component, return_inverse=True)[1].reshape(-1)


def _failure_of(rows: Array, kinds: Whole) -> float:
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
    found = 1.0
    for share in SHARES:
        strip = share * both <= share * inner + outer
        tail = float(np.sum(np.where(strip, 0.0, outer))) * _rounded(len(outer))
        found = min(found, _union(np.where(strip, both, inner)) + tail)
    return found


def _union(each: Array) -> float:
    """Return an upper bound on the probability of any of some events that are independent, or better than that."""
    if np.any(each >= 1.0):  # no logarithm of 0
        return 1.0
    # 1 - prod (1 - p): logarithms of one sign, off by some units in the last place of themselves
    return float(-np.expm1(np.sum(np.log1p(-each)))) * _rounded(len(each))


def _rounded(count: int) -> float:
    """Return a factor beyond what sums and products of so many numbers of one sign are rounded by."""
    return float(ROUNDED ** (1 + count // 8000))


def _tails_by_kind(distance: Array, variance: Array, largest: Array, kinds: Whole) -> Array:
    """Return upper bounds (J,) on P(g > distance), whatever the noise is made of."""
    # How many deviations there are to the end, from below.
    z = _in_deviations(distance, variance)
    normal, light, long = tails(distance, variance), _light_tail(z), _long_tail(z, variance, largest)
    # normal noise whose size depends on the past is sub-Gaussian, too
    stopped = np.minimum(np.minimum(2.0 * normal, light), 1.0)
    return np.select([kinds == NORMAL, kinds == STOPPED, kinds == LIGHT], [normal, stopped, light], long)


def _in_deviations(distance: Array, variance: Array) -> Array:
    """Return lower bounds (J,) on distances in deviations; infinite ends for what is kept, or not, for sure."""
    with np.errstate(all="ignore"):
        z = np.where(np.isnan(variance), -np.inf, distance) / np.sqrt(variance)
        # root and quotient round by U each, and a smaller z has a larger tail
        z = z - 8 * U * np.minimum(np.abs(z), 1e300)
        z = np.where(variance > 0, z, np.where((distance > 0) & ~np.isnan(variance), np.inf, -np.inf))
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
    return _where_it_is(z, rigorous.exp(-0.5 * size * size * (1.0 - 4.0 * U))[1])


def _long_tail(z: Array, variance: Array, largest: Array) -> Array:
    """Return ((1 + r)/2 exp(1 - r))^n from above, where n = V/v and r^2 = 1 + 2 z^2 / n; 1 where z <= 0."""
    with np.errstate(all="ignore"):
        # any v will do that is at least what one step adds: n may be smaller than it is
        n = np.clip(np.nan_to_num(variance / largest, nan=1.0) * (1.0 - 4.0 * U), 1.0, 1e4)
        size = np.clip(z, 0.0, 1e6)
        r = down(np.sqrt(1.0 + 2.0 * (size * size / n) * (1.0 - 8.0 * U)))
        exponent = n * (rigorous.log(up(0.5 + 0.5 * r))[1] + up(1.0 - r))
        return _where_it_is(z, rigorous.exp(np.minimum(exponent + 8.0 * U * n * (1.0 + r), 0.0))[1])


def _where_it_is(z: Array, tail: Array) -> Array:
    """Return a tail beyond z > 0 deviations; 1 below, also where nothing is known, and 0 where nothing is beyond."""
    return np.where(z <= 0.0, 1.0, np.where(z == np.inf, 0.0, np.minimum(tail, 1.0)))
