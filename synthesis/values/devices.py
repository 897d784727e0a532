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

import importlib
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import scipy.sparse
from numpy.typing import NDArray

UNIT = 2.0**-53
"""Unit roundoff u of double precision."""

HOST = "numpy"
"""The device that needs nothing but numpy."""

LIBRARIES = ("torch", "cupy")
"""Libraries whose arrays the sweep runs on."""

Array = Any
"""An array of numpy or of a library."""


def device_put(name: str) -> Callable[[NDArray[Any]], Array]:
    """Return the function that copies numpy arrays to a device (exact).

    Parameters
    ----------
    name : str
        ``"numpy"``, or a library and, after a colon, its own name of the device. Without a colon the default device of
        the library is taken: ``torch:cpu``, ``cupy:0``.

    Raises
    ------
    ValueError
        If there is no such library or device, or if its arrays cannot hold double precision.

    Examples
    --------
    >>> device_put("numpy")(np.arange(3))
    array([0, 1, 2])
    >>> device_put("abacus")
    Traceback (most recent call last):
        ...
    ValueError: `device`: expected `numpy`, `torch:cpu`, `torch:cuda`, `torch:cuda:1`, `cupy` or the like, got 'abacus'
    """
    if name == HOST:
        return np.asarray
    library, _, device_name = name.partition(":") if isinstance(name, str) else ("", "", "")
    if library not in LIBRARIES:
        raise ValueError(
            f"`device`: expected `numpy`, `torch:cpu`, `torch:cuda`, `torch:cuda:1`, `cupy` or the like, got {name!r}"
        )
    try:
        importlib.import_module("array_api_compat")
        module = importlib.import_module(library)
    except ImportError as error:
        raise ValueError(
            f'`device`: {name!r} needs {error.name}; `pip install "certigym[device]"` installs all but {library} '
            "itself; install that as its own pages say for your hardware"
        ) from error
    put = _torch_put(module, device_name or "cpu") if library == "torch" else _cupy_put(module, device_name or "0")
    # One array there and back shows whether the device exists and holds doubles.
    try:
        to_host(put(np.ones(1)))
    except (AssertionError, RuntimeError, TypeError, ValueError) as error:  # each library raises an error of its own
        reason = str(error).strip().split("\n", 1)[0]
        raise ValueError(f"`device`: expected one that is there and holds doubles, got {name!r}: {reason}") from error
    return put


def _torch_put(torch: Any, device_name: str) -> Callable[[NDArray[Any]], Array]:
    """Return the function that copies arrays to a device of torch."""

    def put(array: NDArray[Any]) -> Array:
        return torch.tensor(array, device=device_name)  # always a copy: arrays of numpy may be read-only

    return put


def _cupy_put(cupy: Any, device_name: str) -> Callable[[NDArray[Any]], Array]:
    """Return the function that copies arrays to a device of cupy."""
    number = int(device_name.removeprefix("cuda:")) if device_name != "cuda" else 0

    def put(array: NDArray[Any]) -> Array:
        with cupy.cuda.Device(number):
            return cupy.asarray(array)

    return put


def namespace(array: Array) -> Any:
    """Return the module with the functions for an array: numpy, or the array API of its library."""
    if isinstance(array, np.ndarray):
        return np
    from array_api_compat import array_namespace

    return array_namespace(array)


def to_host(array: Array) -> NDArray[Any]:
    """Return the same numbers as a numpy array (exact)."""
    if isinstance(array, np.ndarray):
        return array
    host: NDArray[Any] = np.asarray(array.get() if hasattr(array, "get") else array.cpu().numpy())
    return host


def beside(array: NDArray[Any], reference: Array) -> Array:
    """Return a numpy array on the device of another array (exact)."""
    if isinstance(reference, np.ndarray):
        return array
    from array_api_compat import device

    # Libraries index by int64 alone; other numbers keep their type.
    copied = np.array(array, dtype=np.int64 if array.dtype.kind in "iu" else None)
    return namespace(reference).asarray(copied, device=device(reference))


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
