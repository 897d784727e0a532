"""Expressions that are affine in several names, solved for these names: Cramer's rule on trees.

`target_k = rest_k + sum_j factor_kj name_j` is solved block by block. A block holds the equations and the names that
are tied to one another; it has as many equations as names, three at most.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from .affine_inputs import ONE, ZERO, minus, over, plus, split_at, times
from .expression_tree import Name, Number, Operation, Tree, names_in

LARGEST_BLOCK = 3
"""Most equations that are tied together: determinants of four have too many products to be enclosed well."""


@dataclass(frozen=True)
class AffineForm:
    """`tree_k = rests[k] + sum_j factors[k][j] * name_j`, in real numbers.

    Parameters
    ----------
    rests : tuple of n trees
    factors : tuple of n tuples of m trees
        Free of the names, as `rests` are.
    """

    rests: tuple[Tree, ...]
    factors: tuple[tuple[Tree, ...], ...]


def affine_form(trees: Sequence[Tree], names: Sequence[str]) -> AffineForm | None:
    """Return trees as affine forms in names (exact in real numbers); None if they are not seen to be affine."""
    rests, rows = [], []
    for tree in trees:
        row, rest = [], tree
        for name in names:
            split = split_at(rest, name)
            if split is None or names_in(split[1]) & {*names}:
                return None
            rest, factor = split
            row.append(factor)
        rests.append(rest)
        rows.append(tuple(row))
    return AffineForm(tuple(rests), tuple(rows))


def replaced(tree: Tree, trees: Mapping[Tree, Tree]) -> Tree:
    """Return a tree with some of its parts replaced (exact in real numbers if these are equal)."""
    if tree in trees:
        return trees[tree]
    if isinstance(tree, Name | Number):
        return tree
    return Operation(tree.name, tuple(replaced(argument, trees) for argument in tree.arguments))


def solved(form: AffineForm, targets: Sequence[str]) -> tuple[tuple[Tree, ...], tuple[tuple[Tree, ...], ...]] | None:
    """Return the names of a square form as trees in named targets, and the inverse matrix of its factors.

    Solutions are not defined where a determinant is 0. None if a block is not square, or has more than
    `LARGEST_BLOCK` equations.

    Examples
    --------
    >>> from .reading import read_expression
    >>> form = affine_form([read_expression("x + 2*u", ["x", "u"])], ["u"])
    >>> solved(form, ["m"])[1]
    ((Operation(name='/', arguments=(Number(value=1.0), Number(value=2.0))),),)
    """
    n = len(form.rests)
    occurs = np.array([[factor != ZERO for factor in row] for row in form.factors], dtype=int).reshape(n, n)
    # Equations are tied that share a name, and so are those that are tied to the same ones.
    tied = np.minimum(occurs @ occurs.T + np.eye(n, dtype=int), 1)
    for _ in range(n):
        tied = np.minimum(tied @ tied, 1)
    names: list[Tree] = [ZERO] * n
    inverse: list[list[Tree]] = [[ZERO] * n for _ in range(n)]
    for block in np.unique(tied, axis=0):
        rows, columns = np.flatnonzero(block).tolist(), np.flatnonzero(block @ occurs).tolist()
        if len(rows) != len(columns) or len(rows) > LARGEST_BLOCK:
            return None
        matrix = [[form.factors[k][j] for j in columns] for k in rows]
        determinant = _determinant(matrix)
        if determinant == ZERO:
            return None
        for at, j in enumerate(columns):
            total: Tree = ZERO
            for place, k in enumerate(rows):
                cofactor = _cofactor(matrix, place, at)
                inverse[j][k] = over(cofactor, determinant)
                total = plus(total, times(cofactor, minus(Name(targets[k]), form.rests[k])))
            names[j] = over(total, determinant)
    return tuple(names), tuple(map(tuple, inverse))


def _determinant(matrix: list[list[Tree]]) -> Tree:
    """Return the determinant of a square matrix of trees, expanded along its first row; 1 of an empty one."""
    if not matrix:
        return ONE
    total: Tree = ZERO
    for j, entry in enumerate(matrix[0]):
        if entry != ZERO:
            total = plus(total, times(entry, _cofactor(matrix, 0, j)))
    return total


def _cofactor(matrix: list[list[Tree]], row: int, column: int) -> Tree:
    smaller = [[entry for j, entry in enumerate(line) if j != column] for k, line in enumerate(matrix) if k != row]
    minor = _determinant(smaller)
    return minus(ZERO, minor) if (row + column) % 2 else minor
