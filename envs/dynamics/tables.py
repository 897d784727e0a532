"""Exits, letters and automaton of many worlds by tables: what `dynamics` decides, looked up.

The half-open regions and the closed workspace cut every axis of an agent at a few edges, and between two of them
nothing changes. So the edges at or below a coordinate are counted, one comparison each; the counts say which
propositions of the agent hold and whether it is outside, exactly: ``low <= x < high`` is "low is counted, high is
not", and ``x <= high`` is "the number after high is not". Nothing is counted for NaN, which lies nowhere.

The automaton then reads agent by agent: its state, and all that it may have read so far, is a row of a table, and the
next agent's count a column. The entries are found by `labeling.contains`, `labeling.inside`, the automaton's diagrams
and `dynamics.decided`, asked once for every case instead of once for every world.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..agents import Labeling, contains, inside
from ..logic import Automaton

LARGEST = 1 << 20
"""Most entries of all tables together; with more of them the worlds are read proposition by proposition."""

Decided = Callable[..., tuple[Any, Any, Any]]
Array = np.ndarray


@dataclass(frozen=True, eq=False)
class Counts:
    """Edges of the agents of a block.

    Parameters
    ----------
    edges : tuple of np.ndarray, shape (E_k, 1, 1) or (E_k, n, 1)
        Per axis, increasing; one list for all agents, or a list for each, filled up with infinity.
    """

    edges: tuple[Array, ...]

    @classmethod
    def of(cls, block: Any, labeling: Labeling) -> Counts:
        """Edges of a `blocks.Block` whose outputs are its states."""
        result = []
        for axis in range(len(block.state_low)):
            lists = []
            for place, i in enumerate(block.agents):
                low, beyond = block.state_low[axis, place], np.nextafter(block.state_high[axis, place], np.inf)
                regions = np.concatenate([labeling.low[i][axis], labeling.high[i][axis]])
                lists.append(np.unique(np.concatenate([low, beyond, regions[np.isfinite(regions)]])))
            common, longest = np.unique(np.concatenate(lists)), max(len(edges) for edges in lists)
            if len(common) <= 2 * longest:
                edges = common[:, None, None]
            else:
                edges = np.full((longest, len(lists), 1), np.inf)
                for place, own in enumerate(lists):
                    edges[: len(own), place, 0] = own
            result.append(edges)
        return cls(tuple(result))

    def codes(self, states: Array) -> Array:
        """Counts of every agent, (n, M) for states (d, n, M); those of several axes as one number, in C order."""
        result: Array | None = None
        for edges, x in zip(self.edges, states, strict=True):
            reached = np.empty(x.shape, dtype=bool)
            one = reached.view(np.uint8)
            count = np.zeros(x.shape, dtype=np.uint8 if len(edges) < 256 else np.uint32)
            for edge in edges.ravel().tolist() if edges.shape[1] == 1 else edges:
                np.greater_equal(x, edge, out=reached)
                np.add(count, one, out=count)
            if result is None:
                result = count.astype(np.intp)
            else:
                result *= len(edges) + 1
                result += count
        assert result is not None
        return result

    def points(self, place: int) -> Array:
        """A point (d, K) with every code of the agent at one place of the block."""
        axes = [np.concatenate([[-np.inf], edges[:, min(place, edges.shape[1] - 1), 0]]) for edges in self.edges]
        return np.stack([axis.ravel() for axis in np.meshgrid(*axes, indexing="ij")])


@dataclass(frozen=True, eq=False)
class Reader:
    """Tables by which worlds are read.

    The *status* of a world is its automaton state, plus the number Q of these if it has failed.

    Parameters
    ----------
    counts : tuple of Counts
        One per block.
    steps : tuple of (int, int, np.ndarray)
        Agents in the order of their propositions: block, place in it, and a flat table, from row times length plus
        code to the row of the next agent times its length, or to the status in the end.
    first : int
        Length of a row of the first table, whose rows are the statuses.
    q, accepted : np.ndarray, shape (2 Q,)
        Automaton state and acceptance by status.
    """

    counts: tuple[Counts, ...]
    steps: tuple[tuple[int, int, Array], ...]
    first: int
    q: Array
    accepted: Array

    def read(self, states: Sequence[Array], q: Array, failed: Array) -> tuple[Array, Array, Array]:
        """Return automaton states, failed and accepted of worlds that have moved to `states` (exact).

        Parameters
        ----------
        states : sequence of np.ndarray, shape (d, n, M)
        q, failed : np.ndarray, shape (M,)
            Before. Worlds in an accepting state of a co-safe task that have not failed have been accepted.
        """
        codes = [counts.codes(x) for counts, x in zip(self.counts, states, strict=True)]
        at, n_states = q.astype(np.intp), len(self.q) // 2
        np.add(at, n_states, out=at, where=failed)
        at *= self.first
        for block, place, table in self.steps:
            at += codes[block][place]
            at = table.take(at)
        return self.q.take(at), at >= n_states, self.accepted.take(at)


def reader(
    blocks: Sequence[Any], labeling: Labeling, automaton: Automaton, accepting: Array, decided: Decided
) -> Reader | None:
    """Return tables for the blocks of a `Dynamics`; None if they would not do.

    They do not if outputs are not the states, if they would be too large, or if the task is accepted before any letter:
    then worlds at the start are in an accepting state without being accepted.

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
    places = sorted((int(i), b, k) for b, block in enumerate(blocks) for k, i in enumerate(block.agents))
    n_states, n_nodes = automaton.n_states, automaton.variable.size
    outside, lost = n_nodes, n_nodes + 1  # rows of worlds that an agent has just left, and that had failed before
    q = np.tile(np.arange(n_states), 2)
    entry = np.concatenate([automaton.root.astype(np.intp), np.full(n_states, lost)])
    tables: list[Array] = []
    for i, b, k in places:
        points = counts[b].points(k)
        holds = contains(points[:, None], labeling.low[i][..., None], labeling.high[i][..., None])
        gone = ~inside(points, blocks[b].state_low[:, k], blocks[b].state_high[:, k])
        kinds, kind = np.unique(np.vstack([holds, gone]), axis=1, return_inverse=True)
        if sum(table.size for table in tables) + len(q) * len(kind) > LARGEST:
            return None
        following = np.empty((len(q), kinds.shape[1]), dtype=np.intp)
        for c, (*letter, out) in enumerate(kinds.T):
            read = _descend(automaton, entry, labeling.agent_propositions[i], np.array(letter, dtype=bool))
            following[:, c] = np.where((entry != lost) & out, outside, read)
        keys = q[:, None] * (n_states + n_nodes + 2) + (following + n_states)
        rows, number = np.unique(keys, return_inverse=True)
        tables.append(number.reshape(following.shape)[:, kind.ravel()])
        q, entry = rows // (n_states + n_nodes + 2), rows % (n_states + n_nodes + 2) - n_states
    failed = entry == lost
    last = np.where(entry >= n_nodes, q, -1 - entry)
    q, failed, _ = decided(accepting, q, last, failed, accepting[q] > failed, entry == outside)
    tables[-1] = (q + n_states * failed)[tables[-1]]
    for n, table in enumerate(tables[1:]):
        tables[n] = tables[n] * table.shape[1]
    flat = tuple((b, k, np.ascontiguousarray(table).ravel()) for (_, b, k), table in zip(places, tables, strict=True))
    status = np.tile(np.arange(n_states, dtype=np.int32), 2)
    return Reader(counts, flat, tables[0].shape[1], status, accepting[status] > (np.arange(2 * n_states) >= n_states))


def _descend(automaton: Automaton, entry: Array, own: Array, letter: Array) -> Array:
    """Where entries of the automaton's diagrams lead once an agent's propositions `own` are known to be `letter`."""
    known = np.full(len(automaton.propositions) + 1, -1)
    known[own] = letter
    variable = np.append(automaton.variable, [-1, -1])  # the two rows that are no node test nothing
    at = entry.copy()
    while True:
        value = np.where(at >= 0, known[variable[np.maximum(at, -1)]], -1)
        on = np.flatnonzero(value >= 0)
        if len(on) == 0:
            return at
        node = at[on]
        at[on] = np.where(value[on] == 1, automaton.high[node], automaton.low[node])
