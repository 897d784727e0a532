"""What coupled agents remember: the abstract state xhat, moved along with the continuous one (THEORY section 6).

From the next state an agent recovers the noise ``w``, draws the abstract noise from the coupling, ``what = w + F e``
with probability ``min(1, phi(what)/phi(w))`` and its mirror image otherwise (always ``what = w`` where F = 0), and
moves xhat as the finite model does. When ``x - xhat`` leaves the relation the certificate claims nothing any more; the
agent starts again from the cell of its state.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .grid import FloatArray, Grid
from .relation_coupled import CoupledRelation, couple
from .relation_exact import apply


@dataclass(frozen=True, eq=False)
class Memory:
    """What coupled agents remember between steps, for the n agents of a group and M worlds.

    Parameters
    ----------
    cells : (n, M) int array
        Abstract states xhat, as cells.
    states, inputs, means : (d, n, M), (m, n, M), (d, n, M) arrays
        State (grid coordinates) and input of the last step, and the mean of the abstract successor.
    lost : (n, M) bool array
        Whether the relation was ever lost.
    """

    cells: NDArray[Any]
    states: FloatArray
    inputs: FloatArray
    means: FloatArray
    lost: NDArray[np.bool_]


def follow(relation: CoupledRelation, grid: Grid, memory: Memory, points: FloatArray, uniform: FloatArray) -> Memory:
    """Move the abstract states along with the continuous ones, now at grid coordinates ``points`` (d, n, M)."""
    column = (-1, *[1] * memory.cells.ndim)
    centres = grid.centres
    with np.errstate(over="ignore", invalid="ignore"):
        expected = apply(relation.A, memory.states) + apply(relation.B, memory.inputs) + relation.drift.reshape(column)
        noise = points - expected
        if np.any(relation.coupling):
            deviation = np.sqrt(relation.covariance).reshape(column)
            error = memory.states - np.moveaxis(centres[memory.cells], -1, 0)
            noise = deviation * couple(noise / deviation, apply(relation.coupling, error) / deviation, uniform)
        landed = memory.means + noise
        inside = np.ones(memory.cells.shape, dtype=bool)
        for edges, own in zip(grid.edges, landed, strict=True):
            inside &= (edges[0] <= own) & (own <= edges[-1])
        cells = grid.cell_of(moved_into(grid, landed))
        kept = inside & relation.related(points - np.moveaxis(centres[cells], -1, 0))
    again = grid.cell_of(moved_into(grid, points))
    return Memory(np.where(kept, cells, again), points, memory.inputs, memory.means, memory.lost | ~kept)


def moved_into(grid: Grid, points: FloatArray) -> FloatArray:
    """Points moved into the grid; NaN goes to the low edge."""
    inside = np.empty(points.shape)
    for own, moved, edges in zip(points, inside, grid.edges, strict=True):
        np.fmax(own, float(edges[0]), out=moved)  # fmax passes over NaN
        np.fmin(moved, float(edges[-1]), out=moved)
    return inside
