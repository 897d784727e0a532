"""First and second derivatives of an operation from those of its arguments, written on a tape."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import intervals as on
from .enclosure import _natural, _slopes_of
from .expression_tree import Number, Operation, Tree, whole_exponent
from .tapes import Place, Tape

Node = tuple[Place, dict[int, Place], dict[tuple[int, int], Place]]
"""The value of an expression, its first derivatives by variables, and its second ones by two of them, ``j <= k``."""


def chained(tape: Tape, tree: Operation, inner: Sequence[Node]) -> Node:
    """Return an operation with its derivatives, by the chain rule."""
    values = [value for value, _, _ in inner]
    value = _value(tape, tree, values)
    if not any(slopes for _, slopes, _ in inner):
        return value, {}, {}
    slopes: dict[int, Place] = {}
    second_derivatives: dict[tuple[int, int], Place] = {}
    for factor, (_, own, inner_second_derivatives) in zip(_first(tape, tree, values, value), inner, strict=True):
        _add(tape, slopes, own, factor)
        _add(tape, second_derivatives, inner_second_derivatives, factor)
    for (a, b), factor in _second(tape, tree, values, value).items():
        for j, one in inner[a][1].items():
            for k, other in inner[b][1].items():
                if a == b and j > k:
                    continue
                product = tape.multiply(factor, tape.multiply(one, other))
                # By two different arguments both orders count; on the diagonal they are the same number.
                if a != b and j == k:
                    product = tape.multiply(tape.number(2.0), product)
                _add(tape, second_derivatives, {(min(j, k), max(j, k)): product}, tape.number(1.0))
    return value, slopes, {k: bend for k, bend in second_derivatives.items() if not tape.is_number(bend, 0.0)}


def _add(tape: Tape, total: dict[Any, Place], more: dict[Any, Place], factor: Place) -> None:
    for k, interval in more.items():
        scaled = tape.multiply(factor, interval)
        total[k] = tape.add(total[k], scaled) if k in total else scaled


def _value(tape: Tape, tree: Operation, values: Sequence[Place]) -> Place:
    if tree.name == "+":
        return tape.add(*values)
    if tree.name == "-":
        return tape.subtract(*values)
    if tree.name == "*":
        return tape.multiply(*values)
    if tree.name == "/":
        return tape.divide(*values)
    if tree.name == "negative":
        return tape.negative(values[0])
    if tree.name == "**" and (whole := whole_exponent(tree.arguments[1])) is not None:
        return _power(tape, values[0], whole)
    return _plain(tape, tree.name, tree.arguments, *values)


def _plain(tape: Tape, name: str, arguments: Sequence[Tree], *values: Place) -> Place:
    """Return the value of an operation as interval arithmetic has it."""

    def enclosed(*boxes: NDArray[Any]) -> NDArray[Any]:
        return _one(_natural(name, arguments, [(box[0], box[1]) for box in boxes]))

    exponent = arguments[1] if name == "**" else None
    return tape.call((name, exponent), enclosed, *values)


def _power(tape: Tape, base: Place, exponent: int) -> Place:
    """Return a whole power."""
    if exponent in (0, 1, 2):
        return (tape.number(1.0), base, tape.square(base))[exponent]

    def enclosed(box: NDArray[Any]) -> NDArray[Any]:
        return _one(on.power((box[0], box[1]), exponent))

    return tape.call(("power", exponent), enclosed, base)


def _one(interval: on.Interval) -> NDArray[Any]:
    """Return an interval as one array (2, n)."""
    low, high = interval
    return np.array(interval if low.shape == high.shape else np.broadcast_arrays(low, high))


def _first(tape: Tape, tree: Operation, values: Sequence[Place], value: Place) -> list[Place]:
    """Return the derivatives by the arguments."""
    if tree.name in ("+", "-", "negative"):
        last = tape.number(1.0 if tree.name == "+" else -1.0)
        return [tape.number(1.0), last][-len(values) :]
    if tree.name == "*":
        return [values[1], values[0]]
    if tree.name == "/":
        inverse = tape.divide(tape.number(1.0), values[1])
        return [inverse, tape.negative(tape.multiply(value, inverse))]
    if tree.name in _FIRST:
        return [_FIRST[tree.name](tape, values[0], value)]
    if tree.name == "**" and (whole := whole_exponent(tree.arguments[1])) is not None:
        return [tape.multiply(tape.number(float(whole)), _power(tape, values[0], whole - 1)), tape.number(0.0)]
    # Other powers, and what is not smooth: slopes of secants, where there are no derivatives.

    def slopes(*boxes: NDArray[Any]) -> list[NDArray[Any]]:
        *inner, own = [(box[0], box[1]) for box in boxes]
        found = _slopes_of(tree.name, tree.arguments, inner, own)
        return [np.ones((2, 1)) if slope is None else _one(slope) for slope in found]

    whole = tape.call(("slopes", tree.name, tree.arguments[1:]), slopes, *values, value)
    return [tape.part(k, whole) for k in range(len(values))]


def _second(tape: Tape, tree: Operation, values: Sequence[Place], value: Place) -> dict[tuple[int, int], Place]:
    """Return the second derivatives by the arguments; those that are left out are 0."""
    first = values[0]
    if tree.name in ("+", "-", "negative"):
        return {}
    if tree.name == "*":
        return {(0, 1): tape.number(1.0)}
    if tree.name == "/":
        inverse = tape.divide(tape.number(1.0), values[1])
        square = tape.square(inverse)
        cube = tape.divide(square, values[1])
        return {(0, 1): tape.negative(square), (1, 1): tape.multiply(tape.multiply(tape.number(2.0), first), cube)}
    if tree.name == "abs":
        return {(0, 0): tape.call("bend of abs", _bend_of_abs, first)}
    if tree.name in ("min", "max"):
        unknown = tape.call("bend of a choice", _bend_of_choice, *values)
        return {(0, 0): unknown, (0, 1): unknown, (1, 1): unknown}
    if tree.name == "**":
        return {(0, 0): _second_of_power(tape, tree.arguments[1], first)}
    return {(0, 0): _SECOND[tree.name](tape, first, value)}


def _second_of_power(tape: Tape, exponent: Tree, base: Place) -> Place:
    if not isinstance(exponent, Number):
        return tape.number(np.nan)
    n = exponent.value
    if (whole := whole_exponent(Number(n - 2.0))) is not None:
        return tape.multiply(tape.number(n * (n - 1.0)), _power(tape, base, whole))

    def enclosed(box: NDArray[Any]) -> NDArray[Any]:
        return _one(on.constant_power((box[0], box[1]), n - 2.0))

    return tape.multiply(tape.number(n * (n - 1.0)), tape.call(("constant power", n - 2.0), enclosed, base))


def _nothing_at(unknown: NDArray[np.bool_]) -> NDArray[Any]:
    ends = np.where(unknown, np.nan, 0.0)
    return np.array([ends, ends])


def _bend_of_abs(a: NDArray[Any]) -> NDArray[Any]:
    return _nothing_at((a[0] <= 0.0) & (a[1] >= 0.0))


def _bend_of_choice(a: NDArray[Any], b: NDArray[Any]) -> NDArray[Any]:
    return _nothing_at((a[1] >= b[0]) & (b[1] >= a[0]))


def _cut_below(a: NDArray[Any]) -> NDArray[Any]:
    return np.maximum(a, 0.0)


def _one_plus_square(tape: Tape, a: Place) -> Place:
    return tape.add(tape.number(1.0), tape.square(a))


def _less_square(tape: Tape, a: Place) -> Place:
    return tape.subtract(tape.number(1.0), tape.square(a))


def _twice(tape: Tape, a: Place, b: Place, sign: float = 1.0) -> Place:
    return tape.multiply(tape.number(2.0 * sign), tape.multiply(a, b))


def _over(tape: Tape, a: Place, number: float = 1.0) -> Place:
    return tape.divide(tape.number(number), a)


Rule = Callable[[Tape, Place, Place], Place]

_FIRST: dict[str, Rule] = {
    "sin": lambda tape, a, f: _plain(tape, "cos", (), a),
    "cos": lambda tape, a, f: tape.negative(_plain(tape, "sin", (), a)),
    "tan": lambda tape, a, f: _one_plus_square(tape, f),
    "atan": lambda tape, a, f: _over(tape, _one_plus_square(tape, a)),
    "exp": lambda tape, a, f: f,
    "log": lambda tape, a, f: _over(tape, a),
    "sqrt": lambda tape, a, f: _over(tape, f, 0.5),
    "tanh": lambda tape, a, f: tape.call("cut below", _cut_below, _less_square(tape, f)),
}
"""Derivatives of functions of one argument, from the argument and the value."""

_SECOND: dict[str, Rule] = {
    "sin": lambda tape, a, f: tape.negative(f),
    "cos": lambda tape, a, f: tape.negative(f),
    "tan": lambda tape, a, f: _twice(tape, f, _one_plus_square(tape, f)),
    "atan": lambda tape, a, f: tape.divide(tape.multiply(tape.number(-2.0), a), tape.square(_one_plus_square(tape, a))),
    "exp": lambda tape, a, f: f,
    "log": lambda tape, a, f: _over(tape, tape.square(a), -1.0),
    "sqrt": lambda tape, a, f: _over(tape, tape.multiply(a, f), -0.25),
    "tanh": lambda tape, a, f: _twice(tape, f, _less_square(tape, f), -1.0),
}
"""Second derivatives of functions of one argument."""
