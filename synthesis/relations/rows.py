"""Rows of matrices times vectors of arrays, term by term, so that the result does not depend on the batch.

Entries that are 0 cost nothing, and no array is made that is not needed.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..cells import FloatArray

Row = tuple[tuple[int, float], ...]
"""Positions and values of the entries of a row that are not 0."""


def rows_of(matrix: FloatArray) -> tuple[Row, ...]:
    """The rows of a matrix (n, d).

    Examples
    --------
    >>> rows_of(np.array([[1.0, 0.0], [0.0, -2.0]]))
    (((0, 1.0),), ((1, -2.0),))
    """
    return tuple(tuple((k, value) for k, value in enumerate(row) if value != 0.0) for row in matrix.tolist())


def times(row: Row, vectors: Sequence[FloatArray] | FloatArray, out: FloatArray | None = None) -> FloatArray:
    """A row times vectors (d, ...): a new array (...), or ``out``.

    Examples
    --------
    >>> times(((0, 1.0), (1, -2.0)), np.array([[1.0, 2.0], [3.0, 4.0]])).tolist()
    [-5.0, -6.0]
    """
    total = np.empty(vectors[0].shape) if out is None else out
    if not row:
        total.fill(0.0)
        return total
    (first, value), *rest = row
    np.multiply(vectors[first], value, out=total)
    for k, value in rest:
        total += value * vectors[k]
    return total


def product(rows: Sequence[Row], vectors: Sequence[FloatArray] | FloatArray) -> FloatArray:
    """All rows times vectors (d, ...): a new array (n, ...)."""
    result = np.empty((len(rows), *vectors[0].shape))
    for k, row in enumerate(rows):
        times(row, vectors, result[k, ...])  # a view, of single numbers, too
    return result
