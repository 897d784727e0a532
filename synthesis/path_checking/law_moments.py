"""Laws whose exponential moments are above those of noise, for checks: formulas of their own.

A law of mean m is *sub-Gaussian* with deviation s if ``E exp(a (e - m)) <= exp(a^2 s^2 / 2)`` for every a. Sums of
independent multiples of such noise are, with the variance of the sum, so that they exceed d with a probability of at
most ``exp(-d^2 / (2 V))``. Other laws are below Laplace's, ``E exp(a (e - m)) <= 1 / (1 - a^2 s^2 / 2)``, and so are
such sums (docs/theory/paths.md, "Noise of other laws"); those without exponential moments are so once their rarest
noise is given up. Nothing of ``Law`` but its numbers is used.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import stdtr, stdtrit

from ...envs.agents import Law, laws_by_author
from ..masses import state

OUTWARD = 1.0 + 1e-12
"""Factor on deviations, far above what they are rounded by."""

ORDERS = 40
"""Half the orders up to which moments of a law without its rarest noise are compared one by one."""

TAILS_OFF = 1e-12
"""What tails of Student's law are off by, far above what was found in comparisons with fifty digits."""

ROUNDED = 1e-12
"""What means may be off by, as a share of the size of the law: some units in the last place, or an exponential."""


CUT = 1e-7
"""Probability, about, of the noise of a component that is given up at each step where its tails are heavy."""

POINTS, WEIGHTS = np.polynomial.legendre.leggauss(16)
"""Of Gauss's rule on [-1, 1]."""

NORMAL, LIGHT, LONG = range(3)
"""What is known of tails: those of the normal law, those with its exponential moments, those with Laplace's."""


@dataclass(frozen=True)
class Moments:
    """Mean of a law, what it may be off by, and an upper bound on the deviation of a law above it, of some tail.

    Noise beyond ``cut`` is given up: it has at most the probability ``lost``.
    """

    mean: float
    off: float
    deviation: float
    tail: int = LIGHT
    cut: float = math.inf
    lost: float = 0.0


def moments_of(law: Law) -> Moments | None:
    """Return the moments of a law; None where no law is known to be above it."""
    # Of laws of others there are no formulas; a frozen one of scipy may be in no file.
    found = None if laws_by_author([law]) else _of(law.to_dict())
    if found is not None:
        state("moments", law, found)
    return found


def _of(data: dict[str, Any]) -> Moments | None:
    match data["law"]:
        case "gaussian":
            return Moments(0.0, 0.0, float(data["std"]), NORMAL)
        case "uniform":
            # sinh(x) / x <= exp(x^2 / 6), term by term.
            low, high = float(data["low"]), float(data["high"])
            return _within(low, high, 0.5 * low + 0.5 * high, 0.5 * (high - low) / math.sqrt(3.0))
        case "triangular":
            low, mode, high = (float(data[key]) for key in ("low", "mode", "high"))
            half = 0.5 * (high - low)
            # The sum of two uniform numbers; Hoeffding's lemma where it is uneven.
            is_even = mode - low == high - mode
            return _within(low, high, (low + mode + high) / 3.0, half / math.sqrt(6.0) if is_even else half)
        case "truncated-gaussian":
            spread, low, high = (float(data[key]) for key in ("spread", "low", "high"))
            half = 0.5 * (high - low)
            if low == -high:
                return Moments(0.0, 0.0, min(spread, half) * OUTWARD)
            return _within(low, high, _cut_mean(spread, low, high), half)
        case "laplace":
            return Moments(0.0, 0.0, math.sqrt(2.0) * float(data["scale"]) * OUTWARD, LONG)
        case "logistic":
            # The product of 1 / (1 - a^2 s^2 / k^2) over all k is below that of Laplace's law with its variance.
            return Moments(0.0, 0.0, math.pi / math.sqrt(3.0) * float(data["scale"]) * OUTWARD, LONG)
        case "student-t":
            return _without_rarest(float(data["scale"]), float(data["df"]))
        case "mixture":
            return _mixed(data["parts"])
    return None


def _without_rarest(scale: float, df: float) -> Moments | None:
    """Return the moments of Student's law where noise is at most so large that more is rare.

    Such noise is even, of at most the variance of the law: its moments of order 2 j are at most
    ``std^2 cut^(2 j - 2)``, those of Laplace's law are ``(2 j)! (s^2 / 2)^j``.
    """
    if not df > 2.0:
        return None
    cut = -scale * float(stdtrit(df, 0.5 * CUT))
    lost = 2.0 * (float(stdtr(df, -cut / scale)) * (1.0 + TAILS_OFF) + TAILS_OFF)
    square, most = scale * scale * df / (df - 2.0), 0.0
    for j in range(1, ORDERS + 1):
        share = square / (cut * cut) if j < ORDERS else 1.0  # which is above that of every further order
        most = max(most, (share / math.factorial(2 * j)) ** (1.0 / j))
    return Moments(0.0, 0.0, cut * math.sqrt(2.0 * most) * OUTWARD, LONG, cut, lost)


def _within(low: float, high: float, mean: float, deviation: float) -> Moments:
    return Moments(mean, ROUNDED * (abs(low) + abs(high)), deviation * OUTWARD)


def _cut_mean(spread: float, low: float, high: float) -> float:
    """Return the mean of a normal law of mean 0 given that it lies in an interval, by a difference of densities."""
    a, b = low / spread, high / spread
    middle, half = 0.5 * (a + b), 0.5 * (b - a)
    if half * (abs(middle) + half) < 1.0:
        # Densities at both ends have lost the digits of their difference. The density about the middle changes by a
        # factor of 5 at most, and sixteen points are as good as doubles.
        density = np.exp(-half * POINTS * (middle + 0.5 * half * POINTS)) * WEIGHTS
        return spread * (middle + half * float(density @ POINTS) / float(density.sum()))
    root = math.sqrt(2.0)
    share = (
        0.5 * (math.erfc(-b / root) - math.erfc(-a / root))
        if a <= 0.0
        else 0.5 * (math.erfc(a / root) - math.erfc(b / root))
    )
    return spread * (math.exp(-0.5 * a * a) - math.exp(-0.5 * b * b)) / (math.sqrt(2.0 * math.pi) * share)


def _mixed(parts: list[dict[str, Any]]) -> Moments | None:
    """Return the moments of a mixture: the part is a number in a bounded range, drawn first (Hoeffding's lemma)."""
    found = [_of({key: value for key, value in part.items() if key not in ("weight", "mean")}) for part in parts]
    means, mean, off, widest, size, tail = list[float](), 0.0, 0.0, 0.0, 0.0, LIGHT
    total = sum(float(part["weight"]) for part in parts)
    for part, own in zip(parts, found, strict=True):
        if own is None or own.lost:
            return None
        tail = max(tail, own.tail)
        means.append(float(part["mean"]) + own.mean)
        mean += float(part["weight"]) / total * means[-1]
        off, widest, size = max(off, own.off), max(widest, own.deviation), max(size, abs(means[-1]))
    half = 0.5 * (max(means) - min(means)) + off
    return Moments(mean, off + ROUNDED * size, math.hypot(half, widest) * OUTWARD, tail)
