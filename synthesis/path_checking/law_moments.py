"""Normal laws whose exponential moments are above those of noise of other laws, for checks: formulas of their own.

A law of mean m is *sub-Gaussian* with deviation s if ``E exp(a (e - m)) <= exp(a^2 s^2 / 2)`` for every a. Sums of
independent multiples of such noise are, with the variance of the sum, so that they exceed d with a probability of at
most ``exp(-d^2 / (2 V))`` (docs/theory/paths.md, "Noise of other laws"). Nothing of ``Law`` but its numbers is used.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from ...envs.agents import Law
from ..certificates import state

OUTWARD = 1.0 + 1e-12
"""Factor on deviations, far above what they are rounded by."""

ROUNDED = 1e-12
"""What means may be off by, as a share of the size of the law: some units in the last place, or an exponential."""


@dataclass(frozen=True)
class Moments:
    """Mean of a law, what it may be off by, and an upper bound on the deviation of a normal law above it."""

    mean: float
    off: float
    deviation: float


def moments_of(law: Law) -> Moments | None:
    """Return the moments of a law; None where no normal law is known to be above it."""
    # Laws of scipy are what they say; a frozen one may be in no file.
    found = None if law.name == "scipy" else _of(law.to_dict())
    if found is not None:
        state("moments", law, found.mean, found.off, found.deviation)
    return found


def _of(data: dict[str, Any]) -> Moments | None:
    match data["law"]:
        case "gaussian":
            return Moments(0.0, 0.0, float(data["std"]))
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
        case "mixture":
            return _mixed(data["parts"])
    return None


def _within(low: float, high: float, mean: float, deviation: float) -> Moments:
    return Moments(mean, ROUNDED * (abs(low) + abs(high)), deviation * OUTWARD)


def _cut_mean(spread: float, low: float, high: float) -> float:
    """Return the mean of a normal law of mean 0 given that it lies in an interval, by a difference of densities."""
    a, b = low / spread, high / spread
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
    means, mean, off, widest, size = list[float](), 0.0, 0.0, 0.0, 0.0
    total = sum(float(part["weight"]) for part in parts)
    for part, own in zip(parts, found, strict=True):
        if own is None:
            return None
        means.append(float(part["mean"]) + own.mean)
        mean += float(part["weight"]) / total * means[-1]
        off, widest, size = max(off, own.off), max(widest, own.deviation), max(size, abs(means[-1]))
    half = 0.5 * (max(means) - min(means)) + off
    return Moments(mean, off + ROUNDED * size, math.hypot(half, widest) * OUTWARD)
