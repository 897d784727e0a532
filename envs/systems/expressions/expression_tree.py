"""Expression trees: inert records that every reading of an expression walks over.

A tree is a number, a name, or an operation on trees. There are three readings of it: arrays of numbers (`evaluation`),
intervals for the search (`intervals`, `enclosure`), and intervals for the check, written a second time
(`synthesis.checker.intervals`). Numbers are doubles: `0.1` is the double nearest to a tenth.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

FUNCTIONS = {
    "abs": 1,
    "atan": 1,
    "clip": 3,
    "cos": 1,
    "exp": 1,
    "log": 1,
    "max": 2,
    "min": 2,
    "sin": 1,
    "sqrt": 1,
    "tan": 1,
    "tanh": 1,
}
"""Functions and their number of arguments; `min` and `max` take more, two at a time. `clip` is read as both."""

LARGEST_POWER = 32
"""Whole exponents up to this size are products, with the same bits everywhere; others are real powers of bases >= 0."""


@dataclass(frozen=True)
class Number:
    """A finite double."""

    value: float


@dataclass(frozen=True)
class Name:
    """A state, an input or a disturbance; `agent.state` for a state of another agent."""

    name: str


@dataclass(frozen=True)
class Operation:
    """An operation on trees: one of `ARITHMETIC`, `FUNCTIONS` but `clip`, or `negative`."""

    name: str
    arguments: tuple[Tree, ...]


Tree = Number | Name | Operation


def whole_exponent(tree: Tree) -> int | None:
    """Return the exponent of a power that is computed by products, or None for a real power."""
    if isinstance(tree, Number) and tree.value == int(tree.value) and abs(tree.value) <= LARGEST_POWER:
        return int(tree.value)
    return None


def names_in(tree: Tree) -> frozenset[str]:
    """Return all names in a tree."""
    if isinstance(tree, Name):
        return frozenset([tree.name])
    if isinstance(tree, Number):
        return frozenset()
    return frozenset().union(*(names_in(argument) for argument in tree.arguments))


def operations_in(tree: Tree) -> int:
    """Return the number of operations in a tree, and one for its leaves."""
    return 1 + sum(map(operations_in, tree.arguments)) if isinstance(tree, Operation) else 1


def with_numbers(tree: Tree, numbers: Mapping[str, float]) -> Tree:
    """Return a tree with names replaced by numbers; sums and products of numbers become numbers (rounded once each).

    Raises
    ------
    ArithmeticError
        If numbers are divided by 0, or a result is too large for a double.
    """
    if isinstance(tree, Number):
        return tree
    if isinstance(tree, Name):
        return Number(numbers[tree.name]) if tree.name in numbers else tree
    arguments = tuple(with_numbers(argument, numbers) for argument in tree.arguments)
    values = [argument.value for argument in arguments if isinstance(argument, Number)]
    # Only what every machine rounds alike is folded: the sine of a number stays, and is enclosed where it is read.
    if len(values) == len(arguments) and tree.name in ("+", "-", "*", "/", "negative"):
        return Number(_folded(tree.name, values))
    return Operation(tree.name, arguments)


def _folded(name: str, values: list[float]) -> float:
    """Return a sum, difference, product, quotient or negative of numbers, or raise ArithmeticError."""
    if name == "negative":
        return -values[0]
    first, second = values
    if name == "/" and second == 0.0:
        raise ZeroDivisionError("division by zero")
    result = {"+": first + second, "-": first - second, "*": first * second}.get(name)
    result = first / second if result is None else result
    if abs(result) > 1e300:
        raise OverflowError("a number is too large")
    return result


def affine(factors: Iterable[float], names: Sequence[str], offset: float) -> Tree:
    """Return the sum of factors times names, and an offset; a name alone where that is all.

    Examples
    --------
    >>> affine([1.0, 0.0], ["x", "y"], 0.0)
    Name(name='x')
    """
    terms: list[Tree] = [
        Name(name) if factor == 1.0 else Operation("*", (Number(float(factor)), Name(name)))
        for factor, name in zip(factors, names, strict=True)
        if factor != 0.0
    ]
    terms += [Number(float(offset))] if offset != 0.0 or not terms else []
    total = terms[0]
    for term in terms[1:]:
        total = Operation("+", (total, term))
    return total
