"""Minimal automata in a canonical order: equal languages give equal arrays.

A `StateGraph` is an automaton under construction. `minimal_automaton` merges states that no word tells apart (Moore's
partition refinement on decision diagrams) and numbers the remaining states breadth first from the initial one, low
before high. The refinement starts from the shortest distances to acceptance and to rejection. These are properties of a
state's language, and they split long chains at once.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from .automaton import Automaton
from .decision_diagram import DecisionDiagrams
from .rebuilt import automaton_from_diagrams


@dataclass(frozen=True)
class StateGraph:
    """An automaton under construction: states with their diagrams, whose terminal values are state indices."""

    propositions: tuple[str, ...]
    diagrams: DecisionDiagrams
    roots: list[int]
    accepting: list[bool]
    initial: int


def saturated(graph: StateGraph) -> StateGraph:
    """Return the co-safe automaton of `graph`: accepting states absorb, and so do states that must reach them.

    A state accepts if all of its successors do, and this is repeated until nothing changes. A state accepts in the end
    if and only if every infinite word from it reaches acceptance (Koenig's lemma). So the result accepts a prefix as
    soon as no continuation can spoil it.
    """
    accepting = list(graph.accepting)
    successors = [graph.diagrams.leaves(root) for root in graph.roots]
    sources = _sources(successors)
    # Count, per state, the successors that do not accept yet; a count that reaches 0 makes the state accept.
    missing = [len(targets) for targets in successors]
    stack = [q for q, accepts in enumerate(accepting) if accepts]
    while stack:
        for q in sources[stack.pop()]:
            missing[q] -= 1
            if missing[q] == 0 and not accepting[q]:
                accepting[q] = True
                stack.append(q)
    roots = [graph.diagrams.terminal(q) if accepting[q] else root for q, root in enumerate(graph.roots)]
    return StateGraph(graph.propositions, graph.diagrams, roots, accepting, graph.initial)


def minimal_automaton(graph: StateGraph, semantics: str, judge_empty_word: bool = True) -> Automaton:
    """Return the minimal complete automaton, its states in canonical order.

    Parameters
    ----------
    graph : StateGraph
        For co-safe semantics its accepting states must be absorbing (`saturated`).
    semantics : str
        Semantics of the result.
    judge_empty_word : bool
        If False, the verdict on the empty word is free: it is chosen such that the automaton is smallest, and rejects
        if both verdicts give the same size. A task is judged on at least one letter, so nothing depends on it.
    """
    # One state stands for each block of equivalent states.
    successors = [graph.diagrams.leaves(root) for root in graph.roots]
    first = [graph.initial] if judge_empty_word else successors[graph.initial]
    states = _reachable(first, successors)
    block = _coarsest_partition(graph, states, successors)
    accepting = {block[q]: graph.accepting[q] for q in states}
    representative = {block[q]: q for q in reversed(states)}
    scratch = DecisionDiagrams()
    roots = _relabelled(graph, scratch, list(representative.values()), block)
    root = {b: roots[q] for b, q in representative.items()}
    if judge_empty_word:
        start = block[graph.initial]
    else:
        # Any state with the transitions of the initial one may stand for it; otherwise it needs a state by itself.
        initial_root = _relabelled(graph, scratch, [graph.initial], block)[graph.initial]
        start = min((b for b in root if root[b] == initial_root), key=lambda b: (accepting[b], b), default=len(root))
        if start == len(root):
            root[start], accepting[start] = initial_root, False
    # Number the states in canonical order, and rebuild their diagrams in a fresh manager.
    order = _reachable([start], {b: scratch.leaves(n) for b, n in root.items()})
    number = {b: i for i, b in enumerate(order)}
    final = DecisionDiagrams()
    memo: dict[int, int] = {}

    def renamed(n: int) -> int | None:
        return final.terminal(number[scratch.value(n)]) if scratch.is_terminal(n) else None

    return automaton_from_diagrams(
        graph.propositions,
        semantics,
        [f"q{i}" for i in range(len(order))],
        0,
        [accepting[b] for b in order],
        final,
        [scratch.rebuild(root[b], final, renamed, memo) for b in order],
    )


def _coarsest_partition(graph: StateGraph, states: list[int], successors: list[list[int]]) -> dict[int, int]:
    """Return the block of each state such that two states share one exactly if no word tells them apart."""
    sources = _sources(successors)
    to_accept = _distances([q for q in states if graph.accepting[q]], sources)
    to_reject = _distances([q for q in states if not graph.accepting[q]], sources)
    block = _numbered({q: (to_accept.get(q, -1), to_reject.get(q, -1)) for q in states})
    count = len(set(block.values()))
    # Split blocks whose states lead to different blocks on some letter, until no block is split.
    while True:
        roots = _relabelled(graph, DecisionDiagrams(), states, block)
        block = _numbered({q: (block[q], roots[q]) for q in states})
        refined = len(set(block.values()))
        if refined == count:
            return block
        count = refined


def _relabelled(
    graph: StateGraph, target: DecisionDiagrams, states: list[int], block: dict[int, int]
) -> dict[int, int]:
    """Return the diagrams of `states` in `target`, with states replaced by their blocks."""
    memo: dict[int, int] = {}
    source = graph.diagrams

    def replace(n: int) -> int | None:
        return target.terminal(block[source.value(n)]) if source.is_terminal(n) else None

    return {q: source.rebuild(graph.roots[q], target, replace, memo) for q in states}


def _numbered(keys: dict[int, tuple[int, int]]) -> dict[int, int]:
    """Return a block number per state: states share one if and only if they share a key."""
    number: dict[tuple[int, int], int] = {}
    return {q: number.setdefault(key, len(number)) for q, key in keys.items()}


def _reachable(first: Sequence[int], successors: Sequence[list[int]] | dict[int, list[int]]) -> list[int]:
    """Return the states reachable from `first`, breadth first."""
    order = list(dict.fromkeys(first))
    seen = set(order)
    for q in order:  # grows while it is read
        for target in successors[q]:
            if target not in seen:
                seen.add(target)
                order.append(target)
    return order


def _sources(successors: list[list[int]]) -> list[list[int]]:
    """Return the states from which some letter leads to each state."""
    sources: list[list[int]] = [[] for _ in successors]
    for q, targets in enumerate(successors):
        for target in targets:
            sources[target].append(q)
    return sources


def _distances(goals: list[int], sources: list[list[int]]) -> dict[int, int]:
    """Return the least number of letters that lead from each state into `goals`; states without a way are left out."""
    distance = dict.fromkeys(goals, 0)
    order = list(goals)
    for target in order:  # grows while it is read: breadth first
        for q in sources[target]:
            if q not in distance:
                distance[q] = distance[target] + 1
                order.append(q)
    return distance
