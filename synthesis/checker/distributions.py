"""Noise: distributions with exponential moments above those of the noise, and tables of normal noise on cells.

A number e of mean m is *sub-Gaussian* with the deviation s if ``E exp(a (e - m)) <= exp(a^2 s^2 / 2)`` for every a, and
*sub-exponential* if ``E exp(a (e - m)) <= 1 / (1 - a^2 s^2 / 2)`` where a^2 s^2 < 2. Such bounds multiply over steps,
also where the size of the noise depends on the past. So a linear form with the variance V of these deviations exceeds d
with a probability of at most ``exp(-d^2 / (2 V))``, or ``((1 + r)/2 exp(1 - r))^(V/v)``, r^2 = 1 + 2 v d^2 / V^2, where
no step adds more than v to V (Chernoff). Which s a distribution has, and why: docs/theory/paths.md, "Noise of other
laws". What Student's distribution gives up rests on ``scipy.special``; nothing else here does.

For a mean y on a lattice, noise w with the deviation s, and cells [a, b) of an axis, with u = (a - y)/s, v = (b - y)/s:

    P(y + w in [a, b)) = Phi(v) - Phi(u),
    E (y + w - a) / (b - a) on it = (phi(u) - phi(v) - u (Phi(v) - Phi(u))) / (v - u).

The second number is the mean of the *hat* that rises from a to b; the other hat has the rest of the first. A function
that is linear on cells is a sum of hats, so its mean is a sum of these numbers.

**Theorem** (``normal_table``). Each entry is at most the true number, and a row lacks at most ``lack`` in all.
"""

from __future__ import annotations

import importlib
import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from . import rigorous
from .fields import Entry, Refused, Unreadable
from .intervals import add, interval, mul, neg
from .rigorous import Array, Truth, U

# What is known of tails, the heavier ones last: normal; normal, of a size that depends on the past; sub-Gaussian;
# sub-exponential. A sum of several kinds is of the last one of them.
NORMAL, STOPPED, LIGHT, LONG = range(4)
OUTWARD = 1.0 + 1e-12  # factor on deviations: more than some square roots and products are rounded by
ROUNDED = 1e-12  # share of the size of a distribution by which its mean may be off as it is computed
# Probability, about, of a component's noise that is given up in a step; what a tail of ``scipy`` may be off by.
GIVEN_UP, TAILS_OFF = 1e-7, 1e-12
LOGISTIC = math.pi / math.sqrt(3.0)  # deviation of the logistic distribution of scale 1
ORDERS = 40  # half the orders up to which moments are compared one by one; from there on (S/b^2)^(1/j) counts as 1
# Beyond ten deviations a tail is between 0 and 1e-23, and a density between 0 and 1e-21.
FAR, FAR_TAIL, FAR_DENSITY = 10.0, 1e-23, 1e-21
AT_ONCE = 2**20  # entries of a table that are formed at once


@dataclass(frozen=True)
class Envelope:
    """Mean, what it may be off by, deviation and tail of what is above a distribution, and what is given up."""

    mean: float
    off: float
    deviation: float
    tail: int
    lost: float = 0.0


def read_distribution(entry: Entry, more: tuple[str, ...] = ()) -> Envelope:
    """Return the envelope of a distribution in the header of a file; ``more`` are keys that its table has besides."""
    named = entry.entries_by_name().get("law")
    if named is None:
        raise entry.wrong("`law` is missing")
    # Tables have the keys of their distribution and no other.
    keys, make = LAWS[named.one_of([*LAWS])]
    own = entry.table(("law", *keys, *more))
    return _mixture(own["parts"]) if make is None else make(*(own[key].number() for key in keys))


def _positive(value: float, name: str, least: float = 5e-324) -> float:
    if not value >= least:
        raise Unreadable(f"a distribution has {name} = {value}, which is not above 0")
    return value


def _bounded(low: float, high: float, mean: float, deviation: float) -> Envelope:
    if not low < high:
        raise Unreadable(f"a distribution lies between {low} and {high}")
    return Envelope(mean, ROUNDED * (abs(low) + abs(high)), deviation * OUTWARD, LIGHT)


def _triangular(low: float, mode: float, high: float) -> Envelope:
    if not low <= mode <= high:
        raise Unreadable(f"a triangular distribution has its mode {mode} outside [{low}, {high}]")
    half = 0.5 * (high - low)
    even = mode - low == high - mode
    return _bounded(low, high, (low + mode + high) / 3.0, half / math.sqrt(6.0) if even else half)


def _cut_normal(spread: float, low: float, high: float) -> Envelope:
    if low == -high:
        return Envelope(0.0, 0.0, min(_positive(spread, "spread"), _positive(high, "high")) * OUTWARD, LIGHT)
    half, found = 0.5 * (high - low), _bounded(low, high, 0.0, 0.5 * (high - low))
    # Means of both hats of the interval share its mass as the mean divides it.
    table, lack = normal_table(np.zeros(1), np.array([low, high]), _positive(spread, "spread"), hats=True)
    fall, rise = table[0]
    least, most = (share / (fall + rise + lack) for share in (rise, rise + lack))
    off = float(found.off + half * (most - least) * OUTWARD)
    return replace(found, mean=float(low + half * (least + most)), off=off)


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


def _mixture(entry: Entry) -> Envelope:
    """Return the envelope of a mixture: the mean of its part is a number in a bounded range, drawn first."""
    parts = [read_distribution(own, ("weight", "mean")) for own in entry.entries()]
    if not parts or any(part.lost for part in parts):
        raise entry.wrong("a mixture has no parts, or one of Student's distribution")
    tables = [own.entries_by_name() for own in entry.entries()]
    weights = [_positive(own["weight"].number(), "weight") for own in tables]
    means = [own["mean"].number() + part.mean for own, part in zip(tables, parts, strict=True)]
    mean = sum(weight / sum(weights) * own for weight, own in zip(weights, means, strict=True))
    # half the range of means, and what each part deviates from its own
    off = max(part.off for part in parts)
    half = 0.5 * (max(means) - min(means)) + off
    deviation = math.hypot(half, max(part.deviation for part in parts)) * OUTWARD
    tail = max(LIGHT, *(part.tail for part in parts))
    return Envelope(mean, off + ROUNDED * max(map(abs, means)), deviation, tail)


LAWS: dict[str, tuple[tuple[str, ...], Callable[..., Envelope] | None]] = {
    "gaussian": (("std",), lambda std: Envelope(0.0, 0.0, _positive(std, "std", 0.0), NORMAL)),
    "uniform": (("low", "high"), lambda a, b: _bounded(a, b, 0.5 * a + 0.5 * b, 0.5 * (b - a) / math.sqrt(3.0))),
    "triangular": (("low", "mode", "high"), _triangular),
    "truncated-gaussian": (("spread", "low", "high"), _cut_normal),
    "laplace": (("scale",), lambda b: Envelope(0.0, 0.0, _positive(b, "scale") * math.sqrt(2.0) * OUTWARD, LONG)),
    "logistic": (("scale",), lambda s: Envelope(0.0, 0.0, _positive(s, "scale") * LOGISTIC * OUTWARD, LONG)),
    "student-t": (("scale", "df"), _student),
    "mixture": (("parts",), None),
}
"""Distributions by their names: the keys of their tables, and their envelopes (a mixture is made of others)."""


def normal_table(points: Array, edges: Array, deviation: float | Array, hats: bool) -> tuple[Array, float]:
    """Return probabilities (Z, S) of cells, or means (Z, 2 S) of their hats, and what a row lacks at most."""
    if not (np.all(np.greater(deviation, 0) & np.less(deviation, np.inf)) and np.all(np.diff(edges) > 0)):
        raise Refused("cells need noise along every axis, and edges that increase")
    # Rows do not depend on each other, and dozens of numbers stand beside each entry while it is formed.
    if (count := min(len(points), len(points) * len(edges) // AT_ONCE + 1)) > 1:
        parts = [normal_table(part, edges, deviation, hats) for part in np.array_split(points, count)]
        return np.concatenate([table for table, _ in parts]), float(np.max([lack for _, lack in parts]))
    # Faces of cells as seen from the lattice points, in deviations.
    x = (edges - points[:, None]) / deviation
    near = np.abs(x) < FAR
    tail = np.zeros((2, *x.shape))
    tail[1] = FAR_TAIL
    low, high = rigorous.tail(np.abs(x[near]))
    # x is rounded twice, by 2 U of itself, which moves a tail by at most 2 U x phi(x) < U / 2
    tail[0][near], tail[1][near] = np.maximum(low - U, 0.0), high + U
    # Tails on either side; that of the far side is 1 less the near one.
    complement = add(interval(np.ones(x.shape)), neg(tail))
    right, left = np.where(x >= 0, tail, complement), np.where(x <= 0, tail, complement)
    # the difference of the smaller tails: of those to the right where the cell lies on the right
    on_right = x[:, :-1] + x[:, 1:] > 0
    from_right, from_left = add(right[..., :-1], neg(right[..., 1:])), add(left[..., 1:], neg(left[..., :-1]))
    mass = np.maximum(np.where(on_right, from_right, from_left), 0.0)
    if hats:
        mass = _hats(x, near, mass, np.diff(edges) / deviation)
    return mass[0], float(np.max(np.sum(mass[1] - mass[0], axis=1))) * 1.001


def _hats(x: Array, near: Truth, mass: Array, width: Array) -> Array:
    """Return ends (2, Z, 2 S) of the means of both hats of every cell."""
    density = np.zeros((2, *x.shape))
    density[1] = FAR_DENSITY
    density[:, near] = rigorous.density_at(x[near], 4.0)  # x is off by 2 U of itself
    # E (y + w - a)^+ on the cell, in deviations, divided by its width.
    a = x[:, :-1]
    first = add(density[..., :-1], neg(density[..., 1:]))
    first = add(first, neg(mul(np.stack([a - 4 * U * np.abs(a), a + 4 * U * np.abs(a)]), mass)))
    rising = np.clip(np.stack([first[0] / (width * (1 + 8 * U)), first[1] / (width * (1 - 8 * U))]), 0.0, None)
    falling = np.clip(add(mass, neg(rising)), 0.0, None)
    return np.stack([falling, rising], axis=-1).reshape(2, len(x), -1)
