"""Expected values on a lattice, and how much they change from one lattice point to the next.

The multilinear interpolant I of ``g(z) = E l(z + w)`` on a lattice is known: what happens between lattice points need
not be guessed from derivatives, and the law of the noise does not matter. Beside the values stand, for every lattice
point, the largest of these around it (``reach`` lattice steps along each axis):

- positive second differences along each axis: how much I bends upward where a line crosses a lattice plane;
- mixed differences of neighbouring points, in absolute value, for each pair of axes: how much I bends between planes;
- differences of neighbouring points along each axis, in absolute value: how steep I is.

How far g itself may be below I is a matter of the noise: for normal noise an eighth of the second differences, and a
slack (``box_kernel``); for uniform noise what the factor varies at the two ends of the noise (docs/theory/linear.md,
"Agents written as expressions").
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d

from ..cells import FloatArray
from .linear_kernel import HatKernel
from .uniform_ends import UniformEnds


@dataclass(frozen=True, eq=False, repr=False)
class LatticeKernel(HatKernel):
    """Kernel whose smoothed factors (n, ..) are blocks of Z columns, and one more for what is lost everywhere.

    The blocks are values; second differences of each axis; mixed ones of each pair of axes; differences of each axis;
    and what uniform noise adds between lattice points, if there is any.

    Parameters
    ----------
    tables, loss
        See ``Kernel``.
    reach : tuple of int
        Lattice steps along each axis within which the largest differences are taken.
    slack : float
        How far g may be below I wherever it is, besides what differences say, for factors of at most 1.
    ends : UniformEnds or None
        The axis with uniform noise, if there is one.
    """

    reach: tuple[int, ...] = field(kw_only=True)
    slack: float = field(kw_only=True)
    ends: UniformEnds | None = field(kw_only=True, default=None)

    @property
    def n_columns(self) -> int:
        """Number of columns of smoothed factors."""
        d = len(self.reach)
        return (1 + 2 * d + math.comb(d, 2) + (self.ends is not None)) * self.n_points + 1

    def smooth(self, factors: NDArray) -> NDArray:
        """Return values of factors (n, 2^d S), from below, and the largest differences around every lattice point."""
        values = super(HatKernel, self).smooth(factors)
        shape, n = self.lattice_shape, self.n_points
        result = np.zeros((len(values), self.n_columns))
        result[:, :n] = values
        result[:, -1] = self.slack * factors.max(axis=1, initial=0.0)
        for row, own in zip(result, values, strict=True):
            for block, table in enumerate(differences(own.reshape(shape)), start=1):
                row[block * n : (block + 1) * n] = self._largest(table).ravel()
        if self.ends is not None:
            for row, added in zip(result, self.ends.charges(self.tables, factors), strict=True):
                row[-1 - n : -1] = self._largest(added).ravel()
        return result

    def _largest(self, table: FloatArray) -> FloatArray:
        """Return the largest numbers (Z_1, ..) within reach of every lattice point."""
        for axis, reach in enumerate(self.reach):
            table = maximum_filter1d(table, 2 * reach + 1, axis=axis, mode="nearest")
        return table


def differences(values: FloatArray) -> list[FloatArray]:
    """Return second, mixed and first differences of numbers (Z_1, ..), each (Z_1, ..), nonnegative.

    Mixed and first ones stand at the lower one of their points; where a point is missing they are 0.
    """
    d, result = values.ndim, []
    for k in range(d):
        second = np.zeros_like(values)
        np.maximum(np.diff(values, 2, axis=k), 0.0, out=second[_cut(d, {k: slice(1, -1)})])
        result.append(second)
    for i, j in combinations(range(d), 2):
        mixed = np.zeros_like(values)
        lower = slice(None, -1)
        np.abs(np.diff(np.diff(values, axis=i), axis=j), out=mixed[_cut(d, {i: lower, j: lower})])
        result.append(mixed)
    for k in range(d):
        first = np.zeros_like(values)
        np.abs(np.diff(values, axis=k), out=first[_cut(d, {k: slice(None, -1)})])
        result.append(first)
    return result


def _cut(d: int, cuts: dict[int, slice]) -> tuple[slice, ...]:
    return tuple(cuts.get(k, slice(None)) for k in range(d))


def bend_of(steps: FloatArray) -> FloatArray:
    """Return what a positive second difference of 1 bends a line that crosses these many lattice steps, at most.

    Between its ends a line of n lattice steps meets a plane at every n-th part of it, where its slope, per length of
    the line, may grow by n. With the hat function of the interval its interpolant is above it by at most n / 4 for n up
    to 1, and by ``(n^2 + 1) / 8`` beyond.
    """
    return np.where(steps < 1.0, 0.25 * steps, 0.125 * (steps**2 + 1.0))
