"""Masses of grid cells around means, from below.

The abstract agent moves from a mean ``z`` on a lattice to the cell that holds ``z + w``, as a rule with ``w ~ N(0,
Sigma)``. Where the components of w are independent, the mass of a cell is a product over axes, so that one table
``(Z_k, S_k)`` per axis is the whole kernel. It depends on the mean alone and serves all cells and inputs: a backup
smooths once and gathers afterwards.

Every entry is a **lower bound** on the true mass (docs/theory/numerics.md): the difference is taken between the tails
that are small, the errors of the special function and of its argument are subtracted, and negative results become 0.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from ....envs.systems.distributions import Gaussian, Law
from ...certificates.value_functions import UNIT, add_rows
from ...relations.grids import FloatArray, shape_text

SMALLEST_MASS = 1e-60
"""Masses below this are set to 0: a lower bound still, and no denormal numbers in the products."""

REACH_DEVIATIONS = 9.0
"""Standard deviations beyond which masses count as 0; both tails together hold less than ``BEYOND_REACH``."""

BEYOND_REACH = 3e-19
"""Upper bound on the mass of a normal distribution beyond 9 standard deviations, 2.3e-19."""

LATTICE_BLOCK = 128
"""Lattice points per block of a table: enough rows for a fast product, few enough that the band stays narrow."""

SUPPORT_STEP = 64
"""Ranges of nonzero cells are rounded outwards to multiples of this, so that rows fall into few groups."""

MANY_PRODUCTS = 4_000_000
"""Products from which it pays to look for the lattice points that carry mass before pushing it."""

NUMBERS_AT_ONCE = 1 << 22
"""Numbers on lattices that are formed at once, 32 MB: more would be no faster, and take memory several times."""

FEW_MASSES = 4
"""Rows up to which ``bincount`` adds up masses faster than a sparse product."""


def gaussian_masses(means: FloatArray, edges: FloatArray, std: float) -> tuple[FloatArray, float]:
    """Return lower bounds on ``P(edges[s] <= z + w < edges[s+1])`` for ``w ~ N(0, std**2)``.

    Parameters
    ----------
    means : (Z,) array
        Lattice of means z, in state units.
    edges : (S + 1,) array
        Increasing cell edges, in state units.
    std : float
        Standard deviation (not the variance), in state units; positive.

    Returns
    -------
    masses : (Z, S) array
        Lower bounds.
    loss : float
        Upper bound on what a row misses altogether, ``max_z sum_s (true - masses)``.

    Notes
    -----
    The relative error of ``ndtr`` on the small tail ``F`` is below ``20 + 4 (1 + x*x)`` units (checked against 50
    digits in the tests). Subtraction, division and the square root inside ``std`` give ``x`` a relative error of at
    most 3 units, which moves ``F`` by at most ``3 |x| phi(x) <= 3 (1 + x*x) F`` units.
    """
    # The tail on the side of each edge that does not hold the mean is small, and has all its digits.
    x = (edges[None, :] - means[:, None]) / std
    tail = ndtr(-np.abs(x))
    error = UNIT * (20.0 + 8.0 * (1.0 + x * x)) * tail
    # A cell on one side of the mean is a difference of two small tails; a cell around it is what both tails leave.
    left, right = x[:, :-1] < 0, x[:, 1:] > 0
    straddles = left & right
    lower, upper = tail[:, :-1], tail[:, 1:]
    mass = np.where(straddles, 1.0 - lower - upper, np.abs(upper - lower))
    # Take off the errors of both tails and of the subtractions.
    slack = error[:, :-1] + error[:, 1:] + 4.0 * UNIT * mass + 4.0 * UNIT * straddles
    masses = mass - slack
    masses[masses < SMALLEST_MASS] = 0.0
    # True masses exceed the entries by the slack once for the errors and once for having taken it off.
    loss = float(np.max(np.sum(2.0 * slack, axis=1))) + SMALLEST_MASS * masses.shape[1]
    return masses, loss


@dataclass(frozen=True, eq=False, repr=False)
class AxisTable:
    """Masses (Z, S) of one axis, stored where they are not 0: blocks of lattice points, each with a range of cells.

    Parameters
    ----------
    shape : (int, int)
        Lattice points Z and cells S.
    blocks : tuple of (z0, z1, s0, s1, (z1 - z0, s1 - s0) array)
        Entries of lattice points z0 .. z1 - 1 and cells s0 .. s1 - 1; the ranges of lattice points tile 0 .. Z.
    """

    shape: tuple[int, int]
    blocks: tuple[tuple[int, int, int, int, NDArray], ...]

    def __repr__(self) -> str:
        stored = sum(entries.size for *_, entries in self.blocks)
        share = 100.0 * stored / max(1, self.shape[0] * self.shape[1])
        return f"AxisTable({self.shape[0]} lattice points x {self.shape[1]} cells, {share:.3g} % of it stored)"

    @classmethod
    def dense(cls, table: NDArray) -> AxisTable:
        """Return a table with all entries in one block; any numeric dtype (``Fraction`` objects in exact tests)."""
        return cls(table.shape, ((0, table.shape[0], 0, table.shape[1], table),))

    def toarray(self) -> NDArray:
        """Return the table as one (Z, S) array."""
        table = np.zeros(self.shape, dtype=self.blocks[0][-1].dtype)
        for z0, z1, s0, s1, entries in self.blocks:
            table[z0:z1, s0:s1] = entries
        return table

    def backup(self, values: NDArray) -> NDArray:
        """Return ``sum_s table[z, s] v[.., s]``: (.., S) -> (.., Z)."""
        if len(self.blocks) == 1:
            _, _, s0, s1, entries = self.blocks[0]
            return values[..., s0:s1] @ entries.T
        if values.ndim > 2:
            return self.backup(values.reshape(-1, values.shape[-1])).reshape(*values.shape[:-1], self.shape[0])
        # Masked factors are 0 outside a region: rows of the same support share products over that range alone.
        groups = _by_support(values)
        if len(groups) == 1:
            return self._smooth_range(values, *groups[0][1:])
        backed_up = np.empty((len(values), self.shape[0]))
        for rows, first, last in groups:
            backed_up[rows] = self._smooth_range(values[rows], first, last)
        return backed_up

    def _smooth_range(self, values: NDArray, first: int, last: int) -> NDArray:
        """Smooth rows (n, S) that are 0 outside the cells ``first .. last - 1``."""
        backed_up = np.empty((len(values), self.shape[0]), dtype=values.dtype)
        for z0, z1, s0, s1, entries in self.blocks:
            a, b = max(s0, first), min(s1, last)
            if a < b:
                np.matmul(values[:, a:b], entries[:, a - s0 : b - s0].T, out=backed_up[:, z0:z1])
            else:
                backed_up[:, z0:z1] = 0.0
        return backed_up

    def propagate(self, masses: NDArray) -> NDArray:
        """Return ``sum_z m[.., z] table[z, s]``: (.., Z) -> (.., S)."""
        propagated = np.empty((*masses.shape[:-1], self.shape[1]), dtype=masses.dtype)
        propagated[...] = 0.0
        products = math.prod(masses.shape[:-1]) * sum(entries.size for *_, entries in self.blocks)
        if products < MANY_PRODUCTS:
            for z0, z1, s0, s1, entries in self.blocks:
                propagated[..., s0:s1] += masses[..., z0:z1] @ entries
            return propagated
        # Policies choose few of the points: multiply only the rows of those that carry mass, block by block.
        used = np.flatnonzero((masses != 0).any(axis=tuple(range(masses.ndim - 1))))
        ends = np.searchsorted(used, [z1 for _, z1, *_ in self.blocks])
        for points, (z0, _, s0, s1, entries) in zip(np.split(used, ends[:-1]), self.blocks, strict=True):
            if len(points):
                propagated[..., s0:s1] += masses[..., points] @ entries[points - z0]
        return propagated


def _by_support(values: NDArray) -> list[tuple[NDArray[np.int64], int, int]]:
    """Return rows (n, S) in groups with about the same range of nonzero cells: (rows, first, last + 1)."""
    n_cells = values.shape[-1]
    present = values != 0
    # First and last nonzero cell of each row, rounded outwards; a row of zeros gets the whole axis.
    first = present.argmax(axis=1) // SUPPORT_STEP * SUPPORT_STEP
    last = np.minimum(n_cells, -(-(n_cells - present[:, ::-1].argmax(axis=1)) // SUPPORT_STEP) * SUPPORT_STEP)
    key = first * (n_cells + 1) + last
    return [(np.flatnonzero(key == k), int(k // (n_cells + 1)), int(k % (n_cells + 1))) for k in np.unique(key)]


def gaussian_table(means: FloatArray, edges: FloatArray, std: float) -> tuple[AxisTable, float]:
    """Return lower bounds on the cell masses around increasing ``means``, banded; else like ``gaussian_masses``."""
    blocks, loss = [], 0.0
    for z0 in range(0, len(means), LATTICE_BLOCK):
        block_means = means[z0 : z0 + LATTICE_BLOCK]
        # Cells within reach of any mean of the block; at least one, also for means far outside the grid.
        s0 = max(0, int(np.searchsorted(edges, block_means[0] - REACH_DEVIATIONS * std)) - 1)
        s1 = min(len(edges) - 1, int(np.searchsorted(edges, block_means[-1] + REACH_DEVIATIONS * std)))
        s0, s1 = min(s0, len(edges) - 2), max(s1, 1)
        masses, missing = gaussian_masses(block_means, edges[s0 : s1 + 1], std)
        blocks.append((z0, z0 + len(block_means), s0, s1, masses))
        loss = max(loss, missing)
    return AxisTable((len(means), len(edges) - 1), tuple(blocks)), loss + BEYOND_REACH


def law_table(means: FloatArray, edges: FloatArray, law: Law) -> tuple[AxisTable, float]:
    """Return lower bounds on the cell masses of noise of any law, as ``gaussian_table`` does for Gaussian noise.

    Masses are differences of the smaller tails, less four times their error: twice as much as they may be off by.
    """
    if isinstance(law, Gaussian):
        return gaussian_table(means, edges, law.std)
    error = 4.0 * law.cdf_error
    blocks, loss = [], 0.0
    for z0 in range(0, len(means), LATTICE_BLOCK):
        below, above = law.tails(edges[None, :] - means[z0 : z0 + LATTICE_BLOCK, None])
        # Of a cell in the upper half, the tails above its edges are the smaller ones.
        upper_half = below[:, :-1] > 0.5
        mass = np.where(upper_half, above[:, :-1] - above[:, 1:], below[:, 1:] - below[:, :-1]) - error
        used = np.flatnonzero(np.any(mass > SMALLEST_MASS, axis=0))
        s0, s1 = (int(used[0]), int(used[-1]) + 1) if len(used) else (0, 1)
        entries = np.where(mass[:, s0:s1] > SMALLEST_MASS, mass[:, s0:s1], 0.0)
        blocks.append((z0, z0 + len(below), s0, s1, entries))
        # A cell lacks what was taken off, and what its mass may be larger than computed; or all of so small a mass.
        loss = max(loss, 2.0 * error * (len(edges) - 1) + SMALLEST_MASS * (len(edges) - 1))
    return AxisTable((len(means), len(edges) - 1), tuple(blocks)), loss


@dataclass(frozen=True, eq=False, repr=False)
class Kernel:
    """Separable kernel from lattice points to cells, as one table per axis.

    Parameters
    ----------
    tables : tuple of AxisTable
        Lower bounds on the masses.
    loss : float
        Upper bound on the mass that one application loses to rounding, per row.
    """

    tables: tuple[AxisTable, ...]
    loss: float = 0.0

    def __repr__(self) -> str:
        points, cells = shape_text(self.lattice_shape), shape_text(self.shape)
        return f"Kernel({points} lattice points to {cells} cells, loses {self.loss:.2g} per step at most)"

    @property
    def shape(self) -> tuple[int, ...]:
        """Cells per axis."""
        return tuple(table.shape[1] for table in self.tables)

    @property
    def lattice_shape(self) -> tuple[int, ...]:
        """Lattice points per axis."""
        return tuple(table.shape[0] for table in self.tables)

    def backup(self, factors: NDArray) -> NDArray:
        """Return ``sum_s P(s | z) v[s]`` for every lattice point z, a lower bound for v >= 0: (n, S) -> (n, Z)."""
        maps = [table.backup for table in self.tables]
        if len(maps) == 1:
            return maps[0](factors)
        return _in_parts(lambda some: _along_axes(some, self.shape, maps), factors, math.prod(self.lattice_shape))

    def propagate(self, masses: FloatArray, policy: NDArray[np.integer]) -> FloatArray:
        """Return the distribution after one step, from below: (n, S) masses under ``policy`` (S,) -> (n, S).

        ``policy`` gives the lattice point of each cell. Cells with -1 (no admissible input) lose their mass.
        """
        n_lattice = math.prod(self.lattice_shape)
        # Cells without a choice send their mass to one more point, which is thrown away.
        slot = np.where(policy < 0, n_lattice, policy)
        maps = [table.propagate for table in self.tables]

        def propagated(some: NDArray) -> NDArray:
            if len(some) <= FEW_MASSES:
                on_lattice = np.stack([np.bincount(slot, weights=row, minlength=n_lattice + 1) for row in some])
            else:
                on_lattice = add_rows(some.T, slot, n_lattice + 1).T
            return _along_axes(on_lattice[:, :n_lattice], self.lattice_shape, maps)

        return _in_parts(propagated, masses, n_lattice)


def _in_parts(map_of: Callable[[NDArray], NDArray], values: NDArray, numbers: int) -> NDArray:
    """Return what a map makes of the rows of values, few at a time where each takes many numbers on the way."""
    parts = min(len(values), len(values) * numbers // NUMBERS_AT_ONCE + 1)
    if parts <= 1:
        return map_of(values)
    first, *others = np.array_split(values, parts)
    start = map_of(first)
    result, end = np.empty((len(values), start.shape[1]), dtype=start.dtype), len(first)
    result[:end] = start
    for some in others:
        result[end : end + len(some)] = map_of(some)
        end += len(some)
    return result


def _along_axes(values: NDArray, shape: tuple[int, ...], maps: Sequence[Callable[[NDArray], NDArray]]) -> NDArray:
    """Apply a linear map of the last axis to each axis of values (n, prod(shape)) in turn; return (n, prod(out))."""
    if len(maps) == 1:
        return maps[0](values)
    tensor = values.reshape(len(values), *shape)
    for axis, transform in enumerate(maps, start=1):
        tensor = np.moveaxis(transform(np.moveaxis(tensor, axis, -1)), -1, axis)
    return tensor.reshape(len(values), math.prod(tensor.shape[1:]))
