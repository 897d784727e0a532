"""Tensor trains: signed sums of products over agents at small rank, with a certified error.

A train is ``f(s_1, .., s_I) = C_1(s_1) C_2(s_2) .. C_I(s_I)``, a product of one matrix per agent. Sums of products are
the special case of diagonal matrices; a train needs far fewer columns where many terms are nearly dependent, as those
of cyclic tasks are. Its entries have signs, so nothing may be dropped, united by minima or clipped in it (THEORY
section 8). It may be *rounded*: a bond is cut down to fewer columns; what that changes is bounded in the sup norm by

    (sup of the left interface) * (largest Frobenius norm of a slice of the discarded core) * (sup of the right one) .

The discarded core is formed explicitly, so the bound does not rest on the accuracy of a factorisation, and the sups are
products of the largest norms of slices. What is rounded is a *masked sum*: trains, each multiplied by the indicator of
a set of joint cells, which a deterministic diagram over the agents describes (``Diagram``); it is never written out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .devices import UNIT

FloatArray = NDArray[Any]
Core = NDArray[Any]
"""(r, S, r') array: one matrix for each of S cells."""

Cells = tuple[NDArray[Any], ...] | None
"""Cells of each agent, increasing; None for all."""

COLUMNS = 2_000_000
"""Most numbers that one evaluation at joint cells holds at once."""


@dataclass(frozen=True, eq=False)
class Train:
    """A product of one matrix per agent and cell, and how far it may be from the function it stands for.

    Parameters
    ----------
    cores : tuple of (r_i, n_i, r_{i+1}) arrays
        Matrices of agent i; the outermost ranks are 1.
    error : float
        Upper bound on the distance, in the sup norm over the joint cells it covers.
    cells : tuple of (n_i,) int arrays, or None
        Cells of each agent that it covers, increasing; elsewhere it is 0, which stands for any nonnegative number.
        None: all of them.
    """

    cores: tuple[Core, ...]
    error: float = 0.0
    cells: Cells = None

    @property
    def rank(self) -> int:
        """Largest number of columns of a bond."""
        return max(core.shape[2] for core in self.cores)

    @cached_property
    def spread(self) -> float:
        """Upper bound on what floating point may change of one value, or of one mean under weights of mass 1."""
        operations = sum(sum(core.shape) for core in self.cores) + 2 * len(self.cores)
        return 2.0 * operations * UNIT * float(np.prod([frobenius_sup(core) for core in self.cores]))

    def at(self, cells: NDArray[Any]) -> FloatArray:
        """Values (M,) at joint cells (M, I); within ``error + spread`` of the function it stands for."""
        values = np.zeros(len(cells))
        covered = np.ones(len(cells), dtype=bool)
        if self.cells is not None:
            cells = cells.copy()
            for i, own in enumerate(self.cells):
                place = np.minimum(np.searchsorted(own, cells[:, i]), len(own) - 1)
                covered &= own[place] == cells[:, i]
                cells[:, i] = place
        parts = -(-len(cells) * self.rank**2 // COLUMNS) or 1
        for rows in np.array_split(np.flatnonzero(covered), parts):
            row = np.ones((len(rows), 1, 1))
            for i, core in enumerate(self.cores):
                row = row @ np.moveaxis(core[:, cells[rows, i]], 1, 0)
            values[rows] = row[:, 0, 0]
        return values

    def total(self, weights: Sequence[FloatArray]) -> float:
        """``sum_s f(s) prod_i weights[i][s_i]`` for weights (S_i,) per agent, up to ``spread`` per unit of mass."""
        row = np.ones(1)
        for i, (core, weight) in enumerate(zip(self.cores, weights, strict=True)):
            row = row @ np.tensordot(core, weight if self.cells is None else weight[self.cells[i]], axes=(1, 0))
        return float(row[0])


@dataclass(frozen=True, eq=False)
class Diagram:
    """A set of joint cells, read agent by agent by a deterministic automaton.

    Parameters
    ----------
    cell_class : tuple of (S_i,) int arrays
        Class of each cell of agent i.
    following : tuple of (N_i, C_i) int arrays
        Node reached from each node by each class, -1 for none; node 0 is the root, and node 0 after the last agent says
        that the joint cell is in the set.
    """

    cell_class: tuple[NDArray[Any], ...]
    following: tuple[NDArray[Any], ...]

    def reached(self, i: int, cells: Cells) -> NDArray[Any]:
        """(N_i, n_i) node reached from every node by the cells of agent i; -1 for none."""
        own = self.cell_class[i]
        return np.asarray(self.following[i][:, own if cells is None else own[cells[i]]])


Masked = tuple[Train, Diagram]
"""A train, and the joint cells outside which it is read as 0."""


def ones(n_cells: Sequence[int], cells: Cells = None) -> Train:
    """The train that is 1 everywhere, or on the given cells."""
    return Train(tuple(np.ones((1, n, 1)) for n in (n_cells if cells is None else map(len, cells))), 0.0, cells)


def added(one: Train, other: Train | None) -> Train:
    """Sum of two trains that cover the same cells, its columns those of both; the first one if there is no other."""
    if other is None:
        return one
    cores = []
    for i, (a, b) in enumerate(zip(one.cores, other.cores, strict=True)):
        first, last = i == 0, i == len(one.cores) - 1
        core = np.zeros((a.shape[0] + (not first) * b.shape[0], a.shape[1], a.shape[2] + (not last) * b.shape[2]))
        core[: a.shape[0], :, : a.shape[2]] = a
        core[-b.shape[0] :, :, -b.shape[2] :] += b
        cores.append(core)
    total = Train(tuple(cores), one.error + other.error, one.cells)
    return total if len(cores) > 1 else replace(total, error=total.error + UNIT * frobenius_sup(cores[0]))


def diagram(masks: Sequence[NDArray[np.bool_]], cubes: NDArray[Any]) -> Diagram:
    """Diagram of a union of disjoint cubes ``prod_i masks[i][cubes[g, i]]``.

    Nodes are the sets of cubes that are still possible, told apart by what the remaining agents are asked.
    """
    cell_class, following = [], []
    nodes = [frozenset(tuple(int(m) for m in cube) for cube in cubes)]
    for own in masks:
        classes, number = np.unique(own, axis=1, return_inverse=True)
        table = np.full((len(nodes), classes.shape[1]), -1, dtype=np.int64)
        found: dict[frozenset[tuple[int, ...]], int] = {}
        for n, node in enumerate(nodes):
            for c in range(classes.shape[1]):
                left = frozenset(cube[1:] for cube in node if classes[cube[0], c])
                if left:
                    table[n, c] = found.setdefault(left, len(found))
        cell_class.append(number.ravel())
        following.append(table)
        nodes = list(found) or [frozenset()]
    return Diagram(tuple(cell_class), tuple(following))


def slice_sup(core: Core) -> float:
    """Upper bound on the largest spectral norm of a slice ``core[:, s, :]``."""
    if min(core.shape[0], core.shape[2]) == 1:
        return float(np.sqrt(np.einsum("asb,asb->s", core, core).max(initial=0.0)))
    size = np.abs(core)
    product = size.sum(axis=0).max(axis=1) * size.sum(axis=2).max(axis=0)
    return float(np.sqrt(np.minimum(np.einsum("asb,asb->s", core, core), product).max(initial=0.0)))


def frobenius_sup(core: Core) -> float:
    """Largest Frobenius norm of a slice ``core[:, s, :]``."""
    return float(np.sqrt(np.einsum("asb,asb->s", core, core).max(initial=0.0)))


def rounded(parts: Sequence[Masked], tolerance: float, relative: float | None = None, rank: int | None = None) -> Train:
    """Sum of masked trains, at smaller rank.

    Parameters
    ----------
    parts : sequence of (Train, Diagram)
        Summands; at least one.
    tolerance : float
        What rounding may change, in the sup norm; ``error`` grows by what it did change at most, rounding of floating
        point included. It is the largest error of the parts, plus that: the sets of the parts must be disjoint.
    relative : float, optional
        If given, bonds are cut at this share of their root mean square instead: for trains that only steer a search.
    rank : int, optional
        Most columns of a bond, for the same use.

    Returns
    -------
    Train
        Left-orthogonal up to its last core.
    """
    n_agents = len(parts[0][0].cores)
    cut = _Cut(tolerance / max(1, 2 * (n_agents - 1)), relative, rank)
    cores, first = _from_the_right(parts, cut)
    error = max(train.error for train, _ in parts) + first
    finished: list[Core] = []
    tails = np.cumprod([1.0, *(slice_sup(core) for core in reversed(cores[1:]))])[::-1]
    left, carry = 1.0, np.ones((1, 1))
    for i, core in enumerate(cores):
        whole = np.tensordot(carry, core, axes=1)
        size = float(np.linalg.norm(carry)) * frobenius_sup(core)
        error += left * (carry.shape[1] + 2) * UNIT * size * float(tails[i])
        if i == n_agents - 1:
            finished.append(whole)
            break
        kept, carry, lost = _split(whole, cut, left * float(tails[i]))
        error += left * lost * float(tails[i])
        finished.append(kept)
        left *= slice_sup(kept)
    return Train(tuple(finished), error * (1 + 1e-12), parts[0][0].cells)


@dataclass(frozen=True)
class _Cut:
    """Where a bond is cut: by its error in the sup norm, or relative to its root mean square."""

    tolerance: float
    relative: float | None
    rank: int | None

    def keep(self, sizes: FloatArray, slices: FloatArray, scale: float) -> int:
        """Columns to keep, of singular values (n,) with squared slice norms (n, S) of their singular vectors."""
        if self.relative is not None:
            tail = np.cumsum(sizes[::-1] ** 2)[::-1]
            few = int(np.sum(tail > (self.relative**2) * tail[0])) if len(tail) else 0
        else:
            tail = np.cumsum((sizes[:, None] ** 2 * slices)[::-1], axis=0)[::-1].max(axis=1, initial=0.0)
            few = int(np.sum(np.sqrt(tail) * scale > 0.9 * self.tolerance))
        return max(1, few if self.rank is None else min(few, self.rank))


def _split(whole: Core, cut: _Cut, scale: float) -> tuple[Core, FloatArray, float]:
    """``whole ~ core . carry`` with a core (r, S, k) of orthonormal columns; and the sup of what is lost, per slice.

    ``scale`` is what an error of one slice may grow to.
    """
    r, n_cells, columns = whole.shape
    matrix = whole.reshape(r * n_cells, columns)
    basis, triangle = np.linalg.qr(matrix)
    turn, sizes, rows = np.linalg.svd(triangle, full_matrices=False)
    basis = basis @ turn
    slices = np.einsum("asn,asn->ns", *(basis.reshape(r, n_cells, -1),) * 2)
    few = cut.keep(sizes, slices, scale)
    basis, carry = np.ascontiguousarray(basis[:, :few]), sizes[:few, None] * rows[:few]
    core = basis.reshape(r, n_cells, few)
    lost = frobenius_sup((matrix - basis @ carry).reshape(whole.shape))
    lost += (few + 4) * UNIT * (frobenius_sup(whole) + frobenius_sup(core) * float(np.linalg.norm(carry)))
    return core, carry, lost


def _from_the_right(parts: Sequence[Masked], cut: _Cut) -> tuple[list[Core], float]:
    """Cores of the masked sum, right-orthogonal but for the first, and an upper bound on the error made."""
    n_agents = len(parts[0][0].cores)
    heads = _head_sups(parts)
    error, tail = 0.0, 1.0
    right = [np.ones((1, 1, 1)) for _ in parts]
    cores: list[Core] = []
    for i in reversed(range(n_agents)):
        blocks = [
            _read(train.cores[i], d.reached(i, train.cells), m) for (train, d), m in zip(parts, right, strict=True)
        ]
        sizes = [
            (m.shape[1] + 2) * frobenius_sup(train.cores[i]) * float(np.linalg.norm(m, axis=(1, 2)).max(initial=0.0))
            for (train, _), m in zip(parts, right, strict=True)
        ]
        error += heads[i] * UNIT * float(np.linalg.norm(sizes)) * tail
        whole = np.concatenate([block.reshape(-1, *block.shape[2:]) for block in blocks])
        if i == 0:
            cores.append(whole.sum(axis=0, keepdims=True))  # one root per part
            error += len(parts) * UNIT * sum(frobenius_sup(block[0]) for block in blocks) * tail
            break
        core, carry, lost = _split(np.ascontiguousarray(whole.transpose(2, 1, 0)), cut, heads[i] * tail)
        error += heads[i] * lost * tail
        core = np.ascontiguousarray(core.transpose(2, 1, 0))
        cores.append(core)
        tail *= slice_sup(core)
        ends = np.cumsum([block.shape[0] * block.shape[1] for block in blocks])[:-1]
        columns = np.split(carry.T, ends)
        right = [m.reshape(*b.shape[:2], -1) for m, b in zip(columns, blocks, strict=True)]
    return cores[::-1], error


def _head_sups(parts: Sequence[Masked]) -> FloatArray:
    """(I,) sup of the row of agents 0 .. i - 1: a joint cell is at one node of each part's diagram."""
    squares = np.zeros(len(parts[0][0].cores))
    for train, _ in parts:
        own = np.cumprod([1.0, *(slice_sup(core) for core in train.cores[:-1])])
        squares += own**2
    return np.sqrt(squares)


def _read(core: Core, reached: NDArray[Any], right: FloatArray) -> Core:
    """(N, r, S, k): the core (r, S, r') times what follows (N', r', k), where each node goes on by each cell."""
    block = np.zeros((len(reached), core.shape[0], core.shape[1], right.shape[2]))
    for node, following in enumerate(right):
        product = core @ following
        for n, goes in enumerate(reached):
            cells = np.flatnonzero(goes == node)
            if len(cells) == core.shape[1]:
                block[n] = product
            elif len(cells):
                block[n][:, cells] = product[:, cells]
    return block
