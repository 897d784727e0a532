"""Expected values on a lattice, and how much they change from one lattice point to the next.

The multilinear interpolant I of ``g(z) = E l(z + w)`` on a lattice is known: what happens between lattice points need
not be guessed from derivatives, and the law of the noise does not matter. Beside the values stand, for every block of
lattice points, the largest of these around it (``reach`` lattice steps along each axis, and a little more):

- positive second differences along each axis: how much I bends upward where a line crosses a lattice plane;
- mixed differences of neighbouring points, in absolute value, for each pair of axes: how much I bends between planes;
- differences of neighbouring points along each axis, in absolute value: how steep I is.

How far g itself may be below I is a matter of the noise, which is normal: an eighth of the second differences, and a
slack (``box_kernel``; docs/theory/linear.md, "One reading for all").
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import combinations
from typing import Any

import numpy as np

from ....envs.systems.distributions import Law
from ...relations.grids import FloatArray, Grid
from ...relations.kinds import block_of
from .box_kernel import rounding_of, slack_of
from .kernel import Kernel
from .linear_kernel import hat_table

NUMBERS_AT_ONCE = 200_000
"""Numbers of tables whose differences are formed at once: they fit into the cache of a core."""

NOTHING = 1e-40
"""Values below this are set to 0: a lower bound still, and no denormal numbers, which are slow, some steps later."""


LONGEST = 1e6
"""Lattice steps, in deviations, at which they are cut: nothing is known between them long before."""


@dataclass(frozen=True, eq=False, repr=False)
class LatticeKernel(Kernel):
    """Kernel whose smoothed factors (n, ..) have Z values, largest differences, and what is lost everywhere.

    The differences have as many columns as there are blocks: second ones of each axis; mixed ones of each pair of axes;
    first ones of each axis.

    Parameters
    ----------
    tables, loss
        See ``Kernel``.
    reach : tuple of int
        Lattice steps along each axis within which the largest differences are taken.
    slack : float
        How far g may be below I wherever it is, besides what differences say, for factors of at most 1.
    """

    reach: tuple[int, ...] = field(kw_only=True)
    slack: float = field(kw_only=True)

    @property
    def n_points(self) -> int:
        """Number of lattice points Z."""
        return math.prod(self.lattice_shape)

    @property
    def n_columns(self) -> int:
        """Number of columns of smoothed factors."""
        d = len(self.reach)
        return self.n_points + (2 * d + math.comb(d, 2)) * self.n_blocks + 1

    @property
    def n_blocks(self) -> int:
        """Number of blocks of lattice points."""
        return math.prod(blocks_of(self.lattice_shape, self.reach))

    def backup(self, factors: Any) -> Any:
        """Return values of factors (n, 2^d S), from below, and the largest differences around every block."""
        # Agents that are alike often have equal factors: each is smoothed once.
        number: dict[bytes, int] = {}
        which = [number.setdefault(row.tobytes(), len(number)) for row in factors]
        firsts = [which.index(k) for k in range(len(number))]
        if len(number) == len(factors):
            return self._smoothed(factors)
        return self._smoothed(factors[firsts])[which]

    def _smoothed(self, factors: FloatArray) -> FloatArray:
        """Return the same of factors of which no two are equal."""
        values = self._values(factors)
        result = np.empty((len(values), self.n_columns))
        result[:, : self.n_points] = values
        result[:, -1] = self.slack * factors.max(axis=1, initial=0.0)
        rows_at_once = max(1, NUMBERS_AT_ONCE // self.n_points)
        for first in range(0, len(values), rows_at_once):
            rows = slice(first, first + rows_at_once)
            tables = largest_differences(values[rows].reshape(-1, *self.lattice_shape), self.reach)
            for k, table in enumerate(tables):
                start = self.n_points + k * self.n_blocks
                result[rows, start : start + self.n_blocks] = table
        return result

    def _values(self, factors: Any) -> FloatArray:
        """Return values at lattice points (n, Z), from below."""
        values = super().backup(factors)
        values[values < NOTHING] = 0.0
        return values


def largest_differences(values: FloatArray, reach: tuple[int, ...]) -> list[FloatArray]:
    """Return the largest differences (n, blocks) of every kind within reach of every block, of numbers (n, Z_1, ..)."""
    block = block_of(reach[0])
    n_places, across = values.shape[1], values[:, :1].size
    # A few planes at a time: all differences of a large lattice would be far larger than any cache.
    planes = block * max(1, NUMBERS_AT_ONCE // (across * block))
    parts = []
    for first in range(0, n_places, planes):
        last = min(first + planes, n_places)
        below, above = max(first - 1, 0), min(last + 1, n_places)
        inside = slice(first - below, last - below)
        parts.append([_blocks(table[:, inside], reach) for table in differences(values[:, below:above])])
    return [_around(np.concatenate(tables, axis=1), reach) for tables in zip(*parts, strict=True)]


def _blocks(tables: FloatArray, reach: tuple[int, ...]) -> FloatArray:
    """Return the largest number of every block."""
    for axis, length in enumerate(reach, start=1):
        tables = _block_largest(tables, axis, block_of(length))
    return tables


def _around(tables: FloatArray, reach: tuple[int, ...]) -> FloatArray:
    """Return the largest of the blocks (n, blocks) within reach of each."""
    for axis, length in enumerate(reach, start=1):
        tables = _largest_within(tables, axis, math.ceil(length / block_of(length)))
    return tables.reshape(len(tables), -1)


def _block_largest(tables: FloatArray, axis: int, block: int) -> FloatArray:
    """Return the largest of every ``block`` numbers along an axis."""
    if block == 1:
        return tables
    result = _part(tables, axis, slice(0, None, block)).copy()
    for first in range(1, block):
        others = _part(tables, axis, slice(first, None, block))
        into = _part(result, axis, slice(0, others.shape[axis]))
        np.maximum(into, others, out=into)
    return result


def _largest_within(tables: FloatArray, axis: int, reach: int) -> FloatArray:
    """Return the largest number within ``reach`` places to either side along an axis."""
    across = 2 if axis == 1 else 1
    if tables.size <= NUMBERS_AT_ONCE or across >= tables.ndim:
        return _largest_in_windows(tables, axis, reach)
    # A few rows across the windows at a time, which fit into the cache.
    rows = max(1, NUMBERS_AT_ONCE * tables.shape[across] // tables.size)
    result = np.empty_like(tables)
    for first in range(0, tables.shape[across], rows):
        part = slice(first, first + rows)
        _part(result, across, part)[...] = _largest_in_windows(_part(tables, across, part), axis, reach)
    return result


def _largest_in_windows(tables: FloatArray, axis: int, reach: int) -> FloatArray:
    """Return the same, of few numbers.

    Windows grow by doubling: each pass takes the larger of two windows side by side.
    """
    shape = list(tables.shape)
    shape[axis] += 2 * reach
    wide = np.full(shape, -np.inf)
    _part(wide, axis, slice(reach, reach + tables.shape[axis]))[...] = tables
    width = 1
    while width < 2 * reach + 1:
        step = min(width, 2 * reach + 1 - width)
        ends = wide.shape[axis] - step
        wide = np.maximum(_part(wide, axis, slice(0, ends)), _part(wide, axis, slice(step, step + ends)))
        width += step
    return wide


def blocks_of(shape: tuple[int, ...], reach: tuple[int, ...]) -> tuple[int, ...]:
    """Return the blocks along each axis."""
    return tuple(math.ceil(n / block_of(r)) for n, r in zip(shape, reach, strict=True))


def differences(values: FloatArray) -> list[FloatArray]:
    """Return second, mixed and first differences of numbers (n, Z_1, ..), each (n, Z_1, ..), nonnegative.

    Mixed and first ones stand at the lower one of their points; where a point is missing they are 0.
    """
    axes, result = range(1, values.ndim), []
    lower, upper, inner = slice(None, -1), slice(1, None), slice(1, -1)
    slopes = {k: _part(values, k, upper) - _part(values, k, lower) for k in axes}
    for k in axes:
        second = np.zeros_like(values)
        into = _part(second, k, inner)
        np.subtract(_part(slopes[k], k, upper), _part(slopes[k], k, lower), out=into)
        np.maximum(into, 0.0, out=into)
        result.append(second)
    for i, j in combinations(axes, 2):
        mixed = np.zeros_like(values)
        into = _part(_part(mixed, i, lower), j, lower)
        np.subtract(_part(slopes[i], j, upper), _part(slopes[i], j, lower), out=into)
        np.abs(into, out=into)
        result.append(mixed)
    for k in axes:
        first = np.zeros_like(values)
        np.abs(slopes[k], out=_part(first, k, lower))
        result.append(first)
    return result


def _part(tables: FloatArray, axis: int, where: slice) -> FloatArray:
    """Return a part of tables along one axis, as a view."""
    return tables[(slice(None),) * axis + (where,)]


def bend_of(steps: FloatArray) -> FloatArray:
    """Return what a positive second difference of 1 bends a line that crosses these many lattice steps, at most.

    Between its ends a line of n lattice steps meets a plane at every n-th part of it, where its slope, per length of
    the line, may grow by n. With the hat function of the interval its interpolant is above it by at most n / 4 for n up
    to 1, and by ``(n^2 + 1) / 8`` beyond.
    """
    return np.where(steps < 1.0, 0.25 * steps, 0.125 * (steps**2 + 1.0))


def lattice_kernel_of(
    grid: Grid, lattice: tuple[FloatArray, ...], laws: Sequence[Law], reach: tuple[int, ...]
) -> LatticeKernel:
    """Return the kernel on a lattice, for normal noise."""
    tables, loss, ratios = [], 0.0, []
    for axis, edges, law in zip(lattice, grid.edges, laws, strict=True):
        ratios.append(min(float(axis[-1] - axis[0]) / (len(axis) - 1) / law.std, LONGEST))
        table, missing = hat_table(axis, edges, law.std)
        tables.append(table)
        loss += missing
    return LatticeKernel(tuple(tables), loss, reach=reach, slack=_slack(np.array(ratios)) + loss)


def _slack(ratios: FloatArray) -> float:
    """Return how far g may be below its interpolant besides what differences say, for factors of at most 1."""
    rounding = rounding_of(ratios)
    return (slack_of(ratios) - rounding) * (1.0 + 1e-9) + rounding
