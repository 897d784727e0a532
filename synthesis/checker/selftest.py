"""Whether this machine computes as the proofs assume: IEEE doubles, rounded to nearest, with gradual underflow.

The proofs trust ``+ - * / sqrt`` to be the double next to the true result, ``nextafter``, and sums and products of
matrices to be off by no more than n roundings, in whatever order a library adds. A processor that flushes small numbers
to zero, another rounding mode, or a library that multiplies matrices in single precision, is noticed here.
"""

from __future__ import annotations

from fractions import Fraction

import numpy as np

from .rigorous import U

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
