"""Choices of linear agents: affine maps of the mean, their values at the corners of cells, and the best of them.

The value of a cell under a choice is a lower bound of ``f(x) = g(m(x))`` on the whole cell that is multilinear again.
With f at the points of a sub-lattice of the image, c the values at its corners, I their interpolant and ``bend`` an
upper bound on how far f may be below the interpolation between the points of the sub-lattice, each of these is one:

    c - E,        E = max (I - f)^+ + bend,        if no corner becomes negative;
    theta c,      theta = min (f - bend)^+ / I;
    the constant  min (f - bend)^+ .

Setting single negative corners to 0 would be wrong. The best of the three, by its mean, is taken for every cell and
factor (docs/theory/linear.md, "The loss"). A gain of 0 costs nothing: the value is that of one lattice point.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from itertools import product

import numpy as np
from numpy.typing import NDArray

from ..cells import FloatArray, Grid, corner_sides, of_cells, shape_text, to_places
from ..relations import LinearRelation
from .box_choices import BoxChoices
from .choices import InputMenu, StepPolicy, TargetWindows, target_windows

ON_LATTICE = 4e-9
"""Share of a lattice step within which a point counts as one of the lattice; bends allow for it."""

NUMBERS_AT_ONCE = 4_000_000
"""Numbers of factors at points that are formed at once: 32 MB."""

ROUGH_PARTS = 2
"""Parts of each side of an image at which it is read to choose a policy."""

FINALISTS = 2
"""Inputs of a menu whose loss is computed before one is chosen."""

LEAST_SHARE = 1e-12
"""Share of the largest weight below which a cell is not worth a decision: it keeps what it has."""

DRAW = 1.0 - 1e-6
"""Share of the mean of another lower bound from which the earlier form is taken."""

PREFERENCE = 1e-9
"""Relative improvement below which the incumbent stays."""


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


@dataclass(frozen=True, eq=False, repr=False)
class AffineChoices:
    """What a linear agent can choose in each cell.

    A choice is a number: ``gain * Z + point`` for agents that choose lattice points z and gains, the number of an
    input for all others.

    Parameters
    ----------
    grid : Grid
    lattice : tuple of (Z_k,) arrays
        Evenly spaced lattice axes.
    relation : LinearRelation
    per_cell : int
        Lattice points per cell and axis.
    windows : tuple of TargetWindows
        By gain, the lattice points that each cell can choose; empty for menus.
    """

    grid: Grid
    lattice: tuple[FloatArray, ...]
    relation: LinearRelation
    per_cell: int
    windows: tuple[TargetWindows, ...] = ()
    memory: dict[str, object] = field(default_factory=dict, repr=False)

    def __repr__(self) -> str:
        of_each = f"{len(self.windows)} gains" if self.windows else f"{len(self.relation.menu)} inputs"
        return f"AffineChoices({self.grid.n_cells} cells, {of_each}, {shape_text(self.shape)} lattice points)"

    @property
    def n_places(self) -> int:
        """Number of places 2^d S."""
        return self.grid.n_cells * 2 ** len(self.lattice)

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
    def pitch(self) -> FloatArray:
        """Lattice steps (d,)."""
        return np.array(
            [(axis[-1] - axis[0]) / max(1, len(axis) - 1) if len(axis) > 1 else 1.0 for axis in self.lattice]
        )

    @cached_property
    def _sub_lattices(self) -> tuple[SubLattice, SubLattice]:
        """Where images are read: for lower bounds, and to choose by."""
        d, parts = len(self.lattice), self.relation.parts
        return SubLattice.of(d, parts), SubLattice.of(d, min(parts, ROUGH_PARTS))

    def centres(self, cells: NDArray[np.int64], policy: StepPolicy) -> FloatArray:
        """Return the means (C, d) of the centres of cells under choices (C,)."""
        if self.windows:
            index = np.unravel_index(policy % self.n_points, self.shape)
            return np.stack([axis[k] for axis, k in zip(self.lattice, index, strict=True)], axis=1)
        relation = self.relation
        return self.grid.centres[cells] @ relation.A.T + relation.offset + relation.menu[policy] @ relation.B.T

    def points(self, policy: StepPolicy) -> NDArray[np.int64]:
        """Return the lattice points nearest to the means of all places (2^d S,); -1 where there is no choice.

        Masses are pushed to them. This is a heuristic where means lie between lattice points.
        """
        cells = np.arange(self.grid.n_cells)
        chosen = np.maximum(policy, 0)
        sides = 2.0 * corner_sides(len(self.lattice)) - 1.0
        gains = self._gains_of(chosen)
        reach = np.einsum("sij,sj,cj->sci", gains, self.grid.half_widths, sides)
        index = np.rint((self.centres(cells, chosen)[:, None] + reach - self.origin) / self.pitch).astype(np.int64)
        inside = np.all((index >= 0) & (index < np.array(self.shape)), axis=2) & (policy >= 0)[:, None]
        flat = np.ravel_multi_index(tuple(np.moveaxis(np.where(inside[..., None], index, 0), 2, 0)), self.shape)
        return to_places(np.where(inside, flat, -1), self.grid.shape)

    def _gains_of(self, policy: NDArray) -> FloatArray:
        """Return the gain matrices (C, d, d) of choices (C,)."""
        number = policy // self.n_points if self.windows else np.zeros(len(policy), dtype=np.int64)
        return self.relation.gains[number]

    def read(self, table: FloatArray, policy: StepPolicy, rough: bool = False) -> FloatArray:
        """Return lower bounds (n, 2^d S) at all places under a policy, from values and bends (n, 2 Z).

        Images are read at few points if ``rough``: about right, and no bounds.
        """
        cells = np.flatnonzero(policy >= 0)
        values = np.zeros((len(table), self.grid.n_cells, 2 ** len(self.lattice)))
        values[:, cells] = self.at(table, cells, policy[cells], rough)
        return to_places(values, self.grid.shape)

    def at(self, table: FloatArray, cells: NDArray[np.int64], choices: NDArray, rough: bool = False) -> FloatArray:
        """Return lower bounds (n, C, 2^d) at the corners of cells (C,) under choices (C,); about right if ``rough``."""
        sub_lattice = self._sub_lattices[rough]
        values = np.empty((len(table), len(cells), 2 ** len(self.lattice)))
        fixed = self._is_fixed(choices)
        values[:, fixed] = table[:, choices[fixed] % self.n_points][..., None]
        for rows in self._chunks(np.flatnonzero(~fixed), len(table) * len(sub_lattice.points)):
            values[:, rows] = self._of_images(table, cells[rows], choices[rows], sub_lattice)
        return values

    def _is_fixed(self, choices: NDArray) -> NDArray[np.bool_]:
        """Return which choices put the mean on one lattice point for the whole cell."""
        return choices < self.n_points if self.windows else np.zeros(len(choices), dtype=bool)

    def _chunks(self, rows: NDArray[np.int64], numbers: int) -> Iterator[NDArray[np.int64]]:
        """Return rows in parts that form few numbers at once."""
        if len(rows):
            yield from np.array_split(rows, len(rows) * numbers // NUMBERS_AT_ONCE + 1)

    def _of_images(
        self, table: FloatArray, cells: NDArray[np.int64], choices: NDArray, sub_lattice: SubLattice
    ) -> FloatArray:
        """Return the same for choices whose means move with the state."""
        gains = self._gains_of(choices)
        offsets = np.einsum("sij,sj,kj->ski", gains, self.grid.half_widths[cells], sub_lattice.points)
        positions = (self.centres(cells, choices)[:, None] + offsets - self.origin) / self.pitch
        values, bend, inside = self._interpolated(table, positions)
        corners = values[:, :, sub_lattice.corners]
        lower = best_below(values, corners, bend, sub_lattice.interpolation)
        # An image that leaves the lattice is not known there: the value of its cell is 0.
        return lower * inside[:, None]

    def _interpolated(self, table: FloatArray, positions: FloatArray) -> tuple[FloatArray, FloatArray, NDArray]:
        """Return values (n, C, K) at positions (C, K, d), largest bends (n, C), and which images are inside (C,).

        Positions are in lattice steps. Between lattice points values are interpolated; bends say by how much they may
        be too large.
        """
        shape = np.array(self.shape)
        nearest = np.rint(positions)
        on_lattice = np.abs(positions - nearest) <= ON_LATTICE
        base = np.where(on_lattice, nearest, np.floor(positions)).astype(np.int64)
        share = np.where(on_lattice, 0.0, positions - base)
        needs_next = (~on_lattice).any(axis=(0, 1))
        inside = np.all((base >= 0) & (base + ~on_lattice < shape), axis=(1, 2))
        base = np.where(inside[:, None, None], base, 0)
        values = np.zeros((len(table), *positions.shape[:2]))
        bend = np.zeros((len(table), len(positions)))
        # Axes on which everything is on the lattice need no neighbour.
        for corner in product(*((0, 1) if needed else (0,) for needed in needs_next)):
            index = np.minimum(base + np.array(corner), shape - 1)
            flat = np.ravel_multi_index(tuple(np.moveaxis(index, 2, 0)), self.shape)
            weight = np.prod(np.where(corner, share, 1.0 - share), axis=2)
            # Cells last in memory: what follows goes over the few points of each.
            across = flat.T.ravel()
            shape_in_memory = (len(table), flat.shape[1], flat.shape[0])
            read = np.take(table, across, axis=1).reshape(shape_in_memory).transpose(0, 2, 1)
            lacking = np.take(table, self.n_points + across, axis=1).reshape(shape_in_memory).transpose(0, 2, 1)
            if needs_next.any():
                read *= weight
                lacking *= weight > 0
                values += read
            else:
                values = read
            np.maximum(bend, lacking.max(axis=2), out=bend)
        return values, bend, inside

    def best(self, weights: FloatArray, table: FloatArray, incumbent: StepPolicy) -> StepPolicy:
        """Return the choices (S,) of the largest weighted value, losses taken off; the incumbent stays among equals.

        Parameters
        ----------
        weights : (2^d S, n) array
            Weights of the objectives at all places.
        table : (n, 2 Z) array
            Values and bends of every lattice point under each objective.
        incumbent : (S,) int32 array
        """
        at_corners = of_cells(weights.T, self.grid.shape)  # (n, S, 2^d)
        heavy = at_corners.sum(axis=(0, 2))
        cells = np.flatnonzero((heavy > LEAST_SHARE * heavy.max(initial=0.0)) | (incumbent < 0))
        result = incumbent.copy()
        if not len(cells) or not heavy.any():
            return result
        here = np.ascontiguousarray(at_corners[:, cells])
        finalists = self._targets(here, table, cells, incumbent) if self.windows else self._inputs(here, table, cells)
        current = incumbent[cells]
        best, score = current.copy(), self._score(here, table, cells, current) * (1.0 + PREFERENCE)
        for candidate in finalists:
            value = self._score(here, table, cells, candidate)
            better = (candidate >= 0) & ((best < 0) | (value > score))
            best, score = np.where(better, candidate, best), np.where(better, value, score)
        result[cells] = best
        return result

    def _score(self, weights: FloatArray, table: FloatArray, cells: NDArray[np.int64], choices: NDArray) -> FloatArray:
        """Return weighted values (C,) of choices with their losses; minus infinity where there is no choice."""
        score = np.full(len(cells), -np.inf)
        for rows in self._chunks(np.flatnonzero(choices >= 0), len(table) * len(self._sub_lattices[True].points)):
            values = self.at(table, cells[rows], choices[rows], rough=True)
            score[rows] = np.einsum("nsc,nsc->s", weights[:, rows], values)
        return score

    def _targets(
        self, weights: FloatArray, table: FloatArray, cells: NDArray[np.int64], incumbent: StepPolicy
    ) -> list[NDArray]:
        """Return, for each gain, the best lattice point of cells with weights (n, C, 2^d): coarse first, then fine."""
        total = np.ascontiguousarray(weights.sum(axis=2).T)
        finalists = []
        for gain, windows in enumerate(self.windows):
            points = self._coarse(gain, total, table, cells)
            # Resting choices stand in where no coarse point is admissible, and where the window is narrow.
            resting = windows.resting_choice[cells]
            points = np.where(points < 0, resting, points)
            if gain == 0:
                current = incumbent[cells]
                points = np.where(points < 0, np.where(current < self.n_points, current, -1), points)
            step = max(1, self.per_cell // 2)
            while True:
                points = self._refined(gain, weights, total, table, cells, points, step)
                if step == 1:
                    break
                step = max(1, step // 2)
            finalists.append(np.where(points >= 0, points + gain * self.n_points, -1))
        return finalists

    def _coarse(self, gain: int, total: FloatArray, table: FloatArray, cells: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return the best point of each cell (C,) on every ``per_cell``-th lattice point; -1 where there is none."""
        windows, fine = self._coarse_windows(gain)
        values = np.ascontiguousarray(table[:, : self.n_points][:, fine])
        weights = np.zeros((self.grid.n_cells, len(table)))
        weights[cells] = total
        wanted = np.zeros(self.grid.n_cells, dtype=bool)
        wanted[cells] = True
        best = np.full(self.grid.n_cells, -1, dtype=np.int64)
        for block in windows.blocks(64):
            if not wanted[block].any():
                continue
            flat, allowed = windows.band(block)
            if len(flat):
                scores = np.where(allowed, weights[block] @ values[:, flat], -np.inf)
                first = scores.argmax(axis=1)
                best[block] = np.where(allowed[np.arange(len(block)), first], fine[flat[first]], -1)
        return best[cells]

    def _coarse_windows(self, gain: int) -> tuple[TargetWindows, NDArray[np.int64]]:
        """Return the windows on every ``per_cell``-th lattice point, and which lattice points these are."""
        key = f"coarse {gain}"
        if key not in self.memory:
            first = self.per_cell // 2
            index = [np.arange(first, n, self.per_cell) if n > first else np.arange(1) for n in self.shape]
            lattice = tuple(axis[k] for axis, k in zip(self.lattice, index, strict=True))
            fine = np.ravel_multi_index(np.meshgrid(*index, indexing="ij"), self.shape).ravel()
            self.memory[key] = target_windows(self.relation.steers[gain], self.grid, lattice), fine
        return self.memory[key]  # type: ignore[return-value]

    def _refined(
        self,
        gain: int,
        weights: FloatArray,
        total: FloatArray,
        table: FloatArray,
        cells: NDArray[np.int64],
        points: NDArray[np.int64],
        step: int,
    ) -> NDArray[np.int64]:
        """Return the best of each point and its neighbours ``step`` away that its cell can choose, losses aside."""
        windows, shape = self.windows[gain], np.array(self.shape)
        present = np.maximum(points, 0)
        index = np.stack(np.unravel_index(present, self.shape), axis=1)
        low, high = windows.low[cells], windows.high[cells] - 1
        corners = self._corner_steps if gain else np.zeros((1, len(shape)), dtype=np.int64)
        best, score = points.copy(), np.full(len(cells), -np.inf)
        moves = sorted(product((-step, 0, step), repeat=len(shape)), key=lambda move: sum(map(abs, move)))
        for move in moves:
            moved = np.clip(index + np.array(move), low, np.maximum(high, low))
            flat = np.ravel_multi_index(tuple(np.clip(moved, 0, shape - 1).T), self.shape)
            allowed = (points >= 0) & np.all((low <= moved) & (moved <= high), axis=1)
            if not windows.relation.is_box:
                allowed &= windows.admissible(cells, flat)
            if gain:
                at = [np.ravel_multi_index(tuple(np.clip(moved + c, 0, shape - 1).T), self.shape) for c in corners]
                value = sum(np.einsum("ns,ns->s", weights[:, :, j], table[:, a]) for j, a in enumerate(at))
            else:
                value = np.einsum("sn,ns->s", total, table[:, flat])
            better = allowed & (value > score)
            best, score = np.where(better, flat, best), np.where(better, value, score)
        return best

    @cached_property
    def _corner_steps(self) -> NDArray[np.int64]:
        """Lattice steps (2^d, d) from the centre of a cell to its corners, rounded."""
        half = np.median(self.grid.half_widths, axis=0)
        sides = 2 * corner_sides(len(self.lattice)) - 1
        return np.rint(sides * half / self.pitch).astype(np.int64)

    def _inputs(self, weights: FloatArray, table: FloatArray, cells: NDArray[np.int64]) -> list[NDArray]:
        """Return the inputs (C,) of the largest weighted values at the corners' images, losses aside, best first."""
        n_inputs, shape = len(self.relation.menu), np.array(self.shape)
        sides = 2.0 * corner_sides(len(self.lattice)) - 1.0
        reach = np.einsum("ij,sj,cj->sci", self.relation.A, self.grid.half_widths[cells], sides)
        scores = np.empty((n_inputs, len(cells)))
        for a in range(n_inputs):
            centre = self.centres(cells, np.full(len(cells), a))
            index = np.rint((centre[:, None] + reach - self.origin) / self.pitch).astype(np.int64)
            inside = np.all((index >= 0) & (index < shape), axis=(1, 2))
            flat = np.ravel_multi_index(tuple(np.moveaxis(np.clip(index, 0, shape - 1), 2, 0)), self.shape)
            value = np.zeros(len(cells))
            for rows in self._chunks(np.flatnonzero(inside), len(table) * flat.shape[1]):
                value[rows] = np.einsum("nsc,nsc->s", weights[:, rows], table[:, flat[rows]])
            scores[a] = value
        order = np.argsort(-scores, axis=0, kind="stable")
        return [order[k].astype(np.int64) for k in range(min(FINALISTS, n_inputs))]

    @cached_property
    def resting_choice(self) -> StepPolicy:
        """(S,) choice whose mean stays nearest to the cell; -1 where there is none."""
        if not self.windows:
            means = self.grid.centres @ self.relation.A.T + self.relation.offset
            moved = means[:, None] + (self.relation.menu @ self.relation.B.T)[None] - self.grid.centres[:, None]
            return np.argmin(np.sum((moved / self.pitch) ** 2, axis=2), axis=1).astype(np.int32)
        # The gain of 1 where it has a target, since it keeps more of the inputs; else that of 0.
        fixed, follows = (windows.resting_choice for windows in self.windows)
        return np.where(fixed >= 0, fixed, np.where(follows >= 0, follows + self.n_points, -1)).astype(np.int32)


Choices = TargetWindows | InputMenu | AffineChoices | BoxChoices
"""What can be chosen in each cell."""


def best_below(values: FloatArray, corners: FloatArray, bend: FloatArray, interpolation: FloatArray) -> FloatArray:
    """Return lower bounds (n, C, 2^d) at the corners of cells, of which the interpolants are below f everywhere.

    Parameters
    ----------
    values : (n, C, K) array
        f at the points of the sub-lattice.
    corners : (n, C, 2^d) array
        f at the corners.
    bend : (n, C) array
        How far f may be below the interpolation between neighbouring points of the sub-lattice.
    interpolation : (2^d, K) array
    """
    between = corners @ interpolation
    least = np.maximum(values - bend[..., None], 0.0)
    constant = least.min(axis=2)
    # Additive: admissible only if all corners stay nonnegative.
    shift = np.maximum(between - values, 0.0).max(axis=2) + bend
    additive = corners - shift[..., None]
    fits = np.all(additive >= 0.0, axis=2)
    # Multiplicative: the smallest ratio; where nothing is there to be scaled it does not matter.
    ratio = np.divide(least, between, out=np.ones_like(between), where=between > 0.0)
    theta = np.minimum(ratio.min(axis=2), 1.0) * (1.0 - 1e-15)
    mean = corners.mean(axis=2)
    by_shift = np.where(fits, mean - shift, -1.0)
    by_theta = theta * mean
    # Where the worst point is the centre, two forms have the same mean: rounding must not decide between them.
    best = np.where((by_theta >= DRAW * constant)[..., None], theta[..., None] * corners, constant[..., None])
    return np.where((by_shift >= DRAW * np.maximum(by_theta, constant))[..., None], additive, best)
