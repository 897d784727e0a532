"""Tasks from automata in the Hanoi Omega-Automata format.

The reader takes deterministic *terminal* Buchi automata (``Acceptance: 1 Inf(0)``): every accepting mark lies on a
state that no letter leaves, or on an edge into such a state. To visit the mark infinitely often then means to reach
that state once, which is co-safe acceptance. What other omega-automata accept cannot be decided after finitely many
letters. The first letter of the word is that of x0, as everywhere. Spot writes such automata, for example by
``ltl2tgba -B -D "a U b"`` for co-safe formulas.
"""

from __future__ import annotations

import difflib
from collections.abc import Sequence
from dataclasses import dataclass

from .automaton import Automaton
from .decision_diagram import FALSE, TRUE, DecisionDiagrams
from .guard_diagrams import CONFLICT, completed, joined_guards, letter_text
from .hoa_text import HoaReader, HoaState, HoaText, hoa_error
from .minimal import StateGraph, minimal_automaton, saturated


@dataclass(frozen=True)
class _Edge:
    guard: int
    target: int
    marked: bool


def automaton_from_hoa(text: str, propositions: Sequence[str]) -> Automaton:
    """Return the minimal complete co-safe automaton of a terminal deterministic Buchi automaton (exact).

    Parameters
    ----------
    text : str
        One automaton in HOA version 1. Labels may use aliases or be implicit. Letters without an edge violate the task.
    propositions : sequence of str
        All propositions in the wanted order; those of the automaton must be among them.

    Raises
    ------
    ValueError
        If the text cannot be read, or the automaton is not deterministic, terminal and Buchi; the message says which.
    """
    if not isinstance(text, str):
        raise ValueError(f"`hoa`: expected a string, got {type(text).__name__}")
    index = {name: i for i, name in enumerate(propositions)}

    def variable_of(name: str) -> int:
        if name not in index:
            close = difflib.get_close_matches(name, list(index)[:5000], n=1) or list(index)[:10]
            raise hoa_error(f"the atomic proposition {name!r} is not declared; declared is {', '.join(close)}")
        return index[name]

    # Read the text, check that acceptance is co-safe, and only then complete and minimise.
    diagrams = DecisionDiagrams()
    reader = HoaReader(text, diagrams, variable_of)
    hoa = reader.read()
    start = _start(hoa)
    # Accepting marks must lead into absorbing states; letters without an edge lead into a trap.
    edges = {number: _edges(state, diagrams, reader.variables) for number, state in hoa.states.items()}
    sinks = _accepting_sinks(edges, diagrams)
    _check_terminal(edges, sinks)
    graph = _graph(edges, sinks, start, diagrams, tuple(propositions))
    return minimal_automaton(saturated(graph), "co-safe")


def _start(hoa: HoaText) -> int:
    """Return the initial state; raise ValueError unless the headers announce one deterministic Buchi automaton."""
    if hoa.acceptance.split() != ["1", "Inf", "(", "0", ")"]:
        raise hoa_error(
            f"expected Buchi acceptance, Acceptance: 1 Inf(0), got {hoa.acceptance or 'none'}; "
            "Spot writes it with the option -B"
        )
    if len(hoa.starts) != 1 or len(hoa.starts[0]) != 1:
        raise hoa_error("expected one initial state (deterministic automaton), got none or several")
    targets = [target for state in hoa.states.values() for _, target, _ in state.edges]
    largest = max([hoa.starts[0][0], *hoa.states, *targets])
    if hoa.n_states is not None and largest >= hoa.n_states:
        raise hoa_error(f"expected states below {hoa.n_states}, got {largest}")
    return hoa.starts[0][0]


def _edges(state: HoaState, diagrams: DecisionDiagrams, variables: list[int]) -> list[_Edge]:
    """Return the edges of a state with their labels; an edge is marked if it or its state is."""
    labels = [label for label, _, _ in state.edges]
    if state.label is not None:
        if any(label is not None for label in labels):
            raise hoa_error(f"state {state.number} has a label and labelled edges; only one is allowed")
        labels = [state.label] * len(labels)
    elif labels and all(label is None for label in labels):
        # Implicit labels: edge number k is taken on the letter whose bits are those of k.
        n = len(variables)
        if n > 20 or len(labels) != 1 << n:
            raise hoa_error(f"state {state.number}: expected 2^{n} edges without labels, got {len(labels)}")
        labels = [
            diagrams.conjoin_all(diagrams.literal(v, bool(code >> i & 1)) for i, v in enumerate(variables))
            for code in range(1 << n)
        ]
    edges: list[_Edge] = []
    for label, (_, target, marks) in zip(labels, state.edges, strict=True):
        if label is None:
            raise hoa_error(f"state {state.number} mixes edges with and without labels")
        if (marks | state.marks) - {0}:
            raise hoa_error(f"state {state.number}: expected acceptance set 0 only, got {max(marks | state.marks)}")
        if label != FALSE:
            edges.append(_Edge(label, target, bool(marks | state.marks)))
    return edges


def _accepting_sinks(edges: dict[int, list[_Edge]], diagrams: DecisionDiagrams) -> set[int]:
    """Return the states that no letter leaves and whose edges are all marked."""
    return {
        number
        for number, out in edges.items()
        if all(edge.target == number and edge.marked for edge in out)
        and diagrams.disjoin_all(edge.guard for edge in out) == TRUE
    }


def _check_terminal(edges: dict[int, list[_Edge]], sinks: set[int]) -> None:
    """Raise ValueError if an accepting mark does not lead into an accepting sink."""
    for number, out in edges.items():
        for edge in out:
            if edge.marked and edge.target not in sinks:
                raise hoa_error(
                    f"state {number} has an accepting mark that does not lead to an accepting state that no letter "
                    "leaves ([t] loop with the mark): the automaton is not terminal, so its task is not co-safe. Use "
                    'semantics "finite-trace" with a formula, or a bounded task'
                )


def _graph(
    edges: dict[int, list[_Edge]], sinks: set[int], start: int, diagrams: DecisionDiagrams, names: tuple[str, ...]
) -> StateGraph:
    """Return the completed automaton; states are numbered from 1, and 0 is the trap for letters without an edge."""
    mentioned = [start, *edges, *(edge.target for out in edges.values() for edge in out)]
    number = {state: i + 1 for i, state in enumerate(dict.fromkeys(mentioned))}
    # Sinks become absorbing states; guards of the others must not overlap unless their targets agree.
    roots = [diagrams.terminal(0)]
    for state, q in number.items():
        if state in sinks:
            roots.append(diagrams.terminal(q))
            continue
        root = joined_guards(diagrams, [(edge.guard, number[edge.target]) for edge in edges.get(state, [])])
        conflict = diagrams.find(root, CONFLICT)
        if conflict is not None:
            raise hoa_error(
                f"state {state} has edges to different states on the letter {letter_text(conflict, names)}; expected a "
                "deterministic automaton (Spot: option -D)"
            )
        roots.append(completed(diagrams, root, 0))
    return StateGraph(names, diagrams, roots, [False, *(state in sinks for state in number)], number[start])
