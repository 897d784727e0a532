"""Deterministic finite automata (DFA) over letters, and words of which some letters are known in part.

The transitions of a state are a binary decision diagram over the propositions. Entries e >= 0 are nodes, which test
proposition ``variable[e]`` and go on at ``low[e]`` or ``high[e]``; entries e < 0 are states ``-1 - e``. A node tests a
smaller proposition than its children, so that every letter leads from every state to one state.

**Theorem** (``followed``). If all words that agree with what is known of their letters so far lead into one of some
states, then with one letter more into one of those that are returned. *Proof.* A node is left on both sides unless its
proposition is known. A co-safe automaton that accepts once has satisfied the task, whatever comes after. QED
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

CO_SAFE, FINITE_TRACE = "co-safe", "finite-trace"

Known = Mapping[int, bool]  # what is known of a letter: propositions by number, and whether they hold


@dataclass(frozen=True, eq=False)
class Automaton:
    """A complete deterministic automaton; ``initial`` is its state before the letter of time 0."""

    propositions: tuple[str, ...]
    semantics: str
    initial: int
    accepting: tuple[bool, ...]
    root: tuple[int, ...]
    variable: tuple[int, ...]
    low: tuple[int, ...]
    high: tuple[int, ...]

    def __post_init__(self) -> None:
        states, nodes = len(self.accepting), len(self.variable)
        entries, children = (*self.root, *self.low, *self.high), zip(self.low, self.high, self.variable)
        pairs = [(child, p) for *both, p in children for child in both if 0 <= child < nodes]
        wrong = {
            f"semantics are {CO_SAFE} or {FINITE_TRACE}": self.semantics not in (CO_SAFE, FINITE_TRACE),
            "it has another number of states than it says": not 0 <= self.initial < states or len(self.root) != states,
            "its diagrams have lists of different lengths": not len(self.low) == len(self.high) == nodes,
            "a diagram leads to what does not exist": any(not -states <= entry < nodes for entry in entries),
            "a diagram tests no proposition": any(not 0 <= p < len(self.propositions) for p in self.variable),
            # Children test larger propositions: there is no circle, and every letter has one way.
            "a diagram tests propositions out of order": any(self.variable[child] <= p for child, p in pairs),
        }
        for what, is_so in wrong.items():
            if is_so:
                raise ValueError(f"the automaton is wrong: {what}")

    @property
    def is_co_safe(self) -> bool:
        """Whether a run satisfies the task as soon as the automaton accepts."""
        return self.semantics == CO_SAFE

    def targets(self, q: int, known: Known) -> set[int]:
        """Return the states to which q leads by letters that agree with what is known."""
        entries, seen, targets = [self.root[q]], set(), set()
        while entries:
            entry = entries.pop()
            if entry < 0:
                targets.add(-1 - entry)
            elif entry not in seen:
                seen.add(entry)
                p = self.variable[entry]
                if known.get(p, True):  # it may hold
                    entries.append(self.high[entry])
                if not known.get(p, False):  # it may fail
                    entries.append(self.low[entry])
        return targets

    def dead(self) -> tuple[bool, ...]:
        """Return which states lead to no accepting state: computed, and not read from any file."""
        leads = [self.targets(q, {}) for q in range(len(self.accepting))]
        alive = {q for q, accepts in enumerate(self.accepting) if accepts}
        # Backward from the accepting states, one transition at a time, until nothing is new.
        while new := {q for q, targets in enumerate(leads) if q not in alive and targets & alive}:
            alive |= new
        return tuple(q not in alive for q in range(len(leads)))


def followed(automaton: Automaton, states: Iterable[int], known: Known) -> set[int]:
    """Return the states after one letter; a co-safe automaton that has accepted stays where it is."""
    reached: set[int] = set()
    for q in states:
        done = automaton.is_co_safe and automaton.accepting[q]  # whatever comes after
        reached |= {q} if done else automaton.targets(q, known)
    return reached
