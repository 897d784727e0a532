"""Inequalities on Gaussian numbers of mean 0, and an upper bound on the probability that one of them fails.

Each asks that a linear form g of the deviation keeps ``-low <= g <= high`` and, where a tube needs it, ``|g| <= slab``.
Slabs are convex and symmetric: by the Gaussian correlation inequality (Royen 2014) they hold together at least as
probably as if they were independent. What is left of a limit beyond its slab is a tail, which is taken off the product.
Any choice of what is a slab and what a tail is a bound; a few are tried.

Where the size of the noise depends on the past the forms are no Gaussian numbers, but martingales whose steps are
normal given the past, with variances of which only upper bounds are known. Such a form is a Brownian motion, read at a
random time that is at most the sum V of these bounds. By the reflection principle it exceeds d with a probability of at
most twice the tail of a normal number with variance V; and all failures are added up.

Noise of other laws whose exponential moments are below those of normal numbers has no slabs either: a form exceeds d
with a probability of at most ``exp(-d^2 / (2 V))`` (Chernoff), also where its size depends on the past. Where these
moments are below those of Laplace's law it is the power V / v of ``(1 + r) exp(1 - r) / 2`` with
``r^2 = 1 + 2 v d^2 / V^2``, where no step adds more than v to V.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.special import erfc

from ..cells import FloatArray
from ..masses import state
from .law_moments import LIGHT, NORMAL
from .roundings import SMALLEST, TAIL, UNIT

SHARES = (1.0, 0.8, 0.6, 0.4, 0.2)
"""Probabilities of all slabs for which the choice between slab and tails is made: 1 is best for small failures."""


MOST_POWER = 1e4
"""Most equal steps that a sum counts as: more make hardly a difference."""


@dataclass(eq=False)
class Inequalities:
    """Distances from 0 at which inequalities end, and the variances of their forms, lists of arrays (J,)."""

    low: list[FloatArray] = field(default_factory=list)
    high: list[FloatArray] = field(default_factory=list)
    slab: list[FloatArray] = field(default_factory=list)
    variance: list[FloatArray] = field(default_factory=list)
    largest: list[FloatArray] = field(default_factory=list)
    """What one step adds to the variances at most; all of it where nothing is known."""
    below: list[FloatArray] = field(default_factory=list)
    above: list[FloatArray] = field(default_factory=list)
    """Other bounds on the tails of each side, where the size of noise depends on the past; 1 where there are none."""
    is_stopped: bool = False
    """Whether variances are upper bounds, on noise whose size depends on the past."""
    tail: int = NORMAL
    """What is known of the tails of the noise (``law_moments``)."""
    lost: float = 0.0
    """Probability of noise that is given up."""

    def add(
        self,
        low: FloatArray,
        high: FloatArray,
        slab: FloatArray,
        variance: FloatArray,
        largest: FloatArray | None = None,
        bounds: tuple[FloatArray, FloatArray] | None = None,
    ) -> None:
        """Add inequalities; infinite where nothing is asked. What is no number is not kept."""
        for kept, new in zip((self.low, self.high, self.slab), (low, high, slab)):
            distance = np.atleast_1d(np.asarray(new, dtype=float))
            kept.append(np.where(np.isnan(distance), -np.inf, distance))
        self.variance.append(np.atleast_1d(np.asarray(variance, dtype=float)))
        most = self.variance[-1] if largest is None else np.atleast_1d(np.asarray(largest, dtype=float))
        self.largest.append(np.minimum(most, self.variance[-1]))
        nothing = np.ones(len(self.variance[-1]))
        for kept, new in zip((self.below, self.above), bounds or (nothing, nothing)):
            kept.append(new)

    def failure(self) -> float:
        """Return an upper bound on the probability that one of them fails."""
        if not self.low:
            return self.lost
        low, high, slab, variance = map(np.concatenate, (self.low, self.high, self.slab, self.variance))
        ends, others = [np.minimum(low, slab), np.minimum(high, slab)], [*map(np.concatenate, (self.below, self.above))]
        if self.tail != NORMAL:
            largest = np.concatenate(self.largest)
            each = [moment_tails(end, variance, self.tail, largest) for end in ends]
            each = [np.minimum(*both) for both in zip(each, others, strict=True)]
            return min(1.0, (float(np.sum(each)) + self.lost) * TAIL)
        if self.is_stopped:
            # Either side on its own, each with twice its tail, or what exponential moments say.
            each = [np.minimum(2.0 * tails(end, variance), other) for end, other in zip(ends, others, strict=True)]
            return min(1.0, float(np.sum(each)) * TAIL)
        both = np.minimum(2.0 * tails(np.minimum(np.minimum(low, high), slab), variance), 1.0)
        inner = np.minimum(2.0 * tails(slab, variance), 1.0)
        outer = np.where(low < slab, tails(low, variance), 0.0) + np.where(high < slab, tails(high, variance), 0.0)
        return min(1.0, *(_with_share(share, both, inner, outer) for share in SHARES))


def _with_share(share: float, both: FloatArray, inner: FloatArray, outer: FloatArray) -> float:
    as_slab = share * both <= share * inner + outer
    chosen = np.where(as_slab, both, inner)
    if np.any(chosen >= 1.0):
        return 1.0
    any_slab = float(-np.expm1(np.sum(np.log1p(-chosen))))
    state("any", chosen, any_slab * TAIL)
    return (any_slab + float(np.sum(np.where(as_slab, 0.0, outer)))) * TAIL


def shortened(
    below: FloatArray, above: FloatArray, shift: FloatArray, drift: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return distances from limits after shifts and drifts (J,), rounded inward."""
    ends = []
    for distance, moved in ((below, shift), (above, -shift)):
        size = np.where(np.isfinite(distance), np.abs(distance), 0.0) + np.abs(moved)
        ends.append(distance + moved - drift - 4.0 * UNIT * size)
    return ends[0], ends[1]


def moment_tails(
    distance: FloatArray, variance: FloatArray, kind: int = LIGHT, largest: FloatArray | None = None
) -> FloatArray:
    """Return upper bounds (J,) on the probabilities that numbers of mean 0 exceed distances, by exponential moments."""
    z = _quotients(distance, variance)
    if kind == LIGHT:
        # Exponentials are off by some units in the last place of themselves.
        tail = np.exp(-np.square(z) * (1.0 - 4.0 * UNIT)) * TAIL + SMALLEST
        tail = np.where(z <= 0.0, 1.0, np.minimum(1.0, tail))
        state("light", z, tail)
        return _known(tail, distance, variance)
    # Any bounds will do, as long as that on what one step adds is not above that on the whole.
    power = np.ones(len(z))
    if largest is not None:
        power = np.clip(np.maximum(variance, SMALLEST) / np.maximum(largest, SMALLEST), 1.0, MOST_POWER)
    z = z / np.sqrt(power)
    root = np.sqrt(1.0 + 4.0 * np.square(z))
    # The exponent is a small difference times a power: what it is off by is added.
    exponent = power * (np.log1p(0.5 * (root - 1.0)) - (root - 1.0)) + 64.0 * UNIT * power * root
    tail = np.where(z <= 0.0, 1.0, np.minimum(1.0, np.exp(np.minimum(exponent, 0.0)) * TAIL + SMALLEST))
    state("long", z, power, tail)
    return _known(tail, distance, variance)


def tails(distance: FloatArray, variance: FloatArray) -> FloatArray:
    """Return upper bounds (J,) on the probabilities that Gaussian numbers of mean 0 exceed distances.

    Without noise a distance is kept for sure if it is positive, else not. A distance of which nothing is known, minus
    infinity, is not kept.
    """
    z = _quotients(distance, variance)
    tail = np.minimum(1.0, 0.5 * erfc(z) * TAIL + SMALLEST)
    state("tails", z, tail)
    return _known(tail, distance, variance)


def _quotients(distance: FloatArray, variance: FloatArray) -> FloatArray:
    """Return distances (J,) in deviations, by the root of 2; infinite ones, which are kept for sure, are 0."""
    scale = np.sqrt(2.0 * np.maximum(variance, SMALLEST))
    # Large quotients have no tail that floating point holds.
    return np.asarray(np.clip(np.where(np.isfinite(distance), distance, 0.0) / scale, -1e3, 1e3))


def _known(tail: FloatArray, distance: FloatArray, variance: FloatArray) -> FloatArray:
    """Return tails (J,) where there is noise and something is known of it."""
    known = np.where(variance > 0.0, tail, np.where(distance > 0.0, 0.0, 1.0))
    is_unknown = (distance == -np.inf) | ~np.isfinite(variance)
    return np.asarray(np.where(distance == np.inf, 0.0, np.where(is_unknown, 1.0, known)))
