"""Values at the corners of cells whose means are affine in the state up to a box, from below.

From x in a cell with centre c the mean is ``m(x) + r``, ``m(x) = z + G (x - c)``, ``|r_k| <= rho_k``. With I the
multilinear interpolant of g on the lattice, steps n_ki of the points that are read (along side k of the cell, in
lattice steps of axis i), and the largest differences around the image, everywhere in the cell

    g(m(x) + r)  >=  interpolation of I(m(x_k))  -  sum_i rho_i slope_i  -  sum_ki bend(n_ki) second_i
                     -  sum_k sum_ij n_ki n_kj / 4 mixed_ij  -  what g may be below I .

What is multilinear and below that at the corners is found by ``corner_forms``. Who chooses the means, and why, is not
asked here.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from itertools import combinations, product

import numpy as np
from numpy.typing import NDArray

from ...relations.grids import FloatArray, corner_sides
from ...relations.kinds import block_of
from .corner_forms import SubLattice, best_below
from .lattice_kernel import bend_of, blocks_of

LOOK = 0.37
"""Share of a lattice step that is added before a position is rounded down to the point where differences are read.

A half would make rounding decide, as positions on half steps are common; search and check have to read alike."""

BESIDE = 1.63
"""Lattice steps that the point where differences are read may be off the position, and one to the next point."""

CHARGED = 0.125
"""What second differences along each axis count for g below I."""

NUMBERS_AT_ONCE = 200_000
"""Numbers of factors at points that are formed at once: they fit into the cache of a core."""

ROUGH_PARTS = 2
"""Parts of each side of an image at which it is read to choose a policy."""

FAR = float(np.finfo(float).max ** 0.25)
"""Where means count as being that are not known: beyond every lattice, and not beyond what can be multiplied."""


@dataclass(frozen=True, eq=False)
class Images:
    """Where the closed cells of n pairs of a cell and a choice are taken.

    Parameters
    ----------
    centre : (n, d) array
        Means z of the centres; not a number where nothing is known of them.
    gain : (n, d, d) array
        G.
    rest : (n, d) array
        rho, an outer bound.
    half : (n, d) array
        Half the widths of the cells.
    """

    centre: FloatArray
    gain: FloatArray
    rest: FloatArray
    half: FloatArray

    def some(self, rows: NDArray[np.int64]) -> Images:
        """Return those of some pairs."""
        return Images(self.centre[rows], self.gain[rows], self.rest[rows], self.half[rows])

    @property
    def middles(self) -> FloatArray:
        """(n, d) means of the centres, far away where nothing is known of them."""
        return np.nan_to_num(self.centre, nan=FAR)


@dataclass(frozen=True, eq=False)
class MultilinearKernel:
    """How tables of a lattice are read at the corners of cells.

    Parameters
    ----------
    lattice : tuple of (Z_k,) arrays
        Evenly spaced lattice axes.
    reach : tuple of int
        Lattice steps along each axis within which largest differences are taken.
    parts : int
        Parts of each side of an image at which it is read for lower bounds.
    """

    lattice: tuple[FloatArray, ...]
    reach: tuple[int, ...]
    parts: int = field(default=2, kw_only=True)

    @property
    def shape(self) -> tuple[int, ...]:
        """Lattice points per axis."""
        return tuple(len(axis) for axis in self.lattice)

    @cached_property
    def n_points(self) -> int:
        """Number of lattice points Z."""
        return int(np.prod(self.shape))

    @cached_property
    def origin(self) -> FloatArray:
        """First point (d,) of the lattice."""
        return np.array([axis[0] for axis in self.lattice])

    @cached_property
    def lattice_spacing(self) -> FloatArray:
        """Lattice steps (d,)."""
        return np.array(
            [(axis[-1] - axis[0]) / max(1, len(axis) - 1) if len(axis) > 1 else 1.0 for axis in self.lattice]
        )

    @cached_property
    def _sub_lattices(self) -> tuple[SubLattice, SubLattice]:
        """Where images are read: for lower bounds, and to choose by."""
        d = len(self.lattice)
        return SubLattice.of(d, self.parts), SubLattice.of(d, 1 if d > 2 else ROUGH_PARTS)

    def numbers(self, rough: bool) -> int:
        """Return the numbers of a factor that are read for one image."""
        return len(self._sub_lattices[rough].points)

    def holds(self, centre: FloatArray, gain: FloatArray, rest: FloatArray, half: FloatArray) -> NDArray[np.bool_]:
        """Return which images are known and lie inside the lattice, what is left of means included.

        Arrays are those of ``Images`` with any first axes that broadcast. Second differences are not known at the
        border of the lattice.
        """
        known: NDArray[np.bool_] = np.all(np.isfinite(centre), axis=-1)
        position = (np.where(known[..., None], centre, 0.0) - self.origin) / self.lattice_spacing
        extent = (np.einsum("...kj,...j->...k", np.abs(gain), half) + rest) / self.lattice_spacing
        last = np.array(self.shape) - 1
        inside = (position - extent >= 1.0) & (position + extent <= last - 1.0)
        inside &= extent + BESIDE <= np.array(self.reach)
        return np.asarray(known & np.all(inside, axis=-1))

    def corners(self, images: Images) -> NDArray[np.int32]:
        """Return the lattice points (n, 2^d) nearest to the images of corners, moved into the lattice."""
        sides, flat = 2.0 * corner_sides(len(self.shape)) - 1.0, np.zeros(1, dtype=np.int64)
        middles, moved = images.middles, images.gain * images.half[:, None, :]
        for k, n in enumerate(self.shape):
            with np.errstate(invalid="ignore"):  # where nothing is known of images
                away = sum(moved[:, k, j, None] * side for j, side in enumerate(sides.T))
                position = (middles[:, k, None] + away - self.origin[k]) / self.lattice_spacing[k]
            flat = flat * n + np.rint(np.clip(np.nan_to_num(position), 0, n - 1)).astype(np.int64)
        return flat.astype(np.int32)

    def backup_lower(
        self, table: FloatArray, images: Images, inside: NDArray[np.bool_], rough: bool = False
    ) -> FloatArray:
        """Return lower bounds (m, n, 2^d) at the corners of cells; about right, and no bounds, if ``rough``.

        Parameters
        ----------
        table : (m, ..) array
            Smoothed factors: values at lattice points, and largest differences behind them.
        images : Images
        inside : (n,) bool array
            Which of them ``holds`` lets pass; of the others nothing is claimed.
        rough : bool
        """
        values = np.empty((len(table), len(inside), 2 ** len(self.lattice)))
        for rows in in_chunks(np.arange(len(inside)), len(table) * self.numbers(rough)):
            values[:, rows] = self._below(table, images.some(rows), inside[rows], self._sub_lattices[rough])
        return values

    def _below(
        self, table: FloatArray, images: Images, inside: NDArray[np.bool_], sub_lattice: SubLattice
    ) -> FloatArray:
        """Return the same, of few images."""
        rest = images.rest / self.lattice_spacing
        middle = np.where(inside[:, None], (images.middles - self.origin) / self.lattice_spacing, 1.0)
        moved = images.gain * images.half[:, None, :] / self.lattice_spacing[:, None]  # (n, i, k) in lattice steps
        moved = np.where(inside[:, None, None], moved, 0.0)
        values = self._interpolant(
            table, [middle[:, i] + sub_lattice.points @ moved[:, i].T for i in range(len(self.shape))]
        )
        parts = round(len(sub_lattice.points) ** (1.0 / len(self.shape))) - 1
        lacking = self._lacking(table, middle, 2.0 * np.abs(moved) / parts, rest)
        lower = best_below(values, values[:, sub_lattice.corners], lacking, sub_lattice.interpolation)
        return np.moveaxis(lower * inside, 1, 2)

    def _interpolant(self, table: FloatArray, position: list[FloatArray]) -> FloatArray:
        """Return the interpolant (n, K, C) of values; positions, one (K, C) per axis, are in lattice steps."""
        base = [np.clip(np.floor(x), 0.0, n - 2.0) for x, n in zip(position, self.shape, strict=True)]
        share = [x - low for x, low in zip(position, base, strict=True)]
        strides = [int(np.prod(self.shape[k + 1 :])) for k in range(len(self.shape))]
        first = sum(low.astype(np.int64) * stride for low, stride in zip(base, strides, strict=True))
        total = np.zeros((len(table), *position[0].shape))
        for corner in product((0, 1), repeat=len(self.shape)):
            factors = [right if side else 1.0 - right for right, side in zip(share, corner, strict=True)]
            weight = math.prod(factors[1:], start=factors[0])
            places = first + int(np.dot(corner, strides))
            for row, own in zip(total, table, strict=True):
                row += weight * own.take(places, mode="clip")  # none is clipped, which takes less time
        return total

    def _lacking(self, table: FloatArray, middle: FloatArray, steps: FloatArray, rest: FloatArray) -> FloatArray:
        """Return how far the value may be below interpolations of what is read (n, C).

        Parameters
        ----------
        middle : (C, d) array
            Images of centres, in lattice steps.
        steps : (C, d, d) array
            Lattice steps along each axis (second index) between points that are read along each side (last index).
        rest : (C, d) array
            What is left of means, in lattice steps.
        """
        d, reach = len(self.shape), self.reach
        index = np.clip(np.floor(middle + LOOK).astype(np.int64), 0, np.array(self.shape) - 1)
        blocks = blocks_of(self.shape, reach)
        flat = np.ravel_multi_index(tuple(index[:, k] // block_of(n) for k, n in enumerate(reach)), blocks)
        weights = [bend_of(steps[:, i]).sum(axis=1) + CHARGED for i in range(d)]
        weights += [0.25 * (steps[:, i] * steps[:, j]).sum(axis=1) for i, j in combinations(range(d), 2)]
        weights += [rest[:, i] for i in range(d)]
        lacking = np.zeros((len(table), len(middle)))
        if table.shape[1] == self.n_points:  # about right is enough
            return lacking
        for row, own in zip(lacking, table, strict=True):
            row[:] = own[-1]
            for number, weight in enumerate(weights):
                row += weight * own.take(self.n_points + number * math.prod(blocks) + flat, mode="clip")
        return lacking


def in_chunks(rows: NDArray[np.int64], numbers: int) -> Iterator[NDArray[np.int64]]:
    """Return rows, each of which forms some numbers, in parts that form few at once."""
    if len(rows):
        yield from np.array_split(rows, len(rows) * numbers // NUMBERS_AT_ONCE + 1)
