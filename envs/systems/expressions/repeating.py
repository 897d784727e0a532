"""By how many turns an expression grows when an angle grows by one: what makes dynamics dynamics of an angle.

Dynamics belong to a point of the circle if `f(x + 2 pi e) = f(x) + 2 pi j` with a whole number j for the angle itself
and 0 for all other states. This is proved on the tree, in fractions: sums add turns, factors multiply them, and the
sine of what grows by whole turns does not grow. What is not seen to be so is refused.
"""

from __future__ import annotations

from fractions import Fraction

from .expression_tree import Name, Number, Tree

ZERO = Fraction(0)

SINES = {"sin": 1, "cos": 1, "tan": 2}
"""Functions that repeat, and how often in a turn."""


def turns(tree: Tree, angle: str) -> Fraction | None:
    """Return by how many turns an expression grows when an angle grows by one (exact), or None if that is not seen.

    Examples
    --------
    >>> from .reading import read_expression
    >>> [turns(read_expression(text, ("a", "v")), "a") for text in ("a + 0.1*v", "v*sin(a)", "0.5*a", "a*v")]
    [Fraction(1, 1), Fraction(0, 1), Fraction(1, 2), None]
    """
    if isinstance(tree, Number):
        return ZERO
    if isinstance(tree, Name):
        return Fraction(tree.name == angle)
    each = [turns(argument, angle) for argument in tree.arguments]
    known = [grown for grown in each if grown is not None]
    if len(known) < len(each):
        return None
    if tree.name in ("+", "-"):
        return known[0] + known[1] if tree.name == "+" else known[0] - known[1]
    if tree.name == "negative":
        return -known[0]
    if tree.name in SINES and (known[0] * SINES[tree.name]).denominator == 1:
        return ZERO
    if tree.name in ("min", "max") and len(set(known)) == 1:
        return known[0]  # both grow alike, and so does the smaller one
    if not any(known):
        return ZERO
    if tree.name == "*":
        first, second = (_number(argument) for argument in tree.arguments)
        if first is not None:
            return first * known[1]
        return None if second is None else second * known[0]
    if tree.name == "/" and (divisor := _number(tree.arguments[1])):
        return known[0] / divisor
    return None


def _number(tree: Tree) -> Fraction | None:
    """Return the value of an expression of numbers alone (exact), or None."""
    if isinstance(tree, Number):
        return Fraction(tree.value)
    if isinstance(tree, Name):
        return None
    values = [_number(argument) for argument in tree.arguments]
    known = [value for value in values if value is not None]
    if len(known) < len(values):
        return None
    if tree.name == "negative":
        return -known[0]
    if tree.name in ("+", "-", "*"):
        first, second = known
        return {"+": first + second, "-": first - second, "*": first * second}[tree.name]
    return known[0] / known[1] if tree.name == "/" and known[1] else None
