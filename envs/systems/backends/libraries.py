"""Where arrays live: in numpy, or in the library of an accelerator.

Code that runs on both asks an array for its `namespace`, and copies what it needs to the array's device once. Only
double precision is used.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import scipy.special
from numpy.typing import NDArray

HOST = "numpy"
"""The device that needs nothing but numpy."""

MUTABLE = ("torch", "cupy")
"""Libraries whose arrays can be written into."""

LIBRARIES = (*MUTABLE, "jax")
"""All libraries of accelerators; arrays of jax never change, so only code that writes into none runs on them."""

Array = Any
"""An array of numpy or of a library."""

_OF_HOST = (np.ndarray, np.generic, float, int)
"""What numpy computes with; a union in place of this tuple would be made anew at every call."""


def device_put(name: str, libraries: Sequence[str] = MUTABLE) -> Callable[[NDArray[Any]], Array]:
    """Return the function that copies numpy arrays to a device (exact).

    Parameters
    ----------
    name : str
        ``"numpy"``, or a library and, after a colon, its own name of the device. Without a colon the default device of
        the library is taken: ``torch:cpu``, ``cupy:0``.
    libraries : sequence of str
        Libraries that will do.

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
    if library not in libraries:
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
    copiers = {"torch": _torch_put, "cupy": _cupy_put, "jax": _jax_put}
    put = copiers[library](module, device_name)
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
        return torch.tensor(array, device=device_name or "cpu")  # always a copy: arrays of numpy may be read-only

    return put


def _jax_put(jax: Any, device_name: str) -> Callable[[NDArray[Any]], Array]:
    """Return the function that copies arrays to a device of jax; double precision has to be switched on in jax."""
    platform, _, number = device_name.partition(":")
    device = jax.devices(platform or None)[int(number or 0)]

    def put(array: NDArray[Any]) -> Array:
        moved = jax.device_put(np.array(array), device)
        if moved.dtype != array.dtype:
            raise ValueError('jax has no double precision; run `jax.config.update("jax_enable_x64", True)` first')
        return moved

    return put


def _cupy_put(cupy: Any, device_name: str) -> Callable[[NDArray[Any]], Array]:
    """Return the function that copies arrays to a device of cupy."""
    number = int(device_name.removeprefix("cuda").removeprefix(":") or 0)

    def put(array: NDArray[Any]) -> Array:
        with cupy.cuda.Device(number):
            return cupy.asarray(array)

    return put


def is_host(array: Array) -> bool:
    """Return whether an array is one of numpy; numbers count as such."""
    return isinstance(array, _OF_HOST)


def namespace(array: Array) -> Any:
    """Return the module with the functions for an array: numpy, or the array API of its library."""
    if is_host(array):
        return np
    from array_api_compat import array_namespace

    return array_namespace(array)


def special(array: Array) -> Any:
    """Return the module with `ndtr`, `ndtri`, `log_ndtr` and their like for an array."""
    library = "numpy" if is_host(array) else namespace(array).__name__
    for name, module in (("torch", "torch.special"), ("cupy", "cupyx.scipy.special"), ("jax", "jax.scipy.special")):
        if name in library:
            return importlib.import_module(module)
    return scipy.special


def concatenated(arrays: Sequence[Array]) -> Array:
    """Return arrays stacked one below the other."""
    return np.concatenate(arrays) if is_host(arrays[0]) else namespace(arrays[0]).concat(list(arrays))


def single(array: Array) -> Array:
    """Return an array in single precision."""
    if is_host(array):
        return array.astype(np.float32)
    return namespace(array).astype(array, namespace(array).float32)


def double(array: Array) -> Array:
    """Return numbers, or an array, in double precision: libraries give whole numbers another one when they divide."""
    if is_host(array):
        return np.asarray(array, dtype=np.float64)
    return namespace(array).astype(array, namespace(array).float64)


def is_whole(array: Any, signed: bool = False) -> bool:
    """Return whether an array of numpy holds whole numbers, of a signed type if that is asked."""
    return bool(np.issubdtype(array.dtype, np.signedinteger if signed else np.integer))


def to_host(array: Array) -> NDArray[Any]:
    """Return the same numbers as a numpy array (exact)."""
    if isinstance(array, np.ndarray):
        return array
    # cupy copies by `get`, torch by `cpu`, jax by numpy's own protocol.
    for name in ("get", "cpu"):
        if hasattr(array, name):
            array = getattr(array, name)()
            break
    return np.asarray(array)


def beside(array: NDArray[Any], reference: Array) -> Array:
    """Return a numpy array on the device of another array (exact)."""
    if isinstance(reference, np.ndarray):
        return array
    from array_api_compat import device

    # Libraries index by int64 alone; other numbers keep their type.
    copied = np.array(array, dtype=np.int64 if is_whole(array) else None)
    return namespace(reference).asarray(copied, device=device(reference))
