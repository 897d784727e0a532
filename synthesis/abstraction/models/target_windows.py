"""Choices of agents whose every mean can be commanded: lattice points in a window around each cell."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....envs.systems.expressions import Number
from ...relations.grids import FloatArray, Grid, shape_text
from ...relations.kinds import ExactOnCells, ExactRelation, SymbolicOnCells, SymbolicTargets
from .action_tables import CELLS_PER_BLOCK, NUMBERS_PER_BLOCK, MeansAt, PointChoices, StepPolicy, bricks, largest

BAND_BYTES = 200_000_000
"""Memory for remembered bands of admissible targets, per agent model."""

AT_ONCE = 2_000_000
"""Most numbers of inputs that are compared at once."""

ZERO = Number(0.0)

Band = tuple[NDArray[np.int64], NDArray[np.bool_]]
"""Lattice points (N,) that some of a block of cells can choose, and which of them each cell can, (cells, N)."""


class WindowMemory:
    """What was computed of windows, for the next sweep; it changes no result, only how long one takes."""

    def __init__(self) -> None:
        self.bands: dict[bytes, Band] = {}
        self.bricks: dict[int, list[NDArray[np.int64]]] = {}
        self.size = 0

    def remember(self, key: bytes, band: Band) -> None:
        """Keep a band as long as all bands together stay below ``BAND_BYTES``."""
        if self.size + band[1].nbytes <= BAND_BYTES:
            self.bands[key] = band
            self.size += band[1].nbytes


@dataclass(frozen=True, eq=False, repr=False)
class TargetWindows(PointChoices):
    """Target means inside a window around each cell: the choice is the lattice point itself.

    Parameters
    ----------
    grid : Grid
    lattice : tuple of (Z_k,) arrays
        Lattice axes; a point is numbered in C order.
    relation : ExactRelation or WrittenTargets
    low, high : (S, d) int32 arrays
        Bounding box ``low <= index < high`` of the admissible targets of each cell.
    memory : WindowMemory
        What was computed of them.
    """

    grid: Grid
    lattice: tuple[FloatArray, ...]
    relation: ExactRelation | SymbolicTargets
    low: NDArray[np.int32]
    high: NDArray[np.int32]
    memory: WindowMemory = field(default_factory=WindowMemory, repr=False)

    def __repr__(self) -> str:
        sizes = np.prod(np.maximum(self.high - self.low, 0), axis=1)
        box = "" if self.relation.is_box else ", less the corners"
        windows = f"{int(sizes.min())} to {int(sizes.max())} targets per cell{box}"
        return f"TargetWindows({self.grid.n_cells} cells, {windows}, of {shape_text(self.shape)} lattice points)"

    @cached_property
    def _on_cells(self) -> ExactOnCells | SymbolicOnCells:
        """What inputs reach from the cells."""
        return self.relation.on(self.grid)

    def leaves(self, share: float) -> bool:
        """Return whether every cell leaves this share of all inputs for the target; neighbours are not counted."""
        return self._on_cells.leaves(share)

    def points(self, policy: StepPolicy) -> NDArray[Any]:
        """Return the lattice points of a policy: the policy itself."""
        return policy

    def admissible(self, cells: NDArray[Any], policy: NDArray[Any]) -> NDArray[np.bool_]:
        """Return whether flat lattice points ``policy`` are admissible targets of ``cells``; the two broadcast."""
        indices = np.unravel_index(policy, self.shape)
        targets = np.stack([axis[index] for axis, index in zip(self.lattice, indices, strict=True)], axis=-1)
        return self._on_cells.fits(cells, targets)

    def blocks(self, size: int) -> list[NDArray[np.int64]]:
        """Return all cells, in bricks of about ``size``: their windows have more in common than those of a line."""
        if size not in self.memory.bricks:
            self.memory.bricks[size] = bricks(self.grid.shape, size)
        return self.memory.bricks[size]

    def band(self, block: NDArray[np.int64]) -> Band:
        """Return the lattice points (N,) that some of a block of cells can choose, and which each can, (cells, N).

        The points are increasing. The band is remembered as long as all bands together stay below ``BAND_BYTES``.
        """
        key, count = block.tobytes(), len(block)
        if key in self.memory.bands:
            return self.memory.bands[key]
        low, high = self.low[block], self.high[block]
        nonempty = np.all(low < high, axis=1)
        if not nonempty.any():
            band = np.zeros(0, dtype=np.int64), np.zeros((count, 0), dtype=bool)
        else:
            # All points of the box around the windows, and which of them lie in the window of each cell.
            bounds = zip(low[nonempty].min(axis=0), high[nonempty].max(axis=0), strict=True)
            axes = [np.arange(a, b) for a, b in bounds]
            flat = np.ravel_multi_index(np.meshgrid(*axes, indexing="ij"), self.shape).ravel()
            allowed = np.ones((count, *(len(axis) for axis in axes)), dtype=bool)
            for k, axis in enumerate(axes):
                inside = (axis >= low[:, k, None]) & (axis < high[:, k, None])
                allowed &= inside.reshape(count, *(-1 if j == k else 1 for j in range(len(axes))))
            allowed = allowed.reshape(count, -1)
            # Windows are boxes around the admissible targets; unless these are boxes themselves, ask one by one.
            if not self.relation.is_box:
                allowed &= self.admissible(block[:, None], flat[None, :])
            used = allowed.any(axis=0)
            band = flat[used], allowed[:, used]
        self.memory.remember(key, band)
        return band

    @cached_property
    def axis_windows(self) -> tuple[tuple[NDArray[np.int32], NDArray[np.int32]], ...] | None:
        """Per axis the window (S_k,), (S_k,) of each of its cells, if windows are products of such; None otherwise."""
        if not self.relation.is_box:
            return None
        windows = []
        for k in range(len(self.lattice)):
            sides = []
            for side in (self.low, self.high):
                table = np.moveaxis(side[:, k].reshape(self.grid.shape), k, 0).reshape(self.grid.shape[k], -1)
                if np.any(table != table[:, :1]):
                    return None
                sides.append(table[:, 0])
            windows.append((sides[0], sides[1]))
        return tuple(windows)

    @cached_property
    def resting_choice(self) -> StepPolicy:
        """(S,) admissible target nearest to the cell itself; -1 where no target is admissible.

        The choice at cells, states and times for which nothing better is known; it makes every policy total.
        """
        targets = []
        for k, axis in enumerate(self.lattice):
            nearest = np.clip(np.searchsorted(axis, self.grid.centres[:, k]), 0, len(axis) - 1)
            targets.append(np.clip(nearest, self.low[:, k], self.high[:, k] - 1))
        empty = np.any(self.low >= self.high, axis=1)
        flat = np.ravel_multi_index([np.where(empty, 0, t) for t in targets], self.shape)
        admissible = ~empty & self.admissible(np.arange(self.grid.n_cells), flat)
        return np.where(admissible, flat, -1).astype(np.int32)

    def _of_one_objective(self, values: FloatArray) -> NDArray[np.int64] | None:
        """Return the largest points of the windows, where these are products: their maximum slides."""
        if self.axis_windows is None:
            return None
        return sliding_argmax(values.reshape(self.shape), self.axis_windows)

    def _blocks(self, idle: NDArray[np.bool_], table: Any) -> list[NDArray[np.int64]]:
        """Return bricks of cells in which something weighs."""
        on_device = not isinstance(table, np.ndarray)
        size = max(CELLS_PER_BLOCK, NUMBERS_PER_BLOCK // table.shape[1]) if on_device else CELLS_PER_BLOCK
        return [block for block in self.blocks(size) if not idle[block].all()]

    def _best_of(self, block: NDArray[Any], weights: Any, table: Any) -> tuple[NDArray[Any], FloatArray]:
        """Return argmax and maximum of the objective over the windows of a block of cells."""
        flat, allowed = self.band(block)
        if len(flat) == 0:
            return np.full(len(allowed), -1), np.full(len(allowed), -np.inf)
        first, value = largest(np.where(allowed, weights @ table[:, flat], -np.inf))
        return np.where(np.isfinite(value), flat[first], -1), value

    def nearest(self, means_at: MeansAt) -> StepPolicy:
        """Return the admissible target (S,) of each cell that is nearest to the mean at its centre, in cell widths."""
        return self.nearest_to(means_at(self.grid.centres))

    def nearest_to(self, means: FloatArray) -> StepPolicy:
        """Return the admissible targets (S,) nearest to means (d, S).

        The nearest point of the window along each axis; where that is not admissible, the whole window is searched.
        """
        scale = self.cell_widths
        indices = []
        for k, axis in enumerate(self.lattice):
            # the two lattice points around the mean, the nearer of them, and then the nearest one inside the window
            above = np.clip(np.searchsorted(axis, means[k]), 1, max(1, len(axis) - 1))
            below = above - 1
            above = np.minimum(above, len(axis) - 1)
            near = np.where(means[k] - axis[below] <= axis[above] - means[k], below, above)
            indices.append(np.clip(near, self.low[:, k], np.maximum(self.high[:, k] - 1, self.low[:, k])))
        empty = np.any(self.low >= self.high, axis=1)
        targets = np.ravel_multi_index([np.where(empty, 0, index) for index in indices], self.shape)
        targets = np.where(empty, -1, targets)
        # the admissible targets need not fill the window: it is a box around them
        refused = np.flatnonzero(~empty & ~self.admissible(np.arange(len(targets)), np.maximum(targets, 0)))
        for s in refused:
            targets[s] = self._searched(int(s), means[:, s], scale)
        return targets.astype(np.int32)

    def _searched(self, cell: int, mean: FloatArray, scale: FloatArray) -> int:
        """Return the nearest admissible target of one cell in its whole window, or -1."""
        ranges = [np.arange(a, b) for a, b in zip(self.low[cell], self.high[cell], strict=True)]
        mesh = [indices.ravel() for indices in np.meshgrid(*ranges, indexing="ij")]
        flat = np.ravel_multi_index(mesh, self.shape)
        admissible = self.admissible(np.full(len(flat), cell), flat)
        if not admissible.any():
            return -1
        gaps = np.zeros(len(flat))
        for axis, indices, goal, width in zip(self.lattice, mesh, mean, scale, strict=True):
            gaps += ((axis[indices] - goal) / width) ** 2
        return int(flat[np.where(admissible, gaps, np.inf).argmin()])

    def carried(self, before: TargetWindows, policy: NDArray[np.int32]) -> NDArray[np.int32]:
        """Return a policy (T, Q, S) of the targets nearest to those of one on other cells."""
        carried = np.empty_like(policy)
        for t, q in np.ndindex(policy.shape[:2]):  # one after the other, to spare memory
            carried[t, q] = self.nearest_targets(before, policy[t, q])
        return carried

    def nearest_targets(self, before: TargetWindows, policy: StepPolicy) -> StepPolicy:
        """Return the admissible targets (S,) nearest to those (S,) of other windows."""
        index = np.unravel_index(np.maximum(policy, 0), before.shape)
        nearest = np.empty((len(policy), len(self.lattice)), dtype=np.int64)
        for k, (axis, coarse) in enumerate(zip(self.lattice, before.lattice, strict=True)):
            target = coarse[index[k]]
            after = np.clip(np.searchsorted(axis, target), 1, len(axis) - 1)
            nearest[:, k] = after - (target - axis[after - 1] < axis[after] - target)
        clipped = np.clip(nearest, self.low, np.maximum(self.high - 1, self.low))
        flat = np.ravel_multi_index(tuple(np.clip(clipped, 0, np.array(self.shape) - 1).T), self.shape)
        fits = (policy >= 0) & np.all(self.low < self.high, axis=1)
        fits &= self.admissible(np.arange(len(flat)), flat)
        return np.where(fits, flat, self.resting_choice).astype(np.int32)

    def is_settled(self, share: float) -> bool:
        """Return whether every cell has a target, and leaves this share of all inputs to it."""
        return not np.any(self.resting_choice < 0) and self.leaves(share)

    @property
    def dense_cost(self) -> int | None:
        """Number of targets of the widest window; None where admissible targets are no boxes."""
        if not self.relation.is_box:
            return None
        return int(np.prod(np.maximum(self.high - self.low, 0), axis=1).max(initial=0))

    def dense_best(self, values: FloatArray) -> FloatArray:
        """Return the largest (n, S) of values (n, Z) over the windows, cell by cell."""
        best = np.zeros((len(values), self.grid.n_cells))
        tensor = values.reshape(-1, *self.shape)
        for s in range(self.grid.n_cells):
            window = tuple(slice(a, b) for a, b in zip(self.low[s], self.high[s], strict=True))
            offered = tensor[(slice(None), *window)].reshape(len(tensor), -1)
            if offered.shape[1]:
                best[:, s] = offered.max(axis=1)
        return best


def windows_of(
    mean_targets: ExactRelation | SymbolicTargets, grid: Grid, lattice: tuple[FloatArray, ...]
) -> TargetWindows:
    """Return the lattice points that each cell can choose."""
    if isinstance(mean_targets, SymbolicTargets):
        return written_windows(mean_targets, grid, lattice)
    return target_windows(mean_targets, grid, lattice)


def target_windows(relation: ExactRelation, grid: Grid, lattice: tuple[FloatArray, ...]) -> TargetWindows:
    """Return the admissible targets of the ``exact`` relation; windows are empty where the reserve uses up the inputs.

    ``z - mean = B v`` with ``|v|_j <= reserve_j`` bounds each axis; for a scaled permutation the box is the window.
    """
    means, reserve = relation.means(grid.centres), relation.reserve(grid.half_widths)
    reach = np.maximum(reserve, 0.0) @ np.abs(relation.B).T
    low, high = np.empty(means.shape, dtype=np.int32), np.empty(means.shape, dtype=np.int32)
    for k, axis in enumerate(lattice):
        low[:, k] = np.searchsorted(axis, means[:, k] - reach[:, k], side="left")
        high[:, k] = np.searchsorted(axis, means[:, k] + reach[:, k], side="right")
        # The search above rounds. Move its ends by one where the inequality that decides everywhere refuses them.
        if relation.is_box:
            j = int(np.flatnonzero(relation.right_inverse[:, k])[0])
            gain = abs(relation.right_inverse[j, k])
            for index, step in ((low, 1), (high, -1)):
                edge = np.clip(index[:, k] if step == 1 else index[:, k] - 1, 0, len(axis) - 1)
                index[:, k] += step * (np.abs(axis[edge] - means[:, k]) * gain > reserve[:, j])
    high = np.where(np.any(reserve < 0, axis=1)[:, None], low, high)
    return TargetWindows(grid, lattice, relation, low, high)


def written_windows(relation: SymbolicTargets, grid: Grid, lattice: tuple[FloatArray, ...]) -> TargetWindows:
    """Return the admissible targets of agents with expressions: first a box around them, then what fits in it.

    Where every axis has an input of its own the admissible targets are a box: its sides are found axis by axis.
    """
    asked = relation.asked_on(grid.edges)
    reach = relation.reach(grid.centres)
    low, high = np.empty(asked.centre.shape, dtype=np.int32), np.empty(asked.centre.shape, dtype=np.int32)
    for k, axis in enumerate(lattice):
        low[:, k] = np.searchsorted(axis, asked.centre[:, k] - reach[:, k], side="left")
        high[:, k] = np.searchsorted(axis, asked.centre[:, k] + reach[:, k], side="right")
        if relation.is_box:
            low[:, k], high[:, k] = _fitting(relation, grid, k, axis, low[:, k], high[:, k])
    known = np.all(np.isfinite(asked.middle), axis=(0, 2))
    high = np.where(known[:, None], high, low)
    return TargetWindows(grid, lattice, relation, low, high)


def _fitting(
    relation: SymbolicTargets,
    grid: Grid,
    k: int,
    axis: FloatArray,
    low: NDArray[np.int32],
    high: NDArray[np.int32],
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Return the window (S,), (S,) of lattice points of one axis, between given ones, that the input of this axis fits.

    Nothing is left of a window with a gap: enclosures of one input are affine on either side of the middle, so only
    rounding can make one.
    """
    asked, width = relation.asked_on(grid.edges), int(np.max(high - low, initial=0))
    j = int(np.flatnonzero([row[k] != ZERO for row in relation.inverse])[0])
    first, last = low.copy(), low.copy()
    for cells in np.array_split(np.arange(len(low)), 1 + len(low) * width * len(relation.inverse) ** 2 // AT_ONCE):
        index = low[cells, None] + np.arange(width)
        targets = np.repeat(asked.centre[cells, None], width, axis=1)
        targets[..., k] = axis[np.minimum(index, len(axis) - 1)]
        fits = (index < high[cells, None]) & relation.fits(asked.of(cells[:, None], targets), (j,))
        if width:
            begin, end = fits.argmax(axis=1), width - fits[:, ::-1].argmax(axis=1)
            whole = fits.any(axis=1) & (fits.sum(axis=1) == end - begin)
            first[cells], last[cells] = low[cells] + begin, np.where(whole, low[cells] + end, low[cells] + begin)
    return first, last


def sliding_argmax(values: FloatArray, windows: Sequence[tuple[NDArray[Any], NDArray[Any]]]) -> NDArray[np.int64]:
    """Return the flat argmax (S,) of a tensor (Z_1, .., Z_d) over products of windows; -1 for empty ones.

    The maximum over a product is taken along one axis after the other; the first of equal maxima along each counts.
    """
    # `flat` goes along with the values: after the last axis it holds the point of each maximum.
    flat = np.arange(values.size).reshape(values.shape)
    for axis, (low, high) in enumerate(windows):
        # Bring the axis to the end and take the argmax over its windows, row by row.
        lead = np.moveaxis(values, axis, -1)
        shape = lead.shape[:-1]
        chosen = _sliding_rows(np.ascontiguousarray(lead).reshape(-1, lead.shape[-1]), low, high)
        points = np.moveaxis(flat, axis, -1).reshape(chosen.shape[0], -1)
        rows = np.arange(len(chosen))[:, None]
        # Read value and point there; an axis of lattice points has become one of cells.
        empty = chosen < 0
        best = np.where(empty, -np.inf, lead.reshape(len(chosen), -1)[rows, np.maximum(chosen, 0)])
        point = np.where(empty, -1, points[rows, np.maximum(chosen, 0)])
        values = np.moveaxis(best.reshape(*shape, -1), -1, axis)
        flat = np.moveaxis(point.reshape(*shape, -1), -1, axis)
    return flat.ravel()


def _sliding_rows(values: FloatArray, low: NDArray[Any], high: NDArray[Any]) -> NDArray[np.int64]:
    """Return the first argmax (R, S) of every row of values (R, Z) over windows ``low[s] .. high[s] - 1``.

    A sparse table: level k holds the argmax of every run of ``2^k`` points, and two overlapping runs cover a window.
    """
    # The largest power of two that fits into each window.
    width = np.maximum(high - low, 0)
    positive = width > 0
    level = np.zeros(len(low), dtype=int)
    level[positive] = np.floor(np.log2(width[positive])).astype(int)
    result = np.full((len(values), len(low)), -1, dtype=np.int64)
    rows = np.arange(len(values))[:, None]
    table = np.broadcast_to(np.arange(values.shape[1]), values.shape)
    for k in range(int(level.max(initial=0)) + 1):
        # A run of 2^k points consists of two runs of 2^(k-1).
        if k:
            half = 1 << (k - 1)
            left, right = table[:, :-half], table[:, half:]
            table = np.where(values[rows, left] >= values[rows, right], left, right)
        here = positive & (level == k)
        if here.any():
            a, b = table[:, low[here]], table[:, high[here] - (1 << k)]
            result[:, here] = np.where(values[rows, a] >= values[rows, b], a, b)
    return result
