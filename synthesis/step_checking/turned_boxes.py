"""Start boxes on cells that are turned against them, as those of correlated noise are: how much of a box each cell has.

Nothing of the search is used. Where one state of a block is drawn, the start is a segment and cells cut it into
intervals. Where two are, the box is a parallelogram in the coordinates of the grid; the length of its section through a
row of cells is linear between places that are known, so that the lengths in the middle give areas exactly.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..cells import FloatArray
from ..masses import AgentPart, state

RESERVE = 1e-13
"""Taken off every share, for the rounding of corners and areas."""


def turned_shares(part: AgentPart, low: FloatArray, high: FloatArray) -> FloatArray:
    """Lower bounds (S,) on the probability of each cell under a start that is uniform on a box of states.

    Raises
    ------
    ValueError
        If three or more states that are drawn are mixed.
    """
    inverse, drawn = np.linalg.inv(part.coordinates), low < high
    lost = RESERVE + rounded(part.coordinates, inverse, low, high)
    shares = np.ones(part.grid.shape)
    left = set(range(len(low)))
    while left:
        axes, states = _block(part.coordinates, min(left))
        left -= set(axes)
        varied = [k for k in states if drawn[k]]
        if len(varied) > 2:
            raise ValueError("three or more states of a start box are mixed by the coordinates of the grid")
        edges = [part.grid.edges[k] for k in axes]
        start, sides = (inverse @ low)[axes], [(inverse[:, k] * (high[k] - low[k]))[axes] for k in varied]
        own = _sections(edges, start, *sides) if len(varied) == 2 else _pieces(edges, start, *sides)
        shape = [n if k in axes else 1 for k, n in enumerate(part.grid.shape)]
        shares = shares * np.maximum(own - lost, 0.0).reshape(shape)
    state("turned", part, low, high, shares)
    return np.asarray(shares).ravel()


def rounded(coordinates: FloatArray, inverse: FloatArray, low: FloatArray, high: FloatArray) -> float:
    """Probability that rounding decides in which cell a start is: it lies so near to an edge, along some axis."""
    size = np.maximum(np.abs(low), np.abs(high))
    off = 2.0**-46 * (len(low) + 2.0) * np.abs(inverse) @ (np.abs(coordinates) @ (np.abs(inverse) @ size))
    # The density of a coordinate is at most one over the longest side along it; those that stay are read elsewhere.
    longest = np.max(np.abs(inverse) * (high - low), axis=1)
    moving = longest > 0.0
    return float(np.sum(2.0 * off[moving] / longest[moving])) if moving.any() else 0.0


def _block(coordinates: FloatArray, axis: int) -> tuple[list[int], list[int]]:
    """Axes of the grid that depend on one another with ``axis``, and the states that they are mixed into."""
    axes, states = {axis}, set[int]()
    while True:
        more = {int(k) for k in np.flatnonzero(np.any(coordinates[:, sorted(axes)] != 0.0, axis=1))}
        wider = {int(k) for k in np.flatnonzero(np.any(coordinates[sorted(more)] != 0.0, axis=0))}
        if more == states and wider == axes:
            return sorted(axes), sorted(states)
        axes, states = wider, more


def _pieces(edges: list[FloatArray], start: FloatArray, *side: FloatArray) -> FloatArray:
    """Shares of a segment ``start + s side``, 0 <= s <= 1, or of a point, in the product of the axes."""
    along = side[0] if side else np.zeros(len(start))
    cuts = [np.zeros(1), np.ones(1)]
    cuts += [(axis - a) / b for axis, a, b in zip(edges, start, along, strict=True) if b != 0.0]
    places = np.unique(np.clip(np.concatenate(cuts), 0.0, 1.0))
    middle, shares = 0.5 * (places[1:] + places[:-1]), np.zeros([len(axis) - 1 for axis in edges])
    where, inside = list[NDArray[np.int64]](), np.ones(len(middle), dtype=bool)
    for axis, a, b in zip(edges, start, along, strict=True):
        y = a + middle * b
        inside &= (axis[0] <= y) & (y <= axis[-1])
        where.append(np.clip(np.searchsorted(axis, y, side="right") - 1, 0, len(axis) - 2))
    np.add.at(shares, tuple(own[inside] for own in where), np.diff(places)[inside])
    return shares


def _sections(edges: list[FloatArray], start: FloatArray, first: FloatArray, second: FloatArray) -> FloatArray:
    """Shares of the parallelogram from ``start`` along two sides, in the product of two axes: areas, by sections."""
    determinant = float(first[0] * second[1] - first[1] * second[0])
    # A point y has the weights (y x second, first x y) / determinant of both sides, between 0 and 1 inside.
    slopes = np.array([[second[1], -second[0]], [-first[1], first[0]]]) / determinant
    corners = start[0] + np.array([0.0, first[0], second[0], first[0] + second[0]])
    cuts = [corners, edges[0]]
    for a, b in slopes.tolist():
        if a != 0.0:  # where a side crosses the edges of the second axis
            cuts += [start[0] + (limit - b * (edges[1] - start[1])) / a for limit in (0.0, 1.0)]
    least, most = max(corners.min(), edges[0][0]), min(corners.max(), edges[0][-1])
    places = np.unique(np.clip(np.concatenate(cuts), least, most)) if least < most else np.zeros(1)
    middle = 0.5 * (places[1:] + places[:-1])
    low, high = np.full(len(middle), -np.inf), np.full(len(middle), np.inf)
    for a, b in slopes.tolist():
        if b != 0.0:
            ends = np.sort(start[1] + (np.array([[0.0], [1.0]]) - a * (middle - start[0])) / b, axis=0)
            low, high = np.maximum(low, ends[0]), np.minimum(high, ends[1])
    lengths = np.minimum(high[:, None], edges[1][1:]) - np.maximum(low[:, None], edges[1][:-1])
    areas = np.maximum(lengths, 0.0) * np.diff(places)[:, None]
    shares = np.zeros((len(edges[0]) - 1, len(edges[1]) - 1))
    np.add.at(shares, np.clip(np.searchsorted(edges[0], middle, side="right") - 1, 0, len(shares) - 1), areas)
    return shares / abs(determinant)
