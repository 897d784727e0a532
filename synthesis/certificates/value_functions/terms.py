"""Nonnegative sums of products, one factor per agent, with shared factors.

Value functions and alive masses are families ``f_q(s_1, .., s_I) = sum_r prod_i factors[i][index[q][r, i], s_i]``, one
sum per automaton state q. Distinct factors are stored once per agent and terms point at them: agents that do not care
about a guard contribute the same factor to many terms.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .row_sums import add_runs

IndexArray = NDArray[Any]
"""Whole numbers that point at rows."""

BoolArray = NDArray[np.bool_]

HASH_SEED = 20251106
"""Seed of the weights that rows are hashed with; any number would do, since collisions are checked."""


@dataclass(frozen=True, eq=False, repr=False)
class Terms:
    """Sums of products per automaton state.

    Parameters
    ----------
    factors : tuple of (n_i, S_i) arrays
        Distinct nonnegative factors of agent i.
    index : tuple of (R_q, I) int64 arrays
        Term r of state q is the product of ``factors[i][index[q][r, i]]`` over the agents.
    """

    factors: tuple[NDArray, ...]
    index: tuple[IndexArray, ...]

    def __repr__(self) -> str:
        terms, distinct_factors = sum(len(rows) for rows in self.index), sum(len(rows) for rows in self.factors)
        sizes = f"terms: {terms}, automaton states: {len(self.index)}, rank {self.rank}"
        return f"Terms({sizes}, agents: {len(self.factors)}, distinct factors: {distinct_factors})"

    @property
    def rank(self) -> int:
        """Largest number of terms of one state."""
        return max(len(rows) for rows in self.index)

    def work(self, q: int) -> int:
        """Return how many numbers ``at`` holds per joint cell."""
        return len(self.index[q])

    def products_between(
        self, q: int, places: Sequence[NDArray], weights: Sequence[NDArray[np.float64]]
    ) -> NDArray[np.float64]:
        """Return the products (M, R) of the terms of state q, up to rounding, between places.

        The factors of agent i are means of their numbers at its places (M, K_i), with weights (M, K_i).
        """
        rows = self.index[q]
        product = np.ones((len(places[0]), len(rows)))
        for i, (at, weight) in enumerate(zip(places, weights, strict=True)):
            product *= np.einsum("lmk,mk->ml", self.factors[i][rows[:, i]][:, at], weight)
        return product

    def total(self, q: int, weights: Sequence[NDArray]) -> float:
        """Return ``sum_r prod_i <weights[i], factor>`` for weights (S_i,) per agent, up to rounding."""
        rows = self.index[q]
        product = np.ones(len(rows), dtype=self.factors[0].dtype)
        for i, weight in enumerate(weights):
            product = product * (self.factors[i] @ weight)[rows[:, i]]
        return product.sum() if len(rows) else product.dtype.type(0)

    def at(self, q: int, cells: NDArray[np.integer]) -> NDArray:
        """Return the values (M,) at joint cells (M, I), up to rounding."""
        rows = self.index[q]
        product = np.ones((len(cells), len(rows)), dtype=self.factors[0].dtype)
        for i, factors in enumerate(self.factors):
            product = product * factors[rows[:, i]][:, cells[:, i]].T
        return product.sum(axis=1)


@dataclass(frozen=True, eq=False, repr=False)
class Merges:
    """Which rows were united: row ``absorbed[k]`` was added to row ``into[k]`` in the factor of ``agent[k]``.

    The other factors of ``into`` become the minima of both. Row ``absorbed[k]`` is gone if ``rest[k]`` is 0; else the
    remainder of a union from below takes its place, that of ``into`` where ``rest[k] = j + 1``, its own where
    ``rest[k] = -(j + 1)``: its factor of agent j less the minimum, the minima of further agents, and its factor of
    ``agent[k]`` as it was.
    """

    into: IndexArray
    absorbed: IndexArray
    agent: IndexArray
    rest: IndexArray | None = None

    @property
    def rests(self) -> IndexArray:
        """``rest``, zeros if no row leaves a remainder."""
        return np.zeros(len(self.into), dtype=np.int64) if self.rest is None else self.rest

    def followed_by(self, later: Merges) -> Merges:
        """Return these unions and then later ones."""
        if not len(later.into):
            return self
        names = ("into", "absorbed", "agent", "rests")
        return Merges(*(np.concatenate([getattr(self, name), getattr(later, name)]) for name in names))

    def __repr__(self) -> str:
        return f"Merges(rows united: {len(self.into)})"

    @classmethod
    def none(cls) -> Merges:
        """Return the record that says that no row was united."""
        empty = np.zeros(0, dtype=np.int64)
        return cls(empty, empty, empty)


def merge_rows(factors: list[NDArray], rows: IndexArray, groups: IndexArray) -> tuple[IndexArray, IndexArray, Merges]:
    """Sum terms of one group that differ in the factor of a single agent (exact).

    Parameters
    ----------
    factors : list of (n_i, S_i) arrays
        Extended in place by the sums.
    rows : (L, I) array
        Factor indices of the terms.
    groups : (L,) array
        Terms of different groups (automaton states) are never united.

    Returns
    -------
    remaining : (L',) array
        Numbers of the rows that remain.
    rows : (L, I) array
        Factor indices, up to date for the remaining rows.
    merges : Merges
        What was united, in order.
    """
    rows = rows.copy()
    n_agents = rows.shape[1]
    remaining = np.arange(len(rows))
    # Rows are compared by a hash that is linear in the indices: the hash without agent i is one subtraction.
    weights: NDArray[Any] = np.asarray(
        np.random.default_rng(HASH_SEED).integers(1, 2**63, size=n_agents, dtype=np.uint64)
    )
    group_hash = groups.astype(np.uint64) * np.uint64(0x9E3779B97F4A7C15)  # 2^64 / golden ratio spreads small numbers
    history: list[tuple[IndexArray, IndexArray, IndexArray]] = []
    # Go round the agents until a whole round unites nothing: sums over one agent make rows alike for another.
    changed, stale = True, True
    while changed and len(remaining) > 1:
        changed = False
        for i in range(n_agents):
            current: NDArray[Any] = rows[remaining].astype(np.uint64)
            if i == 0 or stale:
                stale = False
                whole: NDArray[Any] = (current * weights).sum(axis=1, dtype=np.uint64) + group_hash[remaining]
            # Rows with the same hash without agent i are candidates; the first of them absorbs the others.
            _, first, inverse = np.unique(whole - current[:, i] * weights[i], return_index=True, return_inverse=True)
            if len(first) == len(remaining):
                continue
            into = remaining[first[inverse]]
            absorbed = np.flatnonzero(into != remaining)
            differs = rows[remaining[absorbed]] != rows[into[absorbed]]  # a collision of hashes must not unite terms
            differs[:, i] = groups[remaining[absorbed]] != groups[into[absorbed]]
            absorbed = absorbed[~np.any(differs, axis=1)]
            if len(absorbed) == 0:
                continue
            # a x b + a x b' = a x (b + b'): docs/theory/tree.md, "Uniting terms".
            changed = stale = True
            pairs_into, pairs_from = into[absorbed], remaining[absorbed]
            sum_factors(factors, rows, i, pairs_into, pairs_from)
            history.append((pairs_into, pairs_from, np.full(len(absorbed), i)))
            remaining = np.delete(remaining, absorbed)
    if not history:
        return remaining, rows, Merges.none()
    return remaining, rows, Merges(*(np.concatenate(columns) for columns in zip(*history, strict=True)))


def sum_factors(factors: list[NDArray], rows: IndexArray, i: int, into: IndexArray, absorbed: IndexArray) -> None:
    """Replace the factor of agent i in rows ``into`` by its sum with those of the rows absorbed into them."""
    # Sort the pairs by the absorbing row: its summands then form one run.
    order = np.argsort(into, kind="stable")
    into, absorbed = into[order], absorbed[order]
    heads, starts = np.unique(into, return_index=True)
    sums = add_runs(factors[i][rows[absorbed, i]], starts) + factors[i][rows[heads, i]]
    # The same set of summands gives the same factor, whichever state it belongs to: store it once.
    ends = np.append(starts[1:], len(into))
    number: dict[tuple[int, ...], int] = {}
    fresh: list[int] = []
    for k, (head, a, b) in enumerate(zip(heads, starts, ends, strict=True)):
        key = (int(rows[head, i]), *(int(r) for r in rows[absorbed[a:b], i]))
        if key not in number:
            number[key] = len(factors[i]) + len(fresh)
            fresh.append(k)
        rows[head, i] = number[key]
    factors[i] = np.concatenate([factors[i], sums[np.array(fresh, dtype=np.int64)]])


def compress(factors: NDArray, column: IndexArray) -> tuple[NDArray, IndexArray]:
    """Return the factors that ``column`` points at, and the column renumbered (exact)."""
    if len(factors) == 1 and len(column):
        return factors, column
    used, renumbered = distinct(column)
    return factors if len(used) == len(factors) else factors[used], renumbered


def distinct(numbers: IndexArray) -> tuple[IndexArray, IndexArray]:
    """Return the sorted distinct numbers, and the position of each number among them (exact)."""
    if len(numbers) == 1:  # with many agents a single term each is the usual case, and `np.unique` the slow part
        return numbers, np.zeros(1, dtype=np.int64)
    values, position = np.unique(numbers, return_inverse=True)
    return values, position


@dataclass(frozen=True, eq=False, repr=False)
class MergeLog:
    """Which vertices the value tree kept at one time, enough to grow it again (see ``check``).

    Per automaton state: rows (guard, term of the next step), how rows were united, and which rows became terms.
    """

    origin: tuple[IndexArray, ...]
    merges: tuple[Merges, ...]
    kept: tuple[IndexArray, ...]

    def __repr__(self) -> str:
        rows, terms = sum(map(len, self.origin)), sum(map(len, self.kept))
        united = sum(len(merges.into) for merges in self.merges)
        return f"Skeleton(automaton states: {len(self.origin)}, rows: {rows}, united: {united}, terms: {terms})"


@dataclass(frozen=True, eq=False, repr=False)
class Guards:
    """Guards out of every automaton state, over the label sets of each agent.

    Parameters
    ----------
    masks : tuple of (K_i, n_i) bool arrays
        Distinct sets of label sets of agent i that occur in guards.
    source, target : (G,) int arrays
        Automaton states that guard g connects; only targets from which acceptance can be reached.
    mask : (G, I) int array
        ``masks[i][mask[g, i]]`` is factor i of guard g.
    """

    masks: tuple[BoolArray, ...]
    source: NDArray[np.int32]
    target: NDArray[np.int32]
    mask: NDArray[np.int32]

    def __repr__(self) -> str:
        states = len({*self.source.tolist()})
        return f"Guards({len(self.source)}, agents: {len(self.masks)}, automaton states with guards: {states})"


def tree_rows(merge_log: Sequence[MergeLog]) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Return the tables of a tree in the checker's form: vertices (n, 4), unions (m, 6) and what is kept (k, 3).

    Rows begin with the time and the automaton state.
    """
    tables: list[list[IndexArray]] = [[], [], []]
    for t, step in enumerate(merge_log):
        for q, (origin, merges, kept) in enumerate(zip(step.origin, step.merges, step.kept, strict=True)):
            unions = np.stack([merges.into, merges.absorbed, merges.agent, merges.rests], axis=1)
            for table, rows in zip(tables, (origin, unions, kept[:, None]), strict=True):
                table.append(np.hstack([np.tile([t, q], (len(rows), 1)), rows]).astype(np.int64))
    vertices, unions, kept = (np.concatenate(table) for table in tables)
    return vertices, unions, kept


def candidate_depths(
    origin: IndexArray, merges: Merges, guards: Guards, depths: Sequence[NDArray[np.int64]]
) -> NDArray[np.int64]:
    """Return upper bounds on the steps to acceptance of the rows (guard, term of the next step) of one state.

    A row is one step further from acceptance than its term. United rows carry the larger depth.
    """
    row_depths = np.zeros(len(origin), dtype=np.int64)
    targets = guards.target[origin[:, 0]]
    for target in np.unique(targets):
        here = targets == target
        row_depths[here] = depths[target][origin[here, 1]] + 1
    for into, absorbed, rest in zip(*(a.tolist() for a in (merges.into, merges.absorbed, merges.rests)), strict=True):
        deepest = max(row_depths[into], row_depths[absorbed])
        row_depths[into] = deepest
        if rest:
            row_depths[absorbed] = deepest
    return row_depths


def term_depths(
    merge_log: Sequence[MergeLog], guards: Guards, accepting: NDArray[np.bool_], absorbing: NDArray[np.bool_]
) -> tuple[NDArray[np.int64], ...]:
    """Return upper bounds on the steps to acceptance of every term at time 0, per automaton state.

    United terms carry the larger depth, so that what is paid per step is never too little.
    """
    depths = [np.zeros(int(accepted), dtype=np.int64) for accepted in accepting]
    for step in reversed(merge_log):
        following = []
        for q, (origin, merges, kept) in enumerate(zip(step.origin, step.merges, step.kept, strict=True)):
            if absorbing[q]:
                following.append(np.zeros(int(accepting[q]), dtype=np.int64))
                continue
            following.append(candidate_depths(origin, merges, guards, depths)[kept])
        depths = following
    return tuple(depths)


@dataclass(frozen=True, eq=False, repr=False)
class Occupancy:
    """Alive mass per automaton state at one time; ``leftover`` bounds from above the mass that was dropped so far."""

    terms: Terms
    leftover: float

    def __repr__(self) -> str:
        terms = sum(len(rows) for rows in self.terms.index)
        return f"Occupancy(terms: {terms}, automaton states: {len(self.terms.index)}, leftover {self.leftover:.2g})"

    def masses(self, q: int) -> NDArray[np.float64]:
        """Return the mass (K_q,) of each term of state q, up to rounding."""
        return term_masses(self.terms.factors, self.terms.index[q])


def term_masses(factors: Sequence[NDArray], index: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return the mass of each term, the product over agents of the sums of its factors, up to rounding."""
    product = np.ones(len(index))
    for i, rows in enumerate(factors):
        product *= np.sum(rows, axis=1)[index[:, i]]
    return product
