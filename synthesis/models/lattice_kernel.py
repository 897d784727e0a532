"""Expected values on a lattice, and how much they change from one lattice point to the next.

The multilinear interpolant I of ``g(z) = E l(z + w)`` on a lattice is known: what happens between lattice points need
not be guessed from derivatives, and the law of the noise does not matter. Beside the values stand, for every block of
lattice points, the largest of these around it (``reach`` lattice steps along each axis, and a little more):

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

BLOCKS = 3
"""Blocks within reach to either side: more of them see less that is beyond reach, and take longer."""

NOTHING = 1e-40
"""Values below this are set to 0: a lower bound still, and no denormal numbers, which are slow, some steps later."""


@dataclass(frozen=True, eq=False, repr=False)
class LatticeKernel(HatKernel):
    """Kernel whose smoothed factors (n, ..) have Z values, largest differences, and what is lost everywhere.

    The differences have as many columns as there are blocks: second ones of each axis; mixed ones of each pair of axes;
    first ones of each axis; and what uniform noise adds between lattice points, if there is any.

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
        return self.n_points + (2 * d + math.comb(d, 2) + (self.ends is not None)) * self.n_blocks + 1

    @property
    def n_blocks(self) -> int:
        """Number of blocks of lattice points."""
        return math.prod(blocks_of(self.lattice_shape, self.reach))

    def smooth(self, factors: NDArray) -> NDArray:
        """Return values of factors (n, 2^d S), from below, and the largest differences around every block."""
        # Agents that are alike often have equal factors: each is smoothed once.
        number: dict[bytes, int] = {}
        which = [number.setdefault(row.tobytes(), len(number)) for row in factors]
        if len(number) < len(factors):
            first = [which.index(k) for k in range(len(number))]
            return self.smooth(factors[first])[which]
        values = self._values(factors)
        result = np.zeros((len(values), self.n_columns))
        result[:, : self.n_points] = values
        result[:, -1] = self.slack * factors.max(axis=1, initial=0.0)
        added = [None] * len(values) if self.ends is None else self.ends.charges(self.tables, factors)
        for row, own, at_ends in zip(result, values, added, strict=True):
            tables = differences(own.reshape(self.lattice_shape)) + ([] if at_ends is None else [at_ends])
            row[self.n_points : -1] = np.concatenate([self._largest(table).ravel() for table in tables])
        return result

    def rough(self, factors: NDArray) -> NDArray:
        """Return values with nothing beside them: about right, for choosing policies and for nothing else."""
        return self.alone(self._values(factors))

    def _values(self, factors: NDArray) -> NDArray:
        """Return values at lattice points (n, Z), from below."""
        values = super(HatKernel, self).smooth(factors)
        values[values < NOTHING] = 0.0
        return values

    def _largest(self, table: FloatArray) -> FloatArray:
        """Return the largest numbers within reach of every block, of numbers (Z_1, ..) of lattice points."""
        for axis, reach in enumerate(self.reach):
            block = block_of(reach)
            table = _block_largest(table, axis, block)
            table = maximum_filter1d(table, 2 * math.ceil(reach / block) + 1, axis=axis, mode="nearest")
        return table


def _block_largest(table: FloatArray, axis: int, block: int) -> FloatArray:
    """Return the largest of every ``block`` nonnegative numbers along an axis."""
    if block == 1:
        return table
    result = table[_cut(table.ndim, {axis: slice(0, None, block)})].copy()
    for first in range(1, block):
        others = table[_cut(table.ndim, {axis: slice(first, None, block)})]
        into = result[_cut(table.ndim, {axis: slice(0, others.shape[axis])})]
        np.maximum(into, others, out=into)
    return result


def block_of(reach: int) -> int:
    """Return the lattice points of a block along an axis: those for which largest differences are taken at once."""
    return max(1, reach // BLOCKS)


def blocks_of(shape: tuple[int, ...], reach: tuple[int, ...]) -> tuple[int, ...]:
    """Return the blocks along each axis."""
    return tuple(math.ceil(n / block_of(r)) for n, r in zip(shape, reach, strict=True))


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
