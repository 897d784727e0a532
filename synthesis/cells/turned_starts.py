"""How a start box is spread over cells that are turned against it, as those of correlated noise are.

Grid coordinates y and states ``x = C y`` fall apart into blocks that have nothing to do with one another. A block with
one wide side is a segment in y, cut by the edges of cells; with two it is a parallelogram, cut cell by cell.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.csgraph import connected_components

from .grid import FloatArray, Grid
from .refusal import RelationRefused

RESERVE = 1e-13
"""Taken off every share: far more than the rounding of corners and areas, far less than matters."""

WIDER = 1e-12
"""Share of their size by which boxes are made wider where no cell may be missed: far more than rounding."""

MOST_MIXED = 2
"""Most wide sides of a box that are mixed with one another."""


def start_share(grid: Grid, coordinates: FloatArray, low: FloatArray, high: FloatArray) -> FloatArray:
    """Return the share (S,) of a start box of states, or of a point, in each cell, up to rounding."""
    if np.array_equal(coordinates, np.eye(len(coordinates))):
        return grid.overlap(low, high)
    if not np.array_equal(low, high):
        return turned_share(grid, coordinates, low, high)
    point = np.linalg.solve(coordinates, low)
    inside = all(edges[0] <= x <= edges[-1] for edges, x in zip(grid.edges, point, strict=True))
    share = np.zeros(grid.n_cells)
    share[grid.cell_of(point[:, None])] = float(inside)
    return share


def cells_met(grid: Grid, coordinates: FloatArray, low: FloatArray, high: FloatArray) -> NDArray[np.int64]:
    """Return the cells that a box of states meets: all of them, and where cells are turned some of their neighbours."""
    if np.array_equal(coordinates, np.eye(len(coordinates))) or np.array_equal(low, high):
        return np.flatnonzero(start_share(grid, coordinates, low, high))
    inverse = np.linalg.inv(coordinates)
    middle, reach = inverse @ (0.5 * (low + high)), np.abs(inverse) @ (0.5 * (high - low))
    reach = reach + WIDER * (np.abs(inverse) @ np.maximum(np.abs(low), np.abs(high)))
    met = np.ones((), dtype=bool)
    for edges, y, r in zip(grid.edges, middle, reach, strict=True):
        met = np.multiply.outer(met, (edges[:-1] <= y + r) & (y - r <= edges[1:]))
    return np.flatnonzero(met)


def turned_share(grid: Grid, coordinates: FloatArray, low: FloatArray, high: FloatArray) -> FloatArray:
    """Return the share (S,) of a start box of states in each cell; lower bounds.

    Raises
    ------
    RelationRefused
        If three or more sides of the box are mixed by the coordinates.
    """
    share = np.ones(grid.shape)
    for states, axes in blocks(coordinates):
        wide = low[states] < high[states]
        if np.count_nonzero(wide) > MOST_MIXED:
            raise RelationRefused(
                f"`initial_low`, `initial_high`: expected at most {MOST_MIXED} states that are drawn from an interval "
                f"among those whose noise is correlated, got {np.count_nonzero(wide)}; give a point for the others"
            )
        inverse = np.linalg.inv(coordinates[np.ix_(states, axes)])
        first, sides = inverse @ low[states], inverse[:, wide] * (high - low)[states][wide]
        edges = [grid.edges[k] for k in axes]
        own = _of_segment(edges, first, sides) if sides.shape[1] < 2 else _of_parallelogram(edges, first, sides)
        places = [len(grid.edges[k]) - 1 if k in axes else 1 for k in range(len(grid.shape))]
        share = share * np.maximum(own - RESERVE, 0.0).reshape(places)
    return np.asarray(share).ravel()


def blocks(coordinates: FloatArray) -> Iterator[tuple[NDArray[np.int64], NDArray[np.int64]]]:
    """Yield states and axes of the grid that depend on one another alone; axes rise."""
    d = len(coordinates)
    links = np.zeros((2 * d, 2 * d), dtype=bool)
    links[:d, d:] = coordinates != 0.0
    count, block = connected_components(links, directed=False)
    for k in range(count):
        yield np.flatnonzero(block[:d] == k), np.flatnonzero(block[d:] == k)


def _of_segment(edges: list[FloatArray], first: FloatArray, sides: FloatArray) -> FloatArray:
    """Return the share of the points ``first + s side``, s uniform from 0 to 1, in each cell; a point has no side."""
    begins, ends = np.zeros(()), np.ones(())
    for k, axis in enumerate(edges):
        slope = float(sides[k, 0]) if sides.shape[1] else 0.0
        if slope == 0.0:
            inside = (axis[:-1] <= first[k]) & (first[k] < axis[1:])
            inside[-1] |= first[k] == axis[-1]
            left, right = np.zeros(len(inside)), inside.astype(float)
        else:
            at = (axis - first[k]) / slope
            left, right = np.minimum(at[:-1], at[1:]), np.maximum(at[:-1], at[1:])
        begins, ends = np.maximum.outer(begins, left), np.minimum.outer(ends, right)
    return np.asarray(np.clip(ends - begins, 0.0, 1.0))


def _of_parallelogram(edges: list[FloatArray], first: FloatArray, sides: FloatArray) -> FloatArray:
    """Return the share of a parallelogram from ``first`` along two ``sides`` in each cell: areas of what is cut out."""
    share = np.zeros([len(axis) - 1 for axis in edges])
    whole = first + np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]) @ sides.T
    area = abs(float(np.linalg.det(sides)))
    for i in _met(edges[0], whole[:, 0]):
        strip = _between(whole, 0, edges[0][i], edges[0][i + 1])
        for j in _met(edges[1], strip[:, 1]) if len(strip) else ():
            share[i, j] = _area(_between(strip, 1, edges[1][j], edges[1][j + 1])) / area
    return share


def _met(edges: FloatArray, places: FloatArray) -> range:
    """Return the intervals that some places between the least and the largest one are in."""
    first, last = np.searchsorted(edges, [places.min(), places.max()], side="right") - 1
    return range(max(0, int(first)), min(len(edges) - 1, int(last) + 1))


def _between(polygon: FloatArray, axis: int, low: float, high: float) -> FloatArray:
    """Return the part (n, 2) of a convex polygon between two values along an axis."""
    for side, limit in ((1.0, low), (-1.0, high)):
        gap = side * (polygon[:, axis] - limit)
        kept = list[FloatArray]()
        for k, here in enumerate(gap):
            before = gap[k - 1]
            if (here > 0.0) != (before > 0.0):  # the side from the corner before crosses the limit
                part = before / (before - here)
                kept.append(polygon[k - 1] + part * (polygon[k] - polygon[k - 1]))
            if here > 0.0:
                kept.append(polygon[k])
        polygon = np.array(kept).reshape(-1, 2)
    return polygon


def _area(polygon: FloatArray) -> float:
    """Return the area of a convex polygon, its corners in order."""
    if len(polygon) < 3:
        return 0.0
    x, y = (polygon - polygon[0]).T
    return 0.5 * abs(float(x @ np.roll(y, -1) - y @ np.roll(x, -1)))
