"""Cells of many points at once, exactly.

Bisection costs some fifty nanoseconds per point, because none of its branches can be predicted. Here an axis is cut
into equal buckets with at most one cell edge in each. Arithmetic finds the bucket of a point, and one comparison with
the edge in it decides the cell. Rounding does no harm: ``x -> floor(fl(fl(x - low) * scale))`` never decreases, so that
the edges in earlier buckets are not above x, and those in later ones are.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .grid import FloatArray, Grid

MOST_BUCKETS_PER_CELL = 64
"""Most buckets per cell: tables stay small. Axes that would need more are searched by bisection."""

FIRST_BUCKETS_PER_CELL = 1.0 - 1e-9
"""Buckets per cell that are tried first: a little less than one, so that those of equal cells hold one edge each."""

SHORTEST_AXIS = 1e-290
"""Shortest axis, in state units, that is cut into buckets; on shorter ones the buckets per unit would overflow."""


@dataclass(frozen=True, eq=False)
class Buckets:
    """One axis cut into buckets ``b(x) = floor((x - low) * scale)``.

    Parameters
    ----------
    low : float
        Low end of the axis, in state units.
    scale : float
        Buckets per state unit.
    below : (n,) int64 array or None
        Number of inner cell edges in the buckets before each; None if each bucket before holds one.
    edge : (n,) array
        The inner cell edge in each bucket, in state units; infinite where there is none.
    """

    low: float
    scale: float
    below: NDArray[np.int64] | None
    edge: FloatArray

    def cell_of(self, points: FloatArray) -> NDArray[np.int64]:
        """Return the cell of each point of the axis (exact); points must lie between its ends."""
        distance = points - self.low
        distance *= self.scale
        bucket = distance.astype(np.intp)
        reached = points >= self.edge.take(bucket)
        cells = bucket if self.below is None else self.below.take(bucket)
        cells += reached
        return cells


def buckets(edges: FloatArray) -> Buckets | None:
    """Return the buckets of an axis with increasing cell ``edges``; None if the cells are too unequal for them.

    Examples
    --------
    >>> cut = buckets(np.array([0.0, 1.0, 3.0]))
    >>> cut.cell_of(np.array([0.0, np.nextafter(1.0, 0.0), 1.0, 3.0])).tolist()
    [0, 0, 1, 1]
    """
    inner, span = edges[1:-1], float(edges[-1]) - float(edges[0])
    if not SHORTEST_AXIS <= span < math.inf:
        return None
    # Take more and more buckets until no two edges share one.
    per_cell = FIRST_BUCKETS_PER_CELL
    while per_cell <= MOST_BUCKETS_PER_CELL:
        scale = per_cell * (len(edges) - 1) / span
        edge_buckets = ((inner - edges[0]) * scale).astype(np.intp)
        if np.all(np.diff(edge_buckets) > 0):
            n_buckets = int(span * scale) + 1
            edge = np.full(n_buckets, np.inf)
            edge[edge_buckets] = inner
            below = np.searchsorted(edge_buckets, np.arange(n_buckets))
            # With one edge per bucket the number below a bucket is its own number: no table is needed.
            plain = bool(np.all(below == np.arange(n_buckets)))
            return Buckets(float(edges[0]), float(scale), None if plain else below, edge)
        per_cell = 2.0 if per_cell < 1.0 else 2.0 * per_cell
    return None


def axis_finder(edges: FloatArray) -> Callable[[FloatArray], NDArray[np.int64]]:
    """Return a function from points (...) of one axis with cell ``edges`` to their cells; points must lie on it."""
    cut = buckets(edges)
    if cut is not None:
        return cut.cell_of
    return lambda points: np.asarray(np.searchsorted(edges[1:-1], points, side="right"))


def cell_finder(grid: Grid) -> Callable[[FloatArray], NDArray[np.int64]]:
    """Return a function that does what ``grid.cell_of`` does for points (d, ...) inside the grid, several times faster.

    It pays for many points.
    """
    first, *others = [axis_finder(edges) for edges in grid.edges]

    def find(points: FloatArray) -> NDArray[np.int64]:
        cells = first(points[0])
        for finder, size, coordinates in zip(others, grid.shape[1:], points[1:], strict=True):
            cells *= size
            cells += finder(coordinates)
        return cells

    return find
