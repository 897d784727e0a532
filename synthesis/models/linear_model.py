"""Relation, lattice, kernel and choices of an agent under the relation ``linear``."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np

from ...envs.agents import LinearAgent
from ..cells import FloatArray, Grid, in_grid_coordinates
from ..relations import LinearRelation, linear_relation
from .affine_choices import AffineChoices
from .bends import Bends
from .choices import target_windows
from .linear_kernel import LinearKernel, hat_table, uniform_axis

POINTS_PER_CELL = 4
"""Lattice points per cell and axis: at four, rounding a target costs a hundredth of what cells cost."""

INPUT_LEVELS = {1: 33, 2: 11, 3: 5}
"""Levels of each input of a menu, by the number of inputs; 3 beyond."""

BEYOND_GRID = 3.0
"""Standard deviations that means may lie outside the grid: from farther away hardly any mass comes back."""

EVEN = 2e-9
"""Lattice steps by which the widths of an axis may differ for images to count as lying on the lattice."""

LEAST_SLACK, LEAST_BEND = 1e-5, 1e-3
"""Largest slack per step, for want of high derivatives, and largest bend with which an image is read in few parts."""

BESIDE = 1e-13
"""Share of a step that may lie beside an axis without it being one in another direction: matrices have rounding."""

MOST_PARTS = 8
"""Most parts that each side of an image is read in."""


def linear_model(
    agent: LinearAgent, grid: Grid, coordinates: FloatArray, per_cell: int | None = None
) -> tuple[LinearRelation, tuple[FloatArray, ...], LinearKernel, AffineChoices]:
    """Return relation, lattice, kernel and choices under the ``linear`` relation.

    Agents whose inputs reach every mean choose targets and gains; all others choose inputs from a menu.
    """
    per_cell = per_cell or POINTS_PER_CELL
    reaches_all = np.linalg.matrix_rank(agent.B) == agent.n_states
    relation = linear_relation(agent, coordinates, None if reaches_all else input_menu(agent))
    # How finely images are read depends on the lattice, and that on the relation.
    deviations = np.sqrt(np.diag(in_grid_coordinates(agent, coordinates).covariance))
    lattice = _lattice(agent, relation, grid, deviations, per_cell)
    pitch = np.array([axis[1] - axis[0] for axis in lattice])
    even = all(np.ptp(np.diff(edges)) <= EVEN * step for edges, step in zip(grid.edges, pitch, strict=True))
    on_lattice = bool(relation.steers) and even and per_cell % 2 == 0
    # Steps between the points of an image that are read: of a widest cell, along each side.
    widest = np.array([np.max(np.diff(edges)) for edges in grid.edges])
    gain = np.eye(len(widest)) if relation.steers else relation.A
    lattice_steps = np.zeros((0, len(pitch))) if on_lattice else np.diag(pitch)
    axes = zip(lattice, grid.edges, deviations.tolist(), strict=True)
    tables, losses = zip(*(hat_table(*axis) for axis in axes), strict=True)
    # As few parts as will do; those of images on the lattice are whole lattice steps.
    possible = [n for n in range(2, per_cell + 1) if per_cell % n == 0] if on_lattice else [2, 4, MOST_PARTS]
    parts = possible[-1]
    for parts in possible:
        steps = (gain * widest).T / parts
        sizes = np.abs(steps / deviations)
        steps[sizes <= BESIDE * sizes.max(axis=1, keepdims=True)] = 0.0
        bends = Bends(np.concatenate([steps, lattice_steps]), lattice, grid.edges, deviations, sum(losses))
        if bends.slack[0] <= LEAST_SLACK and bends.largest <= LEAST_BEND:
            break
    relation = replace(relation, parts=parts)
    kernel = LinearKernel(tables, sum(losses), bends=bends)
    windows = tuple(target_windows(steer, grid, lattice) for steer in relation.steers)
    return relation, lattice, kernel, AffineChoices(grid, lattice, relation, per_cell, windows)


def input_menu(agent: LinearAgent) -> FloatArray:
    """Return evenly spaced inputs (A, m), the corners of the input box among them."""
    levels = INPUT_LEVELS.get(agent.n_inputs, 3)
    box = agent.input_box
    axes = [np.linspace(a, b, levels) if b > a else np.array([a]) for a, b in zip(box.low, box.high, strict=True)]
    menu = np.array(list(product(*axes)))
    return np.clip(menu, box.low, box.high)


def _lattice(
    agent: LinearAgent, relation: LinearRelation, grid: Grid, deviations: FloatArray, per_cell: int
) -> tuple[FloatArray, ...]:
    """Return evenly spaced lattice axes that hold all means of cells, those far outside the grid left out."""
    A, B = relation.A, relation.B
    box = agent.input_box
    corners_low = np.array([edges[0] for edges in grid.edges])
    corners_high = np.array([edges[-1] for edges in grid.edges])
    middle, reach = 0.5 * (corners_low + corners_high), 0.5 * (corners_high - corners_low)
    centre = A @ middle + relation.offset + B @ (0.5 * (box.low + box.high))
    extent = np.abs(A) @ reach + np.abs(B) @ (0.5 * (box.high - box.low))
    axes = []
    for k, edges in enumerate(grid.edges):
        low, high, beyond = float(edges[0]), float(edges[-1]), BEYOND_GRID * float(deviations[k])
        width = (high - low) / grid.shape[k]
        first = max(low - beyond, min(low, float(centre[k] - extent[k]))) - width
        last = min(high + beyond, max(high, float(centre[k] + extent[k]))) + width
        axes.append(uniform_axis(low, high, grid.shape[k], per_cell, first, last))
    return tuple(axes)
