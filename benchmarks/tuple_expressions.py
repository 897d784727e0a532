"""Expressions as nested tuples: their text for the package, and their values computed without it.

An expression is a number, a name, or ``(operation, expression, ...)``.
"""

from __future__ import annotations

from typing import Any

import numpy as np

Expression = Any
"""A float, a str, or a tuple."""

INFIX = ("+", "-", "*", "/", "**")


def text_of(expression: Expression) -> str:
    """The expression in the package's syntax."""
    if isinstance(expression, float):
        return repr(expression) if expression >= 0 else f"({expression!r})"
    if isinstance(expression, str):
        return expression
    kind, *parts = expression
    texts = [text_of(part) for part in parts]
    return f"({f' {kind} '.join(texts)})" if kind in INFIX else f"{kind}({', '.join(texts)})"


def value_of(expression: Expression, values: dict[str, np.ndarray]) -> Any:
    """The value of an expression at values (M,) of its names."""
    if isinstance(expression, float):
        return expression
    if isinstance(expression, str):
        return values[expression]
    kind, *parts = expression
    found = [value_of(part, values) for part in parts]
    functions: dict[str, Any] = {
        "+": lambda a, b: a + b,
        "-": lambda a, b: a - b,
        "*": lambda a, b: a * b,
        "/": lambda a, b: a / b,
        "**": lambda a, b: a**b,
        "min": np.minimum,
        "max": np.maximum,
        "clip": lambda a, low, high: np.minimum(np.maximum(a, low), high),
        "atan": np.arctan,
    }
    return (functions[kind] if kind in functions else getattr(np, kind))(*found)
