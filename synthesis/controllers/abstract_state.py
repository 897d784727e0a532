"""What coupled agents remember: the abstract state xhat, moved along with the continuous one (THEORY section 6).

From the next state an agent recovers the noise ``w``, draws the abstract noise from the coupling, ``what = w + F e``
with probability ``min(1, phi(what)/phi(w))`` and its mirror image otherwise (always ``what = w`` where F = 0, and
nothing is drawn), and moves xhat as the finite model does. When ``x - xhat`` leaves the relation the certificate claims
nothing any more; the agent starts again from the cell of its state.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..cells import FloatArray, Grid, axis_finder
from ..relations import CoupledRelation, Row, couple, product, rows_of, times


@dataclass(frozen=True, eq=False)
class Memory:
    """What coupled agents remember between steps, for the n agents of a group and M worlds.

    Parameters
    ----------
    cells : (n, M) int array
        Abstract states xhat, as cells.
    error : (d, n, M) array
        ``x - xhat`` in grid coordinates, finite.
    lost : (n, M) bool array
        Whether the relation was ever lost.
    states, inputs, means : (d, n, M), (m, n, M), (d, n, M) arrays or None
        State (grid coordinates) and input of the last step, and the mean of the abstract successor; None before the
        first step.
    """

    cells: NDArray[Any]
    error: FloatArray
    lost: NDArray[np.bool_]
    states: FloatArray | None = None
    inputs: FloatArray | None = None
    means: FloatArray | None = None

    def selected(self, which: NDArray[Any]) -> Memory:
        """Memory of the worlds ``which`` alone, whole numbers in increasing order."""
        arrays = (self.cells, self.error, self.lost, self.states, self.inputs, self.means)
        return Memory(*(None if own is None else own.take(which, axis=-1) for own in arrays))  # type: ignore[arg-type]


@dataclass(frozen=True, eq=False)
class Tracker:
    """Moves the abstract states of agents that share a relation and a grid.

    All work is done axis by axis on arrays (n, M), and in one order whatever worlds are beside.

    Parameters
    ----------
    relation : CoupledRelation
    grid : Grid
    """

    relation: CoupledRelation
    grid: Grid

    def points(self, states: FloatArray) -> FloatArray:
        """Grid coordinates (d, n, M) of states (d, n, M), which may be the same array."""
        return states if self._inverse is None else product(self._inverse, states)

    def begin(self, points: FloatArray) -> Memory:
        """Memory at time 0 at grid coordinates ``points`` (d, n, M): the cells of the states; outside it is lost."""
        cells, error, inside = self.cells_of(points, points)
        return Memory(cells, np.nan_to_num(error, copy=False), ~inside)

    def follow(self, memory: Memory, points: FloatArray, uniform: FloatArray | None) -> Memory:
        """Memory once the agents are at grid coordinates ``points`` (d, n, M), after the first step.

        ``uniform`` (n, M) are auxiliary draws, used where there is a coupling F.
        """
        assert memory.means is not None
        with np.errstate(over="ignore", invalid="ignore"):
            landed = self._noise(memory, points)
            if self.is_coupled:
                assert uniform is not None
                landed = self._coupled(landed, memory.error, uniform)
            landed += memory.means
            cells, error, kept = self.cells_of(landed, points)
            kept &= self.relation.related(error)
        lost, gone = memory.lost, np.flatnonzero(~kept)
        if len(gone):  # few, as a rule
            there = points.reshape(len(points), -1).take(gone, axis=1)
            again = self.begin(there)
            cells.reshape(-1)[gone] = again.cells
            error.reshape(len(points), -1)[:, gone] = again.error
            lost = lost | ~kept
        return Memory(cells, error, lost, memory.states, memory.inputs, memory.means)

    @cached_property
    def is_coupled(self) -> bool:
        """Whether auxiliary draws are needed: F is not 0."""
        return bool(np.any(self.relation.coupling))

    def _noise(self, memory: Memory, points: FloatArray) -> FloatArray:
        """The noise (d, n, M) of the last step: what the next state is off its mean."""
        assert memory.states is not None and memory.inputs is not None
        noise = np.empty(points.shape)
        for own, x, a, b, c in zip(noise, points, self._A, self._B, self.relation.drift.tolist(), strict=True):
            times(a, memory.states, own)
            own += times(b, memory.inputs)
            if c != 0.0:
                own += c
            np.subtract(x, own, out=own)
        return noise

    def _coupled(self, noise: FloatArray, error: FloatArray, uniform: FloatArray) -> FloatArray:
        """Noise (d, n, M) of the abstract system, drawn from the coupling."""
        deviation = np.sqrt(self.relation.covariance).reshape(-1, *[1] * (noise.ndim - 1))
        noise *= 1.0 / deviation
        result = couple(noise, product(self._F, error), uniform)
        result *= deviation
        return result

    def cells_of(
        self, landed: FloatArray, points: FloatArray
    ) -> tuple[NDArray[np.int64], FloatArray, NDArray[np.bool_]]:
        """Where abstract states land at grid coordinates (d, ...) while the agents are at ``points`` (d, ...).

        Returns
        -------
        cells : (...) int array
            Those outside count as in the nearest cell, NaN at the low edge.
        error : (d, ...) array
            The points less the centres of the cells.
        inside : (...) bool array
            Whether they land in the grid.
        """
        error, inside, cells = np.empty(points.shape), np.ones(points.shape[1:], dtype=bool), None
        held, axes = np.empty(points.shape[1:]), zip(self.grid.edges, self._finders, self._centres, strict=True)
        for own, x, to, (edges, find, middle) in zip(landed, points, error, axes, strict=True):
            np.fmax(own, edges[0], out=held)  # fmax passes over NaN
            np.fmin(held, edges[-1], out=held)
            inside &= held == own
            place = find(held)
            np.subtract(x, middle.take(place), out=to)
            if cells is None:
                cells = place
            else:
                cells *= len(middle)
                cells += place
        assert cells is not None
        return cells, error, inside

    @cached_property
    def _inverse(self) -> tuple[Row, ...] | None:
        """State to grid coordinates; None where they are the same."""
        return None if self.relation.has_state_coordinates else rows_of(np.linalg.inv(self.relation.coordinates))

    @cached_property
    def _A(self) -> tuple[Row, ...]:
        return rows_of(self.relation.A)

    @cached_property
    def _B(self) -> tuple[Row, ...]:
        return rows_of(self.relation.B)

    @cached_property
    def _F(self) -> tuple[Row, ...]:
        """F, for noise of variance 1."""
        return rows_of(self.relation.coupling / np.sqrt(self.relation.covariance)[:, None])

    @cached_property
    def _finders(self) -> list[Callable[[FloatArray], NDArray[np.int64]]]:
        return [axis_finder(edges) for edges in self.grid.edges]

    @cached_property
    def _centres(self) -> list[FloatArray]:
        """Middles of the cells, per axis."""
        return [0.5 * (edges[:-1] + edges[1:]) for edges in self.grid.edges]


def moved_into(grid: Grid, points: FloatArray) -> FloatArray:
    """Points moved into the grid; NaN goes to the low edge."""
    inside = np.empty(points.shape)
    for own, moved, edges in zip(points, inside, grid.edges, strict=True):
        np.fmax(own, float(edges[0]), out=moved)  # fmax passes over NaN
        np.fmin(moved, float(edges[-1]), out=moved)
    return inside
