"""Choices of agents with expressions under the relation ``linear``: inputs, with affine maps and what they leave.

From x in a cell with centre c the mean is ``m(x) + r``, ``m(x) = z + G (x - c)``, ``|r_k| <= rho_k``. With I the
multilinear interpolant of g on the lattice, steps n_ki of the points that are read (along side k of the cell, in
lattice steps of axis i), and the largest differences around the image, everywhere in the cell

    g(m(x) + r)  >=  interpolation of I(m(x_k))  -  sum_i rho_i slope_i  -  sum_ki bend(n_ki) second_i
                     -  sum_k sum_ij n_ki n_kj / 4 mixed_ij  -  what g may be below I .

From there on it is as for linear agents (``affine_choices``, docs/theory/linear.md).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations, product

import numpy as np
from numpy.typing import NDArray

from ..cells import FloatArray, corner_sides, shape_text, to_places
from ..relations import AffineBoxes, WrittenRelation
from .affine_choices import FINALISTS, ROUGH_PARTS, AffineChoices, SubLattice, best_below
from .choices import StepPolicy
from .lattice_kernel import bend_of, block_of, blocks_of

LOOK = 0.37
"""Share of a lattice step that is added before a position is rounded down to the point where differences are read.

A half would make rounding decide, as positions on half steps are common; search and check have to read alike."""

BESIDE = 1.63
"""Lattice steps that the point where differences are read may be off the position, and one to the next point."""


@dataclass(frozen=True, eq=False, repr=False)
class WrittenChoices(AffineChoices):
    """What an agent with expressions can choose in each cell: inputs of a menu, by their numbers.

    Parameters
    ----------
    maps : AffineBoxes
        Means of all cells and choices, (S, A, ..).
    charged : tuple of float
        What second differences along each axis count for g below I: an eighth for normal noise, 0 for uniform noise.
    has_ends : bool
        Whether smoothed factors have columns for what uniform noise adds between lattice points.
    """

    maps: AffineBoxes | None = None
    charged: tuple[float, ...] = ()
    has_ends: bool = False

    def __repr__(self) -> str:
        inputs = len(self.relation.menu)
        return f"WrittenChoices({self.grid.n_cells} cells, {inputs} inputs, {shape_text(self.shape)} lattice points)"

    @cached_property
    def _sub_lattices(self) -> tuple[SubLattice, SubLattice]:
        """Where images are read: for lower bounds, and to choose by."""
        d = len(self.lattice)
        return SubLattice.of(d, self.relation.parts), SubLattice.of(d, 1 if d > 2 else ROUGH_PARTS)

    @property
    def reach(self) -> tuple[int, ...]:
        """Lattice steps along each axis within which largest differences are taken."""
        assert isinstance(self.relation, WrittenRelation)
        return self.relation.reach

    @cached_property
    def _maps(self) -> AffineBoxes:
        assert self.maps is not None
        return self.maps

    @cached_property
    def _admissible(self) -> NDArray[np.bool_]:
        """(S, A) whether the image of the cell is known and lies inside the lattice, what is left of it included."""
        known: NDArray[np.bool_] = np.all(np.isfinite(self._maps.centre), axis=2)
        position = (np.where(known[..., None], self._maps.centre, 0.0) - self.origin) / self.pitch
        return known & self._inside(position, self._extent)

    @cached_property
    def _extent(self) -> FloatArray:
        """(S, 1 or A, d) lattice steps from the middle of an image to its ends, what is left of means included."""
        half = np.einsum("sakj,sj->sak", np.abs(self._maps.gain), self.grid.half_widths)
        return (half + self._maps.rest) / self.pitch

    def _inside(self, position: FloatArray, extent: FloatArray) -> NDArray[np.bool_]:
        """Return which images lie inside: second differences are not known at the border of the lattice."""
        last = np.array(self.shape) - 1
        inside = (position - extent >= 1.0) & (position + extent <= last - 1.0)
        inside &= extent + BESIDE <= np.array(self.reach)
        return np.asarray(np.all(inside, axis=-1))

    def _own(self, numbers: FloatArray, cells: NDArray[np.int64], choices: NDArray) -> FloatArray:
        """Return what maps hold of cells (C,) under choices (C,)."""
        return np.asarray(numbers[cells, choices if numbers.shape[1] > 1 else 0])

    def centres(self, cells: NDArray[np.int64], policy: StepPolicy) -> FloatArray:
        """Return the means (C, d) of the centres of cells under choices (C,); far away where they are not known."""
        return np.nan_to_num(self._maps.centre[cells, policy], nan=np.finfo(float).max ** 0.25)

    def points(self, policy: StepPolicy) -> NDArray[np.int64]:
        """Return the lattice point nearest to the mean of each place (2^d S,); -1 where there is no choice.

        Masses are pushed to them: a heuristic.
        """
        cells, chosen = np.arange(self.grid.n_cells), np.maximum(policy, 0)
        flat = self._corners_of(cells, chosen).astype(np.int64)
        known = (policy >= 0) & self._admissible[cells, chosen]
        return to_places(np.where(known[:, None], flat, -1), self.grid.shape)

    def _corners_of(self, cells: NDArray[np.int64], choices: NDArray) -> NDArray[np.int32]:
        """Return the lattice points (C, 2^d) nearest to the images of the corners of cells, moved into the lattice."""
        sides = 2.0 * corner_sides(len(self.shape)) - 1.0
        reach = np.einsum("sij,sj,cj->sci", self._own(self._maps.gain, cells, choices), self._half[cells], sides)
        position = (self.centres(cells, choices)[:, None] + reach - self.origin) / self.pitch
        index = np.clip(np.nan_to_num(position), 0, np.array(self.shape) - 1)
        index = np.rint(index).astype(np.int64)
        return np.ravel_multi_index(tuple(np.moveaxis(index, 2, 0)), self.shape).astype(np.int32)

    @cached_property
    def _half(self) -> FloatArray:
        return np.asarray(self.grid.half_widths)

    def _of_images(
        self, table: FloatArray, cells: NDArray[np.int64], choices: NDArray, sub_lattice: SubLattice
    ) -> FloatArray:
        """Return lower bounds (n, C, 2^d) at the corners of cells (C,) under choices (C,)."""
        gains = self._own(self._maps.gain, cells, choices)
        rest = self._own(self._maps.rest, cells, choices) / self.pitch
        middle = (self.centres(cells, choices) - self.origin) / self.pitch
        inside = self._admissible[cells, choices]
        middle = np.where(inside[:, None], middle, 1.0)
        moved = gains * self._half[cells][:, None, :] / self.pitch[:, None]  # (C, i, k) in lattice steps
        moved = np.where(inside[:, None, None], moved, 0.0)
        values = self._interpolant(
            table, [middle[:, i, None] + moved[:, i] @ sub_lattice.points.T for i in range(len(self.shape))]
        )
        parts = round(len(sub_lattice.points) ** (1.0 / len(self.shape))) - 1
        lacking = self._lacking(table, middle, 2.0 * np.abs(moved) / parts, rest)
        lower = best_below(values, values[:, :, sub_lattice.corners], lacking, sub_lattice.interpolation)
        return lower * inside[:, None]

    def _interpolant(self, table: FloatArray, position: list[FloatArray]) -> FloatArray:
        """Return the interpolant (n, C, K) of values; positions, one (C, K) per axis, are in lattice steps."""
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
                row += weight * own.take(places)
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
        weights = [bend_of(steps[:, i]).sum(axis=1) + self.charged[i] for i in range(d)]
        weights += [0.25 * (steps[:, i] * steps[:, j]).sum(axis=1) for i, j in combinations(range(d), 2)]
        weights += [rest[:, i] for i in range(d)]
        weights += [np.ones(len(middle))] if self.has_ends else []
        lacking = np.empty((len(table), len(middle)))
        for row, own in zip(lacking, table, strict=True):
            row[:] = own[-1]
            for number, weight in enumerate(weights):
                row += weight * own.take(self.n_points + number * math.prod(blocks) + flat)
        return lacking

    def _inputs(self, weights: FloatArray, table: FloatArray, cells: NDArray[np.int64]) -> list[NDArray]:
        """Return the inputs (C,) of the largest weighted values at the corners' images, losses aside, best first."""
        names = np.full((FINALISTS, len(cells)), -1)
        scores = np.full((FINALISTS, len(cells)), -np.inf)
        for a in range(len(self.relation.menu)):
            corners, value = self._corner_table[a][cells], np.zeros(len(cells))
            for own, weight in zip(table, weights, strict=True):
                value += (weight * own.take(corners)).sum(axis=1)
            name, value = np.full(len(cells), a), np.where(self._admissible[cells, a], value, -np.inf)
            # Into the list of the best, which stays in order.
            for k in range(FINALISTS):
                better = value > scores[k]
                names[k], name = np.where(better, name, names[k]), np.where(better, names[k], name)
                scores[k], value = np.where(better, value, scores[k]), np.where(better, scores[k], value)
        return list(names)

    @cached_property
    def _corner_table(self) -> list[NDArray[np.int32]]:
        """Lattice points (S, 2^d) nearest to the images of corners, for every input."""
        cells = np.arange(self.grid.n_cells)
        return [self._corners_of(cells, np.full(len(cells), a)) for a in range(len(self.relation.menu))]

    @cached_property
    def resting_choice(self) -> StepPolicy:
        """(S,) choice whose mean stays nearest to the cell; -1 where there is none."""
        best, nearest = np.full(self.grid.n_cells, -1, dtype=np.int32), np.full(self.grid.n_cells, np.inf)
        cells = np.arange(self.grid.n_cells)
        for a in range(len(self.relation.menu)):
            away = (self.centres(cells, np.full(len(cells), a)) - self.grid.centres) / self.pitch
            distance = np.where(self._admissible[:, a], np.sum(away**2, axis=1), np.inf)
            closer = distance < nearest
            nearest, best = np.where(closer, distance, nearest), np.where(closer, a, best).astype(np.int32)
        return best
