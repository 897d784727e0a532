"""Elementary functions and the tail of the normal distribution, each enclosed between two doubles.

**Theorem.** For every double x each function here returns ``(low, high)`` with ``low <= f(x) <= high``; what is not a
number gives nan. Only ``+ - * / sqrt``, ``rint``, ``ldexp``, ``nextafter`` and comparisons are trusted, rounded to
nearest with gradual underflow; and that sums and products of matrices are off by no more than n roundings, in whatever
order a library adds. ``wrong_arithmetic`` notices a machine or a library that does otherwise.

*Proof.* U = 2^-53 is the relative error of one operation. Each function reduces its argument, sums a series with all
errors counted (``EXP_ERROR``, ``SIN_ERROR``), and widens the sum by that count; log and atan are guesses that the
function they invert proves on both sides. The tail of the normal distribution is a series of positive terms below
3/2, and beyond it lies between consecutive convergents of Laplace's continued fraction, so that the number of terms
decides how wide the enclosure is, and never whether it holds. Counts are compared with 300 bits in
``tests/checker``.

References: Higham, Accuracy and Stability of Numerical Algorithms (2002), 3.1; Cody and Waite (1980) for reductions;
Abramowitz and Stegun 26.2.14 for the continued fraction.
"""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Truth = NDArray[np.bool_]
Whole = NDArray[np.int64]
Ends = tuple[Array, Array]  # lower and upper ends, arrays of one shape
U = 2.0**-53  # largest relative error of one rounded operation
TINY = 2.0**-1060  # more than all underflow in a function can add: no operation here loses more than 2^-1074
# ln 2 in two parts; the first ends in 21 zeros, so that whole multiples up to 2^20 are exact.
LN2 = (0.693147180369123816490, 1.90821492927058770002e-10)
# pi / 2 in three parts, the first two with room for whole multiples up to 2^20.
HALF_PI = (1.57079632673412561417, 6.07710050630396597660e-11, 2.02226624879595063154e-21)
EXP_ERROR, SIN_ERROR = 32 * U, 24 * U  # counted errors of exp (relative) and of sin and cos (absolute)
LARGEST_ANGLE = 1e6  # angles beyond it are not reduced: sin and cos are between -1 and 1 there
PHI_0 = (0.39894228040143267, 0.39894228040143271)  # 1 / sqrt(2 pi), from below and from above


def _widened(value: Array, error: Any, low: float = -np.inf, high: float = np.inf) -> Ends:
    return np.maximum(value - error - TINY, low), np.minimum(value + error + TINY, high)


def exp(x: Array) -> Ends:
    """Return ends of e^x."""
    with np.errstate(all="ignore"):
        # x = k ln 2 + r with |r| <= .35: the first difference is exact, the second is off by less than U
        k = np.rint(np.clip(x, -1000.0, 1000.0) / LN2[0])
        r = (x - k * LN2[0]) - k * LN2[1]
        # Horner's scheme; r^17 / 17! is below U
        series = np.ones_like(r)
        for n in range(16, 0, -1):
            series = 1.0 + r * series / n
        value = np.ldexp(series, np.where(np.isnan(k), 0.0, k).astype(int))
        value = np.where(x < -1000.0, 0.0, np.where(x > 709.0, np.inf, value))
        # r is off by k times the rounding of the second part of ln 2
        return _widened(value, EXP_ERROR * (1.0 + 2.0**-9 * np.abs(k)) * value, 0.0)


def _quadrant(x: Array) -> tuple[NDArray[np.int64], Array, Array]:
    """Return k modulo 4, sin r and cos r where x = k pi/2 + r, off by ``SIN_ERROR`` at most."""
    k = np.rint(x / (HALF_PI[0] + HALF_PI[1]))
    # |r| <= .79; both differences round once, numbers below 1
    r = (x - k * HALF_PI[0]) - k * HALF_PI[1]
    r = r - k * HALF_PI[2]
    sine, cosine, square = np.ones_like(r), np.ones_like(r), r * r
    for n in range(11, 0, -1):
        sine = 1.0 - square * sine / ((2 * n) * (2 * n + 1))
        cosine = 1.0 - square * cosine / ((2 * n - 1) * (2 * n))
    return np.mod(k, 4).astype(np.int64), r * sine, cosine


def sin(x: Array, quarters: int = 0) -> Ends:
    """Return ends of sin(x + quarters pi/2)."""
    with np.errstate(all="ignore"):
        known = np.abs(x) < LARGEST_ANGLE  # false for nan
        k, sine, cosine = _quadrant(np.where(known, x, 0.0))
        value = np.choose((k + quarters) % 4, [sine, cosine, -sine, -cosine])
        low, high = _widened(value, SIN_ERROR, -1.0, 1.0)
        beyond = np.where(np.isnan(x), np.nan, 1.0)
        return np.where(known, low, -beyond), np.where(known, high, beyond)


def _proved_inverse(guess: Array, rising: Callable[[Array], Ends], x: Array, radius: Array) -> Ends:
    """Return ends of the y with rising(y) = x: a guess moved outward and proved on both sides, else nan."""
    low, high = guess - radius, guess + radius
    return np.where(rising(low)[1] <= x, low, np.nan), np.where(rising(high)[0] >= x, high, np.nan)


def log(x: Array) -> Ends:
    """Return ends of ln x; nan where x <= 0."""
    with np.errstate(all="ignore"):
        guess = np.log(x)
        return _proved_inverse(guess, exp, x, 2.0**-44 * (np.abs(guess) + 1.0))


def _tan(y: Array) -> Ends:
    """Return ends of tan y for |y| < pi/2."""
    sine, cosine = sin(y), sin(y, 1)
    quotients = np.stack([s / c for s in sine for c in cosine])
    error = 4 * U * np.abs(quotients).max(axis=0)
    return quotients.min(axis=0) - error, quotients.max(axis=0) + error


def atan(x: Array) -> Ends:
    """Return ends of the arc tangent of x."""
    with np.errstate(all="ignore"):
        low, high = _proved_inverse(np.arctan(x), _tan, x, 2.0**-44 * (1.0 + 0 * x))
        # beyond 10^6 the arc tangent is within 10^-6 of a quarter turn: 1.5707 < pi/2 - 10^-6 < pi/2 < 1.5708
        near, sign = np.abs(x) < 1e6, np.where(np.isnan(x), np.nan, np.sign(x))
        return np.where(near, low, sign * 1.57075 - 5e-5), np.where(near, high, sign * 1.57075 + 5e-5)


def tanh(x: Array) -> Ends:
    """Return ends of tanh x."""
    with np.errstate(all="ignore"):
        # (e - 1) / (e + 1) rises with e = exp(2 x); three operations on numbers of at most 1 in size
        low, high = exp(2.0 * np.clip(x, -300.0, 300.0))
        return (np.maximum((low - 1) / (low + 1) - 4 * U, -1.0), np.minimum((high - 1) / (high + 1) + 4 * U, 1.0))


def density_at(z: Array, off: float) -> Ends:
    """Return ends of the density of a standard normal number at z, whose square is off by ``off`` U of itself."""
    square = z * z
    # rounded once more here, so that its exponential is off by less than (1 + off) U z^2 of itself
    (low, high), spare = exp(-0.5 * square), ((1.0 + off) * square + 8.0) * U
    return np.maximum(low * (1 - spare) * PHI_0[0], 0.0), high * (1 + spare) * PHI_0[1]


SERIES_END = 1.5  # below it the tail is 1/2 less a series of positive terms, of which 31 leave less than U
# From where to where, and how many terms of the continued fraction make both convergents agree to a few U.
FRACTIONS = ((SERIES_END, 3.0, 100), (3.0, 6.0, 40), (6.0, np.inf, 16))


def tail(z: Any) -> Ends:
    """Return ends of P(N > z) for z >= 0 and standard normal N; nan for what is not a number."""
    z = np.minimum(np.asarray(z, dtype=float), 1e3)  # beyond, the lower end is 0 and the upper one next to it
    with np.errstate(all="ignore"):
        density, ends = density_at(z, 0.0), np.full((2, *z.shape), np.nan)
        # P(N > z) = 1/2 - phi(z) sum of z^(2n+1) / (1 3 5 .. (2n+1))
        near = z < SERIES_END
        term = series = x = z[near]
        for n in range(1, 32):
            term = term * x * x / (2 * n + 1)
            series = series + term
        # positive terms: the sum is off by less than 130 U of itself, and what is left is less than the last term
        ends[0, near] = 0.5 - density[1][near] * series * (1 + 200 * U) - U
        ends[1, near] = 0.5 - density[0][near] * series * (1 - 200 * U) + U
        # phi(z) / (z + 1/(z + 2/(z + 3/..))), between two convergents in a row
        for first, last, count in FRACTIONS:
            at = (z >= first) & (z < last)
            convergents = _convergent(z[at], count), _convergent(z[at], count + 1)
            # errors are damped at each step; 16 U covers what is left of them, the product and the quotient
            ends[0, at] = density[0][at] * np.minimum(*convergents) * (1 - 16 * U)
            ends[1, at] = density[1][at] * np.maximum(*convergents) * (1 + 16 * U) + 2.0**-1000
        return np.maximum(ends[0], 0.0), ends[1]


def _convergent(x: Array, count: int) -> Array:
    fraction = x
    for n in range(count, 0, -1):
        fraction = x + n / fraction
    return 1.0 / fraction


QUOTIENTS = ((1.0, 3.0), (5e-324, 3.0), (1.0 + 2.0**-52, 1.0 - 2.0**-53), (2.0**1023, 1.0 + 2.0**-52))
ROOTS = (2.0, 1.0 - 2.0**-53, 1.0 + 2.0**-52, 5e-324, 1.7976931348623157e308)


def wrong_arithmetic() -> str:
    """Return what this machine computes in another way than the proofs assume; an empty text if nothing does."""
    one = np.array([1.0])
    if (one + 2.0**-53)[0] != 1.0 or (one + 1.5 * 2.0**-53)[0] != 1.0 + 2.0**-52:
        return "sums are not rounded to nearest"
    if (np.array([2.0**-1022]) * 0.5)[0] != 2.0**-1023 or np.nextafter(0.0, 1.0) != 5e-324:
        return "numbers below 2^-1022 are taken for 0"
    for a, b in QUOTIENTS:
        exact, got = Fraction(a) / Fraction(b), float((np.array([a]) / b)[0])
        near = float(np.nextafter(got, -np.inf)), float(np.nextafter(got, np.inf))
        if any(abs(exact - Fraction(got)) > abs(exact - Fraction(neighbour)) for neighbour in near):
            return f"the quotient {a!r} / {b!r} is not rounded to nearest"
    for a in ROOTS:
        root = float(np.sqrt(np.array([a]))[0])
        low, high = (Fraction(root) + Fraction(float(np.spacing(root))) * half / 2 for half in (-1, 1))
        if not low * low <= Fraction(a) <= high * high:
            return f"the root of {a!r} is not rounded to nearest"
    # Products of matrices against rational numbers.
    n = 48
    k = np.arange(n * n, dtype=float).reshape(n, n)
    left, right = np.sin(k) * 2.0 ** (k % 7), np.cos(k * 1.7)
    for product in (left @ right, np.matmul(left[None], right[None])[0], np.einsum("ij,jk->ik", left, right)):
        for i, j in ((0, 0), (n - 1, 3), (17, n - 1)):
            terms = [Fraction(x) * Fraction(y) for x, y in zip(left[i].tolist(), right[:, j].tolist())]
            if abs(sum(terms) - Fraction(float(product[i, j]))) > n * Fraction(U) * sum(map(abs, terms)):
                return "products of matrices are rounded by more than their number of terms explains"
    return ""
