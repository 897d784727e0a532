"""Checks of the fields of an automaton."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

SEMANTICS = ("co-safe", "finite-trace")


def check_semantics(semantics: object) -> None:
    """Raise ValueError unless `semantics` is one of the two names."""
    if not isinstance(semantics, str) or semantics not in SEMANTICS:
        raise ValueError(f'`semantics`: expected "co-safe" or "finite-trace", got {semantics!r}')


def checked_names(field: str, values: object) -> tuple[str, ...]:
    """Return `values` as a tuple of different non-empty strings, or raise ValueError."""
    if isinstance(values, str) or not isinstance(values, Sequence):
        raise ValueError(f"`{field}`: expected a sequence of names, got {values!r}")
    for value in values:
        if not isinstance(value, str) or not value:
            raise ValueError(f"`{field}`: expected non-empty strings, got {value!r}")
    seen: set[str] = set()
    for value in values:
        if value in seen:
            raise ValueError(f"`{field}`: expected different names, got {value!r} twice")
        seen.add(value)
    return tuple(values)


def checked_integers(field: str, values: object, length: int, least: int, bound: int) -> np.ndarray:
    """Return `values` as a read-only int32 array of `length` entries in [least, bound)."""
    given = np.array(values)
    if given.shape != (length,) or (given.dtype.kind not in "iu" and length):
        raise ValueError(f"`{field}`: expected {length} integers, got {given.dtype} of shape {given.shape}")
    if length and not (least <= given.min() and given.max() < bound):
        raise ValueError(f"`{field}`: expected entries from {least} to {bound - 1}, got {given.min()} to {given.max()}")
    result = given.astype(np.int32)
    result.setflags(write=False)
    return result
