"""Minimal automata in a canonical order: equal languages give equal arrays.

A `StateGraph` is an automaton under construction. `minimal_automaton` merges states that no word tells apart
(Moore's partition refinement on decision diagrams) and numbers what is left breadth first from the initial state,
low before high. The refinement starts from the shortest distances to acceptance and to rejection, which are
properties of a state's language and split long chains at once.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from .automaton import Automaton
from .decision_diagram import DecisionDiagrams
from .rebuilt import automaton_from_diagrams


@dataclass(frozen=True)
class StateGraph:
    """States with their diagrams; terminal values are state indices."""

    propositions: tuple[str, ...]
    diagrams: DecisionDiagrams
    roots: list[int]
    accepting: list[bool]
    initial: int


def minimise(automaton: Automaton) -> Automaton:
    """Return the minimal automaton of the same language and semantics, with states named anew."""
    diagrams, roots = automaton.diagrams()
    graph = StateGraph(automaton.propositions, diagrams, roots, list(automaton.accepting), automaton.initial)
    return minimal_automaton(graph, automaton.semantics)


def saturated(graph: StateGraph) -> StateGraph:
    """Return the co-safe automaton of `graph`: accepting states absorb, and so does what must reach them.

    A state all of whose successors accept, accepts, until nothing changes: exactly then does every infinite word
    from the state reach acceptance (Koenig), so the result accepts a prefix as soon as no continuation can spoil it.
    """
    accepting = list(graph.accepting)
    successors = [graph.diagrams.leaves(root) for root in graph.roots]
    sources = _sources(successors)
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
        If False, whether the empty word is accepted is free, and chosen such that the automaton is smallest
        (rejected where both do). A task is judged on at least one letter, so nothing depends on it.
    """
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
        own = _relabelled(graph, scratch, [graph.initial], block)[graph.initial]
        start = min((b for b in root if root[b] == own), key=lambda b: (accepting[b], b), default=len(root))
        if start == len(root):
            root[start], accepting[start] = own, False
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
    sources: list[list[int]] = [[] for _ in successors]
    for q, targets in enumerate(successors):
        for target in targets:
            sources[target].append(q)
    return sources


def _distances(goals: list[int], sources: list[list[int]]) -> dict[int, int]:
    """Return the least number of letters that lead from each state into `goals`, where there is one."""
    distance = dict.fromkeys(goals, 0)
    order = list(goals)
    for target in order:
        for q in sources[target]:
            if q not in distance:
                distance[q] = distance[target] + 1
                order.append(q)
    return distance
