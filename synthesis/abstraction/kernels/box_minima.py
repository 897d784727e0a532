"""Least values over boxes of a multilinear interpolant on a lattice (exact, up to rounding).

Positions are in lattice steps. The interpolant is least over a box at a point each of whose coordinates is an end of
the box or a lattice point between its ends:

- where all of them are lattice points, least values over windows of 2^j points, made once by doubling, cover them: two
  windows along each axis, which overlap;
- the points with a coordinate at an end are on the surface of the box and are tried one by one, by interpolation
  between the two lattice points around that end.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from ...relations.grids import FloatArray


def least_over_boxes(numbers: FloatArray, shape: tuple[int, ...], low: FloatArray, high: FloatArray) -> FloatArray:
    """Return the least values (n, N) of the interpolants of numbers (n, Z) over boxes between positions (N, d).

    Boxes lie inside the lattice: ``0 <= low <= high <= shape - 1``.
    """
    boxes = _Boxes.between(shape, low, high)
    least = np.full((len(numbers), len(low)), np.inf)
    boxes.lower_inside(numbers, least)
    for is_inner in product((True, False), repeat=len(shape)):
        if not all(is_inner):
            boxes.lower_on_faces(numbers, least, is_inner)
    return least


@dataclass(frozen=True, eq=False)
class _Boxes:
    """Boxes by the lattice points in and around them.

    ``first`` and ``count`` (N, d) are the lattice points between the ends of each axis; ``before`` and ``share``, each
    for both ends, the lattice point before an end and the share of the one after it.
    """

    shape: tuple[int, ...]
    strides: NDArray[np.int64]
    first: NDArray[np.int64]
    count: NDArray[np.int64]
    before: tuple[NDArray[np.int64], NDArray[np.int64]]
    share: tuple[FloatArray, FloatArray]

    @classmethod
    def between(cls, shape: tuple[int, ...], low: FloatArray, high: FloatArray) -> _Boxes:
        """Return the boxes between positions (N, d)."""
        strides = np.array([math.prod(shape[k + 1 :]) for k in range(len(shape))])
        first, last = np.ceil(low).astype(np.int64), np.floor(high).astype(np.int64)
        # An end on the last point of an axis is interpolated from the point before.
        before = tuple(np.minimum(np.floor(end).astype(np.int64), np.array(shape) - 2) for end in (low, high))
        share = low - before[0], high - before[1]
        return cls(shape, strides, first, last - first + 1, (before[0], before[1]), share)

    def lower_inside(self, numbers: FloatArray, least: FloatArray) -> None:
        """Lower ``least`` (n, N) to the least of numbers (n, Z) at the lattice points of each box, in place."""
        exists = np.all(self.count > 0, axis=1)
        # The largest power of two that is no larger than the count: two such windows cover it.
        exponents = np.frexp(np.maximum(self.count, 1).astype(float))[1].astype(np.int64) - 1
        sizes, size = np.unique(exponents[exists], axis=0, return_inverse=True)
        boxes_of = [np.flatnonzero(exists)[size.ravel() == number] for number in range(len(sizes))]
        places_of = []
        for boxes, exponent in zip(boxes_of, sizes, strict=True):
            spare = self.count[boxes] - 2**exponent
            places_of.append([(self.first[boxes] + np.array(which) * spare) @ self.strides for which in self._ends])
        for row, table in zip(least, numbers, strict=True):
            for number, minima in each_window_minima(table.reshape(self.shape), 2**sizes):
                boxes, flat = boxes_of[number], minima.ravel()
                for place in places_of[number]:
                    row[boxes] = np.minimum(row[boxes], flat.take(place))

    def lower_on_faces(self, numbers: FloatArray, least: FloatArray, is_inner: tuple[bool, ...]) -> None:
        """Do the same at points that are lattice points along the axes ``is_inner``, and ends along all others."""
        inner = [k for k, inside in enumerate(is_inner) if inside]
        outer = [k for k, inside in enumerate(is_inner) if not inside]
        for steps in product(*(range(int(self.count[:, k].max(initial=0))) for k in inner)):
            boxes = np.flatnonzero(np.all(self.count[:, inner] > np.array(steps, dtype=np.int64), axis=1))
            if not len(boxes):
                continue
            start = (self.first[boxes][:, inner] + np.array(steps, dtype=np.int64)) @ self.strides[inner]
            for which in product((0, 1), repeat=len(outer)):
                place, shares = start.copy(), list[FloatArray]()
                for k, end in zip(outer, which, strict=True):
                    place += self.strides[k] * self.before[end][boxes, k]
                    shares.append(self.share[end][boxes, k])
                for row, table in zip(least, numbers, strict=True):
                    row[boxes] = np.minimum(row[boxes], _between(table, place, self.strides[outer], shares))

    @property
    def _ends(self) -> list[tuple[int, ...]]:
        """Which of two windows along each axis."""
        return list(product((0, 1), repeat=len(self.shape)))


def _between(
    numbers: FloatArray, place: NDArray[np.int64], strides: NDArray[np.int64], shares: list[FloatArray]
) -> FloatArray:
    """Return numbers (Z,) at places (N,), interpolated along the axes with these strides by shares (N,)."""
    if not shares:
        return numbers.take(place)
    low = _between(numbers, place, strides[1:], shares[1:])
    high = _between(numbers, place + strides[0], strides[1:], shares[1:])
    return np.asarray((1.0 - shares[0]) * low + shares[0] * high)


def each_window_minima(table: FloatArray, sides: NDArray[np.int64]) -> Iterator[tuple[int, FloatArray]]:
    """Yield the numbers of some windows, in an order of their own, with the least entry of that at each entry.

    Their ``sides`` (N, d) are powers of two. Windows that leave the table go on with what is left of them. Those with
    equal first sides share what is found along these axes, and longer ones begin with shorter ones.
    """
    yield from _from_axis(table, sides, np.arange(len(sides)), 0)


def _from_axis(
    minima: FloatArray, sides: NDArray[np.int64], some: NDArray[np.int64], axis: int
) -> Iterator[tuple[int, FloatArray]]:
    """Yield the same for some of the windows, of which the least entries along all axes before are known."""
    if axis == sides.shape[1]:
        yield from ((int(number), minima) for number in some)
        return
    before, width = (slice(None),) * axis, 1
    for side in np.unique(sides[some, axis]).tolist():
        while width < side:
            longer, rest = np.empty_like(minima), (*before, slice(-width, None))
            begun = (*before, slice(None, -width))
            np.minimum(minima[begun], minima[(*before, slice(width, None))], out=longer[begun])
            longer[rest] = minima[rest]
            minima, width = longer, 2 * width
        yield from _from_axis(minima, sides, some[sides[some, axis] == side], axis + 1)
