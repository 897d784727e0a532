"""Choices of agents whose means are known to lie in boxes.

The value of a cell under a choice is the least value over the box of its means (``box_minima``). To choose, boxes are
rounded to the nearest lattice points: about right, and 2^d readings for each.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....envs.systems.agents import AnyAgent
from ...relations.grids import FloatArray, Grid, LatticeAxis, MeanAxis, RelationRefused, grid_laws, shape_text
from ...relations.kinds import BoxRelation, MeanBoxes
from ..kernels import BoxKernel, box_kernel_of, each_window_minima, least_over_boxes
from .action_tables import TIE, ActionTable, MeansAt, StepPolicy

MOST_IN_BOX = 100_000.0
"""Most points of a box: the check tries them one by one."""

CELLS_AT_ONCE = 4096
"""Cells whose boxes are made at once."""

READINGS_AT_ONCE = 2_000_000
"""Boxes that are read at once: 16 MB for each of a few arrays."""


@dataclass(frozen=True, eq=False, repr=False)
class BoxChoices(ActionTable):
    """What can be chosen in each cell: inputs with the boxes of lattice points that hold their means.

    Parameters
    ----------
    grid : Grid
    lattice : tuple of D arrays (Z_k,)
        Evenly spaced lattice axes; a point is numbered in C order.
    axes : tuple of LatticeAxis
        What they stand for.
    relation : BoxRelation
        Whose boxes these are.
    low, high : (S, A, D) arrays
        Corners of boxes in lattice steps; -1 for boxes that leave the lattice, where the value is 0.
    sizes : (W, D) int array
        Sides of windows, powers of two.
    size : (S, A) int16 array
        Which of the sizes is used for the box of each cell and choice; -1 where the choice is not admissible.
    corners : (S, A, 2^D) int32 array
        Lattice points at which the windows begin that cover the box, rounded to the nearest lattice points.
    n_times : int
        Parts of equal length in which the choices come, one for each step, in which alone these may be chosen; 1 if all
        may be chosen at every step.
    """

    grid: Grid
    lattice: tuple[FloatArray, ...]
    axes: tuple[LatticeAxis, ...]
    relation: BoxRelation
    low: FloatArray
    high: FloatArray
    sizes: NDArray[np.int64]
    size: NDArray[np.int16]
    corners: NDArray[np.int32]
    n_times: int = field(default=1, kw_only=True)

    is_additive = False
    is_read_at_length = True
    read_per_second = 2e5

    def __repr__(self) -> str:
        cells, n_choices = self.size.shape
        widest = shape_text(tuple(int(n) for n in self.sizes.max(axis=0)))
        return f"BoxChoices({cells} cells, {n_choices} choices, windows of up to {widest} lattice points)"

    def kernel_on(self, agent: AnyAgent, grid: Grid) -> BoxKernel:
        """Return the kernel from the lattice to other cells."""
        laws = grid_laws(agent)
        return box_kernel_of(grid, self.lattice, laws, self.axes, agent.wrapped_axes.tolist())

    @property
    def n_choices(self) -> int:
        """Number of choices A."""
        return self.size.shape[1]

    @cached_property
    def at_times(self) -> tuple[BoxChoices, ...]:
        """The choices of each step by themselves, numbered from 0."""
        if self.n_times == 1:
            return (self,)
        found, length = [], self.size.shape[1] // self.n_times
        for time in range(self.n_times):
            columns = slice(time * length, (time + 1) * length)
            low, high, size, corners = (
                np.ascontiguousarray(table[:, columns]) for table in (self.low, self.high, self.size, self.corners)
            )
            found.append(replace(self, low=low, high=high, size=size, corners=corners, n_times=1))
        return tuple(found)

    def points(self, policy: StepPolicy) -> NDArray[np.int64]:
        """Return the lattice point (S,) nearest to the middle of each choice's box; -1 where nothing is known.

        Masses are pushed to these points: a heuristic, as means may be anywhere in their boxes.
        """
        cells, chosen = np.arange(len(policy)), np.maximum(policy, 0)
        middle = 0.5 * (self.low[cells, chosen] + self.high[cells, chosen])
        known = (policy >= 0) & (middle[:, 0] > 0)
        index = np.where(known[:, None], np.rint(middle), 0).astype(np.int64)
        return np.where(known, np.ravel_multi_index(tuple(index.T), self.shape), -1)

    def middles(self, choice: int) -> FloatArray:
        """Return the middles (S, d) of one choice's boxes, infinite off the lattice."""
        middle, d = 0.5 * (self.low[:, choice] + self.high[:, choice]), len(self.grid.shape)
        result = np.full((len(middle), d), np.inf)
        inside = middle[:, 0] > 0
        for place, (axis, points) in enumerate(zip(self.axes, self.lattice, strict=True)):
            if not axis.is_interpolated:
                # Number 1 is the first cell, whose centre is half a cell beyond the first edge.
                edges = self.grid.edges[axis.state]
                numbers = middle[inside, place] - 0.5
                result[inside, axis.state] = np.interp(numbers, np.arange(len(edges)), edges)
            elif not axis.is_logarithmic:
                step = (points[-1] - points[0]) / (len(points) - 1)
                result[inside, axis.state] = points[0] + step * middle[inside, place]
        return result

    def read(self, backed_up: Any, policy: StepPolicy, rough: bool = False) -> Any:
        """Return the least values (n, S), over the boxes of a policy, of the interpolants of numbers (n, Z).

        They are 0 where there is no choice, or one that is not admissible, or a box leaves the lattice.
        """
        table = backed_up
        values = np.zeros((len(table), len(policy)))
        every, chosen = np.arange(len(policy)), np.maximum(policy, 0)
        usable = (self.size[every, chosen] >= 0) & (self.low[every, chosen, 0] >= 0)
        cells = np.flatnonzero((policy >= 0) & usable)
        low, high = (side[cells, chosen[cells]] for side in (self.low, self.high))
        values[:, cells] = np.maximum(least_over_boxes(table, self.shape, low, high), 0.0)
        return values

    def best(self, weights: FloatArray, table: FloatArray, incumbent: StepPolicy) -> StepPolicy:
        """Return the choices (S,) of the largest weighted value; the incumbent stays among equals.

        Parameters
        ----------
        weights : (S, n) array
            Weights of the objectives in the cells.
        table : (n, Z) array
            Numbers of every lattice point under each objective.
        incumbent : (S,) int32 array
        """
        weights = np.broadcast_to(weights, (len(incumbent), len(table)))
        score = np.where(self.size >= 0, 0.0, -np.inf)
        inside = (self.low[..., 0] >= 0).reshape(-1)
        flat, n_choices = score.reshape(-1), self.size.shape[1]
        corners = self.corners.reshape(-1, self.corners.shape[-1])
        for heavy, numbers in zip(weights.T, table, strict=True):
            if not heavy.any():
                continue
            filled = np.array([number for number, boxes in enumerate(self._by_size) if len(boxes)], dtype=np.int64)
            for place, found in each_window_minima(numbers.reshape(self.shape), self.sizes[filled]):
                number, minima = int(filled[place]), found.ravel()
                for boxes in self._boxes_of(number):
                    least = np.maximum(self._least(minima, corners[boxes]), 0.0) * inside[boxes]
                    flat[boxes] += heavy[boxes // n_choices] * least
        best = score.argmax(axis=1)
        cells = np.arange(len(best))
        top, current = score[cells, best], score[cells, np.maximum(incumbent, 0)]
        better = (top > -np.inf) & ((incumbent < 0) | (top > current * (1.0 + TIE)))
        return np.where(better, best, incumbent).astype(np.int32)

    def nearest(self, means_at: MeansAt) -> StepPolicy:
        """Return the admissible choice (S,) of each cell whose box has its middle nearest to the mean at its centre."""
        means, scale = means_at(self.grid.centres), self.cell_widths
        nearest, best = np.full(self.grid.n_cells, np.inf), np.full(self.grid.n_cells, -1)
        for a in range(self.size.shape[1]):
            gaps = (((self.middles(a) - means.T) / scale) ** 2).sum(axis=1)
            closer = (self.size[:, a] >= 0) & (gaps < nearest)
            nearest, best = np.where(closer, gaps, nearest), np.where(closer, a, best)
        return best.astype(np.int32)

    def _least(self, minima: FloatArray, corners: NDArray[np.int32]) -> FloatArray:
        """Return the least number (N,) over the boxes that windows at ``corners`` (N, 2^d) cover."""
        least = minima.take(corners[:, 0])
        for column in range(1, corners.shape[1]):
            np.minimum(least, minima.take(corners[:, column]), out=least)
        return least

    def _boxes_of(self, number: int) -> Iterator[NDArray[np.int64]]:
        """Return the boxes of one size, as flat numbers (cell, choice), in parts."""
        boxes = self._by_size[number]
        if len(boxes) < READINGS_AT_ONCE:
            yield boxes
        else:
            yield from np.array_split(boxes, len(boxes) // READINGS_AT_ONCE + 1)

    @cached_property
    def _by_size(self) -> list[NDArray[np.int64]]:
        flat = self.size.reshape(-1)
        return [np.flatnonzero(flat == number) for number in range(len(self.sizes))]

    @cached_property
    def _pitch(self) -> FloatArray:
        """Widths (d,) by which distances are measured: steps of the lattice, or cells of states without noise."""
        steps, widths = steps_of(self.lattice), [np.mean(np.diff(edges)) for edges in self.grid.edges]
        along = dict(zip(self.axes, steps.tolist(), strict=True))
        return np.array([along.get(MeanAxis(k), width) for k, width in enumerate(widths)])

    @cached_property
    def resting_choice(self) -> StepPolicy:
        """(S,) admissible choice whose box is nearest to the cell itself; -1 where there is none."""
        nearest, choice = np.full(self.grid.n_cells, np.inf), np.full(self.grid.n_cells, -1, dtype=np.int32)
        for a in range(self.size.shape[1]):
            distance = np.sum(((self.middles(a) - self.grid.centres) / self._pitch) ** 2, axis=1)
            # Boxes that leave the lattice come last.
            distance = np.minimum(distance, np.finfo(float).max)
            closer = (self.size[:, a] >= 0) & (distance < nearest)
            nearest, choice = np.where(closer, distance, nearest), np.where(closer, a, choice).astype(np.int32)
        return choice


def steps_of(lattice: tuple[FloatArray, ...]) -> FloatArray:
    """Return the lattice steps (d,)."""
    return np.array([(axis[-1] - axis[0]) / (len(axis) - 1) for axis in lattice])


def box_choices(
    grid: Grid, lattice: tuple[FloatArray, ...], agent: BoxRelation, axes: tuple[LatticeAxis, ...]
) -> BoxChoices:
    """Return the choices of an agent on a lattice.

    Raises
    ------
    ValueError
        If no choice is admissible in any cell.
    """
    n_cells, n_choices, d = grid.n_cells, agent.n_choices, len(lattice)
    low, high = (np.empty((n_cells, n_choices, d)) for _ in range(2))
    exponents = np.empty((n_cells, n_choices, d), dtype=np.int8)
    corners = np.empty((n_cells, n_choices, 2**d), dtype=np.int32)
    shape = tuple(len(axis) for axis in lattice)
    for first in range(0, n_cells, CELLS_AT_ONCE):
        block = slice(first, first + CELLS_AT_ONCE)
        boxes = agent.mean_boxes(grid.low[block], grid.high[block])
        low[block], high[block] = positions(grid, lattice, axes, boxes)
        # The largest power of two that is no wider than the rounded box; two such windows cover it.
        begin, end = (np.rint(np.maximum(side[block], 0)).astype(np.int64) for side in (low, high))
        power = np.frexp((end - begin + 1).astype(float))[1] - 1
        spare = end - begin + 1 - 2**power
        for k, side in enumerate(product((0, 1), repeat=d)):
            index = begin + np.array(side) * spare
            corners[block, :, k] = np.ravel_multi_index(tuple(np.moveaxis(index, -1, 0)), shape)
        exponents[block] = np.where(boxes.admissible[..., None], power, -1)
    if np.max(np.prod(high - low + 3.0, axis=2)) > MOST_IN_BOX:
        raise RelationRefused(
            f"mean boxes need at most {MOST_IN_BOX:.0f} lattice points in a box; ask for more `cells` or fewer "
            "`targets_per_cell`"
        )
    distinct, size = np.unique(exponents.reshape(-1, d), axis=0, return_inverse=True)
    # Those without an admissible choice, if there are any, come first in this order.
    n_refused = int(np.any(distinct < 0, axis=1).sum())
    if len(distinct) == n_refused:
        raise RelationRefused("no choice is admissible in a whole cell; ask for more `cells`")
    numbers = (size.reshape(n_cells, n_choices) - n_refused).astype(np.int16)
    sizes = 2 ** distinct[n_refused:].astype(np.int64)
    return BoxChoices(grid, lattice, axes, agent, low, high, sizes, numbers, corners)


def positions(
    grid: Grid, lattice: tuple[FloatArray, ...], axes: Sequence[LatticeAxis], boxes: MeanBoxes
) -> tuple[FloatArray, FloatArray]:
    """Return the corners (.., D) of boxes in lattice steps; -1 for boxes that leave the lattice.

    The outermost points count as outside, since second differences are not known there. What positions are off by in
    floating point is part of what kernels take off (``ROUNDING``).
    """
    ends = []
    for side in (0, 1):
        columns = []
        for axis, points in zip(axes, lattice, strict=True):
            numbers = boxes.scales if axis.is_logarithmic else (boxes.low, boxes.high)
            assert numbers is not None  # an axis of scales is there for noise that has some
            column = numbers[side][..., axis.state]
            if not axis.is_interpolated:
                columns.append(cells_at(column, grid.edges[axis.state], side))
                continue
            if axis.is_logarithmic:
                with np.errstate(invalid="ignore", divide="ignore"):  # such choices are not admissible
                    column = np.log(column)
            columns.append((column - points[0]) / ((points[-1] - points[0]) / (len(points) - 1)))
        ends.append(np.stack(columns, axis=-1))
    low, high = ends
    last = np.array([len(axis) - 1 for axis in lattice])
    inside = np.all((low >= 1.0) & (high <= last - 1.0), axis=-1)[..., None]
    return np.where(inside, low, -1.0), np.where(inside, high, -1.0)


ROUNDED_EDGES = 1e-9
"""Share of the narrowest cell within which a next state counts as on an edge: the check rounds in its own way."""


def cells_at(means: FloatArray, edges: FloatArray, side: int) -> FloatArray:
    """Return positions of ends of intervals of next states without noise, lower ones (0) or upper ones (1).

    Cell s has number s + 1, what is in no cell 0 or the last number. A state on an edge is in the cell above it, on the
    upper face of the workspace in the last one, as in labels. What is not a number is outside.
    """
    outward = (2 * side - 1) * ROUNDED_EDGES * np.min(np.diff(edges))
    numbers = np.searchsorted(edges, means + outward, side="right")
    # Faces of the workspace are told apart exactly: states that are capped come to lie on them.
    inside = (edges[0] <= means) & (means <= edges[-1])
    numbers = np.where(inside, np.clip(numbers, 1, len(edges) - 1), np.where(means > edges[-1], len(edges), 0))
    return numbers.astype(float)
