"""Relation, lattice, kernel and choices of a single agent under each kind of relation.

This is the part of a finite model that does not depend on labels; agents with equal dynamics and grid share it.
``abstract`` puts it together with the labels.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

import numpy as np

from ....envs.systems.agents import AnyAgent, LinearAgent, with_expressions
from ...relations.grids import FloatArray, Grid, RelationRefused, grid_laws
from ...relations.kinds import (
    CoupledRelation,
    Relation,
    aimed_relation,
    best_feedback,
    ellipsoid_relation,
    paper_relation,
    symbolic_targets,
    tube_relation,
)
from ..kernels import Kernel, gaussian_table, law_table
from .action_tables import ActionTable
from .ellipsoid_search import find_ellipsoid
from .input_sets import InputSet
from .target_windows import windows_of

SharedModel = tuple[Relation, tuple[FloatArray, ...], Kernel, ActionTable]
"""Relation, lattice axes, kernel and choices: what agents share whose labels may differ."""

SNAPPED_POINTS = 8
"""Distinct means per cell and axis up to which every mean is a lattice point; beyond, means are snapped to as many."""

EQUAL_MEANS = 1e-11
"""Share of a cell by which rounding moves means; E is enlarged by far more."""

MOST_MEANS = 50_000_000
"""Most means of cells and inputs, and most lattice points, of one agent: 400 MB for each axis."""

MOST_CREEPING = 10.0
"""Runs of means that creep along are one up to this many times ``EQUAL_MEANS``."""

NEAR_MEANS = 1e-7
"""Share of a cell up to which means count as one where that spares lattice points; E allows for it."""

SPARED_POINTS = 0.8
"""Share of the lattice points of an axis that may be left for near means to be taken together."""

STRANDED_CELLS = 0.02
"""Share of cells without an admissible target up to which the ``exact`` relation is preferred to a tube."""

BEYOND_GRID = 3.0
"""Standard deviations that target means may lie outside the grid: from farther away hardly any mass comes back."""


def cheapest_model(
    agent: LinearAgent, grid: Grid, coordinates: FloatArray, per_cell: int, room: FloatArray
) -> SharedModel:
    """Return the model under ``exact`` where it applies, unless weak inputs leave many cells without a target.

    Otherwise the model under a tube is returned.
    """
    if np.linalg.matrix_rank(agent.B) < agent.n_states:
        return tube_model(agent, grid, coordinates, room)
    exact = exact_model(agent, grid, coordinates, per_cell)
    if np.mean(exact[3].resting_choice < 0) <= STRANDED_CELLS:
        return exact
    try:
        return tube_model(agent, grid, coordinates, room)
    except RelationRefused:  # no tube fits into the inputs either
        return exact


def exact_model(agent: AnyAgent, grid: Grid, coordinates: FloatArray, targets_per_cell: int) -> SharedModel:
    """Return relation, lattice, kernel and choices under the ``exact`` relation."""
    relation = aimed_relation(agent, coordinates)
    _refuse_many(agent.name, "targets_per_cell", grid.n_cells * targets_per_cell ** len(grid.edges))
    means, reach = relation.on(grid).farthest
    laws = grid_laws(agent, coordinates)
    lattice, tables, loss = [], [], 0.0
    for k, edges in enumerate(grid.edges):
        lowest, highest = means[:, k].min() - reach[k], means[:, k].max() + reach[k]
        axis = _lattice_axis(edges, targets_per_cell, lowest, highest, BEYOND_GRID * laws[k].std)
        table, missing = law_table(axis, edges, laws[k])
        lattice.append(axis)
        tables.append(table)
        loss += missing
    points = tuple(lattice)
    kernel = Kernel(tuple(tables), loss)
    return relation, points, kernel, windows_of(relation, grid, points)


def paper_model(agent: LinearAgent, grid: Grid, settings: Mapping[str, object]) -> SharedModel:
    """Return relation, lattice, kernel and choices under the ``paper`` relation; every mean is a lattice point."""
    relation = paper_relation(agent, grid.edges[0], **settings)  # type: ignore[arg-type]
    return _with_menu(relation, grid, (None,))


def tube_model(agent: LinearAgent, grid: Grid, coordinates: FloatArray, room: FloatArray) -> SharedModel:
    """Return relation, lattice, kernel and choices under the ``tube`` relation; ``room`` (d,) is that of labels."""
    feedback = best_feedback(agent, grid, coordinates, room)
    return _snapped(lambda snap: tube_relation(agent, grid, coordinates, feedback, snap=snap), grid)


def ellipsoid_model(
    agent: LinearAgent,
    grid: Grid,
    coordinates: FloatArray,
    room: FloatArray,
    delta: float = 0.0,
    share: float | None = None,
) -> SharedModel:
    """Return relation, lattice, kernel and choices under the ``ellipsoid`` relation; ``room`` (d,) is that of labels.

    ``delta`` and ``share`` are as for ``find_ellipsoid``.
    """

    def relation(snap: FloatArray | None) -> CoupledRelation:
        ellipsoid = find_ellipsoid(agent, grid, coordinates, room, delta, snap, share)
        return ellipsoid_relation(agent, grid, coordinates, ellipsoid, snap=snap)

    return _snapped(relation, grid)


def _snapped(relation_for: Callable[[FloatArray | None], CoupledRelation], grid: Grid) -> SharedModel:
    """Return the model of a relation that allows for means rounded by half a lattice spacing (d,).

    Where the means fall on few distinct coordinates of an axis, these are its lattice; those that differ by rounding of
    the cell edges are taken together. Otherwise the axis gets a lattice of ``SNAPPED_POINTS`` per cell. What means are
    rounded by widens the set of errors.
    """
    # First without rounding, to see where the means fall; then again with what rounding is needed.
    relation = relation_for(None)
    _refuse_many("", "inputs", grid.n_cells * len(relation.inputs))
    widths = np.array([float(np.max(np.diff(edges))) for edges in grid.edges])
    means = relation.means(grid.centres)
    snap, spacing = np.zeros(len(widths)), list[float | None]()
    for k, width in enumerate(widths):
        values = np.unique(means[..., k])
        distinct, together = len(_distinct(values, width, 0.0)), len(_distinct(values, width, NEAR_MEANS))
        if together <= SPARED_POINTS * distinct:
            snap[k], distinct = NEAR_MEANS * width, together
        if distinct > SNAPPED_POINTS * grid.shape[k]:
            snap[k] = width / SNAPPED_POINTS / 2
        spacing.append(width / SNAPPED_POINTS if distinct > SNAPPED_POINTS * grid.shape[k] else None)
    return _with_menu(relation_for(snap) if snap.any() else relation, grid, tuple(spacing))


def _with_menu(relation: CoupledRelation, grid: Grid, spacing: tuple[float | None, ...]) -> SharedModel:
    """Return a model with a menu of inputs.

    The lattice of an axis is all its distinct means, or the multiples of its ``spacing`` if that is not None.
    """
    _refuse_many("", "inputs", grid.n_cells * len(relation.inputs))
    means = relation.means(grid.centres)
    lattice, index, tables, loss = [], [], [], 0.0
    snaps = np.broadcast_to(relation.snap, len(grid.edges))
    for k, edges in enumerate(grid.edges):
        values, width = means[..., k], float(np.max(np.diff(edges)))
        step = spacing[k]
        axis = _distinct(np.unique(values), width, snaps[k] / width) if step is None else _multiples(values, step)
        # Round every mean to the nearest point; the relation allows for no more than `snap`.
        if len(axis) == 1:
            nearest = np.zeros(values.shape, dtype=np.int64)
        else:
            nearest = np.clip(np.searchsorted(axis, values), 1, len(axis) - 1)
            nearest -= (values - axis[nearest - 1]) < (axis[nearest] - values)
        assert np.max(np.abs(axis[nearest] - values)) <= snaps[k] * (1 + 1e-9) + MOST_CREEPING * EQUAL_MEANS * width
        table, missing = gaussian_table(axis, edges, float(np.sqrt(relation.covariance[k])))
        lattice.append(axis)
        index.append(nearest)
        tables.append(table)
        loss += missing
    _refuse_many("", "cells", math.prod(len(axis) for axis in lattice))
    leads_to = np.ravel_multi_index(index, tuple(len(axis) for axis in lattice)).astype(np.int32)
    distance = np.sum((means - grid.centres[:, None, :]) ** 2, axis=-1)
    input_set = InputSet(grid, tuple(lattice), relation, leads_to, np.argmin(distance, axis=1).astype(np.int32))
    return relation, tuple(lattice), Kernel(tuple(tables), loss), input_set


def _refuse_many(agent: str, argument: str, count: int) -> None:
    """Refuse models with more than ``MOST_MEANS`` means or lattice points, before there is any table of them."""
    if count > MOST_MEANS:
        of = f"agent `{agent}`: " if agent else ""
        raise RelationRefused(
            f"{of}`{argument}`: expected at most {MOST_MEANS} means of an agent in all, got {count}; ask for fewer "
            "`cells`, inputs or targets"
        )


def _distinct(ordered: FloatArray, width: float, near: float) -> FloatArray:
    """Return increasing values, but for those within ``near`` cells of the one before.

    Rounding noise, far below what E is enlarged by, never makes two values of one.
    """
    gap = np.maximum(near, EQUAL_MEANS) * width
    firsts = ordered[np.concatenate([[True], np.diff(ordered) > gap])]
    lasts = ordered[np.append(np.searchsorted(ordered, firsts[1:]) - 1, len(ordered) - 1)]
    if np.all(lasts - firsts <= (gap if near > EQUAL_MEANS else MOST_CREEPING * gap)):
        return firsts
    # Values that creep along have no gaps to be told apart by: a run of them would be taken for one.
    if near > EQUAL_MEANS:
        return _distinct(ordered, width, 0.0)
    # Cut such runs: every value is within the gap of the first of its piece.
    pieces, first = list[float](), 0
    while first < len(ordered):
        pieces.append(float(ordered[first]))
        first = int(np.searchsorted(ordered, ordered[first] + gap, side="right"))
    return np.array(pieces)


def _multiples(values: FloatArray, step: float) -> FloatArray:
    """Return the multiples of ``step`` from the smallest to the largest value."""
    return step * np.arange(np.floor(values.min() / step), np.ceil(values.max() / step) + 1)


def _lattice_axis(edges: FloatArray, per_cell: int, lowest: float, highest: float, beyond: float) -> FloatArray:
    """Return the target means of one axis: ``per_cell`` per cell, and as many outside as can matter.

    They go on outside the grid as far as means get, from ``lowest`` to ``highest``, but at most ``beyond``.
    """
    widths = np.diff(edges)
    offsets = (np.arange(per_cell) + 0.5) / per_cell
    inside = (edges[:-1, None] + widths[:, None] * offsets).ravel()
    first, last = widths[0] / per_cell, widths[-1] / per_cell
    usual = (edges[-1] - edges[0]) / (len(widths) * per_cell)
    # Slivers between two boundaries hold points that are nearly one, and are no measure for the spacing outside.
    inside = inside[np.concatenate([[True], np.diff(inside) > 1e-9 * usual])]
    first, last = max(first, usual), max(last, usual)
    below = int(np.ceil(max(0.0, min(edges[0] - lowest, beyond)) / first))
    above = int(np.ceil(max(0.0, min(highest - edges[-1], beyond)) / last))
    before, after = inside[0] - first * np.arange(below, 0, -1), inside[-1] + last * np.arange(1, above + 1)
    return np.concatenate([before, inside, after])


def reaches_every_mean(agent: AnyAgent) -> bool:
    """Return whether the relation ``exact`` is for an agent: some input leads from every state to every mean nearby."""
    if agent.is_affine:
        return agent.has_full_rank
    if agent.angles:
        return False  # only mean boxes have masses over all windings
    if agent.has_clock:
        return False  # targets would have to be solved for at every step by itself
    if not agent.has_plain_noise:
        return False  # only mean boxes know noise that varies, or is none
    try:
        axes = agent.noise_axes if agent.laws is not None else np.eye(agent.n_states)
        return bool(symbolic_targets(with_expressions(agent), axes))
    except RelationRefused:
        return False
