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
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, TypeAlias

Tree: TypeAlias = "float | str | tuple[Any, ...]"

FUNCTIONS = frozenset(("abs", "atan", "cos", "exp", "log", "sin", "sqrt", "tan", "tanh"))
BINARY = {ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/", ast.Pow: "**"}

LONGEST, DEEPEST = 20_000, 200
"""Characters and levels that are read: recursion over a tree stays far from Python's limit of 1000 calls."""

LARGEST = 1e300
"""Numbers of this size and more are not read: their products overflow."""


def read_expression(text: Any, names: Iterable[str], numbers: Mapping[str, float]) -> Tree:
    """Return the tree of a text.

    Parameters
    ----------
    text : str
    names : iterable of str
        Variables; they go before numbers of the same name.
    numbers : mapping from str to float
        Parameters, which are put in.

    Raises
    ------
    ValueError
        If the text is no expression in these names.
    """
    if not isinstance(text, str) or len(text) > LONGEST:
        raise ValueError(f"an expression is no text of at most {LONGEST} characters")
    try:
        parsed = ast.parse(text.replace("^", "**").replace("\n", " ").strip(), mode="eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        raise ValueError(f"`{text[:60]}` is no expression") from error
    return _read(parsed, frozenset(names), {"pi": 3.141592653589793, **numbers}, 0)


def _read(node: ast.AST, names: frozenset[str], numbers: Mapping[str, float], depth: int) -> Tree:
    if depth > DEEPEST:
        raise ValueError(f"an expression is nested deeper than {DEEPEST} levels")
    if isinstance(node, ast.Constant) and isinstance(node.value, int | float) and not isinstance(node.value, bool):
        if not abs(node.value) < LARGEST:
            raise ValueError(f"an expression holds a number of {LARGEST:g} or more")
        return float(node.value)
    name = _dotted(node)
    if name in names:
        return name
    if name in numbers:
        return numbers[name]
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub | ast.UAdd):
        inner = _read(node.operand, names, numbers, depth + 1)
        return inner if isinstance(node.op, ast.UAdd) else folded("negative", inner)
    if isinstance(node, ast.BinOp) and type(node.op) in BINARY:
        left = _read(node.left, names, numbers, depth + 1)
        return folded(BINARY[type(node.op)], left, _read(node.right, names, numbers, depth + 1))
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and not node.keywords:
        return _call(node.func.id, [_read(argument, names, numbers, depth + 1) for argument in node.args])
    raise ValueError(f"an expression holds what cannot be read: {name or ast.dump(node)[:80]}")


def _dotted(node: ast.AST) -> str:
    """Return a name, also that of another agent's variable; an empty text for anything else."""
    if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
        return f"{node.value.id}.{node.attr}"
    return node.id if isinstance(node, ast.Name) else ""


def _call(function: str, arguments: Sequence[Tree]) -> Tree:
    if function == "clip" and len(arguments) == 3:
        return ("min", ("max", arguments[0], arguments[1]), arguments[2])
    if function in ("min", "max") and len(arguments) >= 2:
        tree = arguments[0]
        for argument in arguments[1:]:
            tree = (function, tree, argument)
        return tree
    if function in FUNCTIONS and len(arguments) == 1:
        return (function, arguments[0])
    raise ValueError(f"an expression calls `{function}` with {len(arguments)} arguments")


def folded(operation: str, *arguments: Tree) -> Tree:
    """Return an operation; on numbers alone its result, rounded to nearest (powers stay as they are)."""
    numbers = [argument for argument in arguments if isinstance(argument, float)]
    if len(numbers) < len(arguments) or operation == "**":
        return (operation, *arguments)
    a, b = numbers[0], numbers[-1]
    if operation == "/" and b == 0.0:
        raise ValueError("an expression divides a number by 0")
    result = {"negative": -a, "+": a + b, "-": a - b, "*": a * b}.get(operation)
    result = a / b if result is None else result
    if not abs(result) < LARGEST:
        raise ValueError(f"an expression holds a number of {LARGEST:g} or more")
    return result


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
    names, waiting = set[str](), list(trees)
    while waiting:
        tree = waiting.pop()
        if isinstance(tree, str):
            names.add(tree)
        elif isinstance(tree, tuple):
            waiting += tree[1:]
    return names
