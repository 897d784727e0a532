"""What an abstract agent can choose between in each cell.

A policy for one step, (S,), gives one choice per cell; -1 where there is none. ``points`` turns it into the lattice
points (means) that the kernel table is read at: the distribution of the next state depends on the point alone.

``TargetWindows``  the choice is the lattice point itself (``exact`` relation: every mean can be commanded); the
                   admissible points lie in a window around each cell.
``InputMenu``      the choice is one of A abstract inputs, each of which leads to a lattice point.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...envs.agents import counted
from ...envs.expressions import Number
from ..cells import FloatArray, Grid, shape_text
from ..relations import ExactRelation, WrittenTargets
from ..values import Array, Residents, beside

StepPolicy = NDArray[np.int32]
"""(S,) choice of each cell for one step; -1 for none."""

Policies = tuple[NDArray[np.int32], ...]
"""Per agent (T, Q, S_i): choice of each cell by time and automaton state; -1 where none is admissible."""

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
        self.kept: set[int] = set()
        self.residents = Residents()

    def remember(self, key: bytes, band: Band) -> None:
        """Keep a band as long as all bands together stay below ``BAND_BYTES``."""
        if self.size + band[1].nbytes <= BAND_BYTES:
            self.bands[key] = band
            self.size += band[1].nbytes
            self.kept.add(id(band[1]))

    def beside(self, allowed: NDArray[np.bool_], reference: Array) -> Array:
        """Return which points are allowed, on the device of another array; remembered bands are copied once."""
        is_remembered = id(allowed) in self.kept
        return self.residents.beside(allowed, reference) if is_remembered else beside(allowed, reference)


@dataclass(frozen=True, eq=False, repr=False)
class TargetWindows:
    """Target means inside a window around each cell.

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
    relation: ExactRelation | WrittenTargets
    low: NDArray[np.int32]
    high: NDArray[np.int32]
    memory: WindowMemory = field(default_factory=WindowMemory, repr=False)

    def __repr__(self) -> str:
        sizes = np.prod(np.maximum(self.high - self.low, 0), axis=1)
        box = "" if self.relation.is_box else ", less the corners"
        windows = f"{int(sizes.min())} to {int(sizes.max())} targets per cell{box}"
        return f"TargetWindows({self.grid.n_cells} cells, {windows}, of {shape_text(self.shape)} lattice points)"

    @property
    def shape(self) -> tuple[int, ...]:
        """Lattice points per axis."""
        return tuple(len(axis) for axis in self.lattice)

    @cached_property
    def _reserve(self) -> FloatArray:
        """(S, m) input half widths left for the target in each cell."""
        assert isinstance(self.relation, ExactRelation)
        return self.relation.reserve(self.grid.half_widths)

    @cached_property
    def _central_means(self) -> FloatArray:
        """(S, d) mean from the cell centre under the central input."""
        assert isinstance(self.relation, ExactRelation)
        return self.relation.means(self.grid.centres)

    def leaves(self, share: float) -> bool:
        """Return whether every cell leaves this share of all inputs for the target; neighbours are not counted."""
        if isinstance(self.relation, WrittenTargets):
            return self.relation.leaves(share, self.grid.edges)
        return bool(np.all(self._reserve >= share * self.relation.input_half_width))

    def points(self, policy: StepPolicy) -> NDArray[Any]:
        """Return the lattice points of a policy: the policy itself."""
        return policy

    def admissible(self, cells: NDArray[Any], policy: NDArray[Any]) -> NDArray[np.bool_]:
        """Return whether flat lattice points ``policy`` are admissible targets of ``cells``; the two broadcast."""
        indices = np.unravel_index(policy, self.shape)
        targets = np.stack([axis[index] for axis, index in zip(self.lattice, indices, strict=True)], axis=-1)
        if isinstance(self.relation, WrittenTargets):
            return self.relation.fits(self.relation.asked_on(self.grid.edges).of(cells, targets))
        wanted = np.abs((targets - self._central_means[cells]) @ self.relation.right_inverse.T)
        return np.all(wanted <= self._reserve[cells], axis=-1)

    def blocks(self, size: int) -> list[NDArray[np.int64]]:
        """Return all cells, in bricks of about ``size``: their windows have more in common than those of a line."""
        if size not in self.memory.bricks:
            self.memory.bricks[size] = _bricks(self.grid.shape, size)
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


@dataclass(frozen=True, eq=False, repr=False)
class InputMenu:
    """A abstract inputs per cell, each with the lattice point it leads to.

    Parameters
    ----------
    leads_to : (S, A) int32 array
        Flat lattice point of each cell and input.
    resting_choice : (S,) int32 array
        The input that stays nearest to the cell.
    """

    leads_to: NDArray[np.int32]
    resting_choice: StepPolicy

    def __repr__(self) -> str:
        return f"InputMenu({self.leads_to.shape[0]} cells, {counted(self.leads_to.shape[1], 'input')} each)"

    def blocks(self, size: int) -> list[NDArray[np.int64]]:
        """Return all cells, in runs of ``size``."""
        return _bricks((len(self.leads_to),), size)

    def points(self, policy: StepPolicy) -> NDArray[Any]:
        """Return the lattice points of a policy; -1 where it has no choice."""
        chosen = np.take_along_axis(self.leads_to, np.maximum(policy, 0)[:, None], axis=1)[:, 0]
        return np.where(policy < 0, -1, chosen)


def _bricks(shape: tuple[int, ...], size: int) -> list[NDArray[np.int64]]:
    """Return the cells of a grid, increasing, in cubes of at most ``size``.

    Examples
    --------
    >>> [brick.tolist() for brick in _bricks((2, 3), 4)]
    [[0, 1, 3, 4], [2, 5]]
    """
    edge = max(1, int(size ** (1.0 / len(shape)) + 1e-9))
    cells = np.arange(math.prod(shape)).reshape(shape)
    corners = product(*(range(0, n, edge) for n in shape))
    return [cells[tuple(slice(a, a + edge) for a in corner)].ravel() for corner in corners]


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


def written_windows(relation: WrittenTargets, grid: Grid, lattice: tuple[FloatArray, ...]) -> TargetWindows:
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
    relation: WrittenTargets,
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
