"""Derivatives of expressions as a list of operations on intervals: written once, run thousands of times.

The chain rule multiplies and adds many numbers that are known from the start: most derivatives of most expressions are
constants. A tape computes these when it is written, does every operation that occurs once, and leaves out what nobody
asks for. An interval is an array (2, n) of lower and upper ends; ends that are not numbers say that nothing is known.
Ends are rounded to the nearest number, not outward: searches read them, and nothing is certified from them.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, field
from operator import itemgetter
from typing import Any

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[Any]
Place = int
"""Where the interval of an operation stands."""


@dataclass(eq=False)
class Tape:
    """Operations in an order in which arguments come first."""

    calls: list[tuple[Callable[..., Any] | None, tuple[Place, ...]]] = field(default_factory=list)
    """Functions of intervals with the places of their arguments; variables have none."""
    known: dict[Place, Any] = field(default_factory=dict)
    """Results that do not depend on variables."""
    variables: dict[Place, int] = field(default_factory=dict)
    places: dict[Hashable, Place] = field(default_factory=dict)

    def _placed(self, key: Hashable, function: Callable[..., Any] | None, arguments: tuple[Place, ...]) -> Place:
        if key not in self.places:
            place = self.places[key] = len(self.calls)
            self.calls.append((function, arguments))
            if function is not None and all(k in self.known for k in arguments):
                with np.errstate(all="ignore"):
                    self.known[place] = function(*[self.known[k] for k in arguments])
        return self.places[key]

    def variable(self, number: int) -> Place:
        """Return the place of a variable."""
        place = self._placed(("variable", number), None, ())
        self.variables[place] = number
        return place

    def number(self, x: float) -> Place:
        """Return the place of a number."""
        return self._placed(("number", x), lambda: np.full((2, 1), x), ())

    def call(self, key: Hashable, function: Callable[..., Any], *arguments: Place) -> Place:
        """Return the place of a function of intervals; functions of one ``key`` are the same."""
        return self._placed((key, arguments), function, arguments)

    def part(self, k: int, whole: Place) -> Place:
        """Return the place of one of several intervals that a function returned."""
        return self._placed(("part", k, whole), itemgetter(k), (whole,))

    def add(self, a: Place, b: Place) -> Place:
        """Return all sums."""
        if self.is_number(a, 0.0) or self.is_number(b, 0.0):
            return b if self.is_number(a, 0.0) else a
        return self.call("+", np.add, *sorted((a, b)))

    def negative(self, a: Place) -> Place:
        """Return all negatives."""
        return self.call("negative", _negative, a)

    def subtract(self, a: Place, b: Place) -> Place:
        """Return all differences."""
        return self.add(a, self.negative(b))

    def multiply(self, a: Place, b: Place) -> Place:
        """Return all products."""
        a, b = sorted((a, b), key=lambda k: k not in self.known)
        if a not in self.known:
            return self.square(a) if a == b else self.call("*", _product, *sorted((a, b)))
        low, high = np.ravel(self.known[a])
        if b in self.known or low != high:
            return self.call("*", _product, a, b)
        if low in (0.0, 1.0):
            return b if low else a
        return self.call(("times", low), lambda interval: interval * low if low >= 0.0 else interval[::-1] * low, b)

    def square(self, a: Place) -> Place:
        """Return all squares."""
        return self.call("square", _square, a)

    def divide(self, a: Place, b: Place) -> Place:
        """Return all quotients; unknown where the denominator can be 0."""
        return self.multiply(a, self.call("1/", _reciprocal, b))

    def is_number(self, a: Place, number: float) -> bool:
        """Return whether an interval is known to be a number."""
        return a in self.known and bool(np.all(self.known[a] == number))

    def running(self, wanted: Sequence[Place]) -> Callable[[FloatArray], list[FloatArray]]:
        """Return a function of the intervals (2, v, n) of variables that computes those at some places."""
        needed, rest = set[Place](), [*wanted]
        while rest:
            k = rest.pop()
            if k not in needed:
                needed.add(k)
                rest.extend(() if k in self.known else self.calls[k][1])
        rows = [(k, self.variables[k]) for k in needed if k in self.variables]
        calls = [(k, *self.calls[k]) for k in sorted(needed) if k not in self.known and k not in self.variables]
        before: list[Any] = [None] * len(self.calls)
        for k in needed & set(self.known):
            before[k] = self.known[k]

        def run(box: FloatArray) -> list[FloatArray]:
            found = before.copy()
            for k, number in rows:
                found[k] = box[:, number]
            with np.errstate(all="ignore"):
                for k, function, arguments in calls:
                    assert function is not None
                    found[k] = function(*[found[j] for j in arguments])
            return [found[k] for k in wanted]

        return run


def _negative(a: FloatArray) -> FloatArray:
    return -a[::-1]


def _product(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return all products: their extremes are products of ends."""
    ends = (a[:, None] * b[None, :]).reshape(4, -1)
    result: FloatArray = np.empty((2, ends.shape[1]))
    np.minimum.reduce(ends, axis=0, out=result[0])
    np.maximum.reduce(ends, axis=0, out=result[1])
    return result


def _square(a: FloatArray) -> FloatArray:
    ends = a * a
    low, high = np.minimum(ends[0], ends[1]), np.maximum(ends[0], ends[1])
    return np.array([np.where((a[0] <= 0.0) & (a[1] >= 0.0), 0.0, low), high])


def _reciprocal(a: FloatArray) -> FloatArray:
    known = (a[0] > 0.0) | (a[1] < 0.0)
    return np.asarray(1.0 / np.where(known, a[::-1], np.nan))
