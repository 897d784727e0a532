"""Interval arithmetic on arrays, rounded outward: what an operation can give on all points of intervals.

An interval is a pair of arrays, lower and upper ends. Ends that are not numbers say that nothing is known: the
operation is not defined on the whole interval (the logarithm of an interval with 0), or its result is not bounded.

Written by hand: interval packages for Python (`pyinterval`, `mpmath.iv`, python-flint's balls) compute one number at a
time, a thousand times slower than arrays, and cells are counted in hundreds of thousands. The check has another
interval arithmetic of its own (`synthesis.checker.intervals`), and tests compare both with 50 digits.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .expression_tree import LARGEST_POWER

FloatArray = NDArray[Any]
Interval = tuple[FloatArray, FloatArray]

RELATIVE = 2.0**-50
"""Outward rounding of sums, products, quotients and roots: four units in the last place, where half a unit would do.

The check rounds outward by less, so that the boxes of the search hold those of the check.
"""

FUNCTION_RELATIVE = 2.0**-46
"""Outward rounding of elementary functions; numpy's are off by less than 2^-50."""

TINY = 1e-300
"""Outward rounding where numbers are so small that they lose digits."""

LARGE_ANGLE = 1e6
"""Angles beyond are not reduced: their sine is anything in [-1, 1]."""

NEAR_TURN = 1e-9
"""Share of a turn within which an interval counts as touching a turning point of sine and cosine."""


def outward(low: FloatArray, high: FloatArray, relative: float = RELATIVE) -> Interval:
    """Return an interval widened by the rounding of its ends."""
    # The builtin `abs` is numpy's on arrays, and much quicker on single numbers.
    return low - (abs(low) * relative + TINY), high + (abs(high) * relative + TINY)


def add(a: Interval, b: Interval) -> Interval:
    """Return all sums."""
    low, high = outward(a[0] + b[0], a[1] + b[1])
    return _not_below_zero(low, a, b), high


def subtract(a: Interval, b: Interval) -> Interval:
    """Return all differences."""
    return outward(a[0] - b[1], a[1] - b[0])


def multiply(a: Interval, b: Interval) -> Interval:
    """Return all products: their extremes are products of ends."""
    # A single number has one end, as factors of derivatives often are.
    ends = [x * y for x in (a[:1] if a[0] is a[1] else a) for y in b]
    low, high = np.minimum(ends[0], ends[1]), np.maximum(ends[0], ends[1])
    for end in ends[2:]:
        low, high = np.minimum(low, end), np.maximum(high, end)
    low, high = outward(low, high)
    return _not_below_zero(low, a, b), high


def _not_below_zero(low: FloatArray, a: Interval, b: Interval) -> FloatArray:
    """Return a lower end that rounding does not move below 0 where both operands are nonnegative: roots are taken."""
    return np.where((a[0] >= 0.0) & (b[0] >= 0.0), np.maximum(low, 0.0), low)


def divide(a: Interval, b: Interval) -> Interval:
    """Return all quotients; unknown where the denominator can be 0."""
    known = (b[0] > 0.0) | (b[1] < 0.0)
    low, high = outward(1.0 / np.where(known, b[1], np.nan), 1.0 / np.where(known, b[0], np.nan))
    return multiply(a, (low, high))


def negative(a: Interval) -> Interval:
    """Return all negatives (exact)."""
    return -a[1], -a[0]


def absolute(a: Interval) -> Interval:
    """Return all absolute values (exact)."""
    low = np.maximum(np.maximum(a[0], -a[1]), 0.0)
    return low, np.maximum(-a[0], a[1])


def minimum(a: Interval, b: Interval) -> Interval:
    """Return all smaller ones of two numbers (exact)."""
    return np.minimum(a[0], b[0]), np.minimum(a[1], b[1])


def maximum(a: Interval, b: Interval) -> Interval:
    """Return all larger ones of two numbers (exact)."""
    return np.maximum(a[0], b[0]), np.maximum(a[1], b[1])


def power(a: Interval, exponent: int) -> Interval:
    """Return all whole powers."""
    if exponent < 0:
        one = np.ones_like(a[0])
        return divide((one, one), power(a, -exponent))
    if exponent == 0:
        return np.ones_like(a[0]), np.ones_like(a[1])
    # Powers of |a| rise; an odd one has the sign of its base.
    ends = [np.abs(a[0]) ** exponent, np.abs(a[1]) ** exponent]
    relative = (LARGEST_POWER + 2) * RELATIVE
    if exponent % 2:
        return outward(np.copysign(ends[0], a[0]), np.copysign(ends[1], a[1]), relative)
    low = np.where((a[0] <= 0.0) & (a[1] >= 0.0), 0.0, np.minimum(*ends))
    low, high = outward(low + 0.0 * a[0], np.maximum(*ends), relative)
    return np.maximum(low, 0.0), high


def real_power(a: Interval, b: Interval) -> Interval:
    """Return all real powers of positive bases, `exp(b log a)`; unknown where the base can be 0 or negative."""
    return exp(multiply(b, log(a)))


def constant_power(a: Interval, exponent: float) -> Interval:
    """Return all powers with one exponent that is no whole number; unknown where the base can be negative."""
    if exponent < 0.0:
        one = np.ones_like(a[0])
        return divide((one, one), constant_power(a, -exponent))
    low = np.where(a[0] >= 0.0, a[0], np.nan)
    low, high = outward(low**exponent, a[1] ** exponent + 0.0 * low, FUNCTION_RELATIVE)
    return np.maximum(low, 0.0), high


def increasing(function: Callable[[FloatArray], FloatArray], a: Interval) -> Interval:
    """Return all values of an increasing elementary function."""
    return outward(function(a[0]), function(a[1]), FUNCTION_RELATIVE)


def exp(a: Interval) -> Interval:
    """Return all values of the exponential function."""
    low, high = increasing(np.exp, a)
    return np.maximum(low, 0.0), high


def log(a: Interval) -> Interval:
    """Return all logarithms; unknown where the argument can be 0 or negative."""
    low = np.where(a[0] > 0.0, a[0], np.nan)
    # Near 1 the logarithm is about the distance to 1, which is known as well as the argument.
    return outward(np.log(low), np.log(a[1]) + 0.0 * low, FUNCTION_RELATIVE)


def sqrt(a: Interval) -> Interval:
    """Return all square roots; unknown where the argument can be negative."""
    low = np.where(a[0] >= 0.0, a[0], np.nan)
    low, high = outward(np.sqrt(low), np.sqrt(a[1]) + 0.0 * low)
    return np.maximum(low, 0.0), high


def atan(a: Interval) -> Interval:
    """Return all inverse tangents."""
    return increasing(np.arctan, a)


def tanh(a: Interval) -> Interval:
    """Return all hyperbolic tangents."""
    low, high = increasing(np.tanh, a)
    return np.maximum(low, -1.0), np.minimum(high, 1.0)


def sin(a: Interval) -> Interval:
    """Return all sines."""
    return _wave(np.sin, a, 0.25)


def cos(a: Interval) -> Interval:
    """Return all cosines."""
    return _wave(np.cos, a, 0.0)


def tan(a: Interval) -> Interval:
    """Return all tangents; unknown where the argument can be at a pole."""
    turns = a[0] / np.pi - 0.5, a[1] / np.pi - 0.5
    known = np.ceil(turns[0] - NEAR_TURN) > turns[1] + NEAR_TURN
    known &= np.maximum(np.abs(a[0]), np.abs(a[1])) < LARGE_ANGLE
    low, high = (np.tan(np.where(known, end, np.nan)) for end in a)
    return outward(low, high, FUNCTION_RELATIVE)


def _wave(function: Callable[[FloatArray], FloatArray], a: Interval, top: float) -> Interval:
    """Return all values of sine or cosine, which is 1 where the angle is ``top`` turns and -1 half a turn later."""
    turns = a[0] / (2.0 * np.pi), a[1] / (2.0 * np.pi)
    ends = function(a[0]), function(a[1])
    low, high = np.minimum(*ends) - FUNCTION_RELATIVE, np.maximum(*ends) + FUNCTION_RELATIVE
    for place, extreme in ((top, 1.0), (top + 0.5, -1.0)):
        # A turning point lies inside if a whole number lies between the ends, counted from it.
        touched = np.ceil(turns[0] - place - NEAR_TURN) <= turns[1] - place + NEAR_TURN
        low, high = np.where(touched & (extreme < 0), -1.0, low), np.where(touched & (extreme > 0), 1.0, high)
    large = np.maximum(np.abs(a[0]), np.abs(a[1])) >= LARGE_ANGLE
    unknown = np.isnan(a[0] + a[1])
    low, high = np.where(large, -1.0, np.maximum(low, -1.0)), np.where(large, 1.0, np.minimum(high, 1.0))
    return np.where(unknown, np.nan, low), np.where(unknown, np.nan, high)
