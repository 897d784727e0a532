"""Multilinear functions on a cell that are below another one, from its values at a few points.

With f at the points of a sub-lattice of the image, c the values at its corners, I their interpolant and ``bend`` what f
may be below the interpolation between the points of the sub-lattice, each of these is a lower bound that is multilinear
again:

    c - E,        E = max (I - f)^+ + bend,        if no corner becomes negative;
    theta c,      theta = min (f - bend)^+ / I,    0 if f < bend at any point, also where I is 0;
    the constant  min (f - bend)^+ .

Setting single negative corners to 0 would be wrong. The best of the three, by its mean, is taken for every cell and
factor (docs/theory/linear.md, "The loss").
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from ...relations.grids import FloatArray, corner_sides

DRAW = 1.0 - 1e-6
"""Share of the mean of another lower bound from which the earlier form is taken."""


@dataclass(frozen=True, eq=False)
class SubLattice:
    """Points inside a cell at whose images values are read.

    Parameters
    ----------
    points : (K, d) array
        From -1 to 1 along each axis, in C order.
    corners : (2^d,) int array
        Which of them are the corners of the cell.
    interpolation : (2^d, K) array
        Weights of the corners at the points.
    """

    points: FloatArray
    corners: NDArray[np.int64]
    interpolation: FloatArray

    @classmethod
    def of(cls, d: int, parts: int) -> SubLattice:
        """Return the points that cut each side of a cell into equal parts."""
        points = np.array(list(product(np.linspace(-1.0, 1.0, parts + 1), repeat=d)))
        sides = corner_sides(d)
        corners = np.ravel_multi_index(tuple((sides * parts).T), (parts + 1,) * d)
        share = 0.5 * (points + 1.0)
        weights = np.prod(np.where(sides[:, None, :], share[None], 1.0 - share[None]), axis=2)
        return cls(points, corners, weights)


def best_below(values: FloatArray, corners: FloatArray, bend: FloatArray, interpolation: FloatArray) -> FloatArray:
    """Return lower bounds (n, 2^d, C) at the corners of cells, of which the interpolants are below f everywhere.

    Parameters
    ----------
    values : (n, K, C) array
        f at the points of the sub-lattice.
    corners : (n, 2^d, C) array
        f at the corners.
    bend : (n, C) array
        How far f may be below the interpolation between neighbouring points of the sub-lattice.
    interpolation : (2^d, K) array
    """
    between = interpolation.T @ corners
    least = np.maximum(values - bend[:, None], 0.0)
    constant = least.min(axis=1)
    # Additive: admissible only if all corners stay nonnegative.
    shift = np.maximum((between - values).max(axis=1), 0.0) + bend
    fits = corners.min(axis=1) >= shift
    # Multiplicative: the smallest ratio. Where I is 0 any theta will do, unless f may be below 0 - bend there: f could
    # be 0 up to the next point, and theta I is not.
    ratio = np.divide(least, between, out=(values >= bend[:, None]).astype(float), where=between > 0.0)
    theta = np.minimum(ratio.min(axis=1), 1.0) * (1.0 - 1e-15)
    mean = corners.mean(axis=1)
    by_shift = np.where(fits, mean - shift, -1.0)
    by_theta = theta * mean
    # Where the worst point is the centre, two forms have the same mean: rounding must not decide between them.
    best = np.where((by_theta >= DRAW * constant)[:, None], theta[:, None] * corners, constant[:, None])
    chosen = (by_shift >= DRAW * np.maximum(by_theta, constant))[:, None]
    return np.where(chosen, corners - shift[:, None], best)
