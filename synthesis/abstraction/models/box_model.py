"""Relation, lattice, kernel and choices of an agent under the relation ``boxes``."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from itertools import product

import numpy as np

from ....envs.systems.agents import AnyAgent, Box
from ....envs.systems.arguments import shortened
from ...relations.grids import (
    FEWER,
    CellAxis,
    FloatArray,
    Grid,
    LatticeAxis,
    MeanAxis,
    RelationRefused,
    ScaleAxis,
    cell_points,
    grid_laws,
    lattice_axes,
)
from ...relations.kinds import BoxRelation, box_relation
from ..kernels import MOST_SCALED, MOST_SCALES, BoxKernel, box_kernel_of, box_lattice, points_per_cell, scale_levels
from .box_choices import BoxChoices, box_choices

INPUT_LEVELS = {1: 17, 2: 7, 3: 4}
"""Levels of each input, by the number of inputs; 3 beyond."""

PARTS, LEAST_SHRINKAGE = (1, 2, 4), 0.03
"""Parts into which cells are cut along each axis to enclose expressions, and by how much that must shrink boxes."""

MOST_CUTS = 64
"""Most parts of a cell: as many enclosures are made of it."""

SAMPLED_CELLS = 500
"""Cells by which that is judged."""

LEAST_DEVIATION, MOST_DEVIATION = 1e-100, 1e100
"""Deviations of scaled laws: squares of smaller ones are 0 in floating point, and those of larger ones infinite."""

CELLS_AT_ONCE = 4096
"""Cells whose scales are enclosed at once."""

MOST_BOXES = 20_000_000
"""Most boxes of an agent, cells times choices: 1 GB in two dimensions."""

MOST_LATTICE = 50_000_000
"""Most lattice points of an agent: 400 MB for each factor."""

MOST_MASSES = 60_000_000
"""Masses of cells around the lattice points of one state, up to which its noise gets more scales: 480 MB."""

FEW = 0.1
"""Share of the cells whose noise may be so small that the lattice is coarse for it: it may be next to nothing where a
population is, and would ask for many times the points."""


def box_model(
    agent: AnyAgent, grid: Grid, per_cell: int | None = None
) -> tuple[BoxRelation, tuple[FloatArray, ...], BoxKernel, BoxChoices]:
    """Return relation, lattice, kernel and choices under the relation ``boxes``, with the choices of defaults."""
    relation = relation_of(agent, grid)
    input_set = relation.input_set
    laws, spread = grid_laws(agent), scale_range(agent, relation, grid)
    if spread is not None:  # the lattice of the means is made for the smallest noise, but for that of a few cells
        smallest = [law.scaled(least) for law, least in zip(laws, spread[3].tolist(), strict=True)]
    else:
        smallest = list(laws)
    deviations = np.sqrt(np.diag(agent.noise_covariance)) if spread is not None else np.array([w.std for w in laws])
    axes = lattice_axes(agent)
    points = (per_cell,) * agent.n_states if per_cell is not None else points_per_cell(grid, smallest, len(axes))
    # Means from anywhere in the grid under any input.
    whole = relation.mean_boxes(*(np.array([[edges[k] for edges in grid.edges]]) for k in (0, -1)))
    low, high = whole.low.min(axis=(0, 1)), whole.high.max(axis=(0, 1))
    # Where expressions have no bound on the whole grid, the lattice goes as far as it ever does.
    low, high = np.where(np.isnan(low), -np.inf, low), np.where(np.isnan(high), np.inf, high)
    count = math.prod(n * k for n, k in zip(grid.shape, points, strict=True))
    if grid.n_cells * len(input_set) > MOST_BOXES or count > MOST_LATTICE:
        raise RelationRefused(
            f"agent `{agent.name}`: mean boxes need at most {MOST_BOXES} boxes and {MOST_LATTICE} lattice points, got "
            f"{grid.n_cells * len(input_set)} and {count}{FEWER}"
        )
    means = box_lattice(grid, deviations, points, low, high, agent.wrapped_axes.tolist())
    points_of: dict[LatticeAxis, FloatArray] = {MeanAxis(k): own for k, own in enumerate(means)}
    points_of |= {CellAxis(k): cell_points(n) for k, n in enumerate(grid.shape)}
    if spread is not None:
        n_scaled = sum(axis.is_logarithmic for axis in axes)
        levels = min(MOST_SCALES, MOST_SCALED / math.prod(map(len, means))) ** (1.0 / max(1, n_scaled))
        levels = min(levels, *(MOST_MASSES / (len(axis) * n) for axis, n in zip(means, grid.shape, strict=True)))
        least, most, usual = (numbers.tolist() for numbers in spread[:3])
        for k in (axis.state for axis in axes if axis.is_logarithmic):
            points_of[ScaleAxis(k)] = scale_levels(least[k], most[k], usual[k], laws[k], levels)
    lattice = tuple(points_of[axis] for axis in axes)
    choices = box_choices(grid, lattice, relation, axes)
    if agent.has_clock:
        choices = replace(choices, n_times=int(agent.input_high[-1]) + 1)
    return relation, lattice, box_kernel_of(grid, lattice, laws, axes, agent.wrapped_axes.tolist()), choices


def scale_range(agent: AnyAgent, relation: BoxRelation, grid: Grid) -> tuple[FloatArray, ...] | None:
    """Return numbers (d,): least and largest positive scales of the noise, how much logarithms vary in a cell on
    average, and the scale that all but a ``FEW`` of the cells are above.

    None if the noise is the same everywhere.
    """
    if agent.noise_scale is None:
        return None
    least, most = np.full(agent.n_states, np.inf), np.zeros(agent.n_states)
    within, smallest = list[FloatArray](), list[FloatArray]()
    for first in range(0, grid.n_cells, CELLS_AT_ONCE):
        block = slice(first, first + CELLS_AT_ONCE)
        scales = relation.scales(grid.low[block], grid.high[block])
        assert scales is not None
        usable = np.all((scales[0] > 0.0) & np.isfinite(scales[1]), axis=2)
        least = np.minimum(least, scales[0][usable].min(axis=0, initial=np.inf))
        most = np.maximum(most, scales[1][usable].max(axis=0, initial=0.0))
        within.append(np.log(scales[1][usable] / scales[0][usable]))
        smallest.append(scales[0][usable])
    if not np.all(most > 0.0):
        raise RelationRefused(f"agent `{agent.name}`: no cell is seen to have a positive `noise_scale`")
    for law, low, high, text in zip(agent.laws or (), least, most, agent.noise_scale, strict=True):
        if law.std == 0.0:
            continue  # a state without noise has none to be multiplied
        if law.std * low < LEAST_DEVIATION or law.std * high > MOST_DEVIATION:
            raise RelationRefused(
                f"agent `{agent.name}`: `noise_scale` {shortened(text, 60)!r} multiplies deviations to numbers from "
                f"{law.std * low:.3g} to {law.std * high:.3g}; expected from {LEAST_DEVIATION:g} to {MOST_DEVIATION:g} "
                "on the workspace; bound the expression, or make the workspace smaller"
            )
    return least, most, np.mean(np.concatenate(within), axis=0), np.quantile(np.concatenate(smallest), FEW, axis=0)


def relation_of(agent: AnyAgent, grid: Grid) -> BoxRelation:
    """Return the relation with the choices that are offered by default."""
    if agent.has_clock:
        return in_fitting_parts(agent, grid, clock_input_set(agent, INPUT_LEVELS))
    return in_fitting_parts(agent, grid, with_rest(agent.input_box, INPUT_LEVELS.get(agent.n_inputs, 3)))


def clock_input_set(agent: AnyAgent, levels: Mapping[int, int]) -> FloatArray:
    """Return the inputs (A, m) of an agent with a clock: at each time, one after the other, the same other inputs.

    ``levels`` are those of each other input, by their number; 3 beyond.
    """
    low, high = agent.input_low[:-1], agent.input_high[:-1]
    others = with_rest(Box(low, high, allow_flat=True), levels.get(len(low), 3))
    times = np.arange(int(agent.input_high[-1]) + 1, dtype=float)
    return np.hstack([np.tile(others, (len(times), 1)), np.repeat(times, len(others))[:, None]])


def in_fitting_parts(agent: AnyAgent, grid: Grid, input_set: FloatArray) -> BoxRelation:
    """Return the relation with cells cut into as many parts as make boxes noticeably smaller, judged by some."""
    some = np.unique(np.linspace(0, grid.n_cells - 1, SAMPLED_CELLS).astype(np.int64))
    best, width = box_relation(agent, input_set), np.inf
    for parts in (number for number in PARTS if number**agent.n_states <= MOST_CUTS):
        relation = box_relation(agent, input_set, parts)
        boxes = relation.mean_boxes(grid.low[some], grid.high[some])
        widths = (boxes.high - boxes.low)[boxes.admissible]
        mean = float(np.mean(widths / np.mean(grid.half_widths, axis=0))) if len(widths) else np.inf
        if not mean < width * (1.0 - LEAST_SHRINKAGE):
            break
        best, width = relation, mean
    return best


def with_rest(box: Box, levels: int) -> FloatArray:
    """Return evenly spaced inputs (A, m) of a box: its corners, and 0 on every axis on which it is admissible."""
    axes = [evenly_with_rest(*ends, levels) for ends in zip(box.low.tolist(), box.high.tolist(), strict=True)]
    return np.clip(np.array(list(product(*axes))), box.low, box.high)


def evenly_with_rest(low: float, high: float, levels: int) -> FloatArray:
    """Return evenly spaced numbers of an interval, both ends among them, and 0 if it lies in the interval."""
    axis = np.clip(np.linspace(low, high, levels), low, high) if high > low else np.array([low])
    return np.unique(np.append(axis, 0.0)) if low <= 0.0 <= high else axis
