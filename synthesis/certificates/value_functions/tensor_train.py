"""Tensor trains: signed sums of products over agents at small rank, with a certified error.

A train is ``f(s_1, .., s_I) = C_1(s_1) C_2(s_2) .. C_I(s_I)``, a product of one matrix per agent. Sums of products are
the special case of diagonal matrices. Where many terms are nearly dependent, as those of cyclic tasks are, a train
needs far fewer columns. Its entries have signs, so that nothing may be dropped, united by minima or clipped in it
(docs/theory/tree.md, "Uniting terms"). It may be *rounded*: a bond is cut down to fewer columns, and what that changes
is bounded in the sup norm by

    (sup of the left interface) * (largest Frobenius norm of a slice of the discarded core) * (sup of the right one) .

The discarded core is formed explicitly, so that the bound does not rest on the accuracy of a factorisation. The sups
are products of the largest norms of slices. What is rounded is a *masked sum*: trains, each multiplied by the indicator
of a set of joint cells. A deterministic diagram over the agents describes the set (``Diagram``); the sum itself is
never written out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .row_sums import UNIT

FloatArray = NDArray[Any]
Core = NDArray[Any]
"""(r, S, r') array: one matrix for each of S cells."""

Cells = tuple[NDArray[Any], ...] | None
"""Cells of each agent, increasing; None for all."""

MOST_HELD = 2_000_000
"""Most numbers that one evaluation at joint cells holds at once: 16 MB."""

CUT_SHARE = 0.9
"""Share of the tolerance of a bond up to which its columns are discarded; the rest is for floating point."""


@dataclass(frozen=True, eq=False, repr=False)
class Train:
    """A product of one matrix per agent and cell, and how far it may be from the function it stands for.

    Parameters
    ----------
    cores : tuple of (r_i, n_i, r_{i+1}) arrays
        Matrices of agent i; the outermost ranks are 1.
    error : float
        Upper bound on the distance, in the sup norm over the joint cells it covers.
    cells : tuple of (n_i,) int arrays, or None
        Cells of each agent that it covers, increasing. Elsewhere it is 0, which stands for any nonnegative number.
        None: all cells.
    """

    cores: tuple[Core, ...]
    error: float = 0.0
    cells: Cells = None

    def __repr__(self) -> str:
        sizes = [core.shape[1] for core in self.cores]
        cells = f"{min(sizes)}" if min(sizes) == max(sizes) else f"{min(sizes)} to {max(sizes)}"
        return f"Train(agents: {len(sizes)}, cells of each: {cells}, rank {self.rank}, error {self.error:.2g})"

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
        """Return values (M,) at joint cells (M, I), within ``error + spread`` of the function it stands for."""
        values = np.zeros(len(cells))
        covered = np.ones(len(cells), dtype=bool)
        # Turn cells into positions among the covered ones; where any agent is elsewhere the value stays 0.
        if self.cells is not None:
            cells = cells.copy()
            for i, covered_cells in enumerate(self.cells):
                place = np.minimum(np.searchsorted(covered_cells, cells[:, i]), len(covered_cells) - 1)
                covered &= covered_cells[place] == cells[:, i]
                cells[:, i] = place
        # Multiply the matrices from the left, a row per joint cell, in portions that fit into memory.
        portions = -(-len(cells) * self.rank**2 // MOST_HELD) or 1
        for rows in np.array_split(np.flatnonzero(covered), portions):
            row = np.ones((len(rows), 1, 1))
            for i, core in enumerate(self.cores):
                row = row @ np.moveaxis(core[:, cells[rows, i]], 1, 0)
            values[rows] = row[:, 0, 0]
        return values

    def total(self, weights: Sequence[FloatArray]) -> float:
        """Return ``sum_s f(s) prod_i weights[i][s_i]`` for weights (S_i,) per agent, up to ``spread`` per mass 1."""
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
        Node that each class leads to from each node, -1 for none. Node 0 is the root; node 0 after the last agent says
        that the joint cell is in the set.
    """

    cell_class: tuple[NDArray[Any], ...]
    following: tuple[NDArray[Any], ...]

    def reached(self, i: int, cells: Cells) -> NDArray[Any]:
        """Return the node (N_i, n_i) that the cells of agent i lead to from every node; -1 for none."""
        classes = self.cell_class[i]
        return np.asarray(self.following[i][:, classes if cells is None else classes[cells[i]]])


Masked = tuple[Train, Diagram]
"""A train, and the joint cells outside which it is read as 0."""


def ones(n_cells: Sequence[int], cells: Cells = None) -> Train:
    """Return the train that is 1 everywhere, or on the given cells (exact)."""
    return Train(tuple(np.ones((1, n, 1)) for n in (n_cells if cells is None else map(len, cells))), 0.0, cells)


def added(first: Train, second: Train | None) -> Train:
    """Return the sum of two trains that cover the same cells, or the first one if there is no second.

    The columns are those of both; the errors add, and the rounding of the addition is added to them.
    """
    if second is None:
        return first
    # Cores are block diagonal; those of the first and the last agent have one row, one column.
    cores = []
    for i, (a, b) in enumerate(zip(first.cores, second.cores, strict=True)):
        is_first, is_last = i == 0, i == len(first.cores) - 1
        rows, columns = a.shape[0] + (not is_first) * b.shape[0], a.shape[2] + (not is_last) * b.shape[2]
        core = np.zeros((rows, a.shape[1], columns))
        core[: a.shape[0], :, : a.shape[2]] = a
        core[-b.shape[0] :, :, -b.shape[2] :] += b
        cores.append(core)
    total = Train(tuple(cores), first.error + second.error, first.cells)
    # Entries are added only where both blocks meet: in trains of one agent.
    return total if len(cores) > 1 else replace(total, error=total.error + UNIT * frobenius_sup(cores[0]))


def diagram(masks: Sequence[NDArray[np.bool_]], cubes: NDArray[Any]) -> Diagram:
    """Return the diagram of a union of disjoint cubes ``prod_i masks[i][cubes[g, i]]`` (exact).

    Nodes are the sets of cubes that are still possible, told apart by what the remaining agents are asked.
    """
    cell_class, following = [], []
    nodes = [frozenset(tuple(int(m) for m in cube) for cube in cubes)]
    for mask in masks:
        # Cells that lie in the same masks form one class.
        classes, number = np.unique(mask, axis=1, return_inverse=True)
        table = np.full((len(nodes), classes.shape[1]), -1, dtype=np.int64)
        next_nodes: dict[frozenset[tuple[int, ...]], int] = {}
        for n, node in enumerate(nodes):
            for c in range(classes.shape[1]):
                remaining = frozenset(cube[1:] for cube in node if classes[cube[0], c])
                if remaining:
                    table[n, c] = next_nodes.setdefault(remaining, len(next_nodes))
        cell_class.append(number.ravel())
        following.append(table)
        nodes = list(next_nodes) or [frozenset()]
    return Diagram(tuple(cell_class), tuple(following))


def slice_sup(core: Core) -> float:
    """Return an upper bound on the largest spectral norm of a slice ``core[:, s, :]``."""
    if min(core.shape[0], core.shape[2]) == 1:
        return float(np.sqrt(np.einsum("asb,asb->s", core, core).max(initial=0.0)))
    # Two bounds on the squared spectral norm, the Frobenius norm and |A|_1 |A|_inf; take the smaller, slice by slice.
    size = np.abs(core)
    product = size.sum(axis=0).max(axis=1) * size.sum(axis=2).max(axis=0)
    return float(np.sqrt(np.minimum(np.einsum("asb,asb->s", core, core), product).max(initial=0.0)))


def frobenius_sup(core: Core) -> float:
    """Return the largest Frobenius norm of a slice ``core[:, s, :]``."""
    return float(np.sqrt(np.einsum("asb,asb->s", core, core).max(initial=0.0)))


def rounded(
    summands: Sequence[Masked], tolerance: float, relative: float | None = None, rank: int | None = None
) -> Train:
    """Return the sum of masked trains at smaller rank, with an upper bound on what rounding changed.

    Parameters
    ----------
    summands : sequence of (Train, Diagram)
        At least one; their sets of joint cells must be disjoint.
    tolerance : float
        What rounding may change, in the sup norm. ``error`` is the largest error of the summands, plus an upper bound
        on what rounding did change, floating point included.
    relative : float, optional
        If given, bonds are cut at this share of their root mean square instead: for trains that only steer a search.
    rank : int, optional
        Most columns of a bond, for the same use.

    Returns
    -------
    Train
        Left-orthogonal up to its last core.
    """
    n_agents = len(summands[0][0].cores)
    # Two sweeps cut each of the n - 1 bonds once each: every cut gets an equal share of the tolerance.
    cut = _Cut(tolerance / max(1, 2 * (n_agents - 1)), relative, rank)
    # First sweep, from the last agent: form the sum bond by bond, so that it never exists at its full rank.
    cores, lost_before = _from_the_right(summands, cut)
    # The sets are disjoint: at a joint cell the error of one summand counts, not their sum.
    error = max(train.error for train, _ in summands) + lost_before
    finished: list[Core] = []
    tails = np.cumprod([1.0, *(slice_sup(core) for core in reversed(cores[1:]))])[::-1]
    # Second sweep, from the first agent: everything to the right is orthogonal now, so singular values show what a
    # column is worth. `left` and `tails` bound the interfaces on both sides of the bond.
    left, carry = 1.0, np.ones((1, 1))
    for i, core in enumerate(cores):
        whole = np.tensordot(carry, core, axes=1)
        # Charge what floating point may change in this product.
        size = float(np.linalg.norm(carry)) * frobenius_sup(core)
        error += left * (carry.shape[1] + 2) * UNIT * size * float(tails[i])
        if i == n_agents - 1:
            finished.append(whole)
            break
        # |x' M y| <= |x| |M|_F |y|: the discarded slices count with the interfaces left and right of them.
        kept_core, carry, lost = _split(whole, cut, left * float(tails[i]))
        error += left * lost * float(tails[i])
        finished.append(kept_core)
        left *= slice_sup(kept_core)
    return Train(tuple(finished), error * (1 + 1e-12), summands[0][0].cells)


@dataclass(frozen=True)
class _Cut:
    """Where a bond is cut: by its error in the sup norm, or relative to its root mean square."""

    tolerance: float
    relative: float | None
    rank: int | None

    def keep(self, sizes: FloatArray, slices: FloatArray, scale: float) -> int:
        """Return the number of columns to keep.

        Parameters
        ----------
        sizes : (n,) array
            Singular values, decreasing.
        slices : (n, S) array
            Squared norms of the slices of their singular vectors.
        scale : float
            Factor by which an error of one slice may grow.
        """
        # Entry k is the error if the columns k, k + 1, .. are discarded.
        if self.relative is not None:
            tail = np.cumsum(sizes[::-1] ** 2)[::-1]
            needed = int(np.sum(tail > (self.relative**2) * tail[0])) if len(tail) else 0
        else:
            tail = np.cumsum((sizes[:, None] ** 2 * slices)[::-1], axis=0)[::-1].max(axis=1, initial=0.0)
            needed = int(np.sum(np.sqrt(tail) * scale > CUT_SHARE * self.tolerance))
        return max(1, needed if self.rank is None else min(needed, self.rank))


def _split(whole: Core, cut: _Cut, scale: float) -> tuple[Core, FloatArray, float]:
    """Split ``whole ~ core . carry`` into a core (r, S, k) of orthonormal columns and a matrix (k, r').

    Parameters
    ----------
    whole : (r, S, r') array
    cut : _Cut
    scale : float
        Factor by which an error of one slice may grow.

    Returns
    -------
    core, carry : arrays
    lost : float
        Upper bound on the Frobenius norm of a slice of what is lost, floating point included.
    """
    r, n_cells, columns = whole.shape
    matrix = whole.reshape(r * n_cells, columns)
    # A QR factorisation first leaves a small square matrix for the singular values.
    basis, triangle = np.linalg.qr(matrix)
    turn, sizes, rows = np.linalg.svd(triangle, full_matrices=False)
    basis = basis @ turn
    slices = np.einsum("asn,asn->ns", *(basis.reshape(r, n_cells, -1),) * 2)
    n_kept = cut.keep(sizes, slices, scale)
    basis, carry = np.ascontiguousarray(basis[:, :n_kept]), sizes[:n_kept, None] * rows[:n_kept]
    core = basis.reshape(r, n_cells, n_kept)
    # Form what is lost explicitly: the bound then holds however accurate the factorisation was.
    lost = frobenius_sup((matrix - basis @ carry).reshape(whole.shape))
    lost += (n_kept + 4) * UNIT * (frobenius_sup(whole) + frobenius_sup(core) * float(np.linalg.norm(carry)))
    return core, carry, lost


def _from_the_right(summands: Sequence[Masked], cut: _Cut) -> tuple[list[Core], float]:
    """Return cores of the masked sum, right-orthogonal but for the first, and an upper bound on the error made."""
    n_agents = len(summands[0][0].cores)
    heads = _head_sups(summands)
    error, tail = 0.0, 1.0
    # Per summand and node of its diagram: what follows to the right of the bond.
    right = [np.ones((1, 1, 1)) for _ in summands]
    cores: list[Core] = []
    for i in reversed(range(n_agents)):
        pairs = list(zip(summands, right, strict=True))
        blocks = [_read(train.cores[i], d.reached(i, train.cells), matrices) for (train, d), matrices in pairs]
        # Charge what floating point may change in these products.
        sizes = [
            (m.shape[1] + 2) * frobenius_sup(train.cores[i]) * float(np.linalg.norm(m, axis=(1, 2)).max(initial=0.0))
            for (train, _), m in pairs
        ]
        error += heads[i] * UNIT * float(np.linalg.norm(sizes)) * tail
        whole = np.concatenate([block.reshape(-1, *block.shape[2:]) for block in blocks])
        if i == 0:
            cores.append(whole.sum(axis=0, keepdims=True))  # one root per summand
            error += len(summands) * UNIT * sum(frobenius_sup(block[0]) for block in blocks) * tail
            break
        # Split the transposed core, so that its rows become orthonormal and the rest moves to the left.
        core, carry, lost = _split(np.ascontiguousarray(whole.transpose(2, 1, 0)), cut, heads[i] * tail)
        error += heads[i] * lost * tail
        core = np.ascontiguousarray(core.transpose(2, 1, 0))
        cores.append(core)
        tail *= slice_sup(core)
        ends = np.cumsum([block.shape[0] * block.shape[1] for block in blocks])[:-1]
        columns = np.split(carry.T, ends)
        right = [m.reshape(*b.shape[:2], -1) for m, b in zip(columns, blocks, strict=True)]
    return cores[::-1], error


def _head_sups(summands: Sequence[Masked]) -> FloatArray:
    """Return upper bounds (I,) on the row of agents 0 .. i - 1: a joint cell is at one node of each diagram."""
    squares = np.zeros(len(summands[0][0].cores))
    for train, _ in summands:
        norms = np.cumprod([1.0, *(slice_sup(core) for core in train.cores[:-1])])
        squares += norms**2
    return np.sqrt(squares)


def _read(core: Core, reached: NDArray[Any], right: FloatArray) -> Core:
    """Return (N, r, S, k): the core (r, S, r') times what follows (N', r', k), at the node that each cell leads to."""
    block = np.zeros((len(reached), core.shape[0], core.shape[1], right.shape[2]))
    for node, following in enumerate(right):
        product = core @ following
        for n, successors in enumerate(reached):
            cells = np.flatnonzero(successors == node)
            if len(cells) == core.shape[1]:
                block[n] = product
            elif len(cells):
                block[n][:, cells] = product[:, cells]
    return block
