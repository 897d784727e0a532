"""Relation, lattice, kernel and choices of a single agent under each kind of relation.

What ``abstract`` puts together with labels: the part of a finite model that agents with the same dynamics and the same
grid share.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from ...envs.agents import LinearAgent
from ..cells import FloatArray, Grid, RelationRefused, in_grid_coordinates
from ..relations import (
    CoupledRelation,
    Relation,
    best_feedback,
    ellipsoid_relation,
    exact_relation,
    paper_relation,
    tube_relation,
)
from .choices import Choices, InputMenu, target_windows
from .ellipsoid_search import find_ellipsoid
from .kernel import Kernel, gaussian_table

Bare = tuple[Relation, tuple[FloatArray, ...], Kernel, Choices]

FINE = 8
"""Distinct means per cell and axis up to which every mean is a lattice point; beyond, means are snapped."""

ROUNDING = 1e-11
"""Share of a cell by which rounding moves means; E is enlarged by far more."""

NEAR = 1e-7
"""Share of a cell up to which means count as one where that spares lattice points; E allows for it."""

SPARED = 0.8
"""Share of the lattice points of an axis that must be left for means to be taken together."""

STRANDED = 0.02
"""Share of cells without an admissible target up to which the ``exact`` relation is preferred to a tube."""


def cheapest_model(agent: LinearAgent, grid: Grid, coordinates: FloatArray, per_cell: int, room: FloatArray) -> Bare:
    """The ``exact`` relation where it applies, unless weak inputs leave many cells without a target; else a tube."""
    if np.linalg.matrix_rank(agent.B) < agent.n_states:
        return tube_model(agent, grid, coordinates, room)
    exact = exact_model(agent, grid, coordinates, per_cell)
    if np.mean(exact[3].resting_choice < 0) <= STRANDED:
        return exact
    try:
        return tube_model(agent, grid, coordinates, room)
    except RelationRefused:  # no tube fits into the inputs either
        return exact


def exact_model(agent: LinearAgent, grid: Grid, coordinates: FloatArray, targets_per_cell: int) -> Bare:
    """Relation, lattice, kernel and choices under the ``exact`` relation."""
    relation = exact_relation(agent, coordinates)
    reach = np.abs(relation.B) @ relation.input_half_width
    means = relation.means(grid.centres)
    deviations = np.sqrt(np.diag(in_grid_coordinates(agent, coordinates).covariance))
    lattice, tables, loss = [], [], 0.0
    for k, edges in enumerate(grid.edges):
        lowest, highest = means[:, k].min() - reach[k], means[:, k].max() + reach[k]
        axis = _lattice_axis(edges, targets_per_cell, lowest, highest, 3.0 * deviations[k])
        table, missing = gaussian_table(axis, edges, float(deviations[k]))
        lattice.append(axis)
        tables.append(table)
        loss += missing
    points = tuple(lattice)
    return relation, points, Kernel(tuple(tables), loss), target_windows(relation, grid, points)


def paper_model(agent: LinearAgent, grid: Grid, settings: Mapping[str, object]) -> Bare:
    """Relation, lattice, kernel and choices under the ``paper`` relation; every mean is a lattice point of its own."""
    relation = paper_relation(agent, grid.edges[0], **settings)  # type: ignore[arg-type]
    return _with_menu(relation, grid, (None,))


def tube_model(agent: LinearAgent, grid: Grid, coordinates: FloatArray, room: FloatArray) -> Bare:
    """Relation, lattice, kernel and choices under the ``tube`` relation; ``room`` (d,) is that of the labels."""
    feedback = best_feedback(agent, grid, coordinates, room)
    return _snapped(lambda snap: tube_relation(agent, grid, coordinates, feedback, snap=snap), grid)


def ellipsoid_model(
    agent: LinearAgent,
    grid: Grid,
    coordinates: FloatArray,
    room: FloatArray,
    delta: float = 0.0,
    share: float | None = None,
) -> Bare:
    """Relation, lattice, kernel and choices under the ``ellipsoid`` relation; ``room`` (d,) is that of the labels."""

    def relation(snap: FloatArray | None) -> CoupledRelation:
        found = find_ellipsoid(agent, grid, coordinates, room, delta, snap, share)
        return ellipsoid_relation(agent, grid, coordinates, found, snap=snap)

    return _snapped(relation, grid)


def _snapped(relation_for: Callable[[FloatArray | None], CoupledRelation], grid: Grid) -> Bare:
    """Model of a relation that allows for means rounded by half a lattice spacing (d,).

    Where the means fall on few distinct coordinates of an axis these are its lattice, those that differ by rounding of
    the cell edges being taken together; otherwise the axis gets a lattice of ``FINE`` points per cell. What means are
    rounded by widens the set of errors.
    """
    relation = relation_for(None)
    widths = np.array([float(np.max(np.diff(edges))) for edges in grid.edges])
    means = relation.means(grid.centres)
    snap, spacing = np.zeros(len(widths)), list[float | None]()
    for k, width in enumerate(widths):
        values = np.unique(means[..., k])
        distinct, together = len(_distinct(values, width, 0.0)), len(_distinct(values, width, NEAR))
        if together <= SPARED * distinct:
            snap[k], distinct = NEAR * width, together
        if distinct > FINE * grid.shape[k]:
            snap[k] = width / FINE / 2
        spacing.append(width / FINE if distinct > FINE * grid.shape[k] else None)
    return _with_menu(relation_for(snap) if snap.any() else relation, grid, tuple(spacing))


def _with_menu(relation: CoupledRelation, grid: Grid, spacing: tuple[float | None, ...]) -> Bare:
    """Lattice (all distinct means of an axis, or multiples of its ``spacing``), kernel and menu."""
    means = relation.means(grid.centres)
    lattice, index, tables, loss = [], [], [], 0.0
    snaps = np.broadcast_to(relation.snap, len(grid.edges))
    for k, edges in enumerate(grid.edges):
        values, width = means[..., k], float(np.max(np.diff(edges)))
        step = spacing[k]
        axis = _distinct(np.unique(values), width, snaps[k] / width) if step is None else _multiples(values, step)
        if len(axis) == 1:
            nearest = np.zeros(values.shape, dtype=np.int64)
        else:
            nearest = np.clip(np.searchsorted(axis, values), 1, len(axis) - 1)
            nearest -= (values - axis[nearest - 1]) < (axis[nearest] - values)
        assert np.max(np.abs(axis[nearest] - values)) <= snaps[k] * (1 + 1e-9) + 10 * ROUNDING * width
        table, missing = gaussian_table(axis, edges, float(np.sqrt(relation.covariance[k])))
        lattice.append(axis)
        index.append(nearest)
        tables.append(table)
        loss += missing
    leads_to = np.ravel_multi_index(index, tuple(len(axis) for axis in lattice)).astype(np.int32)
    distance = np.sum((means - grid.centres[:, None, :]) ** 2, axis=-1)
    menu = InputMenu(leads_to, np.argmin(distance, axis=1).astype(np.int32))
    return relation, tuple(lattice), Kernel(tuple(tables), loss), menu


def _distinct(ordered: FloatArray, width: float, near: float) -> FloatArray:
    """Increasing values but for those within ``near`` cells of the one kept before.

    Rounding noise, far below what E is enlarged by, never makes two values of one.
    """
    gap = np.maximum(near, ROUNDING) * width
    kept = ordered[np.concatenate([[True], np.diff(ordered) > gap])]
    last = ordered[np.append(np.searchsorted(ordered, kept[1:]) - 1, len(ordered) - 1)]
    if np.all(last - kept <= gap) or near <= ROUNDING:
        return kept
    return _distinct(ordered, width, 0.0)  # values that creep along have no gaps to be told apart by


def _multiples(values: FloatArray, step: float) -> FloatArray:
    """Multiples of ``step`` from the smallest to the largest value."""
    return step * np.arange(np.floor(values.min() / step), np.ceil(values.max() / step) + 1)


def _lattice_axis(edges: FloatArray, per_cell: int, lowest: float, highest: float, beyond: float) -> FloatArray:
    """Target means of one axis: ``per_cell`` per cell, continued outside the grid as far as means can get (3 sigma)."""
    widths = np.diff(edges)
    offsets = (np.arange(per_cell) + 0.5) / per_cell
    inside = (edges[:-1, None] + widths[:, None] * offsets).ravel()
    first, last = widths[0] / per_cell, widths[-1] / per_cell
    usual = (edges[-1] - edges[0]) / (len(widths) * per_cell)
    inside = inside[np.concatenate([[True], np.diff(inside) > 1e-9 * usual])]  # points in slivers are one point
    first, last = max(first, usual), max(last, usual)  # a sliver at the edge is no measure
    below = int(np.ceil(max(0.0, min(edges[0] - lowest, beyond)) / first))
    above = int(np.ceil(max(0.0, min(highest - edges[-1], beyond)) / last))
    before, after = inside[0] - first * np.arange(below, 0, -1), inside[-1] + last * np.arange(1, above + 1)
    return np.concatenate([before, inside, after])
