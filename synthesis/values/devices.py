"""Where the arrays of the value tree live: numpy, or the arrays of an accelerator's library.

The sweep over the value tree (``ascent``) smooths, gathers, weighs and pushes factors, and these are most of its work.
It is written once, for numpy and for every library of the Python array API that can be indexed by whole numbers (torch,
cupy). Big arrays, those with an axis of cells or lattice points and the products of terms, stay on the device from the
first step of a sweep to the last; tables of whole numbers (which term points at which factor), policies, and decisions
about terms stay with numpy. This module holds what the two need of each other, and nothing else knows of libraries.

Only double precision is used. Sums may be taken in another order than by numpy: results agree to rounding, and the
reserve for rounding in every bound holds for any order (THEORY section 9).
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import scipy.sparse
from numpy.typing import NDArray

HOST = "numpy"
"""The device that needs nothing but numpy."""

LIBRARIES = ("torch", "cupy")
"""Libraries whose arrays the sweep runs on."""

Array = Any
"""An array of numpy or of a library."""


def device_put(name: str) -> Callable[[NDArray[Any]], Array]:
    """The function that takes numpy arrays to a device.

    Parameters
    ----------
    name : str
        ``"numpy"``, or a library and, after a colon, what it calls the device; left out: ``torch:cpu``, ``cupy:0``.

    Raises
    ------
    ValueError
        If there is no such library or device, or its arrays cannot hold double precision.

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
    library, _, own = name.partition(":") if isinstance(name, str) else ("", "", "")
    if library not in LIBRARIES:
        raise ValueError(
            f"`device`: expected `numpy`, `torch:cpu`, `torch:cuda`, `torch:cuda:1`, `cupy` or the like, got {name!r}"
        )
    try:
        importlib.import_module("array_api_compat")
        module = importlib.import_module(library)
    except ImportError as error:
        raise ValueError(
            f'`device`: {name!r} needs {error.name}; `pip install "certigym[device]"` installs what is needed beside '
            f"{library} itself, which is to be installed as its own pages say for your hardware"
        ) from error
    put = _torch_put(module, own or "cpu") if library == "torch" else _cupy_put(module, own or "0")
    try:
        to_host(put(np.ones(1)))
    except (AssertionError, RuntimeError, TypeError, ValueError) as error:  # each library has its own for what is amiss
        reason = str(error).strip().split("\n", 1)[0]
        raise ValueError(f"`device`: expected one that is there and holds doubles, got {name!r}: {reason}") from error
    return put


def _torch_put(torch: Any, own: str) -> Callable[[NDArray[Any]], Array]:
    def put(array: NDArray[Any]) -> Array:
        return torch.tensor(array, device=own)  # a copy always: numpy's may be read-only

    return put


def _cupy_put(cupy: Any, own: str) -> Callable[[NDArray[Any]], Array]:
    number = int(own.removeprefix("cuda:")) if own != "cuda" else 0

    def put(array: NDArray[Any]) -> Array:
        with cupy.cuda.Device(number):
            return cupy.asarray(array)

    return put


def namespace(array: Array) -> Any:
    """The functions for an array: numpy, or the array API of its library."""
    if isinstance(array, np.ndarray):
        return np
    from array_api_compat import array_namespace

    return array_namespace(array)


def to_host(array: Array) -> NDArray[Any]:
    """The same numbers as a numpy array."""
    if isinstance(array, np.ndarray):
        return array
    own: NDArray[Any] = np.asarray(array.get() if hasattr(array, "get") else array.cpu().numpy())
    return own


def beside(array: NDArray[Any], reference: Array) -> Array:
    """A numpy array on the device of another array."""
    if isinstance(reference, np.ndarray):
        return array
    from array_api_compat import device

    own = np.array(array, dtype=np.int64 if array.dtype.kind in "iu" else None)
    return namespace(reference).asarray(own, device=device(reference))


class Residents:
    """Copies of arrays on devices, each made once; they live as long as the record that holds them.

    The arrays must not change: tables, masks and windows.
    """

    def __init__(self) -> None:
        self.copies: dict[tuple[int, str], tuple[NDArray[Any], Array]] = {}

    def beside(self, array: NDArray[Any], reference: Array) -> Array:
        """A numpy array on the device of another array, as ``beside`` gives it."""
        if isinstance(reference, np.ndarray):
            return array
        from array_api_compat import device

        key = (id(array), str(device(reference)))
        if key not in self.copies:  # the array is kept, too, so that its number stays its own
            self.copies[key] = array, beside(array, reference)
        return self.copies[key][1]


def empty(shape: tuple[int, ...], reference: Array) -> Array:
    """An array to be filled, of the kind of another one, on its device."""
    if isinstance(reference, np.ndarray):
        return np.empty(shape, dtype=reference.dtype)
    from array_api_compat import device

    return namespace(reference).empty(shape, dtype=reference.dtype, device=device(reference))


def take(array: Array, index: NDArray[Any], axis: int = 0) -> Array:
    """Rows or columns by their numbers."""
    if isinstance(array, np.ndarray):
        return array[index] if axis == 0 else array[:, index]
    return namespace(array).take(array, beside(index, array), axis=axis)


def concatenate(arrays: Sequence[Array]) -> Array:
    """Arrays one below the other."""
    return np.concatenate(arrays) if isinstance(arrays[0], np.ndarray) else namespace(arrays[0]).concat(list(arrays))


def multiply_into(a: Array, b: Array, out: Array) -> None:
    """Set ``out`` to a matrix product."""
    if isinstance(out, np.ndarray):
        np.matmul(a, b, out=out)
    else:
        out[...] = a @ b


def add_rows(values: Array, number: NDArray[Any], size: int) -> Array:
    """Sums of the rows of values (n, m) that have the same ``number`` (n,): (size, m)."""
    if isinstance(values, np.ndarray):
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
    """Sums of consecutive rows of values (n, m), each from one of ``starts`` up to the next; none is empty."""
    if isinstance(values, np.ndarray):
        return np.add.reduceat(values, starts, axis=0)
    lengths = np.diff(np.append(starts, len(values)))
    return add_rows(values, np.repeat(np.arange(len(starts)), lengths), len(starts))


UNIT = 2.0**-53
"""Unit roundoff of double precision."""
