"""Noise that is not normal, along trajectories: distributions whose exponential moments are above those of the noise.

A number e of mean m is *sub-Gaussian* with the deviation s if ``E exp(a (e - m)) <= exp(a^2 s^2 / 2)`` for every a, and
*sub-exponential* if ``E exp(a (e - m)) <= 1 / (1 - a^2 s^2 / 2)`` where a^2 s^2 < 2. Such bounds multiply over steps,
also where the size of the noise depends on the past. So a linear form with the variance V of these deviations exceeds d
with a probability of at most ``exp(-d^2 / (2 V))``, or ``((1 + r)/2 exp(1 - r))^(V/v)``, r^2 = 1 + 2 v d^2 / V^2, where
no step adds more than v to V (Chernoff; docs/theory/paths.md, "Noise of other laws").

| distribution | s | because |
|---|---|---|
| uniform, half width h | h / sqrt 3 | sinh(x)/x <= exp(x^2/6), term by term |
| even triangle, half width h | h / sqrt 6 | the sum of two uniform numbers |
| normal, cut to +-b | the smaller of its deviation and b | the cut is largest around 0; Hoeffding |
| on an interval of half width h | h | Hoeffding's lemma |
| mixture | sqrt(r^2 + max s_k^2), r half the range of means | the part is drawn first |
| Laplace, logistic | their deviation (sub-exponential) | their moments, factor by factor |
| Student, given up beyond b | b sqrt(2 max_j ((S/b^2)^(1/j) / (2j)!^(1/j))) | even moments, S the variance |

What Student's distribution gives up rests on ``scipy.special``; nothing else here does.
"""

from __future__ import annotations

import importlib
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from . import fields
from .fields import Unreadable
from .tables import normal_table

NORMAL, STOPPED, LIGHT, LONG = range(4)
"""What is known of tails, the heavier ones last: normal; normal, of a size that depends on the past; sub-Gaussian;
sub-exponential. A sum of several kinds is of the last one of them."""

OUTWARD = 1.0 + 1e-12
"""Factor on deviations: more than some square roots and products are rounded by."""

ROUNDED = 1e-12
"""Share of the size of a distribution by which its mean may be off as it is computed."""

GIVEN_UP, TAILS_OFF = 1e-7, 1e-12
"""Probability, about, of a component's noise that is given up in a step; what a tail of ``scipy`` may be off by."""

ORDERS = 40
"""Half the orders up to which moments are compared one by one; from there on (S/b^2)^(1/j) counts as 1."""


@dataclass(frozen=True)
class Envelope:
    """Mean, what it may be off by, deviation and tail of what is above a distribution, and what is given up."""

    mean: float
    off: float
    deviation: float
    tail: int
    lost: float = 0.0


def read_distribution(value: Any, place: str) -> Envelope:
    """Return the envelope of a distribution in the header of a file."""
    if not isinstance(value, dict) or not isinstance(value.get("law"), str) or value["law"] not in LAWS:
        raise fields.expected(f"{place}.law", f"one of {', '.join(LAWS)}", value)
    # Tables have the keys of their distribution and no other.
    keys, make = LAWS[value["law"]]
    own = fields.table(value, place, ("law", *keys))
    if value["law"] == "mixture":
        return _mixture(own["parts"], f"{place}.parts")
    return make(*(fields.number(own[key], f"{place}.{key}") for key in keys))


def _positive(value: float, name: str) -> float:
    if not value > 0.0:
        raise Unreadable(f"a distribution has {name} = {value}, which is not above 0")
    return value


def _bounded(low: float, high: float, mean: float, deviation: float) -> Envelope:
    if not low < high:
        raise Unreadable(f"a distribution lies between {low} and {high}")
    return Envelope(mean, ROUNDED * (abs(low) + abs(high)), deviation * OUTWARD, LIGHT)


def _normal(std: float) -> Envelope:
    if not std >= 0.0:
        raise Unreadable(f"a normal distribution has the deviation {std}")
    return Envelope(0.0, 0.0, std, NORMAL)


def _uniform(low: float, high: float) -> Envelope:
    return _bounded(low, high, 0.5 * low + 0.5 * high, 0.5 * (high - low) / math.sqrt(3.0))


def _triangular(low: float, mode: float, high: float) -> Envelope:
    if not low <= mode <= high:
        raise Unreadable(f"a triangular distribution has its mode {mode} outside [{low}, {high}]")
    half = 0.5 * (high - low)
    even = mode - low == high - mode
    return _bounded(low, high, (low + mode + high) / 3.0, half / math.sqrt(6.0) if even else half)


def _cut_normal(spread: float, low: float, high: float) -> Envelope:
    half = 0.5 * (high - low)
    if low == -high:
        return Envelope(0.0, 0.0, min(_positive(spread, "spread"), _positive(high, "high")) * OUTWARD, LIGHT)
    if not low < high:
        raise Unreadable(f"a distribution lies between {low} and {high}")
    # Means of both hats of the interval share its mass as the mean divides it (``tables``).
    table, lack = normal_table(np.zeros(1), np.array([low, high]), _positive(spread, "spread"), hats=True)
    fall, rise = table[0]
    least, most = (share / (fall + rise + lack) for share in (rise, rise + lack))
    found = _bounded(low, high, float(low + half * (least + most)), half)
    return replace(found, off=float(found.off + half * (most - least) * OUTWARD))


def _laplace(scale: float) -> Envelope:
    return Envelope(0.0, 0.0, math.sqrt(2.0) * _positive(scale, "scale") * OUTWARD, LONG)


def _logistic(scale: float) -> Envelope:
    return Envelope(0.0, 0.0, math.pi / math.sqrt(3.0) * _positive(scale, "scale") * OUTWARD, LONG)


def _student(scale: float, df: float) -> Envelope:
    if not df > 2.0:
        raise Unreadable(f"Student's distribution with {df} degrees of freedom has no variance")
    special = importlib.import_module("scipy.special")
    # Noise beyond the cut is given up: its probability is charged as a failure.
    cut = -_positive(scale, "scale") * float(special.stdtrit(df, 0.5 * GIVEN_UP))
    lost = 2.0 * (float(special.stdtr(df, -cut / scale)) * (1.0 + TAILS_OFF) + TAILS_OFF)
    square, most = scale * scale * df / (df - 2.0), 0.0
    for j in range(1, ORDERS + 1):
        share = square / (cut * cut) if j < ORDERS else 1.0
        most = max(most, (share / math.factorial(2 * j)) ** (1.0 / j))
    return Envelope(0.0, 0.0, cut * math.sqrt(2.0 * most) * OUTWARD, LONG, lost)


def _mixture(value: Any, place: str) -> Envelope:
    """Return the envelope of a mixture: the mean of its part is a number in a bounded range, drawn first."""

    def part(own: Any, at: str) -> tuple[float, float, Envelope]:
        if not isinstance(own, dict) or not {"weight", "mean"} <= own.keys():
            raise fields.expected(at, "a distribution with `weight` and `mean`", own)
        rest = {key: entry for key, entry in own.items() if key not in ("weight", "mean")}
        weight = _positive(fields.number(own["weight"], f"{at}.weight"), "weight")
        return weight, fields.number(own["mean"], f"{at}.mean"), read_distribution(rest, at)

    parts = fields.each(value, place, part)
    if not parts or any(own.lost for _, _, own in parts):
        raise Unreadable(f"{place}: a mixture has no parts, or one of Student's distribution")
    means = [mean + own.mean for _, mean, own in parts]
    total = sum(weight for weight, _, _ in parts)
    mean = sum(weight / total * own for (weight, _, _), own in zip(parts, means, strict=True))
    off = max(own.off for _, _, own in parts)
    half = 0.5 * (max(means) - min(means)) + off
    deviation = math.hypot(half, max(own.deviation for _, _, own in parts)) * OUTWARD
    tail = max(LIGHT, *(own.tail for _, _, own in parts))
    return Envelope(mean, off + ROUNDED * max(map(abs, means)), deviation, tail)


LAWS: dict[str, tuple[tuple[str, ...], Callable[..., Envelope]]] = {
    "gaussian": (("std",), _normal),
    "uniform": (("low", "high"), _uniform),
    "triangular": (("low", "mode", "high"), _triangular),
    "truncated-gaussian": (("spread", "low", "high"), _cut_normal),
    "laplace": (("scale",), _laplace),
    "logistic": (("scale",), _logistic),
    "student-t": (("scale", "df"), _student),
    "mixture": (("parts",), _normal),
}
"""Distributions by their names: the keys of their tables, and their envelopes (mixtures have their own)."""
