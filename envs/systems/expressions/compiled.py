"""Expressions as Python functions, written once: every operation that occurs is done once, and nothing is walked over.

The values are those of `evaluation.computed`, to the last bit. Sums and products are rounded correctly, whoever does
them; so one text serves plain numbers and arrays of numpy, and only what is not the same in both is put in from
outside: quotients, powers, functions, the lesser of two.

The text is made of names that are numbered and of the words of this module; nothing that a user has written is in it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Any

import numpy as np

from .evaluation import _OPERATIONS, power
from .expression_tree import Name, Number, Tree, whole_exponent

Function = Callable[..., tuple[Any, ...]]


class Compiled:
    """Expressions as functions of groups of values.

    Parameters
    ----------
    trees : sequence of Tree
    groups : sequence of sequences of str
        Names, group by group: a function takes one sequence of values for each group.

    Examples
    --------
    >>> x = Name("x")
    >>> from certigym.envs.systems.expressions import Operation
    >>> Compiled([Operation("*", (x, Number(2.0)))], [["x"]]).numbers([3.0])
    (6.0,)
    """

    def __init__(self, trees: Sequence[Tree], groups: Sequence[Sequence[str]]) -> None:
        self._given = tuple(trees), tuple(tuple(names) for names in groups)
        self._lines: list[str] = []
        self._constants: dict[str, float] = {}
        # What is the same is computed once; the key is the operation and where its arguments stand.
        self._places: dict[tuple[str, ...], str] = {}
        self._names = {name: f"v{g}_{k}" for g, names in enumerate(groups) for k, name in enumerate(names)}
        results = [self._placed(tree) for tree in trees]
        heads = [f"    ({''.join(f'v{g}_{k}, ' for k in range(len(names)))}) = g{g}" for g, names in enumerate(groups)]
        heads = [head for head, names in zip(heads, groups) if names]
        arguments = ", ".join(f"g{g}" for g in range(len(groups)))
        body = [*heads, *self._lines, f"    return ({''.join(f'{name}, ' for name in results)})"]
        self._code = compile("\n".join([f"def values({arguments}):", *body]), "<expressions>", "exec")

    def __reduce__(self) -> tuple[Any, ...]:
        return Compiled, self._given  # functions that were made here do not travel; they are made again

    @cached_property
    def numbers(self) -> Function:
        """The function of plain numbers; the caller ignores warnings of numpy unless `is_plain`."""
        return self._function(self._constants, _ON_NUMBERS)

    @cached_property
    def arrays(self) -> Function:
        """The function of numpy arrays of one shape; the caller ignores warnings.

        Results may be views of arguments, and have one entry where they depend on none.
        """
        return self._function({name: np.array([value]) for name, value in self._constants.items()}, _ON_ARRAYS)

    @cached_property
    def is_plain(self) -> bool:
        """Whether there are only sums, differences and products, of which numpy never warns about plain numbers."""
        return all(key[0] in ("+", "-", "*", "negative", "number") for key in self._places)

    def _function(self, constants: dict[str, Any], words: dict[str, Any]) -> Function:
        names: dict[str, Any] = {"__builtins__": {}, **constants, **words}
        exec(self._code, names)
        function: Function = names["values"]
        return function

    def _placed(self, tree: Tree) -> str:
        """Return the name of the value of a tree; write the lines that compute it, unless they are there."""
        if isinstance(tree, Name):
            return self._names[tree.name]
        if isinstance(tree, Number):
            key: tuple[str, ...] = ("number", tree.value.hex())
            if key not in self._places:
                self._places[key] = f"c{len(self._constants)}"
                self._constants[self._places[key]] = tree.value
            return self._places[key]
        exponent = whole_exponent(tree.arguments[1]) if tree.name == "**" else None
        if exponent is not None:
            key = ("power", self._placed(tree.arguments[0]), str(exponent))
        else:
            key = (tree.name, *map(self._placed, tree.arguments))
        if key not in self._places:
            self._places[key] = f"r{len(self._lines)}"
            self._lines.append(f"    {self._places[key]} = {_TEXTS[key[0]].format(*key[1:])}")
        return self._places[key]


_TEXTS = {
    "+": "{} + {}",
    "-": "{} - {}",
    "*": "{} * {}",
    "negative": "-{}",
    "/": "divided({}, {})",
    "**": "raised({}, {})",
    "power": "power({}, {})",
    "abs": "absolute({})",
    "min": "least({}, {})",
    "max": "most({}, {})",
    **{name: name + "({})" for name in ("sin", "cos", "tan", "atan", "exp", "log", "sqrt", "tanh")},
}
"""How operations are written."""

_WORDS = {"divided": "/", "raised": "**", "absolute": "abs", "least": "min", "most": "max"}
_WORDS |= {name: name for name in ("sin", "cos", "tan", "atan", "exp", "log", "sqrt", "tanh")}
"""Words of the text that are put in, and the operations that they stand for."""


def _on_numbers(function: Callable[..., Any]) -> Callable[..., float]:
    """Return numpy's function of plain numbers: on arrays of one entry, whose bits are those of many."""

    def called(*arguments: float) -> float:
        result: float = function(*[np.array([argument]) for argument in arguments]).item()
        return result

    return called


_OWN = {word: _on_numbers(_OPERATIONS[name]) for word, name in _WORDS.items()}


def _divided(a: float, b: float) -> float:
    return a / b if b != 0.0 else _OWN["divided"](a, b)  # Python refuses to divide by 0


# What is equal or no number is left to numpy: of 0 and -0 it takes one.
def _least(a: float, b: float) -> float:
    return a if a < b else b if b < a else _OWN["least"](a, b)


def _most(a: float, b: float) -> float:
    return a if a > b else b if b > a else _OWN["most"](a, b)


def _power(base: float, exponent: int) -> float:
    """Return a whole power by the products of `evaluation.power`."""
    result = 1.0
    for bit in bin(abs(exponent))[2:]:
        result = result * result
        if bit == "1":
            result = result * base
    return result if exponent >= 0 else _divided(1.0, result)


_ON_ARRAYS = {**{word: _OPERATIONS[name] for word, name in _WORDS.items()}, "power": power}
_ON_NUMBERS = {**_OWN, "divided": _divided, "least": _least, "most": _most, "absolute": abs, "power": _power}
