"""Expressions: read from text into trees, and never executed.

A tree is a number, a name, or a tuple ``(operation, tree, ..)`` with the operations ``+ - * / ** negative min max`` and
the functions of one argument in ``FUNCTIONS``. Its meaning is that of real numbers: ``jets`` encloses it.

The grammar is that of Python's expressions, cut down to numbers, names (also ``agent.name``), ``+ - * / **`` (or
``^``), signs, brackets, and calls of ``FUNCTIONS``, ``min`` and ``max`` of two or more, ``clip(x, low, high)``. The
constant ``pi`` is the double next to it. Operations on numbers alone are carried out at once, rounded to nearest, as
every simulator does it.
"""

from __future__ import annotations

import ast
import math
from collections.abc import Iterable, Mapping, Sequence
from functools import reduce
from typing import Any, TypeAlias

Tree: TypeAlias = "float | str | tuple[Any, ...]"

FUNCTIONS = frozenset(("abs", "atan", "cos", "exp", "log", "sin", "sqrt", "tan", "tanh"))
BINARY = {ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/", ast.Pow: "**"}
# Characters and levels that are read: recursion over a tree stays far from Python's limit of 1000 calls.
LONGEST, DEEPEST = 20_000, 200
LARGEST = 1e300  # numbers of this size and more are not read: their products overflow


def read_expression(text: Any, names: Iterable[str], numbers: Mapping[str, float]) -> Tree:
    """Return the tree of a text in names of variables, and of parameters, whose ``numbers`` are put in.

    Variables go before parameters of the same name. Raises ``ValueError`` if the text is no such expression.
    """
    if not isinstance(text, str) or len(text) > LONGEST:
        raise ValueError(f"an expression is no text of at most {LONGEST} characters")
    try:
        parsed = ast.parse(text.replace("^", "**").replace("\n", " ").strip(), mode="eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        raise ValueError(f"`{text[:60]}` is no expression") from error
    return _read(parsed, frozenset(names), {"pi": 3.141592653589793, **numbers}, 0)


def _read(node: ast.AST, names: frozenset[str], numbers: Mapping[str, float], depth: int) -> Tree:
    if depth > DEEPEST:  # before what is below is read
        raise ValueError(f"an expression is nested deeper than {DEEPEST} levels")
    if isinstance(node, ast.Constant) and isinstance(node.value, int | float) and not isinstance(node.value, bool):
        return _small(node.value)
    name = node.id if isinstance(node, ast.Name) else ""
    if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
        name = f"{node.value.id}.{node.attr}"  # a variable of another agent
    if name in names:
        return name
    if name in numbers:
        return numbers[name]  # a parameter, put in as it stands
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub | ast.UAdd):
        inner = _read(node.operand, names, numbers, depth + 1)
        return inner if isinstance(node.op, ast.UAdd) else folded("negative", inner)
    if isinstance(node, ast.BinOp) and type(node.op) in BINARY:
        left = _read(node.left, names, numbers, depth + 1)
        return folded(BINARY[type(node.op)], left, _read(node.right, names, numbers, depth + 1))
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and not node.keywords:
        return _call(node.func.id, [_read(argument, names, numbers, depth + 1) for argument in node.args])
    raise ValueError(f"an expression holds what cannot be read: {name or ast.dump(node)[:80]}")


def _call(function: str, arguments: Sequence[Tree]) -> Tree:
    if function == "clip" and len(arguments) == 3:
        return ("min", ("max", arguments[0], arguments[1]), arguments[2])
    if function in ("min", "max") and len(arguments) >= 2:
        return reduce(lambda tree, argument: (function, tree, argument), arguments)
    if function in FUNCTIONS and len(arguments) == 1:
        return (function, arguments[0])
    raise ValueError(f"an expression calls `{function}` with {len(arguments)} arguments")


def folded(operation: str, *arguments: Tree) -> Tree:
    """Return an operation; on numbers alone its result, rounded to nearest (powers stay as they are)."""
    numbers = [argument for argument in arguments if isinstance(argument, float)]
    if len(numbers) < len(arguments) or operation == "**":  # powers of numbers are enclosed, not rounded
        return (operation, *arguments)
    a, b = numbers[0], numbers[-1]
    # a quotient by 0 is no number, and refused as one that is too large
    quotient = a / b if b else math.inf
    return _small({"negative": -a, "+": a + b, "-": a - b, "*": a * b, "/": quotient}[operation])


def _small(number: float) -> float:
    if not abs(number) < LARGEST:
        raise ValueError(f"an expression holds a number of {LARGEST:g} or more, or a quotient by 0")
    return float(number)


def affine(row: Sequence[float], names: Sequence[str], constant: float) -> Tree:
    """Return the tree of ``row @ names + constant``, its sum as shallow as it can be."""
    terms: list[Tree] = [("*", c, name) if c != 1.0 else name for c, name in zip(row, names, strict=True) if c]
    terms += [constant] if constant or not terms else []
    while len(terms) > 1:
        pairs = [("+", *terms[k : k + 2]) for k in range(0, len(terms) - 1, 2)]
        terms = pairs + terms[len(terms) - len(terms) % 2 :]
    return terms[0]


def plain_sum(tree: Tree) -> tuple[tuple[float, str], ...] | None:
    """Return factors and names of a sum of multiples of names, each of them once (no name: a number); else None."""
    found, waiting, constants = dict[str, float](), [(1.0, tree)], list[float]()
    while waiting:
        sign, part = waiting.pop()
        factor, name = (part[1], part[2]) if isinstance(part, tuple) and part[0] == "*" else (1.0, part)
        if isinstance(name, float) and not isinstance(factor, float):
            factor, name = name, factor
        if isinstance(part, float):
            constants.append(sign * part)
        elif isinstance(name, str) and isinstance(factor, float) and name not in found:
            found[name] = sign * factor
        elif isinstance(part, tuple) and part[0] in ("+", "-", "negative"):
            last = sign if part[0] == "+" else -sign
            waiting += [(last, part[-1])] if part[0] == "negative" else [(sign, part[1]), (last, part[2])]
        else:
            return None
    return (*((factor, name) for name, factor in found.items()), *((number, "") for number in constants))


def names_in(trees: Sequence[Tree]) -> set[str]:
    """Return the names in trees."""
    names = {tree for tree in trees if isinstance(tree, str)}
    return names.union(*(names_in(tree[1:]) for tree in trees if isinstance(tree, tuple)))
