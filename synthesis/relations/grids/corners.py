"""Corners of cells: where factors that are multilinear in every cell have their values (docs/theory/linear.md).

A factor of a linear agent has one number per *place*, a corner of a cell: 2^d for each cell, since the two sides of a
face may have different values. Along axis k there are ``2 S_k`` places, the lower and the upper end of each interval,
and places of the grid are numbered in C order over ``(2 S_1, .., 2 S_d)``.
"""

from __future__ import annotations

import math
from itertools import product

import numpy as np
from numpy.typing import NDArray

from .grid import FloatArray, Grid


def spread(values: NDArray, shape: tuple[int, ...]) -> NDArray:
    """Return numbers of cells (.., S) at all corners of their cells (.., 2^d S); ``shape`` are the cells per axis."""
    table = values.reshape(*values.shape[:-1], *shape)
    for axis in range(len(shape)):
        table = np.repeat(table, 2, axis=values.ndim - 1 + axis)
    return table.reshape(*values.shape[:-1], math.prod(shape) * 2 ** len(shape))


def of_cells(values: NDArray, shape: tuple[int, ...]) -> NDArray:
    """Return the numbers (.., S, 2^d) of places (.., 2^d S), the corners of each cell in C order of their sides."""
    d, lead = len(shape), values.shape[:-1]
    table = values.reshape(*lead, *(n for size in shape for n in (size, 2)))
    first = len(lead)
    order = [*range(first), *range(first, first + 2 * d, 2), *range(first + 1, first + 2 * d, 2)]
    return table.transpose(order).reshape(*lead, math.prod(shape), 2**d)


def to_places(values: NDArray, shape: tuple[int, ...]) -> NDArray:
    """Return the numbers (.., 2^d S) of places from those of cells' corners (.., S, 2^d); inverse of ``of_cells``."""
    d, lead = len(shape), values.shape[:-2]
    table = values.reshape(*lead, *shape, *(2,) * d)
    first = len(lead)
    order = [*range(first), *(first + k + side * d for k in range(d) for side in (0, 1))]
    return table.transpose(order).reshape(*lead, math.prod(shape) * 2**d)


def corner_sides(d: int) -> NDArray[np.int64]:
    """Return the sides (2^d, d), 0 for the lower and 1 for the upper end, of the corners of a cell in C order."""
    return np.array(list(product((0, 1), repeat=d)), dtype=np.int64)


def hats(grid: Grid, points: FloatArray) -> tuple[NDArray[np.int64], FloatArray]:
    """Return the places (M, 2^d) around points (d, M) of the grid, and their weights, which sum to 1 up to rounding.

    The value of a multilinear factor at a point is the sum of its numbers at these places, weighted.
    """
    indices = np.unravel_index(grid.cell_of(points), grid.shape)
    sides = corner_sides(len(grid.shape))
    places, weights = np.zeros((points.shape[1], len(sides)), dtype=np.int64), np.ones((points.shape[1], len(sides)))
    for k, (edges, index) in enumerate(zip(grid.edges, indices, strict=True)):
        share = np.clip((points[k] - edges[index]) / (edges[index + 1] - edges[index]), 0.0, 1.0)
        places = places * (2 * grid.shape[k]) + 2 * index[:, None] + sides[:, k]
        weights *= np.where(sides[:, k], share[:, None], 1.0 - share[:, None])
    return places, weights


def hat_share(grid: Grid, low: FloatArray, high: FloatArray) -> FloatArray:
    """Return the mean hat of every place (2^d S,) over a box of states, up to rounding.

    The mean of a multilinear factor over the box is the sum of its numbers, weighted so. Equal ends are points;
    what lies outside the grid has no weight.
    """
    share = np.ones(1)
    for edges, a, b in zip(grid.edges, low.tolist(), high.tolist(), strict=True):
        left, right = edges[:-1], edges[1:]
        if a == b:
            inside = (left <= a) & (a < right)
            inside[-1] |= a == right[-1]
            part, middle = inside.astype(float), np.full(len(left), a)
        else:
            first, last = np.maximum(left, a), np.minimum(right, b)
            part, middle = np.maximum(last - first, 0.0) / (b - a), 0.5 * (first + last)
        upper = np.clip((middle - left) / (right - left), 0.0, 1.0)
        axis = np.stack([part * (1.0 - upper), part * upper], axis=1).ravel()
        share = (share[:, None] * axis).ravel()
    return share
