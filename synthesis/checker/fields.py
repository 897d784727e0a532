"""What a header may hold: tables without unknown keys, names, whole numbers and finite numbers, each asked for by name.

Every function returns a plain value, or raises ``Unreadable`` with the place and what was expected there. Nothing is
converted: a truth value is no number, a text is no list.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Sequence
from typing import Any, TypeVar

import numpy as np

from .rigorous import Array

T = TypeVar("T")

NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
LARGEST = 1e150
"""Sizes of numbers: products of two of them are numbers."""


class Unreadable(ValueError):
    """A file that holds no certificate: damaged, of another format, or with a number out of range."""


class Refused(Exception):
    """A certificate whose claim is not proved: what failed, where, and by how much."""


def expected(place: str, what: str, got: Any) -> Unreadable:
    """Return the error that says what was expected at a place."""
    return Unreadable(f"{place}: expected {what}, got {repr(got)[:60]}")


def table(value: Any, place: str, keys: Collection[str], optional: Collection[str] = ()) -> dict[str, Any]:
    """Return a table that has all keys and no other than these and the optional ones."""
    if not isinstance(value, dict):
        raise expected(place, "a table", value)
    for key in keys:
        if key not in value:
            raise Unreadable(f"{place}: `{key}` is missing")
    for key in value:
        if key not in keys and key not in optional:
            raise Unreadable(f"{place}: {key[:40]!r} is no key of this format")
    return value


def text(value: Any, place: str) -> str:
    """Return a text."""
    if not isinstance(value, str):
        raise expected(place, "a text", value)
    return value


def name(value: Any, place: str) -> str:
    """Return a name: letters, digits and underscores."""
    if not isinstance(value, str) or not NAME.fullmatch(value):
        raise expected(place, "a name", value)
    return value


def names(value: Any, place: str) -> tuple[str, ...]:
    """Return different names."""
    found = each(value, place, name)
    if len(set(found)) != len(found):
        raise Unreadable(f"{place}: a name stands there twice")
    return tuple(found)


def each(value: Any, place: str, read: Callable[[Any, str], T], count: int | None = None) -> list[T]:
    """Return what ``read`` makes of each entry of a list, of ``count`` entries if that is given."""
    if not isinstance(value, list) or (count is not None and len(value) != count):
        raise expected(place, "a list" if count is None else f"a list of {count} entries", value)
    return [read(entry, f"{place}[{k}]") for k, entry in enumerate(value)]


def whole(value: Any, place: str, least: int, below: int) -> int:
    """Return a whole number in ``least .. below - 1``."""
    if type(value) is not int or not least <= value < below:
        raise expected(place, f"a whole number from {least} to {below - 1}", value)
    return value


def number(value: Any, place: str) -> float:
    """Return a number of moderate size."""
    if type(value) not in (int, float) or not abs(value) <= LARGEST:
        raise expected(place, f"a number of at most {LARGEST:g}", value)
    return float(value)


def limit(value: Any, place: str, unlimited: float) -> float:
    """Return a number; ``null`` says that there is no limit."""
    return unlimited if value is None else number(value, place)


def vector(value: Any, place: str, count: int) -> Array:
    """Return an array (count,) of numbers."""
    return np.array(each(value, place, number, count), dtype=float).reshape(count)


def matrix(value: Any, place: str, rows: int, columns: int | None = None) -> Array:
    """Return an array (rows, columns) of numbers."""
    found = each(value, place, lambda row, where: each(row, where, number, columns), rows)
    if len({len(row) for row in found}) > 1:
        raise Unreadable(f"{place}: its rows have different lengths")
    return np.array(found, dtype=float).reshape(rows, -1 if found and found[0] else 0)


def box(value: dict[str, Any], place: str, low: str, high: str, count: int) -> Array:
    """Return corners (2, count) of a closed box, the lower one nowhere above the upper one."""
    ends = np.stack([vector(value[key], f"{place}.{key}", count) for key in (low, high)])
    if np.any(ends[0] > ends[1]):
        raise Unreadable(f"{place}: `{low}` is above `{high}`")
    return ends


def over_time(value: Any, place: str, horizon: int, count: int, unlimited: float) -> Array:
    """Return an array (horizon + 1, count): one list for all times, or a list of lists for each."""

    def row(entry: Any, where: str) -> list[float]:
        return each(entry, where, lambda end, at: limit(end, at, unlimited), count)

    moves = isinstance(value, list) and bool(value) and isinstance(value[0], list)
    rows = each(value, place, row, horizon + 1) if moves else [row(value, place)] * (horizon + 1)
    return np.array(rows, dtype=float).reshape(horizon + 1, count)


def distinct(groups: Sequence[Sequence[str]], place: str) -> None:
    """Raise ``Unreadable`` if a name stands for two things."""
    everything = [entry for group in groups for entry in group]
    if len(set(everything)) != len(everything):
        raise Unreadable(f"{place}: a name stands for two things")
