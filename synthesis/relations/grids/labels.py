"""What the abstraction knows of an agent's letter in each cell (docs/theory/guards.md, "What the abstraction knows").

The points that a cell stands for, ``xhat + E``, can have several classes; the set of them is the cell's *label set*. It
is a single class where the relation is exact and the grid aligned. Cells some of whose points may be outside the
workspace are failure (label -1). At time 0 the true state is known to lie in the cell itself, so that the start is read
with the sets of the cells, not of ``xhat + E``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ....envs.systems.arguments import counted
from ....envs.tasks.problem import Problem
from .grid import FloatArray, Grid
from .refusal import RelationRefused

LABEL_SLACK = 1e-12
"""Share by which closed boxes are enlarged: far more than the rounding of their corners."""


@dataclass(frozen=True, eq=False, repr=False)
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

    def __repr__(self) -> str:
        cells, failed = counted(len(self.number), "cell"), int((self.number < 0).sum())
        sets, single = counted(len(self.sets), "label set"), int((self.sets.sum(axis=1) == 1).sum())
        return f"CellLabels({cells}, {failed} of them failure; {sets}, {single} of a single class)"

    @property
    def is_certain(self) -> bool:
        """Whether every cell has one class and lies inside the workspace."""
        return bool(np.all(self.number >= 0) and np.all(self.sets.sum(axis=1) == 1))

    @property
    def key(self) -> tuple[object, ...]:
        """Value for comparing labels."""
        return (self.number.tobytes(), self.sets.tobytes(), self.sets.shape)


def cell_labels(problem: Problem, agent: int, grid: Grid) -> CellLabels:
    """Return the label sets of the points of the cells themselves, half-open boxes (exact)."""
    return _labels(problem, agent, grid.low, grid.high, np.zeros(grid.n_cells, dtype=bool))


def error_labels(problem: Problem, agent: int, grid: Grid, reach: FloatArray) -> CellLabels:
    """Return supersets of the labels within ``reach`` (d,) state units of each cell centre, faces included."""
    return _closed(problem, agent, grid.centres, np.broadcast_to(reach, grid.centres.shape))


def _closed(problem: Problem, agent: int, centre: FloatArray, reach: FloatArray) -> CellLabels:
    """Return the label sets of closed boxes, rounded outwards."""
    workspace = problem.agents[agent].workspace
    slack = LABEL_SLACK * (np.abs(centre) + reach)
    low, high = centre - reach - slack, centre + reach + slack
    return _labels(problem, agent, low, high, np.any((low < workspace.low) | (high > workspace.high), axis=1))


def _labels(problem: Problem, agent: int, low: FloatArray, high: FloatArray, outside: NDArray[np.bool_]) -> CellLabels:
    """Return the label sets of boxes (S, d); those that may be ``outside`` the workspace are failure.

    Where exits are read as letters the outside is one class more, and nothing is failure by itself.
    """
    possible = problem.labeling.box_classes(agent, low, high)
    if problem.labeling.reads_exits:
        outside = np.zeros(len(low), dtype=bool)
    sets, number = np.unique(possible[~outside], axis=0, return_inverse=True)
    if len(sets) == 0:
        raise RelationRefused(
            f"agent `{problem.agent_names[agent]}`: every cell may reach beyond the workspace; ask for more `cells` "
            "or a smaller `epsilon`"
        )
    labels = np.full(len(low), -1, dtype=np.int32)
    labels[~outside] = number.ravel()
    return CellLabels(labels, sets.astype(bool))
