"""What coupled agents remember: the abstract state xhat, moved along with the continuous one.

From the next state an agent recovers the noise ``w``. It draws the abstract noise from the coupling, ``what = w + F e``
with probability ``min(1, phi(what)/phi(w))`` and its mirror image otherwise (docs/theory/relations.md, "Maximal
coupling"); if F = 0, always ``what = w``, and nothing is drawn. Then it moves xhat as the finite model does. When
``x - xhat`` leaves the relation the certificate claims nothing any more, and the agent starts again from the cell of
its state.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...relations.grids import FloatArray, Grid, axis_finder
from ...relations.kinds import CoupledRelation, Row, couple, product, rows_of, times


@dataclass(frozen=True, eq=False)
class Memory:
    """What coupled agents remember between steps, for the n agents of a group and M worlds.

    Parameters
    ----------
    cells : (n, M) int array
        Abstract states xhat, as cells.
    error : (d, n, M) array
        ``x - xhat``, finite.
    lost : (n, M) bool array
        Whether the relation was ever lost.
    states, inputs, means : (d, n, M), (m, n, M), (d, n, M) arrays or None
        State and input of the last step, and the mean of the abstract successor; None before the first step.
    """

    cells: NDArray[Any]
    error: FloatArray
    lost: NDArray[np.bool_]
    states: FloatArray | None = None
    inputs: FloatArray | None = None
    means: FloatArray | None = None

    def selected(self, which: NDArray[Any]) -> Memory:
        """Return the memory of the worlds ``which`` alone, whole numbers in increasing order."""
        arrays = (self.cells, self.error, self.lost, self.states, self.inputs, self.means)
        selected = (None if array is None else array.take(which, axis=-1) for array in arrays)
        return Memory(*selected)  # type: ignore[arg-type]


@dataclass(frozen=True, eq=False)
class Tracker:
    """Moves the abstract states of agents that share a relation and a grid.

    All work is done axis by axis on arrays (n, M), in an order that does not depend on the number of worlds.

    Parameters
    ----------
    relation : CoupledRelation
    grid : Grid
    """

    relation: CoupledRelation
    grid: Grid

    def begin(self, points: FloatArray) -> Memory:
        """Return the memory at time 0 at states (d, n, M): the cells of the states; outside it is lost."""
        cells, error, inside = self.cells_of(points, points)
        return Memory(cells, np.nan_to_num(error, copy=False), ~inside)

    def follow(self, memory: Memory, points: FloatArray, uniform: FloatArray | None) -> Memory:
        """Return the memory once the agents are at ``points`` (d, n, M), after the first step.

        ``uniform`` (n, M) are auxiliary draws, used where there is a coupling F.
        """
        assert memory.means is not None
        # xhat' = Pi(z + what); agents far outside may overflow, and count as lost then.
        with np.errstate(over="ignore", invalid="ignore"):
            landed = self._noise(memory, points)
            if self.is_coupled:
                assert uniform is not None
                landed = self._coupled(landed, memory.error, uniform)
            landed += memory.means
            cells, error, is_related = self.cells_of(landed, points)
            is_related &= self.relation.related(error)
        # Where the relation is lost, few worlds as a rule, begin again from the cell of the state.
        lost, restarted = memory.lost, np.flatnonzero(~is_related)
        if len(restarted):
            there = points.reshape(len(points), -1).take(restarted, axis=1)
            again = self.begin(there)
            cells.reshape(-1)[restarted] = again.cells
            error.reshape(len(points), -1)[:, restarted] = again.error
            lost = lost | ~is_related
        return Memory(cells, error, lost, memory.states, memory.inputs, memory.means)

    @cached_property
    def is_coupled(self) -> bool:
        """Whether auxiliary draws are needed: F is not 0."""
        return bool(np.any(self.relation.coupling))

    def _noise(self, memory: Memory, points: FloatArray) -> FloatArray:
        """Return the noise (d, n, M) of the last step, ``w = x' - (A x + B u + c)``."""
        assert memory.states is not None and memory.inputs is not None
        noise = np.empty(points.shape)
        for component, x, a, b, c in zip(noise, points, self._A, self._B, self.relation.drift.tolist(), strict=True):
            times(a, memory.states, component)
            component += times(b, memory.inputs)
            if c != 0.0:
                component += c
            np.subtract(x, component, out=component)
        return noise

    def _coupled(self, noise: FloatArray, error: FloatArray, uniform: FloatArray) -> FloatArray:
        """Return the noise (d, n, M) of the abstract system, drawn from the coupling; ``noise`` is overwritten."""
        deviation = np.sqrt(self.relation.covariance).reshape(-1, *[1] * (noise.ndim - 1))
        noise *= 1.0 / deviation
        result = couple(noise, product(self._F, error), uniform)
        result *= deviation
        return result

    def cells_of(
        self, landed: FloatArray, points: FloatArray
    ) -> tuple[NDArray[np.int64], FloatArray, NDArray[np.bool_]]:
        """Return where abstract states (d, ...) land while the agents are at ``points`` (d, ...).

        Returns
        -------
        cells : (...) int array
            What lands outside counts as in the nearest cell, NaN as at the low edge.
        error : (d, ...) array
            The points less the centres of the cells.
        inside : (...) bool array
            Whether they land in the grid.
        """
        error, inside, cells = np.empty(points.shape), np.ones(points.shape[1:], dtype=bool), None
        held, axes = np.empty(points.shape[1:]), zip(self.grid.edges, self._finders, self._centres, strict=True)
        for coordinate, x, component, (edges, find, middle) in zip(landed, points, error, axes, strict=True):
            # Move what is outside onto the nearest edge; fmax passes over NaN.
            np.fmax(coordinate, edges[0], out=held)
            np.fmin(held, edges[-1], out=held)
            inside &= held == coordinate
            place = find(held)
            np.subtract(x, middle.take(place), out=component)
            if cells is None:
                cells = place
            else:
                cells *= len(middle)
                cells += place
        assert cells is not None
        return cells, error, inside

    @cached_property
    def _A(self) -> tuple[Row, ...]:
        return rows_of(self.relation.A)

    @cached_property
    def _B(self) -> tuple[Row, ...]:
        return rows_of(self.relation.B)

    @cached_property
    def _F(self) -> tuple[Row, ...]:
        """Rows of F, for noise of variance 1."""
        return rows_of(self.relation.coupling / np.sqrt(self.relation.covariance)[:, None])

    @cached_property
    def _finders(self) -> list[Callable[[FloatArray], NDArray[np.int64]]]:
        return [axis_finder(edges) for edges in self.grid.edges]

    @cached_property
    def _centres(self) -> list[FloatArray]:
        """Middles of the cells, per axis."""
        return [0.5 * (edges[:-1] + edges[1:]) for edges in self.grid.edges]


def moved_into(grid: Grid, points: FloatArray) -> FloatArray:
    """Return points (d, ...) moved into the grid if they are outside; NaN goes to the low edge."""
    inside = np.empty(points.shape)
    for coordinate, moved, edges in zip(points, inside, grid.edges, strict=True):
        np.fmax(coordinate, float(edges[0]), out=moved)  # fmax passes over NaN
        np.fmin(moved, float(edges[-1]), out=moved)
    return inside
