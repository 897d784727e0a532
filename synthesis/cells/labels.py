"""What the abstraction knows of an agent's letter in each cell.

The points that a cell stands for, ``xhat + E``, can have several classes; the set of them is the cell's *label set*. It
is a single class where the relation is exact and the grid aligned. Cells some of whose points may be outside the
workspace are failure (label -1). At time 0 the true state is known to lie in the cell itself, so the start is read with
the sets of the cells, not of ``xhat + E``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...envs.problem import Problem
from .grid import FloatArray, Grid
from .refusal import RelationRefused


@dataclass(frozen=True, eq=False)
class CellLabels:
    """Label set of every cell of one agent.

    Parameters
    ----------
    number : (S,) int32 array
        Index into ``sets``; -1 for failure.
    sets : (n, C) bool array
        Distinct sets of classes that occur.
    """

    number: NDArray[np.int32]
    sets: NDArray[np.bool_]

    @property
    def is_certain(self) -> bool:
        """Whether every cell has one class and lies inside the workspace."""
        return bool(np.all(self.number >= 0) and np.all(self.sets.sum(axis=1) == 1))

    @property
    def key(self) -> tuple[object, ...]:
        """Value for comparing labels."""
        return (self.number.tobytes(), self.sets.tobytes(), self.sets.shape)


def cell_labels(problem: Problem, agent: int, grid: Grid, coordinates: FloatArray) -> CellLabels:
    """Label sets of the points of the cells themselves (half-open boxes in state coordinates, else bounding boxes)."""
    if np.array_equal(coordinates, np.eye(len(coordinates))):
        return _labels(problem, agent, grid.low, grid.high, np.zeros(grid.n_cells, dtype=bool))
    centre, reach = grid.centres @ coordinates.T, grid.half_widths @ np.abs(coordinates).T
    return _closed(problem, agent, centre, reach)


def error_labels(problem: Problem, agent: int, grid: Grid, coordinates: FloatArray, reach: FloatArray) -> CellLabels:
    """Label sets of the points within ``reach`` (d,) state units of each cell centre, faces included."""
    centre = grid.centres @ coordinates.T
    return _closed(problem, agent, centre, np.broadcast_to(reach, centre.shape))


def _closed(problem: Problem, agent: int, centre: FloatArray, reach: FloatArray) -> CellLabels:
    """Label sets of closed boxes, rounded outwards."""
    workspace = problem.agents[agent].workspace
    slack = 1e-12 * (np.abs(centre) + reach)
    low, high = centre - reach - slack, centre + reach + slack
    return _labels(problem, agent, low, high, np.any((low < workspace.low) | (high > workspace.high), axis=1))


def _labels(problem: Problem, agent: int, low: FloatArray, high: FloatArray, outside: NDArray[np.bool_]) -> CellLabels:
    possible = problem.labeling.box_classes(agent, low, high)
    sets, number = np.unique(possible[~outside], axis=0, return_inverse=True)
    if len(sets) == 0:
        raise RelationRefused(
            f"agent `{problem.agent_names[agent]}`: every cell may reach beyond the workspace; ask for more `cells` "
            "or a smaller `epsilon`"
        )
    every = np.full(len(low), -1, dtype=np.int32)
    every[~outside] = number.ravel()
    return CellLabels(every, sets.astype(bool))
