"""Rows of matrices times vectors of arrays, entry by entry: the same bits in a batch and for one point.

Entries that are 0 cost nothing, and no array is made that is not needed.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..grids import FloatArray

Row = tuple[tuple[int, float], ...]
"""Positions and values of the entries of a row that are not 0."""


def rows_of(matrix: FloatArray) -> tuple[Row, ...]:
    """Return the rows of a matrix (n, d), without their zeros (exact).

    Examples
    --------
    >>> rows_of(np.array([[1.0, 0.0], [0.0, -2.0]]))
    (((0, 1.0),), ((1, -2.0),))
    """
    return tuple(tuple((k, value) for k, value in enumerate(row) if value != 0.0) for row in matrix.tolist())


def times(row: Row, vectors: Sequence[FloatArray] | FloatArray, out: FloatArray | None = None) -> FloatArray:
    """Return a row times vectors (d, ...) as a new array (...), or in ``out`` if it is given.

    Examples
    --------
    >>> times(((0, 1.0), (1, -2.0)), np.array([[1.0, 2.0], [3.0, 4.0]])).tolist()
    [-5.0, -6.0]
    """
    total = np.empty(vectors[0].shape) if out is None else out
    if not row:
        total.fill(0.0)
        return total
    (first, value), *others = row
    np.multiply(vectors[first], value, out=total)
    for k, value in others:
        total += value * vectors[k]
    return total


def product(rows: Sequence[Row], vectors: Sequence[FloatArray] | FloatArray) -> FloatArray:
    """Return all rows times vectors (d, ...) as a new array (n, ...)."""
    result = np.empty((len(rows), *vectors[0].shape))
    for k, row in enumerate(rows):
        times(row, vectors, result[k, ...])  # the ellipsis makes a view even of single numbers
    return result
