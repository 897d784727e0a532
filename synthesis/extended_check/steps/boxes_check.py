"""The relation ``boxes``, once more: enclosures of means, the charge of the lattice and least values over boxes.

Boxes around means are those of ``step_intervals``, whether dynamics are matrices or expressions. On a lattice of steps
eta, with ``g(z) = E v(z + w)``, a multilinear interpolant of g is above g by at most ``sum_k eta_k^2 / 8 sup (d_k^2
g)^+``, and the supremum over a small box is found from second differences at its corners, up to fourth
derivatives (docs/theory/boxes.md, "The charge"). Taking both off at lattice points leaves an interpolant below g. It is
least over a box at a point each of whose coordinates is an end of the box or a lattice point between the ends; here all
of them are tried.

Where noise has scales, its logarithm is one more coordinate of a box, and what interpolation may add is bounded by the
laws, at the smallest noise between two points. A state without noise lands in a cell that the box touches.

Nothing of the kernels, choices and minima of the search is used.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ....envs.systems.agents import AnyAgent
from ...certificates.cell_probabilities import (
    AgentRecord,
    axis_tables,
    backup,
    law_charge,
    law_height,
    lost_to_rounding,
    scale_charge,
    state,
)
from ...relations.grids import FloatArray, MeanAxis, ScaleAxis, lattice_axes, points_by_axis
from .geometry import cell_boxes
from .mean_enclosures import enclosed_means, enclosed_scales
from .proximity_slack import ProximitySlack

STRAIGHT, CROSSED = 1.40031, 0.46840
"""Half the L1 norms of the fourth derivative of the normal density, and of the product of two second ones; rounded up
in the fifth digit."""

ROUNDING = 2.999e-9
"""Share of the largest value that is taken off for rounding and lattices that are uneven by 1e-9 of a step: hardly less
than for the search, since what is left after unions from below depends on it in both directions."""

MOST_POINTS = 100_000
"""Most points of a box, as they are tried one by one; larger boxes are worth nothing."""

CELLS_AT_ONCE = 100_000
"""Boxes of expressions that are made at once."""

CHUNK = 2_000_000
"""Numbers that are formed at once."""


@dataclass(frozen=True, eq=False)
class BoxTables:
    """What a step needs of one agent.

    Parameters
    ----------
    masses : list of (Z_k, S_k) arrays
        Cell masses around every lattice point, from below.
    slack : array
        What is taken off, per unit of the largest value, besides second differences and what ``near`` says: numbers
        that broadcast to the lattice.
    near : NearSlack or None
        What interpolation adds from how much values vary near a point, where laws bound it.
    bent : tuple of int, or None
        Axes of the lattice along which second differences are taken off; None where laws bound what they do.
    off : (d,) array
        What means are off by in floating point, at most.
    written : WrittenBoxes
        Boxes of all cells and choices that policies use.
    """

    masses: list[FloatArray]
    slack: FloatArray
    near: ProximitySlack | None
    bent: tuple[int, ...] | None
    off: FloatArray
    written: WrittenBoxes


@dataclass(frozen=True, eq=False)
class WrittenBoxes:
    """Corners (K, d) of boxes, by increasing numbers ``cell * A + choice`` (K,).

    ``scales`` are the ends (K, d) of what the noise is multiplied with; None where it is the same everywhere.
    """

    numbers: NDArray[np.int64]
    low: FloatArray
    high: FloatArray
    scales: tuple[FloatArray, FloatArray] | None

    @classmethod
    def of(cls, agent: AnyAgent, part: AgentRecord) -> WrittenBoxes:
        """Boxes around the means of every cell under every choice that a policy makes there."""
        input_set = np.array(part.relation["menu"], dtype=float)
        cells = np.broadcast_to(np.arange(part.policy.shape[-1]), part.policy.shape)
        asked = part.policy >= 0
        numbers = np.unique(cells[asked] * np.int64(len(input_set)) + part.policy[asked])
        cell, choice = np.divmod(numbers, len(input_set))
        low, high = cell_boxes(part)
        corners, scales = [], []
        for some in np.array_split(np.arange(len(numbers)), len(numbers) // CELLS_AT_ONCE + 1):
            here, inputs = cell[some], input_set[choice[some]]
            parts = int(part.relation.get("parts", 1))
            first, last = enclosed_means(agent, low[here], high[here], inputs, parts)
            corners.append((first, last))
            if agent.noise_scale is not None:
                scales.append(enclosed_scales(agent, low[here], high[here], inputs, parts))
        least, most = (np.concatenate(ends) for ends in zip(*corners, strict=True))
        if not scales:
            return cls(numbers, least, most, None)
        small, large = (np.concatenate(ends) for ends in zip(*scales, strict=True))
        return cls(numbers, least, most, (small, large))

    def at(self, numbers: NDArray[np.int64]) -> tuple[FloatArray, FloatArray]:
        """Corners (C, d) of the boxes with some numbers (C,)."""
        places = np.searchsorted(self.numbers, numbers)
        return self.low[places], self.high[places]

    def scales_at(self, numbers: NDArray[np.int64]) -> tuple[FloatArray, FloatArray]:
        """Ends (C, d) of the scales of boxes with some numbers (C,)."""
        assert self.scales is not None
        places = np.searchsorted(self.numbers, numbers)
        return self.scales[0][places], self.scales[1][places]


def box_tables(
    agent: AnyAgent, part: AgentRecord, off: FloatArray, known: dict[tuple[bytes, ...], list[FloatArray]]
) -> BoxTables:
    """Compute the tables of one agent anew; ``off`` (d,) is what its means are off by."""
    interpolation_error, r, bent = _slack_of_laws(agent, part), np.zeros(0), None
    slack = np.zeros(1)
    if interpolation_error is None:
        # All laws are normal, and the noise is the same everywhere; states without noise are not interpolated.
        bent = tuple(place for place, axis in enumerate(lattice_axes(agent)) if axis.is_interpolated)
        deviations = np.sqrt(np.diag(agent.noise_covariance))
        r = np.array([_step(part.lattice[k]) / deviations[k] for k in bent])
    else:
        r = _rounded_steps(agent, part)
    for k, own in enumerate(r.tolist() if bent is not None else []):
        # Of eta^2/8: second differences are off by a twelfth of fourth ones, and more between the corners.
        slack = slack + STRAIGHT * own**4 / 96.0
        slack = slack + sum(
            (STRAIGHT if e == k else CROSSED) * own**2 * other**2 / 64.0 for e, other in enumerate(r.tolist())
        )
    slack = slack + ROUNDING * (1.0 + float(r.sum())) + lost_to_rounding(agent, part)
    masses = axis_tables(agent, part, known)
    near = None if interpolation_error is None else ProximitySlack.of(agent, part, interpolation_error, masses)
    slack = slack if near is not None or interpolation_error is None else slack + interpolation_error
    return BoxTables(masses, slack, near, bent, off, WrittenBoxes.of(agent, part))


def _step(axis: FloatArray) -> float:
    return float((axis[-1] - axis[0]) / (len(axis) - 1))


def _smallest(agent: AnyAgent, part: AgentRecord, k: int) -> FloatArray:
    """Scales (L,) of the noise of a state, by level: the smallest one between a level and its neighbours."""
    points = points_by_axis(agent, part.lattice).get(ScaleAxis(k))
    if points is None:
        return np.ones(1)
    logarithms = np.maximum(points - _step(points), points[0])
    scales = np.exp(logarithms)
    state("function", "exp", (), logarithms, scales * (1.0 - 1e-13), scales * (1.0 + 1e-13))
    return scales


def _slack_of_laws(agent: AnyAgent, part: AgentRecord) -> FloatArray | None:
    """What interpolation adds, as far as laws bound it, at most 1 along each axis: an array that broadcasts.

    None where all laws are normal and the noise is the same everywhere, so that second differences say more.
    """
    if agent.laws is None:
        return None
    points = points_by_axis(agent, part.lattice)
    axes = [*points]
    total = np.zeros((1,) * len(axes))
    for k, law in enumerate(agent.laws):
        if ScaleAxis(k) in points:
            total = total + min(1.0, scale_charge(law, _step(points[ScaleAxis(k)])))
        if MeanAxis(k) in points:
            # A scale s divides the density by s, and its argument: jumps count 1 / s, bends 1 / s^2.
            scales, step = _smallest(agent, part, k), _step(points[MeanAxis(k)])
            costs = np.array([min(1.0, law_charge(law, step / scale)) for scale in scales])
            along = axes.index(MeanAxis(k)) - 1  # levels of the scale stand before the means
            total = total + (
                costs.reshape([-1 if p == along else 1 for p in range(len(axes))]) if len(costs) > 1 else costs[0]
            )
    return total


def _rounded_steps(agent: AnyAgent, part: AgentRecord) -> FloatArray:
    """Lattice steps, in deviations or what counts as such, by which positions are off by a small share.

    That counts by the height of the density; a normal one has .4 / sigma.
    """
    assert agent.laws is not None
    points, steps = points_by_axis(agent, part.lattice), []
    for k, law in enumerate(agent.laws):
        if ScaleAxis(k) in points:
            steps.append(_step(points[ScaleAxis(k)]))
        if MeanAxis(k) in points:
            small = float(_smallest(agent, part, k).min())
            sharp = 1.0 / law.std if law.name == "gaussian" else max(1.0 / law.std, 2.6 * law_height(law))
            steps.append(_step(points[MeanAxis(k)]) / small * sharp)
    return np.array(steps)


def box_values(
    agent: AnyAgent, part: AgentRecord, tables: BoxTables, factors: FloatArray, rows: Sequence[tuple[int, int]]
) -> list[FloatArray]:
    """Value factors (n, S) one step earlier, below the truth from every state of a cell, of factors (n, S) >= 0.

    One array for each of some rows (t, q) of the policy.
    """
    found = [np.zeros((len(factors), part.grid.n_cells)) for _ in rows]
    moving = [_moving_cells(agent, part, tables, *row) for row in rows]
    for n, factor in enumerate(factors):
        backed_up = backup(factor[None], tables.masses)[0].reshape([len(axis) for axis in part.lattice])
        most = factor.max(initial=0.0)
        slack = tables.slack * most + (0.0 if tables.near is None else tables.near.around(factor, most))
        table = backed_up - slack if tables.bent is None else below(backed_up, slack, tables.bent)
        for values, (cells, low, high) in zip(found, moving, strict=True):
            for some in np.array_split(np.arange(len(cells)), len(cells) // CHUNK + 1):
                values[n, cells[some]] = np.maximum(least(table, low[some], high[some]), 0.0)
    return found


def _moving_cells(
    agent: AnyAgent, part: AgentRecord, tables: BoxTables, t: int, q: int
) -> tuple[NDArray[np.int64], FloatArray, FloatArray]:
    """Cells (C,) whose boxes can be read, and the corners (C, D) of these boxes in lattice steps."""
    policy = part.policy[min(t, len(part.policy) - 1), q]
    cells = np.flatnonzero(policy >= 0)
    low, high = mean_positions(agent, part, tables, cells, policy[cells])
    last = np.array([len(axis) - 1 for axis in part.lattice])
    # Second differences are not known at the border of the lattice: what comes nearer is worth nothing.
    inside = np.all((low >= 1.0) & (high <= last - 1.0), axis=1)
    inside &= np.prod(high - low + 3.0, axis=1) <= MOST_POINTS
    return cells[inside], low[inside], high[inside]


def mean_positions(
    agent: AnyAgent, part: AgentRecord, tables: BoxTables, cells: NDArray[np.int64], choices: NDArray[np.integer]
) -> tuple[FloatArray, FloatArray]:
    """Corners (C, D), in lattice steps, of boxes that hold what moves from all points of cells under choices."""
    numbers = cells * len(part.relation["menu"]) + choices
    low, high = tables.written.at(numbers)
    ends = low - tables.off, high + tables.off
    scales = tables.written.scales_at(numbers) if tables.written.scales is not None else ends
    return _positions(agent, part, ends[0], scales[0]), _positions(agent, part, ends[1], scales[1])


def _positions(agent: AnyAgent, part: AgentRecord, means: FloatArray, scales: FloatArray) -> FloatArray:
    """Places (C, D) on the lattice of means and scales (C, d); not numbers where a scale is not positive."""
    columns = []
    for axis, points in zip(lattice_axes(agent), part.lattice, strict=True):
        value = (scales if axis.is_logarithmic else means)[:, axis.state]
        if not axis.is_interpolated:
            # The number of edges at or below, 0 and the last number being outside; the workspace holds its upper face.
            edges = part.grid.edges[axis.state]
            below = np.where(value == edges[-1], len(edges) - 1, np.sum(value[:, None] >= edges, axis=1))
            # An end that is not a number is no place at all, at either side of a box.
            columns.append(np.where(np.isnan(value), np.nan, below))
            continue
        if axis.is_logarithmic:
            positive = np.where(value > 0.0, value, np.nan)
            value = np.log(positive)
            off = 4.0 * 2.0**-53 * np.abs(value)
            state("function", "log", (), positive, value - off, value + off)
        columns.append((value - points[0]) / _step(points))
    return np.stack(columns, axis=1)


def below(table: FloatArray, slack: FloatArray, bent: tuple[int, ...]) -> FloatArray:
    """Values on a lattice, less what an interpolant along axes ``bent`` may be above the truth around each point."""
    interpolation_error = np.broadcast_to(slack, table.shape).copy()
    for k in bent:
        bend = np.zeros(table.shape)
        middle = tuple(slice(1, -1) if j == k else slice(None) for j in range(table.ndim))
        bend[middle] = np.diff(table, 2, axis=k)
        padded = np.pad(np.maximum(bend, 0.0), 1)
        # The small boxes around a point have their corners among its neighbours.
        shifts = itertools.product(*((0, 1, 2) if j in bent else (1,) for j in range(table.ndim)))
        views = [padded[tuple(slice(s, s + n) for s, n in zip(shift, table.shape, strict=True))] for shift in shifts]
        largest = views[0]
        for view in views[1:]:
            largest = np.maximum(largest, view)
        interpolation_error += largest / 8.0
    return np.asarray(table - interpolation_error)


def least(table: FloatArray, low: FloatArray, high: FloatArray) -> FloatArray:
    """Least value (C,) of the multilinear interpolant of a table over boxes between positions (C, d)."""
    d, flat = table.ndim, np.ascontiguousarray(table).ravel()
    strides = [math.prod(table.shape[k + 1 :]) for k in range(d)]
    first, count = np.ceil(low).astype(np.int64), (np.floor(high) - np.ceil(low)).astype(np.int64) + 1
    lower_end, upper_end = np.floor(low).astype(np.int64), np.floor(high).astype(np.int64)
    result = np.full(len(low), np.inf)
    # Along each axis: both ends (-2, -1), then the lattice points between them, the first of them being 0.
    for point in itertools.product(*(range(-2, int(count[:, k].max(initial=0))) for k in range(d))):
        here = np.flatnonzero(np.all(count > np.array(point), axis=1))
        ends = [k for k in range(d) if point[k] < 0]
        place, share = np.zeros(len(here), dtype=np.int64), []
        for k in range(d):
            if point[k] >= 0:
                place += strides[k] * (first[here, k] + point[k])
            else:
                base = lower_end if point[k] == -2 else upper_end
                place += strides[k] * base[here, k]
                share.append((low if point[k] == -2 else high)[here, k] - base[here, k])
        value = np.zeros(len(here))
        for corner in itertools.product((0, 1), repeat=len(ends)):
            weight = np.ones(len(here))
            for side, part_of_step in zip(corner, share, strict=True):
                weight = weight * (part_of_step if side else 1.0 - part_of_step)
            value += weight * flat[place + sum(strides[k] * side for k, side in zip(ends, corner, strict=True))]
        result[here] = np.minimum(result[here], value)
    return result
