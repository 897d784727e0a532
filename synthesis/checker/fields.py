"""What a header may hold: tables without unknown keys, names, whole numbers and finite numbers, each asked for by name.

Every method returns a plain value, or raises ``Unreadable`` with the place and what was expected there. Nothing is
converted: a truth value is no number, a text is no list. Arrays of the file stand in its header by number.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Sequence
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from .rigorous import Array, Truth, Whole

T = TypeVar("T")
Shape = tuple[int | None, ...]  # lengths of an array along its axes; None stands for any length
NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
LARGEST = 1e150  # sizes of numbers: products of two of them are numbers


class Unreadable(ValueError):
    """A file that holds no certificate: damaged, of another format, or with a number out of range."""


class Refused(Exception):
    """A certificate whose claim is not proved: what failed, where, and by how much."""


class Entry(NamedTuple):
    """A value of the header and where it stands; arrays of the file, and which of them were asked for."""

    value: Any
    place: str
    arrays: tuple[NDArray[Any], ...] = ()
    used: set[int] | None = None

    def wrong(self, what: str) -> Unreadable:
        """Return the error that says what is wrong here."""
        return Unreadable(f"{self.place}: {what}")

    def expected(self, what: str) -> Unreadable:
        """Return the error that says what was expected here."""
        return self.wrong(f"expected {what}, got {repr(self.value)[:60]}")

    def made(self, make: Callable[[], T]) -> T:
        """Return what is made of it; what is wrong with that is wrong at this place."""
        try:
            return make()
        except Unreadable:
            raise
        except ValueError as error:
            raise self.wrong(str(error)) from error

    def table(self, keys: Collection[str], optional: Collection[str] = ()) -> dict[str, Entry]:
        """Return the entries of a table that has all keys, and no other than these and the optional ones."""
        found = self.entries_by_name()
        if missing := [key for key in keys if key not in found]:
            raise self.wrong(f"`{missing[0]}` is missing")
        if unknown := [key for key in found if key not in (*keys, *optional)]:
            raise self.wrong(f"{unknown[0][:40]!r} is no key of this format")
        return found

    def entries_by_name(self) -> dict[str, Entry]:
        """Return the entries of a table with any keys."""
        if not isinstance(self.value, dict):
            raise self.expected("a table")
        return {key: self._replace(value=value, place=f"{self.place}.{key}") for key, value in self.value.items()}

    def entries(self, count: int | None = None) -> list[Entry]:
        """Return the entries of a list, of ``count`` entries if that is given."""
        if not isinstance(self.value, list) or (count is not None and len(self.value) != count):
            raise self.expected("a list" if count is None else f"a list of {count} entries")
        return [self._replace(value=value, place=f"{self.place}[{k}]") for k, value in enumerate(self.value)]

    def text(self) -> str:
        """Return a text."""
        if not isinstance(self.value, str):
            raise self.expected("a text")
        return self.value

    def one_of(self, words: Sequence[str]) -> str:
        """Return one of some words."""
        if self.text() not in words:
            raise self.expected(f"one of {', '.join(words)}")
        return str(self.value)

    def truth(self) -> bool:
        """Return a truth value."""
        if type(self.value) is not bool:
            raise self.expected("true or false")
        return self.value

    def name(self) -> str:
        """Return a name: letters, digits and underscores."""
        if not isinstance(self.value, str) or not NAME.fullmatch(self.value):
            raise self.expected("a name")
        return self.value

    def names(self) -> tuple[str, ...]:
        """Return different names."""
        found = tuple(entry.name() for entry in self.entries())
        distinct(found, self.place)
        return found

    def whole(self, least: int, below: int) -> int:
        """Return a whole number in ``least .. below - 1``."""
        if type(self.value) is not int or not least <= self.value < below:  # a truth value is no number
            raise self.expected(f"a whole number from {least} to {below - 1}")
        return self.value

    def wholes(self, least: int, below: int, count: int | None = None) -> tuple[int, ...]:
        """Return whole numbers in ``least .. below - 1``."""
        return tuple(entry.whole(least, below) for entry in self.entries(count))

    def number(self) -> float:
        """Return a number of moderate size."""
        if type(self.value) not in (int, float) or not abs(self.value) <= LARGEST:
            raise self.expected(f"a number of at most {LARGEST:g}")
        return float(self.value)

    def vector(self, count: int | None, unlimited: float | None = None) -> Array:
        """Return an array (count,) of numbers; where limits may be missing, ``null`` is ``unlimited``."""
        entries, null = self.entries(count), unlimited is not None
        return np.array([unlimited if null and own.value is None else own.number() for own in entries], dtype=float)

    def matrix(self, rows: int, columns: int | None = None) -> Array:
        """Return an array (rows, columns) of numbers."""
        found = [row.vector(columns) for row in self.entries(rows)]
        if len({len(row) for row in found}) > 1:
            raise self.wrong("its rows have different lengths")
        return np.array(found, dtype=float).reshape(rows, len(found[0]) if found else 0)

    def over_time(self, horizon: int, count: int, unlimited: float) -> Array:
        """Return an array (horizon + 1, count): one list for all times, or a list of lists for each."""
        moves = isinstance(self.value, list) and bool(self.value) and isinstance(self.value[0], list)  # lists of lists
        rows = self.entries(horizon + 1) if moves else [self] * (horizon + 1)
        return np.array([row.vector(count, unlimited) for row in rows]).reshape(horizon + 1, count)

    def _array(self, shape: Shape) -> NDArray[Any]:
        number = self.whole(0, len(self.arrays))
        if self.used is not None:
            self.used.add(number)
        array = self.arrays[number]
        if array.ndim != len(shape) or any(b is not None and a != b for a, b in zip(array.shape, shape)):
            raise self.wrong(f"expected an array of shape {shape}, got {array.shape}")
        return array

    def floats(self, shape: Shape, infinite: bool = False) -> Array:
        """Return an array of floats of this shape, all of them finite unless told otherwise."""
        array = self._array(shape)
        if array.dtype != np.float64:
            raise self.wrong(f"expected floats, got {array.dtype}")
        if np.isnan(array).any() or (not infinite and not np.all(np.abs(array) <= LARGEST)):
            raise self.wrong(f"it holds what is no number, or one beyond {LARGEST:g}")
        return array

    def integers(self, shape: Shape, least: int, below: int) -> Whole:
        """Return an array of whole numbers of this shape, all of them in ``least .. below - 1``."""
        array = self._array(shape)
        if array.dtype.kind != "i":
            raise self.wrong(f"expected whole numbers, got {array.dtype}")
        if array.size and not (least <= int(array.min()) and int(array.max()) < below):
            raise self.wrong(f"it holds a number that is not in {least} .. {below - 1}")
        return array.astype(np.int64)  # wide enough for sums of such numbers

    def truths(self, shape: Shape) -> Truth:
        """Return an array of truth values of this shape; their bytes are 0 or 1."""
        array = self._array(shape)
        if array.dtype != np.bool_ or np.any(array.view(np.uint8) > 1):
            raise self.wrong("expected truth values")
        return array


def box(own: dict[str, Entry], low: str, high: str, count: int) -> Array:
    """Return corners (2, count) of a closed box, the lower one nowhere above the upper one."""
    ends = np.stack([own[low].vector(count), own[high].vector(count)])
    if np.any(ends[0] > ends[1]):
        raise own[low].wrong(f"it is above `{high}`")
    return ends


def distinct(names: Sequence[str], place: str) -> None:
    """Raise ``Unreadable`` if a name stands for two things."""
    if len(set(names)) != len(names):
        raise Unreadable(f"{place}: a name stands there twice")
