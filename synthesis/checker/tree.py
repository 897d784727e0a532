"""Value iteration on a tree of products: from the end to the start, one factor for each agent in each term.

At time t and in automaton state q the value is a sum of *vertices*, products of one factor for each agent. A vertex
comes from a *guard*, which leads from q to another state for all letters in a product of sets of cells, and from a
vertex of that state one step later: each factor is cut to the set of the guard, and taken one step back (``cells``).

**Theorem.** Let guards out of a state be disjoint, and lead where they say for all letters that their cells may have
(or to acceptance for good). Then the sum of any vertices, each taken once, is at most the probability to satisfy the
task from there, and so is what is left when two vertices a x b and a' x b' are united:

    a x b + a' x b' >= (a + a') x m + a x (b - m),    m = min(b, b'),

where the last product may stay as a *remainder* or be dropped. QED by induction over time: vertices of different guards
are about different next letters, noise of agents is independent, and sums only ever drop what is at least 0.

Reference: docs/theory/tree.md, docs/theory/guards.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from .automaton import Automaton
from .cells import Cells, Kernel, spread
from .fields import Refused
from .motions import Labels
from .rigorous import Array, Truth, U, Whole

# Share of a factor from which a remainder is taken where steps are not additive: the difference of nearly equal
# factors has no digits left, and is larger in its second differences than it is.
KEPT = 1.0 - 1e-9


@dataclass(frozen=True, eq=False)
class Guards:
    """From where to where (G,), and the set of cells (G, I) of each agent, a row of its ``sets``."""

    source: Whole
    target: Whole
    sets: Whole


@dataclass(frozen=True, eq=False)
class Tree:
    """Vertices (n, 4): time, state, guard, child; unions (n, 6): time, state, into, absorbed, agent, remainder; and
    what is kept (n, 3): time, state, vertex. Rows stand in the order of times and states."""

    vertices: Whole
    unions: Whole
    kept: Whole

    @cached_property
    def keys(self) -> list[Whole]:
        """Time and state of each row, in one number; ``Refused`` unless rows stand in their order."""
        keys = [rows[:, 0] * 2**31 + rows[:, 1] for rows in (self.vertices, self.unions, self.kept)]
        if any(np.any(np.diff(key) < 0) for key in keys):
            raise Refused("the rows of the tree are not in the order of times and states")
        return keys

    def at(self, t: int, q: int) -> tuple[Whole, Whole, Whole]:
        """Return guards and children (n, 2), unions (m, 4) and kept vertices (k,) of a time and a state."""
        first, last = zip(*(np.searchsorted(key, t * 2**31 + np.array([q, q + 1])).tolist() for key in self.keys))
        tables = self.vertices[:, 2:], self.unions[:, 2:], self.kept[:, 2]
        vertices, unions, kept = (rows[a:b] for rows, a, b in zip(tables, first, last))
        return vertices, unions, kept


def finished(automaton: Automaton) -> list[bool]:
    """Return which states are accepting for good, whatever comes: those that a co-safe run has satisfied by then."""
    return [automaton.is_co_safe and accepts for accepts in automaton.accepting]


def check_guards(
    automaton: Automaton, guards: Guards, sets: Sequence[Truth], known: Sequence[tuple[list[int], Labels]]
) -> None:
    """Raise ``Refused`` unless guards out of one state are disjoint and lead where they say.

    ``known`` are the propositions of each agent and their labels in its cells.
    """
    done = finished(automaton)
    # Two guards overlap if their sets have a cell in common for every agent.
    meets = [(own.astype(np.int64) @ own.T.astype(np.int64)) > 0 for own in sets]
    for q in np.unique(guards.source).tolist():
        here = np.flatnonzero(guards.source == q)
        overlap = np.ones((len(here), len(here)), dtype=bool)
        for i, both in enumerate(meets):
            overlap &= both[np.ix_(guards.sets[here, i], guards.sets[here, i])]
        if np.any(overlap & ~np.eye(len(here), dtype=bool)) or done[q]:  # every guard meets itself
            raise Refused(f"guards out of automaton state {q} overlap, or leave what is decided")
    # All labels that cells of a set have: the automaton is followed through each of them.
    letters = [[np.unique(labels[cells], axis=0).tolist() for cells in own] for own, (_, labels) in zip(sets, known)]
    for g, (q, target) in enumerate(zip(guards.source.tolist(), guards.target.tolist(), strict=True)):
        entries = {automaton.root[q]}
        for i, (propositions, _) in enumerate(known):
            if propositions:
                rows = letters[i][guards.sets[g, i]]
                entries = {e for entry in entries for row in rows for e in _led(automaton, entry, propositions, row)}
        if not all(entry < 0 and (-1 - entry == target or done[-1 - entry]) for entry in entries):
            raise Refused(f"guard {g} out of automaton state {q} does not always lead to state {target}")


def _led(automaton: Automaton, entry: int, propositions: list[int], row: list[int]) -> set[int]:
    """Return the entries that are reached through propositions of one agent with these labels."""
    if entry < 0 or automaton.variable[entry] not in propositions:
        return {entry}
    label = row[propositions.index(automaton.variable[entry])]
    high = _led(automaton, automaton.high[entry], propositions, row) if label >= 0 else set()
    return high | (_led(automaton, automaton.low[entry], propositions, row) if label <= 0 else set())


@dataclass(frozen=True, eq=False)
class Team:
    """Agents on cells, and the task: guards of all steps, and those of the letter of time 0."""

    automaton: Automaton
    horizon: int
    agents: Sequence[Cells]
    guards: Guards
    start: Guards


@dataclass(eq=False)
class _Values:
    """The value function at a time: distinct factors (n, places) of each agent, and terms (n, I) of each state."""

    factors: list[Array]
    terms: list[Whole]


def value_at_start(team: Team, tree: Tree) -> float:
    """Return a lower bound on the probability that the task is satisfied from the start."""
    # At the end: 1 where the automaton accepts, and nothing elsewhere.
    ones = [np.ones((1, cells.kernel.places)) for cells in team.agents]
    terms = [np.zeros((int(accepts), len(team.agents)), dtype=np.int64) for accepts in team.automaton.accepting]
    later, size = _Values(ones, terms), 0
    for t in range(team.horizon - 1, -1, -1):
        later = _one_step_earlier(team, tree, later, t)
        size += sum(len(rows) for rows in later.terms)
    # Read the value where runs start: over products of sets of cells that the letter of time 0 leads from.
    total = 0.0
    for target, sets in zip(team.start.target.tolist(), team.start.sets.tolist(), strict=True):
        each = zip(team.agents, sets, later.factors, later.terms[target].T, strict=True)
        read = [(cells.start[own] @ factors.T)[term] for cells, own, factors, term in each]
        total += float(np.prod(read, axis=0).sum())
    # all numbers are at least 0: sums and products of so many are off by less than this share of themselves
    places = sum(cells.kernel.places for cells in team.agents)
    count = size + len(tree.unions) + places + 8 * team.horizon * len(team.agents) + 64
    return min(1.0, max(0.0, total * (1.0 - 4.0 * U * count)))


def _one_step_earlier(team: Team, tree: Tree, later: _Values, t: int) -> _Values:
    """Return the value function at time t from that of time t + 1."""
    stacks = [[np.ones((1, cells.kernel.places))] for cells in team.agents]
    terms, memory = [], _Memory()
    for q, is_done in enumerate(finished(team.automaton)):
        if is_done:
            terms.append(np.zeros((1, len(team.agents)), dtype=np.int64))
            continue
        # Vertices of this state, united, and cut down to those that are kept.
        vertices, unions, kept = tree.at(t, q)
        below = _children(team.guards, later, vertices, q)
        _check_unions(unions, kept, len(vertices), len(team.agents))
        terms.append(np.zeros((len(kept), len(team.agents)), dtype=np.int64))
        for i, cells in enumerate(team.agents):
            cut = spread(cells.sets_at(t + 1)[team.guards.sets[vertices[:, 0], i]], cells.kernel)
            vertex = cut * later.factors[i][below[:, i]]
            _unite(vertex, unions, i, KEPT if cells.kernel.inputs else 1.0)
            backed, where = memory.backup(cells.kernel, vertex[kept], cells.policy_at(t, q))
            terms[-1][:, i] = where + sum(len(own) for own in stacks[i])
            stacks[i].append(backed)
    return _Values([np.concatenate(own) for own in stacks], terms)


class _Memory:
    """What was computed at one time: agents that are alike, and states whose factors are equal, share it."""

    def __init__(self) -> None:
        self.backups: dict[tuple[int, bytes, bytes], Array] = {}

    def backup(self, kernel: Kernel, factors: Array, policy: Whole) -> tuple[Array, Whole]:
        """Return distinct factors one step earlier, and which of them each of the factors (n, places) becomes."""
        # Equal factors are taken back once.
        keys = [row.tobytes() for row in factors]
        number = {key: k for k, key in enumerate(dict.fromkeys(keys))}
        where = np.array([number[key] for key in keys], dtype=np.int64)
        whole = id(kernel), b"".join(number), policy.tobytes()
        if whole not in self.backups:
            distinct = factors[[keys.index(key) for key in number]]
            self.backups[whole] = kernel.backup(kernel.values(distinct), distinct.max(axis=1, initial=0.0), policy)
        return self.backups[whole], where


def _children(guards: Guards, later: _Values, vertices: Whole, q: int) -> Whole:
    """Return the factors (n, I) of the children of vertices (n, 2)."""
    guard, child = vertices.T
    if np.any(guards.source[guard] != q):
        raise Refused("the tree uses a guard of another automaton state")
    if len(np.unique(vertices, axis=0)) != len(vertices):
        raise Refused("the tree counts a vertex twice")
    # Terms of all states, one after the other.
    counts = np.array([len(terms) for terms in later.terms])
    if np.any(child >= counts[guards.target[guard]]):  # else it would be one of another state
        raise Refused("the tree names a vertex that does not exist")
    return np.concatenate(later.terms)[(np.cumsum(counts) - counts)[guards.target[guard]] + child]


def _check_unions(unions: Whole, kept: Whole, n: int, n_agents: int) -> None:
    """Raise ``Refused`` if a vertex is counted twice: absorbed and used again, or kept twice."""
    into, absorbed, agent, rest = unions.T
    if np.any(unions[:, :2] >= n) or np.any(kept >= n) or np.any(agent >= n_agents):
        raise Refused("the tree unites or keeps a vertex that does not exist")
    if np.any((rest < -n_agents) | (rest > n_agents) | ((rest != 0) & (np.abs(rest) - 1 == agent))):
        raise Refused("the tree keeps a remainder of no agent, or of the one whose factors are added")
    # A vertex that was absorbed is gone, unless a remainder took its place.
    gone: set[int] = set()
    twice = len(np.unique(kept)) != len(kept)
    for a, b, remains in zip(into.tolist(), absorbed.tolist(), rest.tolist(), strict=True):
        twice |= a == b or a in gone or b in gone
        gone |= set() if remains else {b}
    if twice or gone & set(kept.tolist()):
        raise Refused("the tree counts a vertex twice")


def _unite(vertex: Array, unions: Whole, i: int, share: float) -> None:
    """Unite factors (n, places) of agent i in place; a positive remainder is of the first vertex, else the second."""
    for a, b, agent, rest in unions.tolist():
        first, second = vertex[a].copy(), vertex[b].copy()
        least = np.minimum(first, second)
        vertex[a] = first + second if agent == i else least
        if rest:
            remaining = first if rest > 0 else second
            lessened = np.maximum(remaining * share - least, 0.0) if abs(rest) - 1 == i else least
            vertex[b] = remaining if agent == i else lessened
