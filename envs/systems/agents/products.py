"""Products of matrices and vectors, summed in a fixed order."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..backends import namespace


def row_times(row: Any, x: Any) -> Any:
    """Return one row of a matrix times a vector, summed in a fixed order: the same bits in a batch and for one point.

    Parameters
    ----------
    row, x : sequence of components
        Numbers, or arrays that broadcast.
    """
    total = row[0] * x[0]
    for k in range(1, len(x)):
        total += row[k] * x[k]
    return total


def linear(matrix: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Return a matrix times vectors, shape (p, ...), computed by `row_times`.

    Parameters
    ----------
    matrix : np.ndarray, shape (p, d, ...)
    x : np.ndarray, shape (d, ...)
        Trailing axes broadcast against those of `matrix`.
    """
    stacked: np.ndarray = namespace(x).stack([row_times(row, x) for row in matrix])
    return stacked
