"""Where the arrays of the value tree live: in numpy, or in the library of an accelerator.

The sweep over the value tree (``ascent``) smooths, gathers, weighs and pushes factors; this is most of its work. It is
written once, for numpy and for every library of the Python array API whose arrays can be indexed by whole numbers
(torch, cupy). Large arrays stay on the device from the first step of a sweep to the last: those with an axis of cells
or lattice points, and the products of terms. Tables of whole numbers (which term points at which factor), policies, and
decisions about terms stay with numpy. This module holds all that the two sides need of each other; no other module
knows of libraries.

Only double precision is used. A library may sum in another order than numpy: results agree up to rounding, and the
reserve for rounding in every bound holds for any order (docs/theory/numerics.md).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import scipy.sparse
from numpy.typing import NDArray

from ....envs.systems.backends import Array, beside, namespace

UNIT = 2.0**-53
"""Unit roundoff u of double precision."""


class Residents:
    """Copies of arrays on devices, each made once; they live as long as the record that holds them.

    The arrays must not change: tables, masks and windows.
    """

    def __init__(self) -> None:
        self.copies: dict[tuple[int, str], tuple[NDArray[Any], Array]] = {}

    def __repr__(self) -> str:
        return f"Residents({len(self.copies)} copies)"

    def beside(self, array: NDArray[Any], reference: Array) -> Array:
        """Return a numpy array on the device of another array, as ``beside`` does."""
        if isinstance(reference, np.ndarray):
            return array
        from array_api_compat import device

        key = (id(array), str(device(reference)))
        if key not in self.copies:  # the array is held as well, so that no other one gets its id
            self.copies[key] = array, beside(array, reference)
        return self.copies[key][1]


def empty(shape: tuple[int, ...], reference: Array) -> Array:
    """Return an array to be filled, with the type and on the device of another one."""
    if isinstance(reference, np.ndarray):
        return np.empty(shape, dtype=reference.dtype)
    from array_api_compat import device

    return namespace(reference).empty(shape, dtype=reference.dtype, device=device(reference))


def take(array: Array, index: NDArray[Any], axis: int = 0) -> Array:
    """Return rows or columns by their numbers."""
    if isinstance(array, np.ndarray):
        return array[index] if axis == 0 else array[:, index]
    return namespace(array).take(array, beside(index, array), axis=axis)


def concatenate(arrays: Sequence[Array]) -> Array:
    """Return arrays stacked one below the other."""
    return np.concatenate(arrays) if isinstance(arrays[0], np.ndarray) else namespace(arrays[0]).concat(list(arrays))


def multiply_into(a: Array, b: Array, out: Array) -> None:
    """Set ``out`` to the matrix product of ``a`` and ``b``."""
    if isinstance(out, np.ndarray):
        np.matmul(a, b, out=out)
    else:
        out[...] = a @ b


def add_rows(values: Array, number: NDArray[Any], size: int) -> Array:
    """Return the sums (size, m) of the rows of values (n, m) that have the same ``number`` (n,)."""
    if isinstance(values, np.ndarray):
        # A sparse product is faster than `np.add.at`, and adds in the order of the rows.
        pick = scipy.sparse.csr_array((np.ones(len(number)), (number, np.arange(len(number)))), (size, len(number)))
        return pick @ values
    total = empty((size, *values.shape[1:]), values)
    total[...] = 0.0
    if hasattr(total, "index_add_"):
        total.index_add_(0, beside(number, values), values)
    else:  # the array API has no such sum either
        namespace(values).add.at(total, beside(number, values), values)
    return total


def add_runs(values: Array, starts: NDArray[Any]) -> Array:
    """Return the sums of runs of rows of values (n, m); a run begins at each of ``starts`` and none is empty."""
    if isinstance(values, np.ndarray):
        return np.add.reduceat(values, starts, axis=0)
    lengths = np.diff(np.append(starts, len(values)))
    return add_rows(values, np.repeat(np.arange(len(starts)), lengths), len(starts))
