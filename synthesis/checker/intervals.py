"""Interval arithmetic with outward rounding, on arrays whose first axis holds both ends.

**Theorem.** Let a, b be arrays (2, ..) with lower ends in ``a[0]`` and upper ends in ``a[1]``. For every x between the
ends of a and y between those of b, each operation returns ends around the result at (x, y). Where it is not defined for
all x and y both ends are nan: *nothing is known*, and nan passes through all that follows.

*Proof.* The ends of each result are among results at ends, or at inner extrema that are named, computed with one
rounding each and moved outward by one number. Sums of many numbers are moved by their counted rounding.

Reference: Moore, Kearfott, Cloud, Introduction to Interval Analysis (2009), chapters 2 and 4.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from . import rigorous
from .rigorous import LARGEST_ANGLE, Array, Ends, Truth, U


def interval(low: Any, high: Any = None) -> Array:
    """Return the array (2, ..) of these ends; with one argument, of points."""
    low = np.asarray(low, float)
    return np.array([low, low] if high is None else np.broadcast_arrays(low, np.asarray(high, float)))


def down(x: Any) -> Array:
    """Return the next smaller numbers."""
    return np.nextafter(x, -np.inf)


def up(x: Any) -> Array:
    """Return the next larger numbers."""
    return np.nextafter(x, np.inf)


def known(a: Array) -> Truth:
    """Return whether both ends are numbers; infinite ends are."""
    return np.asarray(~np.isnan(a).any(axis=0))


def _is(a: Array, value: float) -> Truth:
    return np.asarray((a[0] == value) & (a[1] == value))


def add(a: Array, b: Array) -> Array:
    """Return sums; what is exactly 0 adds nothing and rounds nothing."""
    low, high = a[0] + b[0], a[1] + b[1]
    exact = _is(a, 0.0) | _is(b, 0.0)
    return np.where(exact, np.array([low, high]), np.array([down(low), up(high)]))


def neg(a: Array) -> Array:
    """Return negatives (exact)."""
    return -a[::-1]


def mul(a: Array, b: Array) -> Array:
    """Return products; a factor that is exactly 0 gives 0, also with what is unbounded or not known.

    So a slope that is exactly 0 stays 0; whether a *value* is defined is asked apart (``jets.Jet``).
    """
    with np.errstate(invalid="ignore", over="ignore"):
        p, q, r, s = a[0] * b[0], a[0] * b[1], a[1] * b[0], a[1] * b[1]
    # the least and the largest product are among those of ends: a bilinear form has its extrema at corners
    least, most = np.minimum(np.minimum(p, q), np.minimum(r, s)), np.maximum(np.maximum(p, q), np.maximum(r, s))
    low, high = down(least), up(most)
    low = np.where((a[0] >= 0) & (b[0] >= 0), np.maximum(low, 0.0), low)
    one = _is(a, 1.0) | _is(b, 1.0)
    zero = _is(a, 0.0) | _is(b, 0.0)
    return np.where(zero, 0.0, np.where(one, np.array([least, most]), np.array([low, high])))


def total(a: Array, axis: int) -> Array:
    """Return sums along an axis of ``a`` (2, ..), counted without the ends' axis."""
    n, size = a.shape[axis + 1], np.abs(a).max(axis=0).sum(axis=axis)
    # n - 1 additions in any order: off by (n - 1) U of the sum of sizes to first order, and size is rounded, too
    error, empty = (n + 2) * U * size, size == 0
    low, high = a[0].sum(axis=axis), a[1].sum(axis=axis)
    return np.stack([np.where(empty, 0.0, down(low - error)), np.where(empty, 0.0, up(high + error))])


def recip(a: Array) -> Array:
    """Return reciprocals; nan where a holds 0."""
    apart = (a[0] > 0) | (a[1] < 0)
    with np.errstate(divide="ignore"):
        return np.stack([down(1.0 / np.where(apart, a[1], np.nan)), up(1.0 / np.where(apart, a[0], np.nan))])


def square(a: Array) -> Array:
    """Return squares."""
    size = np.abs(a)
    low = np.where((a[0] <= 0) & (a[1] >= 0), 0.0, np.maximum(down(size.min(axis=0) ** 2), 0.0))
    return np.stack([low + 0 * a[0], up(size.max(axis=0) ** 2)])


def root(a: Array) -> Array:
    """Return square roots; nan where a holds a negative number."""
    with np.errstate(invalid="ignore"):
        r = np.sqrt(np.where(a[0] >= 0, a, np.nan))
    return np.stack([np.maximum(down(r[0]), 0.0), up(r[1])])


def _rising(function: Callable[[Array], Ends]) -> Callable[[Array], Array]:
    """Return a rising function on intervals: the lower end of its lower end, the upper end of its upper one."""
    return lambda a: np.stack([function(a[0])[0], function(a[1])[1]])


exp, atan, tanh = _rising(rigorous.exp), _rising(rigorous.atan), _rising(rigorous.tanh)


def log(a: Array) -> Array:
    """Return natural logarithms; nan where a holds a number of at most 0."""
    return _rising(rigorous.log)(np.where(a[0] > 0, a, np.nan))


LARGEST_POWER = 32  # whole powers up to it are products, of any number; others are exp(p log x), of positive numbers


def power(a: Array, p: float) -> Array:
    """Return powers with a fixed exponent."""
    if p == int(p) and abs(p) <= LARGEST_POWER:
        if p < 0:  # of a number that may be 0 nothing is known
            return recip(power(a, -p))
        result = interval(np.ones_like(a[0]))
        for _ in range(int(p) // 2):
            result = mul(result, square(a))
        return mul(result, a) if int(p) % 2 else np.maximum(result, 0.0)
    return exp(mul(interval(np.full_like(a[0], p)), log(np.where(a[0] > 0, a, np.nan))))


# How near, in turns, an end may be to a top of the sine for the top to count as reached: more than turns are off by
# below 10^4; beyond, a top that is missed by rounding is less above the end than ``SIN_ERROR``.
NEAR_TOP = 1e-12


def sine(a: Array, quarters: int = 0) -> Array:
    """Return sin(x + quarters pi/2): between the values at its ends, and at tops and bottoms between them."""
    ends = np.stack([np.stack(rigorous.sin(end, quarters)) for end in a])  # (end of a, low and high, ..)
    low, high = ends[:, 0].min(axis=0), ends[:, 1].max(axis=0)
    turns = a / (2 * np.pi) + 0.25 * quarters
    top, bottom = (np.floor(turns[1] - place + NEAR_TOP) >= turns[0] - place - NEAR_TOP for place in (0.25, 0.75))
    # ends beyond the largest angle that is reduced have all values between -1 and 1 already
    low, high = np.where(bottom, -1.0, np.maximum(low, -1.0)), np.where(top, 1.0, np.minimum(high, 1.0))
    return np.where(known(a), np.stack([low, high]), np.nan)


def tangent(a: Array) -> Array:
    """Return tangents; nan where a pole lies between the ends."""
    halves = a / np.pi - 0.5
    between = (np.floor(halves[1] + NEAR_TOP) < halves[0] - NEAR_TOP) & (np.abs(a).max(axis=0) < LARGEST_ANGLE)
    low, high = (mul(sine(interval(end)), recip(sine(interval(end), 1))) for end in a)
    return np.where(between & known(a), np.stack([low[0], high[1]]), np.nan)
