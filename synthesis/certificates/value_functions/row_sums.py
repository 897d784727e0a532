"""Sums of rows of factors, by number or in runs."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse
from numpy.typing import NDArray

UNIT = 2.0**-53
"""Unit roundoff u of double precision."""


def add_rows(values: NDArray[Any], number: NDArray[Any], size: int) -> NDArray[Any]:
    """Return the sums (size, m) of the rows of values (n, m) that have the same ``number`` (n,)."""
    # A sparse product is faster than `np.add.at`, and adds in the order of the rows.
    pick = scipy.sparse.csr_array((np.ones(len(number)), (number, np.arange(len(number)))), (size, len(number)))
    return np.asarray(pick @ values)


def add_runs(values: NDArray[Any], starts: NDArray[Any]) -> NDArray[Any]:
    """Return the sums of runs of rows of values (n, m); a run begins at each of ``starts`` and none is empty."""
    return np.asarray(np.add.reduceat(values, starts, axis=0))
