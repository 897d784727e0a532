"""Expressions that are affine in a name: what is left without it, and what it is multiplied with."""

from __future__ import annotations

from collections.abc import Mapping

from .expression_tree import Name, Number, Operation, Tree, names_in

ZERO, ONE = Number(0.0), Number(1.0)


def split_at(tree: Tree, name: str) -> tuple[Tree, Tree] | None:
    """Return (rest, factor) with `tree = rest + factor * name` in real numbers, both without the name.

    None if the tree is not seen to be of this form: the rules are those of sums, differences, signs, products with
    one side free of the name, and quotients by what is free of it.

    Examples
    --------
    >>> from .reading import read_expression
    >>> split_at(read_expression("x + 2*u", ["x", "u"]), "u")
    (Name(name='x'), Number(value=2.0))
    """
    if name not in names_in(tree):
        return tree, ZERO
    if isinstance(tree, Name):
        return ZERO, ONE
    assert isinstance(tree, Operation)
    if tree.name == "negative":
        inner = split_at(tree.arguments[0], name)
        return None if inner is None else (minus(ZERO, inner[0]), minus(ZERO, inner[1]))
    if tree.name not in ("+", "-", "*", "/"):
        return None
    first, second = (split_at(argument, name) for argument in tree.arguments)
    if first is None or second is None:
        return None
    if tree.name in ("+", "-"):
        joined = plus if tree.name == "+" else minus
        return joined(first[0], second[0]), joined(first[1], second[1])
    # In products and quotients only one side may hold the name, and no denominator.
    if second[1] == ZERO:
        by = times if tree.name == "*" else over
        return by(first[0], second[0]), by(first[1], second[0])
    if tree.name == "*" and first[1] == ZERO:
        return times(first[0], second[0]), times(first[0], second[1])
    return None


def substituted(tree: Tree, trees: Mapping[str, Tree]) -> Tree:
    """Return a tree with names replaced by trees (exact in real numbers)."""
    if isinstance(tree, Name):
        return trees.get(tree.name, tree)
    if isinstance(tree, Number):
        return tree
    return Operation(tree.name, tuple(substituted(argument, trees) for argument in tree.arguments))


def plus(a: Tree, b: Tree) -> Tree:
    """Return a sum; 0 is left out."""
    return b if a == ZERO else a if b == ZERO else Operation("+", (a, b))


def minus(a: Tree, b: Tree) -> Tree:
    """Return a difference; 0 is left out."""
    return a if b == ZERO else Operation("negative", (b,)) if a == ZERO else Operation("-", (a, b))


def times(a: Tree, b: Tree) -> Tree:
    """Return a product; 0 and 1 are left out."""
    if ZERO in (a, b):
        return ZERO
    return b if a == ONE else a if b == ONE else Operation("*", (a, b))


def over(a: Tree, b: Tree) -> Tree:
    """Return a quotient; 0 and 1 are left out."""
    return a if a == ZERO or b == ONE else Operation("/", (a, b))
