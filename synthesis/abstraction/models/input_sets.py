"""Choices of agents whose abstract inputs each lead to a lattice point."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....envs.systems.arguments import counted
from ...relations.grids import FloatArray, Grid
from ...relations.kinds import CoupledRelation
from .action_tables import CELLS_PER_BLOCK, NUMBERS_PER_BLOCK, MeansAt, PointChoices, StepPolicy, largest


@dataclass(frozen=True, eq=False, repr=False)
class InputSet(PointChoices):
    """A abstract inputs per cell, each with the lattice point it leads to.

    Parameters
    ----------
    grid : Grid
    lattice : tuple of (Z_k,) arrays
        Means per axis.
    relation : CoupledRelation
    leads_to : (S, A) int32 array
        Flat lattice point of each cell and input.
    resting : (S,) int32 array
        The input that stays nearest to the cell.
    """

    grid: Grid
    lattice: tuple[FloatArray, ...]
    relation: CoupledRelation
    leads_to: NDArray[np.int32]
    resting: StepPolicy

    read_per_second = 4e6

    def __repr__(self) -> str:
        return f"InputMenu({self.leads_to.shape[0]} cells, {counted(self.leads_to.shape[1], 'input')} each)"

    @property
    def input_set(self) -> NDArray[np.int32]:
        """Lattice point (S, A) of each cell and input."""
        return self.leads_to

    @property
    def resting_choice(self) -> StepPolicy:
        """(S,) input that stays nearest to the cell."""
        return self.resting

    def points(self, policy: StepPolicy) -> NDArray[Any]:
        """Return the lattice points of a policy; -1 where it has no choice."""
        chosen = np.take_along_axis(self.leads_to, np.maximum(policy, 0)[:, None], axis=1)[:, 0]
        return np.where(policy < 0, -1, chosen)

    def _blocks(self, idle: NDArray[np.bool_], table: Any) -> list[NDArray[np.int64]]:
        """Return the cells with something to decide, in large blocks: menus need no neighbours in a block."""
        rows = 4 if isinstance(table, np.ndarray) else len(table)
        size = max(CELLS_PER_BLOCK, NUMBERS_PER_BLOCK // (self.leads_to.shape[1] * rows))
        busy = np.flatnonzero(~idle)
        return [busy[first : first + size] for first in range(0, len(busy), size)]

    def _best_of(self, block: NDArray[Any], weights: Any, table: Any) -> tuple[NDArray[Any], FloatArray]:
        """Return argmax and maximum of the objective over the inputs of a block of cells."""
        points = self.leads_to[block]
        if isinstance(table, np.ndarray):
            # Row by row: the numbers that a row of the table gives to a block stay in the cache.
            scores = np.zeros(points.shape)
            for weight, row in zip(weights.T, table, strict=True):
                if weight.any():
                    scores += weight[:, None] * row.take(points)
            return largest(scores)
        reached = table[:, points.ravel()].reshape(len(table), *points.shape)
        return largest(np.einsum("sn,nsa->sa", weights, reached))

    def largest(self, backed_up: FloatArray) -> FloatArray:
        """Return the largest values (S,) of a smoothed factor (Z,) over all inputs."""
        return np.asarray(backed_up.take(self.leads_to).max(axis=1))

    def nearest(self, means_at: MeansAt) -> StepPolicy:
        """Return the input (S,) of each cell whose mean is nearest to that at its centre, in cell widths."""
        scale, means = self.cell_widths, means_at(self.grid.centres)
        points = np.stack(np.meshgrid(*self.lattice, indexing="ij"), axis=-1).reshape(-1, len(scale))
        # Distances of all inputs on offer; places of the menu that are empty are infinitely far.
        gaps = (((points[np.maximum(self.leads_to, 0)] - means.T[:, None]) / scale) ** 2).sum(axis=-1)
        gaps = np.where(self.leads_to < 0, np.inf, gaps)
        return np.where((self.leads_to >= 0).any(axis=1), gaps.argmin(axis=1), -1).astype(np.int32)

    def same_as(self, relation: Mapping[str, Any], input_set: NDArray[Any] | None) -> bool:
        """Return whether a menu that was stored is this one."""
        return input_set is not None and np.array_equal(input_set, self.leads_to)

    @property
    def dense_cost(self) -> int:
        """Number of inputs."""
        return int(self.leads_to.shape[1])

    def dense_best(self, values: FloatArray) -> FloatArray:
        """Return the largest (n, S) of values (n, Z), one input after the other."""
        best = np.zeros((len(values), len(self.leads_to)))
        for input_set in self.leads_to.T:
            best = np.maximum(best, np.where(input_set >= 0, values[:, np.maximum(input_set, 0)], 0.0))
        return best
