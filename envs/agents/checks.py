"""Numbers from users: read-only float64 arrays, or an error that names the argument.

Every array that enters a problem passes through `float_array`, whether it comes from Python or from a file.
"""

from __future__ import annotations

from numbers import Real
from typing import Any

import numpy as np

LARGEST = 1e100
"""Largest magnitude accepted: far beyond any model, and its square is still a finite float64."""


def float_array(value: Any, name: str, shape: tuple[int | None, ...], example: str) -> np.ndarray:
    """Return `value` as a read-only float64 array of the given shape (exact copy).

    Parameters
    ----------
    value : array_like
        Numbers, or nested lists of numbers. Strings and Booleans are refused.
    name : str
        Argument named in the error.
    shape : tuple of int or None
        Expected lengths, None for any length of at least 1.
    example : str
        A value of the right form, shown in the error.

    Raises
    ------
    ValueError
        If `value` has another shape, or holds anything but finite numbers of magnitude at most 1e100.
    """
    wanted = f"numbers of shape ({', '.join('any' if n is None else str(n) for n in shape)}) such as {example}"
    try:
        cells = np.array(value, dtype=object)
    except (ValueError, TypeError, OverflowError) as error:
        raise ValueError(f"`{name}`: expected {wanted}, got {shown(value)}") from error
    if any(isinstance(cell, (list, tuple, np.ndarray)) for cell in cells.flat):
        raise ValueError(f"`{name}`: expected {wanted}, got rows of unequal length or depth in {shown(value)}")
    for cell in cells.flat:
        if not isinstance(cell, Real) or isinstance(cell, bool):
            raise ValueError(f"`{name}`: expected {wanted}, got {shown(cell)}; give plain numbers")
    if cells.ndim != len(shape) or any(n not in (None, m) for n, m in zip(shape, cells.shape)) or cells.size == 0:
        raise ValueError(f"`{name}`: expected {wanted}, got shape {_shape(cells.shape)}: {shown(value)}")
    for cell in cells.flat:
        if not abs(cell) <= LARGEST:
            raise ValueError(f"`{name}`: expected finite numbers of magnitude at most {LARGEST:g}, got {shown(cell)}")
    return read_only(cells.astype(np.float64) + 0.0)  # + 0.0 turns -0.0 into 0.0: equal problems, equal fingerprints


def read_only(array: np.ndarray) -> np.ndarray:
    """Return `array` itself, marked read-only."""
    array.flags.writeable = False
    return array


def shown(value: Any, limit: int = 60) -> str:
    """Return a one-line, shortened `repr` of a value for error messages."""
    try:
        text = " ".join(repr(value).split())
    except (ValueError, RecursionError):  # integers of more digits than Python prints, lists nested too deeply
        text = f"a value of type {type(value).__name__}"
    return text if len(text) <= limit else f"{text[: limit - 3]}..."


def _shape(shape: tuple[int, ...]) -> str:
    return f"({', '.join(str(n) for n in shape)})"


def checked_count(value: Any, argument: str, least: int = 1, most: int = 10_000) -> int:
    """Return a number of agents, or raise ValueError."""
    if isinstance(value, bool) or not isinstance(value, int) or not least <= value <= most:
        raise ValueError(f"`{argument}`: expected an integer from {least} to {most}, got {shown(value)}")
    return value
