"""Expected values on a lattice so fine that their least value over a box can be read from its points.

With ``g(m) = E v(m + w)`` at the points of a lattice, and m between lattice points, multilinear interpolation I along
one axis after the other gives

    g(m)  >=  I(m)  -  sum_k eta_k^2 / 8 * sup (d^2 g / dm_k^2)^+ .

The supremum is over the small box between the corners around m. Second derivatives at lattice points are read from
second differences of g itself, ``D_k = g(z + eta_k) - 2 g(z) + g(z - eta_k)``. With ``r_k = eta_k / sigma_k`` and
0 <= v <= M,

    eta_k^2 sup d^2 g / dm_k^2  <=  max over corners of D_k  +  M (c_4 r_k^4 / 12 + sum_e c_ke r_k^2 r_e^2 / 8) ,

where c_4 = c_kk and c_ke are half the L1 norms of phi'''' and of phi'' phi'' (docs/theory/boxes.md, "The charge"). What
is stored at a point takes off the largest D_k of all its neighbours. So the interpolant of the stored numbers is below
g everywhere, and so is its least value over a box. Where an axis has another law than the normal one, or its noise is
larger in some places, what interpolation adds along each axis is bounded by the law alone (``Law.interpolation_error``
along the mean, ``Law.scale_charge`` along the logarithm of the scale), for factors of at most M, or by how much factors
vary within reach of the noise (``proximity_error``).

Along a state without noise nothing is interpolated: its points are cells (``lattice_axes``).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....envs.systems.agents import TURN
from ....envs.systems.distributions import Gaussian, Law
from ...relations.grids import CellAxis, FloatArray, Grid, LatticeAxis, MeanAxis, ScaleAxis
from .kernel import AxisTable, Kernel, law_table
from .proximity_error import ProximityError
from .second_derivative_bounds import FOURTH, SQUARED

ROUNDING = 3e-9
"""Share of the largest value that is taken off for rounding, per unit of ``1 + sum of pitches in deviations``: axes may
be uneven by 1e-9 of a step, and positions be off by as much."""

POINTS_PER_DEVIATION = {1: 6.0, 2: 6.0}
"""Lattice points per deviation, at least, by dimension: the slack is then 3e-5 per axis and step."""

FEWER_PER_DEVIATION = 4.0
"""The same beyond: a slack of 1e-4, for a third of the points."""

POINTS_PER_CELL = {1: 16, 2: 4, 3: 2}
"""Lattice points per cell and axis, at least, by dimension (2 beyond): choices are told apart by them."""

MOST_PER_CELL = {1: 256, 2: 24, 3: 3}
"""The same, at most: where cells are wider than several deviations, boxes are, and a finer lattice gains nothing.

In three dimensions it would also take most of the time."""

CHARGE = 2e-4
"""What interpolation may add per axis and step where laws alone bound it, if memory allows."""

MOST_POINTS = 4_000_000
"""Lattice points from which fewer are taken for each cell."""

BEYOND_GRID = 3.0
"""Standard deviations by which the lattice goes beyond the grid: a box that reaches farther is worth .0014 at most."""


@dataclass(frozen=True, eq=False, repr=False)
class BoxKernel(Kernel):
    """Kernel whose smoothed factors have the charge of the lattice taken off.

    Parameters
    ----------
    tables, loss
        See ``Kernel``.
    ratios : (d,) array
        Lattice steps in standard deviations of the noise (or what counts as such, see ``ratio_of``).
    charge : array or None
        What interpolation adds, for factors of at most 1, where it is bounded by laws: numbers that broadcast to the
        lattice; None where all laws are normal.
    points : tuple of int
        Lattice points per axis; by default those of the tables.
    bent : tuple of int
        Axes of the lattice that are interpolated; all by default.
    near : NearCharge, optional
        Windows within which values may vary less than from 0 to their largest, beside ``interpolation_error``.
    """

    ratios: FloatArray = field(default_factory=lambda: np.zeros(0))
    interpolation_error: FloatArray | None = None
    points: tuple[int, ...] = ()
    bent: tuple[int, ...] | None = None
    near: ProximityError | None = None

    def backup(self, factors: Any) -> Any:
        """Return numbers (n, Z) whose multilinear interpolant is below g, up to the border of the lattice.

        ``factors`` (n, S) are nonnegative; the numbers need not be.
        """
        values = np.ascontiguousarray(super().backup(factors))
        largest = factors.max(axis=1, initial=0.0)
        for n, (row, most) in enumerate(zip(values, largest.tolist(), strict=True)):
            table = row.reshape(self.points or self.lattice_shape)
            if self.interpolation_error is None:
                take_charge(table, most * self.slack, self.bent)
            else:
                table -= (
                    most * self.interpolation_error
                    if self.near is None
                    else self.near.of_values(factors[n], most, self.interpolation_error)
                )
                table -= most * self.slack
        return values

    @property
    def slack(self) -> float:
        """What is taken off everywhere, besides second differences or charges, for factors of at most 1."""
        if self.interpolation_error is not None:
            return rounding_of(self.ratios) + self.loss
        return slack_of(self.ratios) + self.loss


def slack_of(ratios: FloatArray) -> float:
    """Return an upper bound on what second differences miss, for factors of at most 1; see the module's text."""
    squares = np.asarray(ratios) ** 2
    constants = np.where(np.eye(len(squares), dtype=bool), FOURTH, SQUARED)
    per_axis = FOURTH * squares**2 / 12.0 + squares * (constants @ squares) / 8.0
    return float(np.sum(per_axis) / 8.0) * (1.0 + 1e-9) + rounding_of(ratios)


def rounding_of(ratios: FloatArray) -> float:
    """Return what is taken off for rounding, for factors of at most 1."""
    return ROUNDING * (1.0 + float(np.sum(ratios)))


def take_charge(table: NDArray, slack: float, bent: tuple[int, ...] | None = None) -> None:
    """Take off slack and second differences along some axes (all by default) from values (Z_1, ..), in place."""
    along_axes = range(table.ndim) if bent is None else bent
    interpolation_error = np.full(table.shape, slack)
    for k in along_axes:
        along = np.moveaxis(table, k, 0)
        second = np.zeros_like(along)
        np.maximum(along[2:] - 2.0 * along[1:-1] + along[:-2], 0.0, out=second[1:-1])
        second = np.moveaxis(second, 0, k)
        # Every point answers for all small boxes of which it is a corner: the largest of its neighbours counts.
        for axis in along_axes:
            second = largest_of_neighbours(second, axis)
        interpolation_error += 0.125 * second
    table -= interpolation_error


def largest_of_neighbours(table: NDArray, axis: int) -> NDArray:
    """Return the largest of every entry and its two neighbours along an axis."""
    along = np.moveaxis(table, axis, 0)
    result = along.copy(order="K")  # in the order of memory, whichever axis is the first one now
    np.maximum(result[1:], along[:-1], out=result[1:])
    np.maximum(result[:-1], along[1:], out=result[:-1])
    return np.moveaxis(result, 0, axis)


def points_per_cell(grid: Grid, laws: Sequence[Law], n_axes: int | None = None) -> tuple[int, ...]:
    """Return lattice points per cell and axis: fine against the noise and against cells, as long as memory allows.

    ``n_axes`` is the number of axes of the lattice, if it has more than the grid: boxes then hold more points.
    """
    d = len(grid.shape) if n_axes is None else n_axes
    widths = np.array([(axis[-1] - axis[0]) / n for axis, n in zip(grid.edges, grid.shape, strict=True)])
    still = [law.std == 0.0 for law in laws]
    fewest, most = POINTS_PER_CELL.get(d, 2), MOST_PER_CELL.get(d, 4)
    # Cells may be very wide: the smaller number is taken before it is rounded to a whole one.
    normal = all(isinstance(law, Gaussian) for law in laws)
    per_deviation = POINTS_PER_DEVIATION.get(d, FEWER_PER_DEVIATION)
    pitches = np.array(
        [
            width if none else law.std / per_deviation if normal else law.lattice_spacing(CHARGE)
            for law, none, width in zip(laws, still, widths.tolist(), strict=True)
        ]
    )
    needed = np.minimum(widths / pitches, most)
    wanted = [1 if none else max(fewest, math.ceil(n)) for n, none in zip(needed.tolist(), still, strict=True)]
    size = math.prod(n * count for n, count in zip(grid.shape, wanted, strict=True))
    share = min(1.0, (MOST_POINTS / size) ** (1.0 / max(1, len(grid.shape) - sum(still))))
    return tuple(1 if none else max(2, math.floor(n * share)) for n, none in zip(wanted, still, strict=True))


def box_lattice(
    grid: Grid,
    deviations: FloatArray,
    per_cell: tuple[int, ...],
    low: FloatArray,
    high: FloatArray,
    wrapped: Sequence[bool] | None = None,
) -> tuple[FloatArray, ...]:
    """Return evenly spaced axes that hold the means between ``low`` and ``high`` (d,), as far as they matter.

    Beyond the grid along an axis that is ``wrapped`` there is no outside: half a turn, and three deviations.
    Points lie on the edges of equal cells, so that images of cells have their sides on lattice points where they can.
    """
    axes = []
    for k, edges in enumerate(grid.edges):
        first, last, beyond = float(edges[0]), float(edges[-1]), BEYOND_GRID * float(deviations[k])
        beyond += 0.5 * TURN if wrapped is not None and wrapped[k] else 0.0
        lattice_spacing = (last - first) / (grid.shape[k] * per_cell[k])
        # The outermost points are not used; one more inside of them on either side is for rounding outward.
        below = math.ceil((first - max(first - beyond, min(first, float(low[k])))) / lattice_spacing) + 2
        above = math.ceil((min(last + beyond, max(last, float(high[k]))) - last) / lattice_spacing) + 2
        axes.append(first + lattice_spacing * np.arange(-below, grid.shape[k] * per_cell[k] + above + 1))
    return tuple(axes)


def box_kernel_of(
    grid: Grid,
    lattice: tuple[FloatArray, ...],
    laws: Sequence[Law],
    axes: Sequence[LatticeAxis] | None = None,
    wrapped: Sequence[bool] | None = None,
) -> BoxKernel:
    """Return the kernel on a lattice, whose axes are those of the means by default.

    ``wrapped`` says which states are angles, whose cells have the masses of all windings.
    """
    axes = [MeanAxis(k) for k in range(len(laws))] if axes is None else axes
    points = dict(zip(axes, lattice, strict=True))
    tables, loss, ratios, charges = [], 0.0, [], list[FloatArray]()
    for k, (edges, law) in enumerate(zip(grid.edges, laws, strict=True)):
        if CellAxis(k) in points:
            tables.append(AxisTable.dense(_staying(grid.shape[k])))
            continue
        axis, levels = points[MeanAxis(k)], points.get(ScaleAxis(k))
        lattice_spacing = float(axis[-1] - axis[0]) / (len(axis) - 1)
        own = [law] if levels is None else [law.scaled(math.exp(level)) for level in levels.tolist()]
        make = wound_table if wrapped is not None and wrapped[k] else law_table
        table, missing = _stacked([make(axis, edges, each) for each in own])
        tables.append(table)
        loss += missing
        ratios.append(max(ratio_of(each, lattice_spacing) for each in own))
        along = axes.index(MeanAxis(k) if levels is None else ScaleAxis(k))
        shape = [-1 if place == along else 1 for place in range(len(axes))]
        costs = [each.interpolation_error(lattice_spacing * (1.0 + 1e-9)) for each in own]
        if levels is not None:
            step = float(levels[-1] - levels[0]) / (len(levels) - 1)
            ratios.append(step)
            # Between two levels the noise may be as small as at the lower one, so that both take off what that costs.
            costs = [cost + law.scale_charge(step * (1.0 + 1e-9)) for cost in (costs[0], *costs[:-1])]
        charges.append(np.array(costs).reshape(shape))
    normal = all(isinstance(law, Gaussian) for law in laws) and not any(axis.is_logarithmic for axis in axes)
    bent = tuple(place for place, axis in enumerate(axes) if axis.is_interpolated)
    shape_of = tuple(len(axis) for axis in lattice)
    interpolation_error = np.asarray(sum(charges, np.zeros((1,) * len(axes))))
    if normal:
        return BoxKernel(tuple(tables), loss, np.array(ratios), None, shape_of, bent)
    winds = wrapped is not None and any(wrapped)
    near = None if winds else ProximityError.of(grid.edges, points, laws, loss)
    return BoxKernel(tuple(tables), loss, np.array(ratios), interpolation_error, shape_of, bent, near)


def wound_table(means: FloatArray, edges: FloatArray, law: Law) -> tuple[AxisTable, float]:
    """Return lower bounds on the masses of the cells of an angle over windings: of a cell and all its copies.

    What windings that are left out would add counts as nothing. Copies are where they are up to rounding: the mass
    that lies so near to an edge is part of the loss (docs/theory/angles.md, "Masses over windings").
    """
    total, loss = np.zeros((len(means), len(edges) - 1)), 0.0
    for winding in range(-WINDINGS, WINDINGS + 1):
        table, missing = law_table(means - TURN * winding, edges, law)
        total, loss = total + table.toarray(), loss + missing
    off = COPIES_OFF * (float(np.abs(means).max()) + TURN * WINDINGS)
    near = 4.0 * off * (1.0 / float(np.diff(edges).min()) + 2.0 * law.height)
    return AxisTable.dense(total * (1.0 - 1e-14)), loss + 2.0 * near


WINDINGS, COPIES_OFF = 3, 1e-15
"""Windings to either side whose masses are counted, and what copies of edges are off by, as a share of their size."""


def _staying(n_cells: int) -> FloatArray:
    """Return the masses of a state without noise: all in the cell of the mean, none where that is no cell."""
    return np.vstack([np.zeros(n_cells), np.eye(n_cells), np.zeros(n_cells)])


def _stacked(found: Sequence[tuple[AxisTable, float]]) -> tuple[AxisTable, float]:
    """Return tables of the same means under several laws as one, law after law, and the largest loss."""
    if len(found) == 1:
        return found[0]
    blocks, first = [], 0
    for table, _ in found:
        blocks += [(first + z0, first + z1, s0, s1, entries) for z0, z1, s0, s1, entries in table.blocks]
        first += table.shape[0]
    return AxisTable((first, found[0][0].shape[1]), tuple(blocks)), max(loss for _, loss in found)


LEAST_LEVELS, LEAST_STEP = 3, 1e-3
"""Fewest levels of a scale, and the step where the scale is the same everywhere."""

LEVELS_OF_A_CELL = 6.0
"""Levels within the scales of one cell beyond which more are not worth it: the least value over them costs more."""

MOST_SCALED, MOST_SCALES = 3_000_000, 128
"""Lattice points, and combinations of scales, up to which scales get more levels."""


def scale_levels(least: float, most: float, of_cell: float, law: Law, count: float) -> FloatArray:
    """Return evenly spaced logarithms of scales between ``least`` and ``most``, with one and a half steps to spare.

    As many as the law's charge asks for, ``count`` at most, and not many more in a cell, over which the logarithm of
    the scale varies by ``of_cell``.
    """
    width = math.log(most) - math.log(least)
    wanted = max(law.scale_step(CHARGE), of_cell / LEVELS_OF_A_CELL)
    n = max(LEAST_LEVELS, math.ceil(min(width / wanted, count)))
    step = max(width / n, LEAST_STEP)
    return math.log(least) + step * (np.arange(n + 4) - 1.5)


def ratio_of(law: Law, lattice_spacing: float) -> float:
    """Return a lattice step in deviations of the noise, in smaller ones where its density is higher.

    What positions are off by moves g by that times the height of the density; a normal one has the height .4 / sigma.
    """
    return (
        lattice_spacing / law.std
        if isinstance(law, Gaussian)
        else lattice_spacing * max(1.0 / law.std, 2.6 * law.height)
    )
