"""Ellipsoids in which the normal part of errors lies: narrower for many rows at once than a strip for each.

Let g be the form of the errors of one agent (``error_system``), W any matrix, and V the covariance of W g.

**Theorem.** ``P(|W g| > R) <= P(chi2_d > R^2 / v)``, where v is at least the largest eigenvalue of V. On the event
``|W g| <= R`` every row c satisfies ``|c g| <= R |a| + |c - a W| |g|``, for any a.

*Proof.* W g has the distribution of V^(1/2) z with z standard normal, no longer than sqrt(v) |z|. And
``c g = a W g + (c - a W) g``. QED Eigenvalues are bounded by absolute sums of rows (Gershgorin); W is about the inverse
of a root of the covariance of g, so that v is 1 up to rounding, and a is c times that root.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from . import rigorous
from .error_system import ErrorSystem
from .intervals import add, down, exp, interval, mul, recip, up
from .rigorous import Array, U


@dataclass(frozen=True, eq=False)
class Ellipsoid:
    """``|W g| <= radius`` for the states ``places`` of one agent; ``root`` is about the inverse of W."""

    places: slice
    root: Array
    white: Array
    radius: float
    lost: float

    @classmethod
    def of(cls, errors: ErrorSystem, places: slice, radius: float) -> Ellipsoid:
        """Return the ellipsoid of an agent now, and the probability that its errors are outside."""
        D = len(errors.spread)
        covariance = errors.covariance(np.eye(D)[places])[0]
        # Any root will do: states that no noise has reached get a little of their own.
        scale = np.sqrt(np.maximum(np.diag(covariance), 1e-30))
        d = len(scale)
        root = np.linalg.cholesky(covariance / np.outer(scale, scale) + 1e-10 * np.eye(d)) * scale[:, None]
        rows = np.zeros((d, D))
        rows[:, places] = np.linalg.inv(root)
        found, off = errors.covariance(rows)
        largest = float(np.max(np.sum(np.abs(found) + off, axis=1))) * (1.0 + 4.0 * U * d)
        return cls(places, root, rows[:, places], radius, chi_tail(radius, d, largest))

    @property
    def widths(self) -> Array:
        """Upper bounds (d,) on |g|."""
        # g = root h + (1 - root W) g: what the root misses is small, and g is at most twice root h
        d = len(self.root)
        off = np.abs(np.eye(d) - self.root @ self.white) + (d + 4.0) * U * np.abs(self.root) @ np.abs(self.white)
        plain = self.radius * np.sqrt(np.sum(self.root**2, axis=1)) * (1.0 + (d + 8.0) * U)
        if not np.max(off.sum(axis=1)) <= 1e-3:
            return np.full(d, np.inf)
        return np.asarray(up(plain + 1.01 * off @ np.full(d, plain.max()) * (1.0 + 4.0 * d * U)))

    def reach(self, rows: Array, most: Array) -> Array:
        """Return upper bounds (n,) on ``|c g|`` for rows (n, d), where ``|g| <= most`` (d,)."""
        a = rows @ self.root
        size, d = np.abs(a), len(most)
        missed = np.abs(rows - a @ self.white) + (d + 4.0) * U * (np.abs(rows) + size @ np.abs(self.white))
        length = np.sqrt(np.sum(a * a, axis=1)) * (1.0 + (d + 8.0) * U)
        return np.asarray(up(self.radius * length) + (missed @ most) * (1.0 + (d + 4.0) * U) + 1e-290)


def chi_tail(radius: float, d: int, largest: float) -> float:
    """Return an upper bound on ``P(chi2_d > radius^2 / largest)``.

    With x = radius^2 / (2 largest) it is, for even d, ``exp(-x)`` times the sum of ``x^k / k!`` for k < d / 2; for odd
    d, twice the normal tail at sqrt(2 x), and ``exp(-x)`` times the sum of ``x^(k + 1/2) / Gamma(k + 3/2)``.
    """
    if not (radius > 0.0 and 0.0 < largest < np.inf):
        return 1.0
    x = down(np.full(1, radius * radius / (2.0 * largest)) * (1.0 - 4.0 * U))
    if not x[0] < 700.0:
        return chi_tail(37.0, d, 1.0)
    odd = d % 2
    # the first term, and what each is more than the one before
    root = np.sqrt(x)
    term = exp(-interval(x)[::-1])
    if odd:  # 1 / Gamma(3/2) = 2 / sqrt(pi)
        term = mul(mul(term, np.stack([down(root), up(root)])), np.array([[1.1283791670955125], [1.1283791670955128]]))
    total = np.zeros((2, 1))
    if odd:
        z = down(np.sqrt(2.0 * x))
        total = 2.0 * np.stack(rigorous.tail(np.minimum(z, 37.0)))
    for k in range(d // 2):
        total = add(total, term)
        term = mul(term, mul(interval(x), recip(interval(np.full(1, k + 1.0 + 0.5 * odd)))))
    return min(1.0, float(total[1, 0]))
