"""Relation, lattice, kernel and choices of a single agent under each kind of relation.

This is the part of a finite model that does not depend on labels; agents with equal dynamics and grid share it.
``abstract`` puts it together with the labels.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ....envs.systems.agents import AnyAgent, LinearAgent, with_expressions
from ...relations.grids import FloatArray, Grid, RelationRefused, grid_laws
from ...relations.kinds import (
    Relation,
    aimed_relation,
    paper_relation,
    symbolic_targets,
)
from ..kernels import Kernel, gaussian_table, law_table
from .action_tables import ActionTable
from .input_sets import InputSet
from .target_windows import windows_of

SharedModel = tuple[Relation, tuple[FloatArray, ...], Kernel, ActionTable]
"""Relation, lattice axes, kernel and choices: what agents share whose labels may differ."""

EQUAL_MEANS = 1e-11
"""Share of a cell by which rounding moves means; E is enlarged by far more."""

MOST_MEANS = 50_000_000
"""Most means of cells and inputs, and most lattice points, of one agent: 400 MB for each axis."""

MOST_CREEPING = 10.0
"""Runs of means that creep along are one up to this many times ``EQUAL_MEANS``."""

STRANDED_CELLS = 0.02
"""Share of cells without an admissible target up to which the ``exact`` relation is preferred to others."""

BEYOND_GRID = 3.0
"""Standard deviations that target means may lie outside the grid: from farther away hardly any mass comes back."""


def exact_model(agent: AnyAgent, grid: Grid, targets_per_cell: int) -> SharedModel:
    """Return relation, lattice, kernel and choices under the ``exact`` relation."""
    relation = aimed_relation(agent)
    _refuse_many(agent.name, "targets_per_cell", grid.n_cells * targets_per_cell ** len(grid.edges))
    means, reach = relation.on(grid).farthest
    laws = grid_laws(agent)
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
    edges = grid.edges[0]
    relation = paper_relation(agent, edges, **settings)  # type: ignore[arg-type]
    _refuse_many("", "inputs", grid.n_cells * len(relation.inputs))
    means, width = relation.means(grid.centres)[..., 0], float(np.max(np.diff(edges)))
    axis = _distinct(np.unique(means), width)
    _refuse_many("", "cells", len(axis))
    leads_to = np.zeros(means.shape, dtype=np.int32)
    if len(axis) > 1:
        leads_to = np.clip(np.searchsorted(axis, means), 1, len(axis) - 1)
        leads_to -= (means - axis[leads_to - 1]) < (axis[leads_to] - means)
    assert np.max(np.abs(axis[leads_to] - means)) <= MOST_CREEPING * EQUAL_MEANS * width
    table, missing = gaussian_table(axis, edges, float(np.sqrt(relation.covariance[0])))
    resting = np.argmin((means - grid.centres) ** 2, axis=1).astype(np.int32)
    input_set = InputSet(grid, (axis,), relation, leads_to.astype(np.int32), resting)
    return relation, (axis,), Kernel((table,), missing), input_set


def _refuse_many(agent: str, argument: str, count: int) -> None:
    """Refuse models with more than ``MOST_MEANS`` means or lattice points, before there is any table of them."""
    if count > MOST_MEANS:
        of = f"agent `{agent}`: " if agent else ""
        raise RelationRefused(
            f"{of}`{argument}`: expected at most {MOST_MEANS} means of an agent in all, got {count}; ask for fewer "
            "`cells`, inputs or targets"
        )


def _distinct(ordered: FloatArray, width: float) -> FloatArray:
    """Return increasing values; those that only rounding, far below what E is enlarged by, tells apart are one."""
    gap = EQUAL_MEANS * width
    firsts = ordered[np.concatenate([[True], np.diff(ordered) > gap])]
    lasts = ordered[np.append(np.searchsorted(ordered, firsts[1:]) - 1, len(ordered) - 1)]
    if np.all(lasts - firsts <= MOST_CREEPING * gap):
        return firsts
    # Values that creep along have no gaps to be told apart by. Cut such runs: every value is within the gap of the
    # first of its piece.
    pieces, first = list[float](), 0
    while first < len(ordered):
        pieces.append(float(ordered[first]))
        first = int(np.searchsorted(ordered, ordered[first] + gap, side="right"))
    return np.array(pieces)


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
        return bool(symbolic_targets(with_expressions(agent)))
    except RelationRefused:
        return False
