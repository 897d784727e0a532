"""Automata built from diagrams, and the same automata over other propositions.

Every automaton is assembled here: the nodes of a diagram manager become the flat arrays of the record. Nodes are
numbered in the order in which they are first met, so equal diagrams give equal arrays and equal fingerprints.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from .automaton import Automaton, checked_names
from .decision_diagram import DecisionDiagrams
from .formula import Formula

FEW_STATES = 64
"""Number of states out of reach that are not worth an automaton of its own."""

NodeMaker = Callable[[DecisionDiagrams, int, int, int], int]
"""Function from a manager, the tested proposition's number and the nodes for false and true to the new node."""


def automaton_from_diagrams(
    propositions: Sequence[str],
    semantics: str,
    state_names: Sequence[str],
    initial: int,
    accepting: Any,
    manager: DecisionDiagrams,
    roots: Sequence[int],
) -> Automaton:
    """Return the automaton whose state q moves by the diagram ``roots[q]`` (exact)."""
    # States share their nodes; terminals become negative entries (see `Automaton`).
    number: dict[int, int] = {}
    for root in roots:
        for n in manager.nodes(root):
            if not manager.is_terminal(n):
                number.setdefault(n, len(number))

    def entry(n: int) -> int:
        return -1 - manager.value(n) if manager.is_terminal(n) else number[n]

    return Automaton(
        propositions=tuple(propositions),
        semantics=semantics,
        state_names=tuple(state_names),
        initial=initial,
        accepting=np.array(accepting, dtype=bool),
        root=np.array([entry(n) for n in roots], dtype=np.int32),
        variable=np.array([manager.variable(n) for n in number], dtype=np.int32),
        low=np.array([entry(manager.low(n)) for n in number], dtype=np.int32),
        high=np.array([entry(manager.high(n)) for n in number], dtype=np.int32),
    )


def over_propositions(automaton: Automaton, order: Sequence[str]) -> Automaton:
    """Return the same automaton over other propositions: reordered, unused ones added or left out (exact).

    Raises
    ------
    ValueError
        If a proposition on which a transition depends is not in `order`.
    """
    order = checked_names("order", order)
    if order == automaton.propositions:
        return automaton
    place = {name: i for i, name in enumerate(order)}
    tested = [automaton.propositions[p] for p in sorted({int(p) for p in automaton.variable})]
    missing = [name for name in tested if name not in place]
    if missing:
        raise ValueError(f"`order`: expected all propositions that the transitions test, {missing[0]!r} is missing")

    def node(manager: DecisionDiagrams, variable: int, low: int, high: int) -> int:
        return manager.choose(place[automaton.propositions[variable]], low, high)

    return _rebuilt(automaton, order, node)


def with_meanings(automaton: Automaton, order: Sequence[str], meanings: Mapping[str, Formula]) -> Automaton:
    """Return the automaton over other propositions that tests what some names mean, where it tested these (exact).

    Parameters
    ----------
    automaton : Automaton
    order : sequence of str
        Propositions of the result.
    meanings : mapping
        For the name of a proposition that is not in `order`: a formula of `order` with `!`, `&` and `|` alone.
    """
    place = {name: i for i, name in enumerate(order)}

    def chosen(manager: DecisionDiagrams, formula: Formula, low: int, high: int) -> int:
        """Return "if the formula then `high` else `low`"."""
        if formula.operator == "atom":
            return manager.choose(place[formula.name], low, high)
        if formula.operator == "!":
            return chosen(manager, formula.operands[0], high, low)
        for operand in reversed(formula.operands):
            # Of a conjunction the operands that hold lead on; of a disjunction those that do not.
            if formula.operator == "&":
                high = chosen(manager, operand, low, high)
            else:
                low = chosen(manager, operand, low, high)
        return high if formula.operator == "&" else low

    def node(manager: DecisionDiagrams, variable: int, low: int, high: int) -> int:
        name = automaton.propositions[variable]
        return chosen(manager, meanings.get(name, Formula("atom", name=name)), low, high)

    return _rebuilt(automaton, order, node)


def within(automaton: Automaton, letters: int) -> Automaton:
    """Return the automaton without the states that no ``letters`` letters reach; those become one that fails (exact).

    An automaton with few such states is returned as it is.
    """
    near = {automaton.initial}
    frontier = [automaton.initial]
    for _ in range(letters):
        if not frontier:
            break
        frontier = [q for q in {r for q in frontier for r in successors(automaton, q)} if q not in near]
        near.update(frontier)
    if automaton.n_states - len(near) <= FEW_STATES:
        return automaton
    kept = sorted(near)
    number = {q: k for k, q in enumerate(kept)}
    manager = DecisionDiagrams()
    nodes: list[int] = [-1] * automaton.variable.size

    def child(entry: int) -> int:
        return nodes[entry] if entry >= 0 else manager.terminal(number.get(-1 - entry, len(kept)))

    for n in np.argsort(-automaton.variable, kind="stable"):
        low, high = child(int(automaton.low[n])), child(int(automaton.high[n]))
        nodes[n] = manager.choose(int(automaton.variable[n]), low, high)
    return automaton_from_diagrams(
        automaton.propositions,
        automaton.semantics,
        [*(automaton.state_names[q] for q in kept), _new_name(automaton)],
        number[automaton.initial],
        [*automaton.accepting[kept], False],
        manager,
        [*(child(int(automaton.root[q])) for q in kept), manager.terminal(len(kept))],
    )


def successors(automaton: Automaton, q: int) -> set[int]:
    """Return the states that some letter leads to from q."""
    seen, stack = set[int](), [int(automaton.root[q])]
    while stack:
        entry = stack.pop()
        if entry not in seen:
            seen.add(entry)
            stack += [] if entry < 0 else [int(automaton.low[entry]), int(automaton.high[entry])]
    return {-1 - entry for entry in seen if entry < 0}


def _new_name(automaton: Automaton) -> str:
    """Return a name that no state has."""
    name = "beyond"
    while name in automaton.state_names:
        name += "_"
    return name


def _rebuilt(automaton: Automaton, order: Sequence[str], node: NodeMaker) -> Automaton:
    """Return the automaton over the propositions `order`, with every node replaced by what `node` makes of it."""
    manager = DecisionDiagrams()
    nodes: list[int] = [-1] * automaton.variable.size

    def child(entry: int) -> int:
        return nodes[entry] if entry >= 0 else manager.terminal(-1 - entry)

    # Children test later propositions than their parents, so they are made first.
    for n in np.argsort(-automaton.variable, kind="stable"):
        low, high = child(int(automaton.low[n])), child(int(automaton.high[n]))
        nodes[n] = node(manager, int(automaton.variable[n]), low, high)
    roots = [child(int(entry)) for entry in automaton.root]
    return automaton_from_diagrams(
        order, automaton.semantics, automaton.state_names, automaton.initial, automaton.accepting, manager, roots
    )
