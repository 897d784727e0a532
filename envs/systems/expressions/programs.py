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

from .chain_rule import Node, chained
from .evaluation import power
from .expression_tree import Name, Number, Operation, Tree, whole_exponent
from .tapes import Tape

FloatArray = NDArray[Any]
SecondDerivativeBounds = dict[tuple[int, int], FloatArray]
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
        found = self._derived.slopes(np.stack([variables, variables]))
        p, (v, n) = len(self.results), variables.shape
        values, matrix = np.empty((p, n)), np.zeros((p, v, n))
        for i, interval in enumerate(found[:p]):
            values[i] = 0.5 * (interval[0] + interval[1])
        for (i, j), slope in zip(self._derived.first, found[p:], strict=True):
            matrix[i, j] = 0.5 * (slope[0] + slope[1])
        return values, matrix

    def curved(self, box: FloatArray) -> list[tuple[dict[int, FloatArray], SecondDerivativeBounds]]:
        """Return intervals around first and second derivatives on boxes (2, v, n) of variables (rounded to nearest).

        Derivatives that are left out are 0.
        """
        found: list[tuple[dict[int, FloatArray], SecondDerivativeBounds]] = [({}, {}) for _ in self.results]
        intervals = iter(self._derived.second_derivatives(box))
        for i, j in self._derived.first:
            found[i][0][j] = next(intervals)
        for i, j, k in self._derived.second:
            found[i][1][j, k] = next(intervals)
        return found

    @cached_property
    def _derived(self) -> Derived:
        """The tape of derivatives."""
        tape = Tape()
        found: list[Node] = []
        for step in self.steps:
            tree = step.tree
            if isinstance(tree, Number):
                found.append((tape.number(tree.value), {}, {}))
            elif isinstance(tree, Name):
                found.append((tape.variable(step.variable), {step.variable: tape.number(1.0)}, {}))
            else:
                found.append(chained(tape, tree, [found[k] for k in step.arguments]))
        nodes = [found[k] for k in self.results]
        first = [(i, j) for i, (_, slopes, _) in enumerate(nodes) for j in slopes]
        second = [(i, j, k) for i, (_, _, second_derivatives) in enumerate(nodes) for j, k in second_derivatives]
        slopes = [nodes[i][1][j] for i, j in first]
        second_derivatives = [nodes[i][2][j, k] for i, j, k in second]
        values = [value for value, _, _ in nodes]
        return Derived(first, second, tape.running([*values, *slopes]), tape.running([*slopes, *second_derivatives]))


@dataclass(frozen=True)
class Derived:
    """Which derivatives of which results there are, and functions of boxes (2, v, n) that enclose them.

    Parameters
    ----------
    first, second : lists
        Results with one variable, and with two.
    slopes, bends : callable
        Return values and first derivatives; first and second derivatives.
    """

    first: list[tuple[int, int]]
    second: list[tuple[int, int, int]]
    slopes: Callable[[FloatArray], list[FloatArray]]
    second_derivatives: Callable[[FloatArray], list[FloatArray]]


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
