"""Deterministic finite automata over letters, with symbolic transitions.

Model: an automaton starts in ``initial`` before any letter; the first letter it reads is that of x0. A letter is the
set of propositions that hold, represented by one Boolean per proposition. The transitions of a state are a decision
diagram over the propositions whose terminals are automaton states, so 1000 propositions cost 1000 nodes rather than
2^1000 table rows.

Semantics (carried by the automaton):

- ``"co-safe"``: satisfied as soon as an accepting state is entered (accepting states are absorbing), also by infinite
  words; satisfied at once if ``initial`` is accepting.
- ``"finite-trace"``: judged by the state after the last letter;
- ``"opposite"``: of the opposite of a task (``problem.opposite``). Satisfied as soon as an accepting state is entered
  that cannot be left, otherwise judged by the state after the last letter. An agent that leaves its workspace does not
  end the run: from then on none of its propositions holds.

Reference: docs/theory/setting.md, "Satisfaction".
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any

import numpy as np

from .decision_diagram import DecisionDiagrams

SEMANTICS = ("co-safe", "finite-trace")
"""How formulas are judged."""

OPPOSITE = "opposite"
"""How the opposites of tasks are, which have an automaton and no formula."""

FORMAT, VERSION = "certigym-automaton", 1
"""Marks that `to_dict` writes beside the fields, so that `from_dict` refuses anything else."""

_INTEGER_FIELDS = ("accepting", "root", "variable", "low", "high")
_TABLE_PROPOSITIONS = 12
"""Number of propositions up to which letters are looked up in a dense table: 4096 columns, made in milliseconds."""

_TABLE_ENTRIES = 1 << 22
"""Most entries of that table (16 MiB); beyond them the diagrams are followed."""

_LONG_CHAIN, _MANY = 8, 0.25
"""Nodes with one exit from which they are read at once, and the share of entries that have to stand at the first one:
to look for it takes as long as some levels."""


@dataclass(frozen=True, eq=False)
class Automaton:
    """Complete deterministic finite automaton with symbolic transitions (exact).

    Entries of `root`, `low` and `high` are coded: ``e >= 0`` is diagram node e, ``e < 0`` is automaton state
    ``-1 - e``. All arrays are read-only.

    Parameters
    ----------
    propositions : tuple of str
        Names; their order is the variable order of the diagrams. P of them.
    semantics : str
        ``"co-safe"``, ``"finite-trace"`` or ``"opposite"``.
    state_names : tuple of str
        Q different names.
    initial : int
        State before the first letter.
    accepting : array (Q,), bool
        Accepting states; for co-safe semantics they must be absorbing.
    root : array (Q,), int32
        Entry at which the diagram of each state starts.
    variable : array (n,), int32
        Proposition that each node tests; children test strictly larger ones.
    low, high : array (n,), int32
        Entries to which each node leads if its proposition is false, true.

    Raises
    ------
    ValueError
        If a field does not describe a complete deterministic automaton.
    """

    propositions: tuple[str, ...]
    semantics: str
    state_names: tuple[str, ...]
    initial: int
    accepting: np.ndarray
    root: np.ndarray
    variable: np.ndarray
    low: np.ndarray
    high: np.ndarray

    def __post_init__(self) -> None:
        if self.semantics != OPPOSITE:
            check_semantics(self.semantics)
        object.__setattr__(self, "propositions", checked_names("propositions", self.propositions))
        object.__setattr__(self, "state_names", checked_names("state_names", self.state_names))
        n_states = len(self.state_names)
        if n_states == 0:
            raise ValueError("`state_names`: expected at least one state, got none")
        if not isinstance(self.initial, (int, np.integer)) or not 0 <= self.initial < n_states:
            raise ValueError(f"`initial`: expected a state index below {n_states}, got {self.initial!r}")
        object.__setattr__(self, "initial", int(self.initial))
        object.__setattr__(self, "accepting", _checked_accepting(self.accepting, n_states))
        self._check_diagrams()
        if self.semantics == "co-safe" and not np.all(self._stays[self.accepting]):
            raise ValueError("`accepting`: expected absorbing states in a co-safe automaton, got one that can be left")

    def _check_diagrams(self) -> None:
        """Store the arrays of the diagrams as read-only int32; raise ValueError unless they lead somewhere and end."""
        n_states, n_nodes = len(self.state_names), np.size(self.variable)
        limits = {
            "root": (n_states, -n_states, n_nodes),
            "variable": (n_nodes, 0, len(self.propositions)),
            "low": (n_nodes, -n_states, n_nodes),
            "high": (n_nodes, -n_states, n_nodes),
        }
        for name, (length, least, bound) in limits.items():
            object.__setattr__(self, name, checked_integers(name, getattr(self, name), length, least, bound))
        # Children that test later propositions exclude cycles.
        for name in ("low", "high"):
            child = getattr(self, name)
            inner = child >= 0
            if not np.all(self.variable[child[inner]] > self.variable[inner]):
                raise ValueError(f"`{name}`: expected children that test later propositions than their parents")

    # Pickle the fields alone: a pickled array would come back writable, and the table can be made again.
    def __reduce__(self) -> tuple[type[Automaton], tuple[Any, ...]]:
        return Automaton, tuple(getattr(self, field.name) for field in fields(self))

    def __repr__(self) -> str:
        return (
            f"Automaton({self.n_states} states, {len(self.propositions)} propositions, "
            f"{self.variable.size} nodes, {self.semantics})"
        )

    @property
    def is_co_safe(self) -> bool:
        """Whether the task is satisfied as soon as an accepting state is entered."""
        return self.semantics == "co-safe"

    @property
    def reads_exits(self) -> bool:
        """Whether an agent that leaves its workspace is read as a letter, none of whose propositions holds."""
        return self.semantics == OPPOSITE

    @property
    def n_states(self) -> int:
        """Number of states Q (dimensionless count)."""
        return len(self.state_names)

    # --- reading letters -----------------------------------------------------------------------------------
    def next_state(self, q: Any, letters: Any) -> np.ndarray:
        """Return the state after reading one letter, elementwise (exact).

        Parameters
        ----------
        q : int array of any shape S
            States.
        letters : bool array (P, *S)
            Which propositions hold.

        Returns
        -------
        int32 array of shape S

        Raises
        ------
        ValueError
            If a shape or type is wrong, or a state is out of range.
        """
        q, letters = np.asarray(q), np.asarray(letters)
        if not np.issubdtype(q.dtype, np.integer) or (q.size and not (0 <= q.min() and q.max() < self.n_states)):
            raise ValueError(f"`q`: expected state indices below {self.n_states}, got {q!r}")
        expected = (len(self.propositions), *q.shape)
        if letters.shape != expected or (letters.dtype != np.bool_ and letters.size):
            raise ValueError(
                f"`letters`: expected Booleans of shape {expected}, one row per proposition, "
                f"got {letters.dtype} of shape {letters.shape}"
            )
        if self._table is None:
            return self._walk(q, letters)
        # The letter as a binary number is the column of the table.
        code = np.zeros(q.shape, dtype=np.int64)
        for p, row in enumerate(letters):
            code += row.astype(np.int64) << p
        result: np.ndarray = self._table[q, code]
        return result

    def _walk(self, q: np.ndarray, letters: np.ndarray) -> np.ndarray:
        """Return the next states by following the diagrams, all entries together, one step per level."""
        # `at` is coded like the entries: a node while it is at least 0, a state in the end.
        at = self.root[q.reshape(-1)].astype(np.int64)
        flat = letters.reshape(len(self.propositions), q.size)
        active = np.flatnonzero(at >= 0)
        while active.size:
            node = at[active]
            here = active[node == node[0]]
            variables, wanted, leaves, goes_on = self._chain(int(node[0]))
            if len(variables) < _LONG_CHAIN or here.size < _MANY * active.size:
                at[active] = np.where(flat[self.variable[node], active], self.high[node], self.low[node])
            else:
                # All that stand at this node read the whole chain at once; the others wait.
                rows = flat[variables] if here.size == q.size else flat[variables][:, here]
                at[here] = np.where((rows == wanted).all(axis=0), goes_on, leaves)
            active = active[at[active] >= 0]
        result: np.ndarray = (-1 - at).astype(np.int32).reshape(q.shape)[()]
        return result

    def _chain(self, node: int) -> tuple[np.ndarray, np.ndarray, int, int]:
        """Return the longest chain of nodes from one on that all have one exit, such as those of a conjunction.

        That are the propositions (k,) that are read, what each is to be (k, 1) for the chain to go on, the entry to
        which any other value leaves, and the one at which the chain ends.
        """
        if node not in self._chains:
            best: tuple[np.ndarray, np.ndarray, int, int] | None = None
            for leaves in {int(self.low[node]), int(self.high[node])}:
                variables, wanted, at = list[int](), list[bool](), node
                while at >= 0 and (self.low[at] == leaves) != (self.high[at] == leaves):
                    variables.append(int(self.variable[at]))
                    wanted.append(bool(self.low[at] == leaves))
                    at = int(self.high[at] if wanted[-1] else self.low[at])
                if best is None or len(variables) > len(best[0]):
                    best = np.array(variables, dtype=np.int64), np.array(wanted)[:, None], leaves, at
            assert best is not None
            self._chains[node] = best
        return self._chains[node]

    @cached_property
    def _chains(self) -> dict[int, tuple[np.ndarray, np.ndarray, int, int]]:
        return {}

    @cached_property
    def _table(self) -> np.ndarray | None:
        """Dense transition table (Q, 2^P), bit p of the column = proposition p; None if it would be too large."""
        n = len(self.propositions)
        if n > _TABLE_PROPOSITIONS or self.n_states << n > _TABLE_ENTRIES:
            return None
        letters = (np.arange(1 << n)[None, :] >> np.arange(n)[:, None] & 1).astype(bool)
        return np.stack([self._walk(np.full(1 << n, q), letters) for q in range(self.n_states)])

    def letter(self, names: Collection[str]) -> np.ndarray:
        """Return the letter in which exactly the propositions `names` hold: bool array (P,)."""
        if isinstance(names, str):
            raise ValueError(f"`names`: expected a collection of proposition names, got the string {names!r}")
        unknown = [name for name in names if name not in self._index]
        if unknown:
            raise ValueError(f"`names`: expected propositions among {', '.join(self.propositions)}, got {unknown[0]!r}")
        result = np.zeros(len(self.propositions), dtype=bool)
        result[[self._index[name] for name in names]] = True
        return result

    @cached_property
    def _index(self) -> dict[str, int]:
        return {name: i for i, name in enumerate(self.propositions)}

    def accepts(self, word: Sequence[Collection[str]]) -> bool:
        """Return whether the state after reading all letters of `word` from `initial` is accepting (exact).

        Each letter is a collection of proposition names. For co-safe automata this says whether *every*
        continuation of the word satisfies the task.
        """
        q: Any = self.initial
        for names in word:
            q = self.next_state(q, self.letter(names))
        return bool(self.accepting[q])

    @cached_property
    def dead(self) -> np.ndarray:
        """Read-only bool array (Q,): states from which no word leads to acceptance."""
        # Walk backwards from the accepting states; what is never met is dead.
        manager, roots = self.diagrams()
        sources: list[list[int]] = [[] for _ in roots]
        for q, root in enumerate(roots):
            for target in manager.leaves(root):
                sources[target].append(q)
        alive = self.accepting.copy()
        stack = [int(q) for q in np.flatnonzero(alive)]
        while stack:
            for q in sources[stack.pop()]:
                if not alive[q]:
                    alive[q] = True
                    stack.append(q)
        result: np.ndarray = ~alive
        result.setflags(write=False)
        return result

    @cached_property
    def finished(self) -> np.ndarray:
        """Read-only bool array (Q,): states whose entry satisfies the task; none for finite traces."""
        result: np.ndarray = self.accepting & (self.is_co_safe | (self.reads_exits & self._stays))
        result.setflags(write=False)
        return result

    @property
    def _stays(self) -> np.ndarray:
        """States (Q,) that every letter leads back to."""
        return np.asarray(self.root == -1 - np.arange(self.n_states))

    @cached_property
    def absorbing(self) -> np.ndarray:
        """Read-only bool array (Q,): states in which nothing is left to decide, `dead` or `finished`."""
        result: np.ndarray = self.dead | self.finished
        result.setflags(write=False)
        return result

    # --- diagrams ------------------------------------------------------------------------------------------
    def diagrams(self) -> tuple[DecisionDiagrams, list[int]]:
        """Return a fresh manager with the diagrams (terminal value = state index) and the root per state."""
        manager = DecisionDiagrams()
        nodes: list[int] = [-1] * self.variable.size

        def child(entry: int) -> int:
            return nodes[entry] if entry >= 0 else manager.terminal(-1 - entry)

        # Children test later propositions than their parents, so they are made first.
        for n in np.argsort(-self.variable, kind="stable"):
            nodes[n] = manager.node(int(self.variable[n]), child(int(self.low[n])), child(int(self.high[n])))
        return manager, [child(int(entry)) for entry in self.root]

    # --- as plain values -----------------------------------------------------------------------------------
    def to_dict(self) -> dict[str, Any]:
        """Return the automaton as plain values for JSON (exact); `from_dict` reads them back."""
        return {
            "format": FORMAT,
            "version": VERSION,
            "semantics": self.semantics,
            "propositions": list(self.propositions),
            "states": list(self.state_names),
            "initial": self.initial,
            "accepting": np.flatnonzero(self.accepting).tolist(),
            "root": self.root.tolist(),
            "variable": self.variable.tolist(),
            "low": self.low.tolist(),
            "high": self.high.tolist(),
        }

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Automaton:
        """Return the automaton that `to_dict` wrote; raise ValueError if `data` is anything else."""
        _check_data(data)
        n_states = len(data["states"])
        if not all(0 <= q < n_states for q in data["accepting"]):
            raise ValueError(f"`accepting`: expected state indices below {n_states}")
        accepting = np.zeros(n_states, dtype=bool)
        accepting[np.array(data["accepting"], dtype=np.int64)] = True
        return Automaton(
            propositions=tuple(data["propositions"]),
            semantics=data["semantics"],
            state_names=tuple(data["states"]),
            initial=data["initial"],
            accepting=accepting,
            root=np.array(data["root"], dtype=np.int32),
            variable=np.array(data["variable"], dtype=np.int32),
            low=np.array(data["low"], dtype=np.int32),
            high=np.array(data["high"], dtype=np.int32),
        )


def followed(automaton: Automaton, entry: int, positions: Mapping[int, int], holds: Sequence[bool]) -> int:
    """Return the entry that an entry leads to by the propositions of one agent (exact).

    Parameters
    ----------
    automaton : Automaton
    entry : int
        As in `root`, `low` and `high`: a diagram node, or a state coded as ``-1 - q``.
    positions : mapping from int to int
        By the number of a proposition of the agent, its place in `holds`; others stop the walk.
    holds : sequence of bool
        Which propositions of the agent hold.
    """
    while entry >= 0 and (k := positions.get(int(automaton.variable[entry]))) is not None:
        entry = int(automaton.high[entry] if holds[k] else automaton.low[entry])
    return entry


def _check_data(data: Mapping[str, Any]) -> None:
    """Raise ValueError unless plain values have the fields and types that `to_dict` writes."""
    if not isinstance(data, Mapping) or data.get("format") != FORMAT:
        raise ValueError(f'`data`: expected a dictionary with "format": "{FORMAT}"')
    if data.get("version") != VERSION:
        raise ValueError(f"`version`: expected {VERSION}, got {data.get('version')!r}; written by another release")
    expected = {"format", "version", "semantics", "propositions", "states", "initial", *_INTEGER_FIELDS}
    if set(data) != expected:
        odd = sorted(map(str, set(data) ^ expected))
        raise ValueError(f"`data`: expected exactly the fields {', '.join(sorted(expected))}; differs in {odd[0]!r}")
    for field in ("propositions", "states"):
        if not isinstance(data[field], list) or not all(isinstance(name, str) for name in data[field]):
            raise ValueError(f"`{field}`: expected a list of strings")
    for field in _INTEGER_FIELDS:
        values = data[field]
        if not isinstance(values, list) or not all(type(v) is int and abs(v) < 2**31 for v in values):
            raise ValueError(f"`{field}`: expected a list of integers below 2^31")
    if type(data["initial"]) is not int:
        raise ValueError(f"`initial`: expected an integer, got {data['initial']!r}")


def check_semantics(semantics: object) -> None:
    """Raise ValueError unless `semantics` is one of the two names."""
    if not isinstance(semantics, str) or semantics not in SEMANTICS:
        raise ValueError(f'`semantics`: expected "co-safe" or "finite-trace", got {semantics!r}')


def checked_names(field: str, values: object) -> tuple[str, ...]:
    """Return `values` as a tuple of different non-empty strings, or raise ValueError."""
    if isinstance(values, str) or not isinstance(values, Sequence):
        raise ValueError(f"`{field}`: expected a sequence of names, got {values!r}")
    for value in values:
        if not isinstance(value, str) or not value:
            raise ValueError(f"`{field}`: expected non-empty strings, got {value!r}")
    seen: set[str] = set()
    for value in values:
        if value in seen:
            raise ValueError(f"`{field}`: expected different names, got {value!r} twice")
        seen.add(value)
    return tuple(values)


def _checked_accepting(values: object, n_states: int) -> np.ndarray:
    """Return `values` as a read-only bool array of shape (n_states,); raise ValueError if they are anything else."""
    accepting = np.array(values)
    if accepting.shape != (n_states,) or accepting.dtype != np.bool_:
        raise ValueError(f"`accepting`: expected {n_states} Booleans, got {accepting.dtype} {accepting.shape}")
    accepting.setflags(write=False)
    return accepting


def checked_integers(field: str, values: object, length: int, least: int, bound: int) -> np.ndarray:
    """Return `values` as a read-only int32 array of `length` entries in [least, bound)."""
    array = np.array(values)
    if array.shape != (length,) or (length and not np.issubdtype(array.dtype, np.integer)):
        raise ValueError(f"`{field}`: expected {length} integers, got {array.dtype} of shape {array.shape}")
    if length and not (least <= array.min() and array.max() < bound):
        raise ValueError(f"`{field}`: expected entries from {least} to {bound - 1}, got {array.min()} to {array.max()}")
    result = array.astype(np.int32)
    result.setflags(write=False)
    return result
