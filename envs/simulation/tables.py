"""Exits, letters and automaton of many worlds by tables: the decisions of `dynamics`, looked up.

The half-open regions and the closed workspace cut every axis of an agent at a few edges, and between two of them
nothing changes. So it is enough to count the edges at or below a coordinate, one comparison each. The counts say which
propositions of the agent hold and whether it is outside, exactly: ``low <= x < high`` means that low is counted and
high is not, and ``x <= high`` means that the next number after high is not. Nothing is counted for NaN, which lies
nowhere.

The automaton then reads agent by agent. A row of an agent's table is a state of the automaton together with all that it
may have read so far; a column is a count of the agent; the entry is the row of the next agent's table. The entries come
from `labeling.contains`, `labeling.inside`, the automaton's diagrams and `dynamics.decided`, which are asked once for
every case instead of once for every world.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from ..tasks.automata import Automaton
from ..tasks.regions import Labeling, contains, inside

MOST_ENTRIES = 1 << 20
"""Most entries of all tables together: 8 MiB, about what a processor caches.

With more of them the worlds are read proposition by proposition.
"""

Decided = Callable[..., tuple[Any, Any, Any]]
"""The function `rules.decided`."""


@dataclass(frozen=True, eq=False)
class Counts:
    """Edges of the agents of a block, and the counting of those at or below a coordinate.

    Parameters
    ----------
    edges : tuple of np.ndarray, shape (E_k, 1, 1) or (E_k, n, 1)
        Per axis, increasing: one list for all agents, or a list for each, filled up with infinity.
    """

    edges: tuple[np.ndarray, ...]

    @classmethod
    def of(cls, block: Any, labeling: Labeling) -> Counts:
        """Return the edges of a `blocks.Block` whose outputs are its states."""
        result = []
        for axis in range(len(block.state_low)):
            # The workspace is closed: a point leaves it at the next number after its upper edge.
            lists = []
            for place, i in enumerate(block.agents):
                low, beyond = block.state_low[axis, place], np.nextafter(block.state_high[axis, place], np.inf)
                regions = np.concatenate([labeling.low[i][axis], labeling.high[i][axis]])
                lists.append(np.unique(np.concatenate([low, beyond, regions[np.isfinite(regions)]])))
            common, longest = np.unique(np.concatenate(lists)), max(len(edges) for edges in lists)
            # One list for all agents is counted without reading edges per agent, worth up to twice the comparisons.
            if len(common) <= 2 * longest:
                edges = common[:, None, None]
            else:
                edges = np.full((longest, len(lists), 1), np.inf)
                for place, agent_edges in enumerate(lists):
                    edges[: len(agent_edges), place, 0] = agent_edges
            result.append(edges)
        return cls(tuple(result))

    @cached_property
    def steps(self) -> tuple[Sequence[Any], ...]:
        """The edges of each axis one after the other: numbers, or arrays (n, 1) where agents differ."""
        return tuple(edges.ravel().tolist() if edges.shape[1] == 1 else list(edges) for edges in self.edges)

    @cached_property
    def kind(self) -> type[np.unsignedinteger[Any]]:
        """The smallest type that holds the codes."""
        most = math.prod(len(edges) + 1 for edges in self.edges)
        return np.uint8 if most <= 256 else np.uint16 if most <= 65536 else np.uint32

    def codes(self, states: np.ndarray) -> np.ndarray:
        """Return the codes (n, M) of states (d, n, M): the counts of an agent's axes as one number, in C order."""
        # The smallest numbers that hold all codes are the quickest to add.
        code = np.zeros(states.shape[1:], dtype=self.kind)
        reached = np.empty(states.shape[1:], dtype=bool)
        # The result of a comparison, seen as the numbers 0 and 1, is added without a copy.
        as_number = reached.view(np.uint8)
        for k, (steps, x) in enumerate(zip(self.steps, states, strict=True)):
            if k:
                code *= len(steps) + 1
            for edge in steps:
                np.greater_equal(x, edge, out=reached)
                np.add(code, as_number, out=code)
        return code

    def points(self, place: int) -> np.ndarray:
        """Return one point for every code of the agent at one place of the block: (d, K)."""
        # The lower edge of each interval lies in it; minus infinity lies below all edges.
        axes = [np.concatenate([[-np.inf], edges]) for edges in self._edges_of(place)]
        return np.stack([axis.ravel() for axis in np.meshgrid(*axes, indexing="ij")])

    def between(self, place: int, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        """Return the codes of the agent at one place at all states from `low` to `high`, (d,) each, ends included."""
        axes = self._edges_of(place)
        spans = [
            np.arange(*np.searchsorted(edges, [a, b], side="right") + [0, 1]) for edges, a, b in zip(axes, low, high)
        ]
        sizes = [len(edges) + 1 for edges in axes]
        return np.ravel_multi_index(np.meshgrid(*spans, indexing="ij"), sizes).ravel()

    def _edges_of(self, place: int) -> list[np.ndarray]:
        """Return the edges of the axes of the agent at one place, (E_k,) each."""
        return [edges[:, min(place, edges.shape[1] - 1), 0] for edges in self.edges]


@dataclass(frozen=True, eq=False, repr=False)
class Reader:
    """Tables that read worlds.

    The *status* of a world is its automaton state q, or q + Q if it has failed, with Q the number of states.

    Parameters
    ----------
    counts : tuple of Counts
        One per block.
    steps : tuple of (int, int, np.ndarray)
        Agents in the order of their propositions: block, place in it, and a flat table. The index is the row times its
        length plus the code of the agent; the entry is the next agent's row times its length, or the status in the end.
    first : int
        Length of a row of the first table. Its rows are the statuses.
    q, accepted : np.ndarray, shape (2 Q,)
        Automaton state and acceptance by status.
    """

    counts: tuple[Counts, ...]
    steps: tuple[tuple[int, int, np.ndarray], ...]
    first: int
    q: np.ndarray
    accepted: np.ndarray

    def __repr__(self) -> str:
        return f"Reader({len(self.steps)} tables with {sum(table.size for _, _, table in self.steps)} entries)"

    def read(
        self, states: Sequence[np.ndarray], q: np.ndarray, failed: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return automaton states, failed and accepted of worlds that have moved to `states` (exact).

        Parameters
        ----------
        states : sequence of np.ndarray, shape (d, n, M)
        q, failed : np.ndarray, shape (M,)
            Before the move. A world in an accepting state of a co-safe task that has not failed has been accepted.
        """
        codes = [counts.codes(x) for counts, x in zip(self.counts, states, strict=True)]
        n_states = len(self.q) // 2
        at = q.astype(np.intp)
        if np.count_nonzero(failed):
            at += failed * np.intp(n_states)
        at *= self.first
        for block, place, table in self.steps:
            at += codes[block][place]
            at = table.take(at)
        return self.q.take(at), at >= n_states, self.accepted.take(at)

    def statuses(self, q: int, boxes: Sequence[tuple[np.ndarray, np.ndarray]]) -> np.ndarray:
        """Return the statuses that worlds in the automaton state q may have once they have read a state in boxes.

        The corners of the boxes, (d, n, 1) per block, belong to them.
        """
        at = np.array([q * self.first])
        for block, place, table in self.steps:
            low, high = (corner[:, place, 0] for corner in boxes[block])
            at = np.unique(table[at[:, None] + self.counts[block].between(place, low, high)])
        return at


def reader(
    blocks: Sequence[Any], labeling: Labeling, automaton: Automaton, accepting: np.ndarray, decided: Decided
) -> Reader | None:
    """Return tables for the blocks of a `Dynamics`; None if they would not do.

    There are none if outputs are not the states, if the tables would be too large, or if the task is accepted before
    any letter: then worlds at the start are in an accepting state without being accepted.

    Parameters
    ----------
    blocks : sequence of `blocks.Block`
    labeling : Labeling
    automaton : Automaton
        Its propositions are those of the labelling, in the same order.
    accepting : np.ndarray of bool, shape (Q,)
        As in `Dynamics`.
    decided : callable
        `dynamics.decided`.
    """
    if accepting[automaton.initial] or not all(block.identity_output for block in blocks):
        return None
    counts = tuple(Counts.of(block, labeling) for block in blocks)
    # Codes of agents with many states are too many to be listed at all.
    if any(math.prod(len(edges) + 1 for edges in each.edges) > MOST_ENTRIES for each in counts):
        return None
    places = sorted((int(i), b, k) for b, block in enumerate(blocks) for k, i in enumerate(block.agents))
    n_states, n_nodes = automaton.n_states, automaton.variable.size
    # A row is a pair: the automaton state before the step, and the entry of the diagrams that the agents read so far
    # lead to. Two entries beyond the nodes stand for worlds that an agent has just left, and that had failed before.
    outside, lost = n_nodes, n_nodes + 1
    q = np.tile(np.arange(n_states), 2)
    entry = np.concatenate([automaton.root.astype(np.intp), np.full(n_states, lost)])
    tables: list[np.ndarray] = []
    for i, b, k in places:
        kinds, kind = _kinds(counts[b], blocks[b], k, labeling)
        if sum(table.size for table in tables) + len(q) * len(kind) > MOST_ENTRIES:
            return None
        following = np.empty((len(q), kinds.shape[1]), dtype=np.intp)
        for c, (*letter, gone) in enumerate(kinds.T):
            read = _descend(automaton, entry, labeling.agent_propositions[i], np.array(letter, dtype=bool))
            following[:, c] = np.where((entry != lost) & gone, outside, read)
        # Write every pair as one number; the different ones are the rows of the next table.
        keys = q[:, None] * (n_states + n_nodes + 2) + (following + n_states)
        rows, number = np.unique(keys, return_inverse=True)
        tables.append(number.reshape(following.shape)[:, kind])
        q, entry = rows // (n_states + n_nodes + 2), rows % (n_states + n_nodes + 2) - n_states
    # After the last agent every entry is a state, or one of the two beyond the nodes: decide as the dynamics do.
    failed = entry == lost
    last = np.where(entry >= n_nodes, q, -1 - entry)
    q, failed, _ = decided(accepting, q, last, failed, accepting[q] > failed, entry == outside)
    tables[-1] = (q + n_states * failed)[tables[-1]]
    # Entries become offsets into the flat tables, so that a step costs one addition and one look-up.
    for n, table in enumerate(tables[1:]):
        tables[n] = tables[n] * table.shape[1]
    flat = tuple((b, k, np.ascontiguousarray(table).ravel()) for (_, b, k), table in zip(places, tables, strict=True))
    status = np.tile(np.arange(n_states, dtype=np.int32), 2)
    return Reader(counts, flat, tables[0].shape[1], status, accepting[status] > (np.arange(2 * n_states) >= n_states))


def _kinds(counts: Counts, block: Any, place: int, labeling: Labeling) -> tuple[np.ndarray, np.ndarray]:
    """Return what the codes of an agent stand for: the different kinds, and the kind of each code.

    Returns
    -------
    kinds : np.ndarray of bool, shape (P_i + 1, n_kinds)
        Which propositions hold, and whether the agent is outside its workspace.
    kind : np.ndarray of int
        Per code.
    """
    i = block.agents[place]
    points = counts.points(place)
    holds = contains(points[:, None], labeling.low[i][..., None], labeling.high[i][..., None])
    gone = ~inside(points, block.state_low[:, place], block.state_high[:, place])
    kinds, kind = np.unique(np.vstack([holds, gone]), axis=1, return_inverse=True)
    return kinds, kind.ravel()


def _descend(automaton: Automaton, entry: np.ndarray, propositions: np.ndarray, letter: np.ndarray) -> np.ndarray:
    """Return the entries of the automaton's diagrams that `entry` leads to once `propositions` are set to `letter`."""
    # 1 or 0 for the propositions that are set, -1 for the others and for the two entries that are no nodes.
    value_of = np.full(len(automaton.propositions) + 1, -1)
    value_of[propositions] = letter
    variable = np.append(automaton.variable, [-1, -1])
    at = entry.copy()
    # All entries together, one step per level, until none stands at a node whose proposition is set.
    while True:
        value = np.where(at >= 0, value_of[variable[np.maximum(at, -1)]], -1)
        on = np.flatnonzero(value >= 0)
        if len(on) == 0:
            return at
        node = at[on]
        at[on] = np.where(value[on] == 1, automaton.high[node], automaton.low[node])
