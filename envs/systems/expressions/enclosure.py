"""Intervals around expressions on boxes: the least and the largest that they can be, and a little beyond.

Three enclosures of an expression f on a box are made, and what they have in common is kept (docs/theory/boxes.md,
"Boxes of expressions"):

- *natural*: every operation on intervals. It forgets that a name which occurs twice has one value.
- *mean value*: `f(c) + sum_k D_k ([x_k] - c_k)` with the middle c and slopes D_k, intervals that hold the partial
  derivatives on the whole box. It is off by second order in the width of the box.
- *monotone*: where a slope is nowhere negative, f is least at the lower end of that axis, and so on; along all other
  axes the natural enclosure is taken. It is exact, up to rounding, where f rises or falls along every axis.

Slopes are carried along with the values, operation by operation.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import intervals as on
from .expression_tree import Name, Number, Tree, whole_exponent
from .intervals import Interval

FloatArray = NDArray[Any]
Slopes = dict[int, Interval]
"""Partial derivatives by the number of the variable; those that are left out are 0."""


@dataclass(frozen=True, eq=False)
class Affine:
    """What a name stands for: `constant + sum_k slopes[k] * variable k`, as arrays that broadcast.

    States are variables themselves; inputs of a menu are constants.
    """

    constant: FloatArray
    slopes: Mapping[int, FloatArray] = field(default_factory=dict)

    def on_box(self, box: Sequence[Interval]) -> tuple[Interval, Slopes]:
        """Return values and slopes on a box of variables (outer bounds)."""
        slopes = {k: (number, number) for k, number in self.slopes.items()}
        if len(slopes) == 1 and not np.any(self.constant):
            [(k, number)] = self.slopes.items()
            if np.all(number == 1.0):
                return box[k], slopes  # the variable itself, without rounding
        value: Interval = (self.constant, self.constant)
        for k, slope in slopes.items():
            value = on.add(value, on.multiply(slope, box[k]))
        return value, slopes


def enclosed(trees: Sequence[Tree], names: Mapping[str, Affine], box: Sequence[Interval]) -> list[Interval]:
    """Return intervals around expressions on boxes (outer bounds).

    Ends are not numbers where nothing is known: an operation is not defined everywhere on the box, or not bounded.

    Parameters
    ----------
    trees : sequence of p trees
    names : mapping from str to Affine
        What the names stand for.
    box : sequence of intervals
        One interval per variable, arrays that broadcast: many boxes at once.
    """
    with np.errstate(all="ignore"):
        values = _outputs(trees, names, box)
        middle = [(0.5 * (low + high),) * 2 for low, high in box]
        at_middle = _outputs(trees, names, middle)
        result = []
        for k, ((natural, slopes), (centre, _)) in enumerate(zip(values, at_middle, strict=True)):
            ends = [natural, _mean_value(centre, slopes, box, middle)]
            if any(np.any((slope[0] >= 0.0) | (slope[1] <= 0.0)) for slope in slopes.values()):
                one = (trees[k], names)
                ends.append((_at_corner(one, slopes, box, True)[0], _at_corner(one, slopes, box, False)[1]))
            result.append(_common(natural, ends))
        return result


def gradients(
    trees: Sequence[Tree], names: Mapping[str, Affine], at: Sequence[FloatArray]
) -> list[tuple[FloatArray, dict[int, FloatArray]]]:
    """Return values and partial derivatives of expressions at points (rounded).

    Derivatives that are left out are 0. At kinks they are between the slopes on both sides; where nothing is known they
    are not numbers.

    Parameters
    ----------
    trees, names
        As for ``enclosed``.
    at : sequence of arrays
        The variables, arrays that broadcast.
    """
    with np.errstate(all="ignore"):
        found = _outputs(trees, names, [(point, point) for point in at])
        return [
            (0.5 * (low + high), {k: 0.5 * (slope[0] + slope[1]) for k, slope in slopes.items()})
            for (low, high), slopes in found
        ]


ARITHMETIC_ROUNDS, FUNCTIONS_ROUND = 2.0**-51, 2.0**-46
"""Shares of its size by which a result is rounded: of sums, products, quotients and roots, and of other functions. The
check allows for half of the one and a quarter of the other."""


def roundings(trees: Sequence[Tree], names: Mapping[str, Affine], box: Sequence[Interval]) -> list[FloatArray]:
    """Return how far expressions may be off on boxes as they are computed in double precision (upper bounds).

    Inner terms count with their own sizes: ``1e13*(x + 1) - 1e13*x`` is small, and loses what 1e13 loses. Each
    operation passes on the errors of its arguments, times its slopes on intervals that hold these errors, and adds its
    own. Numbers and names are exact. Bounds are not numbers, or infinite, where nothing is known. Parameters as for
    ``enclosed``.
    """
    with np.errstate(all="ignore"):
        leaves = {name: affine.on_box(box)[0] for name, affine in names.items()}
        return [_rounding(tree, leaves)[1] for tree in trees]


def _rounding(tree: Tree, leaves: Mapping[str, Interval]) -> tuple[Interval, FloatArray]:
    """Return an interval around all that an expression may be computed as, and how far that may be off."""
    if isinstance(tree, Number):
        return (np.array([tree.value]),) * 2, np.zeros(1)
    if isinstance(tree, Name):
        return leaves[tree.name], np.zeros(1)
    pairs = [_rounding(argument, leaves) for argument in tree.arguments]
    values = [value for value, _ in pairs]
    value = _natural(tree.name, tree.arguments, values)
    share = ARITHMETIC_ROUNDS if tree.name in ("+", "-", "*", "/", "sqrt") else FUNCTIONS_ROUND
    own = 0.0 if tree.name in ("negative", "abs", "min", "max") else share
    off = own * np.maximum(np.abs(value[0]), np.abs(value[1])) + (np.finfo(float).tiny if own else 0.0)
    for slope, (_, passed) in zip(_slopes_of(tree.name, tree.arguments, values, value), pairs, strict=True):
        steepest = np.ones(1) if slope is None else np.maximum(np.abs(slope[0]), np.abs(slope[1]))
        off = off + np.where(passed == 0.0, 0.0, steepest * passed)
    return (value[0] - off, value[1] + off), off


def _mean_value(centre: Interval, slopes: Slopes, box: Sequence[Interval], middle: Sequence[Interval]) -> Interval:
    value = centre
    for k, slope in slopes.items():
        value = on.add(value, on.multiply(slope, on.subtract(box[k], middle[k])))
    return value


def _at_corner(
    one: tuple[Tree, Mapping[str, Affine]],
    slopes: Slopes,
    box: Sequence[Interval],
    least: bool,
) -> Interval:
    """Return the natural enclosure with variables whose slope has a sign where the value is least, or largest."""
    reduced = list(box)
    for j, (steepest_down, steepest_up) in slopes.items():
        low, high = box[j]
        rises, falls = steepest_down >= 0.0, steepest_up <= 0.0
        to_low, to_high = (rises, falls) if least else (falls, rises)
        # A slope that is not a number has no sign, and the whole interval stays.
        reduced[j] = np.where(to_high & ~to_low, high, low), np.where(to_low, low, high)
    tree, names = one
    return _dual(tree, _on_box(names, reduced), False)[0]


def _common(natural: Interval, ends: Sequence[Interval]) -> Interval:
    """Return what several enclosures have in common; unknown where the natural one is."""
    low, high = ends[0]
    for more_low, more_high in ends[1:]:
        low, high = np.fmax(low, more_low), np.fmin(high, more_high)
    unknown = np.isnan(natural[0]) | np.isnan(natural[1])
    return np.where(unknown, np.nan, low), np.where(unknown, np.nan, high)


def _on_box(names: Mapping[str, Affine], box: Sequence[Interval]) -> dict[str, tuple[Interval, Slopes]]:
    return {name: affine.on_box(box) for name, affine in names.items()}


def _outputs(
    trees: Sequence[Tree], names: Mapping[str, Affine], box: Sequence[Interval]
) -> list[tuple[Interval, Slopes]]:
    """Return natural enclosures and slopes of expressions."""
    leaves = _on_box(names, box)
    return [_dual(tree, leaves, True) for tree in trees]


def _dual(tree: Tree, leaves: Mapping[str, tuple[Interval, Slopes]], with_slopes: bool) -> tuple[Interval, Slopes]:
    """Return the natural enclosure of an expression, and its slopes if they are asked for."""
    if isinstance(tree, Number):
        number = np.array([tree.value])
        return (number, number), {}
    if isinstance(tree, Name):
        value, slopes = leaves[tree.name]
        return value, slopes if with_slopes else {}
    pairs = [_dual(argument, leaves, with_slopes) for argument in tree.arguments]
    values, slopes_of = [value for value, _ in pairs], [slopes for _, slopes in pairs]
    value = _natural(tree.name, tree.arguments, values)
    if not any(slopes_of):
        return value, {}
    # The chain rule: slopes of the arguments times those of the operation.
    total: Slopes = {}
    for factor, slopes in zip(_slopes_of(tree.name, tree.arguments, values, value), slopes_of, strict=True):
        if factor is None:
            total = _sum(total, slopes)
        elif slopes:
            total = _sum(total, {k: on.multiply(factor, slope) for k, slope in slopes.items()})
    return value, total


def _sum(first: Slopes, second: Slopes) -> Slopes:
    result = dict(first)
    for k, slope in second.items():
        result[k] = on.add(result[k], slope) if k in result else slope
    return result


_UNARY = {
    "negative": on.negative,
    "abs": on.absolute,
    "sin": on.sin,
    "cos": on.cos,
    "tan": on.tan,
    "atan": on.atan,
    "exp": on.exp,
    "log": on.log,
    "sqrt": on.sqrt,
    "tanh": on.tanh,
}
_BINARY = {"+": on.add, "-": on.subtract, "/": on.divide, "min": on.minimum, "max": on.maximum}


def _natural(name: str, arguments: Sequence[Tree], values: Sequence[Interval]) -> Interval:
    """Return an operation on intervals."""
    if name in _UNARY:
        return _UNARY[name](values[0])
    if name == "**":
        exponent = whole_exponent(arguments[1])
        if exponent is not None:
            return on.power(values[0], exponent)
        if isinstance(arguments[1], Number):
            return on.constant_power(values[0], arguments[1].value)
        return on.real_power(*values)
    if name == "*":
        # A square is no product of two different numbers.
        return on.power(values[0], 2) if arguments[0] == arguments[1] else on.multiply(*values)
    return _BINARY[name](*values)


def _slopes_of(
    name: str, arguments: Sequence[Tree], values: Sequence[Interval], value: Interval
) -> list[Interval | None]:
    """Return the slopes of an operation with respect to its arguments; None stands for 1.

    Where there is no derivative (`abs` at 0), they hold all slopes of secants nearby, which is what the mean value form
    and monotony need.
    """
    one = np.ones(1), np.ones(1)
    first = values[0]
    if name == "+":
        return [None, None]
    if name == "-":
        return [None, (-one[0], -one[1])]
    if name == "*":
        return [values[1], first]
    if name == "/":
        inverse = on.divide(one, values[1])
        return [inverse, on.negative(on.multiply(value, inverse))]
    if name == "**":
        return _slopes_of_power(arguments[1], first, values[1], value)
    if name in ("min", "max"):
        return _slopes_of_choice(name, first, values[1])
    return [_SLOPES[name](first, value)]


def _slopes_of_power(exponent: Tree, base: Interval, power: Interval, value: Interval) -> list[Interval | None]:
    whole = whole_exponent(exponent)
    if whole == 0:
        return [(np.zeros(1), np.zeros(1)), (np.zeros(1), np.zeros(1))]
    if whole is not None:
        factor = np.array([float(whole)])
        return [on.multiply((factor, factor), on.power(base, whole - 1)), (np.zeros(1), np.zeros(1))]
    # a^b = exp(b log a): slopes b a^b / a, and a^b log a.
    return [on.divide(on.multiply(power, value), base), on.multiply(value, on.log(base))]


def _slopes_of_choice(name: str, first: Interval, second: Interval) -> list[Interval | None]:
    """Return the slopes of `min` and `max`: 1 and 0 where it is known which argument is taken, [0, 1] elsewhere."""
    sure_first, sure_second = first[1] < second[0], second[1] < first[0]
    if name == "max":
        sure_first, sure_second = sure_second, sure_first
    unknown = np.isnan(first[0] + second[0])
    low, high = np.where(sure_first, 1.0, 0.0), np.where(sure_second, 0.0, 1.0)
    low, high = np.where(unknown, np.nan, low), np.where(unknown, np.nan, high)
    return [(low, high), (1.0 - high, 1.0 - low)]


def _slope_of_abs(a: Interval, _: Interval) -> Interval:
    low, high = np.where(a[0] >= 0.0, 1.0, -1.0), np.where(a[1] <= 0.0, -1.0, 1.0)
    return low + 0.0 * a[0], high + 0.0 * a[0]


def _one_over(a: Interval) -> Interval:
    return on.divide((np.ones(1), np.ones(1)), a)


def _one_plus_square(a: Interval) -> Interval:
    return on.add((np.ones(1), np.ones(1)), on.power(a, 2))


_SLOPES = {
    "negative": lambda a, f: (-np.ones(1), -np.ones(1)),
    "abs": _slope_of_abs,
    "sin": lambda a, f: on.cos(a),
    "cos": lambda a, f: on.negative(on.sin(a)),
    "tan": lambda a, f: _one_plus_square(f),
    "atan": lambda a, f: _one_over(_one_plus_square(a)),
    "exp": lambda a, f: f,
    "log": lambda a, f: _one_over(a),
    "sqrt": lambda a, f: _one_over(on.add(f, f)),
    "tanh": lambda a, f: on.maximum(on.subtract((np.ones(1), np.ones(1)), on.power(f, 2)), (np.zeros(1), np.zeros(1))),
}
"""Derivatives of functions of one argument, from the argument and the value."""
