"""Expressions as lists of operations, each done once: values, derivatives and intervals around second derivatives.

Trees repeat themselves: the sine of an angle stands in every row. A program does every operation that occurs once, in
an order in which arguments come first. It serves searches along paths, which read the same expressions thousands of
times; nothing is certified from it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import intervals as on
from .enclosure import _natural, _slopes_of
from .evaluation import power
from .expression_tree import Name, Number, Operation, Tree, whole_exponent
from .intervals import Interval

FloatArray = NDArray[Any]
Bends = dict[tuple[int, int], Interval]
"""Second derivatives by two variables ``j <= k``; those that are left out are 0."""


@dataclass(frozen=True)
class Step:
    """An operation with the places of its arguments and their trees, a number, or a variable by its place."""

    tree: Tree
    arguments: tuple[int, ...] = ()
    variable: int = -1


@dataclass(frozen=True, eq=False)
class Program:
    """Expressions of named variables.

    Parameters
    ----------
    steps : tuple of Step
    results : tuple of int
        Where the values of the expressions stand.
    """

    steps: tuple[Step, ...]
    results: tuple[int, ...]

    @classmethod
    def of(cls, trees: Sequence[Tree], names: Sequence[str]) -> Program:
        """Put trees of these names in order."""
        places: dict[Tree, int] = {}
        steps: list[Step] = []

        def place(tree: Tree) -> int:
            if tree not in places:
                if isinstance(tree, Operation):
                    # Equal arguments are one: a square is no product of two different numbers.
                    is_square = tree.name == "*" and tree.arguments[0] == tree.arguments[1]
                    done = Operation("**", (tree.arguments[0], Number(2.0))) if is_square else tree
                    step = Step(done, tuple(place(argument) for argument in done.arguments))
                else:
                    step = Step(tree, (), names.index(tree.name) if isinstance(tree, Name) else -1)
                places[tree] = len(steps)
                steps.append(step)
            return places[tree]

        results = tuple(place(tree) for tree in trees)
        return cls(tuple(steps), results)

    def values(self, variables: FloatArray) -> FloatArray:
        """Return the values (p, ..) at variables (v, ..) (rounded)."""
        found: list[Any] = []
        with np.errstate(all="ignore"):
            for function, arguments in self._calls:
                found.append(function(variables, *[found[k] for k in arguments]))
        result = np.empty((len(self.results), *variables.shape[1:]))
        for i, k in enumerate(self.results):
            result[i] = found[k]
        return result

    @cached_property
    def _calls(self) -> list[tuple[Callable[..., Any], tuple[int, ...]]]:
        """Operations as functions of the variables and of values before."""
        return [(_function(step), step.arguments) for step in self.steps]

    def slopes(self, variables: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the values (p, n) and partial derivatives (p, v, n) at variables (v, n) (rounded)."""
        found = self._dual([(row, row) for row in variables], False)
        p, (v, n) = len(self.results), variables.shape
        values, matrix = np.empty((p, n)), np.zeros((p, v, n))
        for i, k in enumerate(self.results):
            interval, slopes, _ = found[k]
            values[i] = 0.5 * (interval[0] + interval[1])
            for j, slope in slopes.items():
                matrix[i, j] = 0.5 * (slope[0] + slope[1])
        return values, matrix

    def curved(self, box: Sequence[Interval]) -> list[tuple[Interval, dict[int, Interval], Bends]]:
        """Return intervals around values, first and second derivatives on boxes of variables (outer bounds)."""
        found = self._dual(box, True)
        return [found[k] for k in self.results]

    def _dual(self, box: Sequence[Interval], twice: bool) -> list[tuple[Interval, dict[int, Interval], Bends]]:
        found: list[tuple[Interval, dict[int, Interval], Bends]] = []
        one = np.ones(1), np.ones(1)
        with np.errstate(all="ignore"):
            for step in self.steps:
                tree = step.tree
                if isinstance(tree, Number):
                    number = np.array([tree.value])
                    found.append(((number, number), {}, {}))
                elif isinstance(tree, Name):
                    found.append((box[step.variable], {step.variable: one}, {}))
                else:
                    found.append(_chained(tree, [found[k] for k in step.arguments], twice))
        return found


def _function(step: Step) -> Callable[..., Any]:
    tree = step.tree
    if isinstance(tree, Number):
        number = tree.value
        return lambda variables: number
    if isinstance(tree, Name):
        place = step.variable
        return lambda variables: variables[place]
    if tree.name == "**":
        n = whole_exponent(tree.arguments[1])
        if n is not None:
            return lambda variables, base, _: power(np.asarray(base), n)
    function = _FUNCTIONS[tree.name]
    return lambda variables, *arguments: function(*arguments)


def _chained(
    tree: Operation, inner: list[tuple[Interval, dict[int, Interval], Bends]], twice: bool
) -> tuple[Interval, dict[int, Interval], Bends]:
    """Return an operation with its derivatives, by the chain rule."""
    values = [value for value, _, _ in inner]
    value = _natural(tree.name, tree.arguments, values)
    if not any(slopes for _, slopes, _ in inner):
        return value, {}, {}
    slopes: dict[int, Interval] = {}
    bends: Bends = {}
    factors = _slopes_of(tree.name, tree.arguments, values, value)
    for factor, (_, own, own_bends) in zip(factors, inner, strict=True):
        _add(slopes, own, factor)
        _add(bends, own_bends, factor)
    if twice:
        for (a, b), factor in _second(tree, values, value).items():
            first, second = inner[a][1], inner[b][1]
            for j, one in first.items():
                for k, other in second.items():
                    if a == b and j > k:
                        continue
                    product = on.multiply(factor, on.multiply(one, other))
                    # By two different arguments both orders count; on the diagonal they are the same number.
                    if a != b and j == k:
                        product = on.add(product, product)
                    _add(bends, {(min(j, k), max(j, k)): product}, None)
    return value, slopes, bends


def _add(total: dict[Any, Interval], more: dict[Any, Interval], factor: Interval | None) -> None:
    for k, interval in more.items():
        scaled = interval if factor is None else on.multiply(factor, interval)
        total[k] = on.add(total[k], scaled) if k in total else scaled


def _second(tree: Operation, values: list[Interval], value: Interval) -> dict[tuple[int, int], Interval]:
    """Return the second partial derivatives of an operation by its arguments; those that are left out are 0."""
    first = values[0]
    if tree.name in ("+", "-", "negative"):
        return {}
    if tree.name == "*":
        return {(0, 1): _number(1.0)}
    if tree.name == "/":
        second = values[1]
        return {
            (0, 1): on.divide(_number(-1.0), on.power(second, 2)),
            (1, 1): on.divide(on.multiply(_number(2.0), first), on.multiply(second, on.power(second, 2))),
        }
    if tree.name == "abs":
        return {(0, 0): _nothing_at((first[0] <= 0.0) & (first[1] >= 0.0))}
    if tree.name in ("min", "max"):
        second = values[1]
        unknown = _nothing_at((first[1] >= second[0]) & (second[1] >= first[0]))
        return {(0, 0): unknown, (0, 1): unknown, (1, 1): unknown}
    if tree.name == "**":
        return {(0, 0): _second_of_power(tree.arguments[1], first)}
    return {(0, 0): _SECOND[tree.name](first)}


def _second_of_power(exponent: Tree, base: Interval) -> Interval:
    if not isinstance(exponent, Number):
        return _nothing_at(np.ones(1, dtype=bool))
    n = exponent.value
    factor, whole = _number(n * (n - 1.0)), whole_exponent(Number(n - 2.0))
    return on.multiply(factor, on.power(base, whole) if whole is not None else on.constant_power(base, n - 2.0))


def _number(x: float) -> Interval:
    return np.array([x]), np.array([x])


def _nothing_at(unknown: NDArray[np.bool_]) -> Interval:
    ends = np.where(unknown, np.nan, 0.0)
    return ends, ends


def _of_tan(a: Interval) -> Interval:
    t = on.tan(a)
    return on.multiply(on.multiply(_number(2.0), t), on.add(_number(1.0), on.power(t, 2)))


def _of_atan(a: Interval) -> Interval:
    return on.divide(on.multiply(_number(-2.0), a), on.power(on.add(_number(1.0), on.power(a, 2)), 2))


def _of_tanh(a: Interval) -> Interval:
    t = on.tanh(a)
    return on.multiply(on.multiply(_number(-2.0), t), on.subtract(_number(1.0), on.power(t, 2)))


_FUNCTIONS: dict[str, Callable[..., Any]] = {
    "+": np.add,
    "-": np.subtract,
    "*": np.multiply,
    "/": np.divide,
    "**": np.power,
    "negative": np.negative,
    "abs": np.abs,
    "min": np.minimum,
    "max": np.maximum,
    "sin": np.sin,
    "cos": np.cos,
    "tan": np.tan,
    "atan": np.arctan,
    "exp": np.exp,
    "log": np.log,
    "sqrt": np.sqrt,
    "tanh": np.tanh,
}

_SECOND: dict[str, Callable[[Interval], Interval]] = {
    "sin": lambda a: on.negative(on.sin(a)),
    "cos": lambda a: on.negative(on.cos(a)),
    "tan": _of_tan,
    "exp": on.exp,
    "log": lambda a: on.divide(_number(-1.0), on.power(a, 2)),
    "sqrt": lambda a: on.divide(_number(-1.0), on.multiply(on.multiply(_number(4.0), a), on.sqrt(a))),
    "atan": _of_atan,
    "tanh": _of_tanh,
}
"""Second derivatives of functions of one argument."""
