"""Letters read by the decision diagrams of an automaton, on the device where the worlds live."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ..systems.backends import namespace
from ..tasks.automata import Automaton
from .blocks import Put

TABLE_LETTERS = 1 << 12
"""Most letters that are listed in a table of transitions, as many as `Automaton` lists."""


@dataclass(frozen=True, eq=False, repr=False)
class Diagrams:
    """The transitions of an automaton; entries are coded as in `Automaton`.

    Parameters
    ----------
    root, variable, low, high : int arrays on a device
    levels : int
        Most propositions that a path through a diagram tests.
    table : int array (Q, 2^P), or None
        Following states, if the letters are few: bit p of the column is proposition p.
    weights : int array (P, 1)
        2^p for the table.
    """

    root: Any
    variable: Any
    low: Any
    high: Any
    levels: int
    table: Any
    weights: Any

    @classmethod
    def of(cls, automaton: Automaton, put: Put) -> Diagrams:
        """Return the transitions of an automaton where `put` puts them."""
        count = len(automaton.propositions)
        table = None
        if 1 << count <= TABLE_LETTERS:
            letters = (np.arange(1 << count)[None, :] >> np.arange(count)[:, None] & 1).astype(bool)
            rows = [automaton.next_state(np.full(1 << count, q), letters) for q in range(automaton.n_states)]
            table = put(np.stack(rows).astype(np.int64))
        # One node at least, so that finished entries have one to look at.
        variable, low, high = (
            put(np.append(values, 0).astype(np.int64)) for values in (automaton.variable, automaton.low, automaton.high)
        )
        weights = put((1 << np.arange(count, dtype=np.int64) % 62)[:, None])
        root = put(automaton.root.astype(np.int64))
        return cls(root, variable, low, high, _levels(automaton), table, weights)

    def next_state(self, q: Any, letters: Any) -> Any:
        """Return the states (M,) after letters (P, M) are read (exact)."""
        xp = namespace(letters)
        if self.table is not None:
            # The letter as a binary number is the column of the table.
            return self.table[q, xp.sum(letters * self.weights, axis=0)]
        at, worlds = self.root[q], xp.cumulative_sum(xp.ones_like(q)) - 1
        for _ in range(self.levels):
            node = xp.maximum(at, xp.zeros_like(at))
            following = xp.where(letters[self.variable[node], worlds], self.high[node], self.low[node])
            at = xp.where(at >= 0, following, at)
        return -1 - at


def _levels(automaton: Automaton) -> int:
    """Return the most nodes on a path: children test later propositions, so they have larger depths to their ends."""
    depth = np.zeros(len(automaton.variable) + 1, dtype=int)
    for node in np.argsort(automaton.variable)[::-1]:
        children = [depth[entry] for entry in (automaton.low[node], automaton.high[node]) if entry >= 0]
        depth[node] = 1 + max(children, default=0)
    return int(depth[automaton.root[automaton.root >= 0]].max(initial=0))
