"""Expressions computed on arrays of numbers, with the same bits for one number and for many.

Sums, products and quotients are rounded correctly, so their bits depend on nothing. Elementary functions are numpy's,
and always called on contiguous arrays of at least one axis: numpy has other loops, with other last bits, for other
arrays. Whole powers are products in a fixed order. What is not defined, such as the logarithm of -1, is not a number,
and lies outside every workspace.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..backends import is_host, namespace
from .expression_tree import Name, Number, Tree, whole_exponent

FloatArray = NDArray[Any]


def computed(trees: Sequence[Tree], values: Mapping[str, FloatArray]) -> list[FloatArray]:
    """Return the values of expressions (rounded once per operation).

    Parameters
    ----------
    trees : sequence of Tree
    values : mapping from str to array
        Values of the names: arrays of one shape, with at least one axis.
    """
    shape = np.broadcast_shapes((1,), *(tuple(value.shape) for value in values.values()))
    one = next(iter(values.values()), np.zeros(1))[:1]
    xp = namespace(one)
    with np.errstate(all="ignore"):
        # What may be a view of the arguments is copied.
        found = (xp.broadcast_to(_value(tree, values, one), shape) for tree in trees)
        return [np.array(value) if is_host(value) else 1.0 * value for value in found]


def _value(tree: Tree, values: Mapping[str, FloatArray], one: FloatArray) -> FloatArray:
    """Return the value of one expression; numbers become arrays beside `one`."""
    if isinstance(tree, Number):
        return np.array([tree.value]) if is_host(one) else namespace(one).full_like(one, tree.value)
    if isinstance(tree, Name):
        return values[tree.name]
    arguments = [_value(argument, values, one) for argument in tree.arguments]
    if tree.name == "**":
        exponent = whole_exponent(tree.arguments[1])
        if exponent is not None:
            return power(arguments[0], exponent)
    if is_host(one):
        return _OPERATIONS[tree.name](*arguments)
    xp = namespace(one)
    found: FloatArray = getattr(xp, _STANDARD.get(tree.name, tree.name))(*xp.broadcast_arrays(*arguments))
    return found


def power(base: FloatArray, exponent: int) -> FloatArray:
    """Return a whole power by products: from the highest bit of the exponent on, square and multiply."""
    result = namespace(base).ones_like(base)
    for bit in bin(abs(exponent))[2:]:
        result = result * result
        if bit == "1":
            result = result * base
    return result if exponent >= 0 else 1.0 / result


def _on_contiguous(function: Callable[..., Any]) -> Callable[..., FloatArray]:
    def called(*arguments: FloatArray) -> FloatArray:
        whole = np.broadcast_arrays(*arguments)
        return np.asarray(function(*(np.ascontiguousarray(argument) for argument in whole)))

    return called


_OPERATIONS: dict[str, Callable[..., FloatArray]] = {
    "+": np.add,
    "-": np.subtract,
    "*": np.multiply,
    "/": np.divide,
    "**": _on_contiguous(np.power),
    "negative": np.negative,
    "abs": np.abs,
    "min": np.minimum,
    "max": np.maximum,
    "sin": _on_contiguous(np.sin),
    "cos": _on_contiguous(np.cos),
    "tan": _on_contiguous(np.tan),
    "atan": _on_contiguous(np.arctan),
    "exp": _on_contiguous(np.exp),
    "log": _on_contiguous(np.log),
    "sqrt": _on_contiguous(np.sqrt),
    "tanh": _on_contiguous(np.tanh),
}

_STANDARD = {
    "+": "add",
    "-": "subtract",
    "*": "multiply",
    "/": "divide",
    "**": "pow",
    "min": "minimum",
    "max": "maximum",
}
"""Names of the Python array API where they are others than those of expressions."""
