"""The same task with every proposition about pairs taken as what it usually is: false, or true where that is wanted."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...envs.tasks.automata import Automaton
from ...envs.tasks.problem import Problem, Specification
from ...envs.tasks.regions import Proposition
from ..relations.grids import RelationRefused, refuse_shared_noise


def usual_values(problem: Problem) -> NDArray[np.bool_]:
    """Return what each proposition about a pair is taken to be: bool (number of pairs,).

    It is false, unless the task cannot be satisfied by any word in which it always is.
    """
    automaton, first = problem.automaton, problem.labeling.first_pair
    result = np.zeros(len(problem.labeling.pairs), dtype=bool)
    for k in range(len(result)):
        result[k] = not _can_accept(automaton, first + k)
    return result


def _can_accept(automaton: Automaton, never: int) -> bool:
    """Return whether some word, which has a letter at least, in which one proposition never holds is accepted."""
    states, met, stack = set[int](), set[int](), [int(automaton.root[automaton.initial])]
    while stack:
        entry = stack.pop()
        if entry < 0:
            if -1 - entry not in states:
                states.add(-1 - entry)
                stack.append(int(automaton.root[-1 - entry]))
        elif entry not in met:
            met.add(entry)
            stack.append(int(automaton.low[entry]))
            stack += [] if automaton.variable[entry] == never else [int(automaton.high[entry])]
    return any(automaton.accepting[q] for q in states)


def without_pairs(problem: Problem, usual: NDArray[np.bool_]) -> Problem:
    """Return the problem whose automaton takes all propositions about pairs as usual; its states keep their numbers.

    As long as all pairs are as usual, both automata are in the same state.

    Raises
    ------
    RelationRefused
        If states cannot keep their numbers: too many of them are out of reach without the pairs.
    """
    refuse_shared_noise(problem)
    first = problem.labeling.first_pair
    automaton = _cut(problem.automaton, first, usual)
    result = Problem(
        name=f"{problem.name[:180]} without pairs",
        horizon=problem.horizon,
        agents=problem.agents,
        propositions={name: p for name, p in problem.propositions.items() if isinstance(p, Proposition)},
        specification=Specification(automaton=automaton),
    )
    if not np.array_equal(result.automaton.root, automaton.root):
        raise RelationRefused("without pairs, too many states of the task's automaton are out of reach")
    return result


def _cut(automaton: Automaton, first: int, usual: NDArray[np.bool_]) -> Automaton:
    """Return the automaton over the propositions before ``first``, all later ones taken as usual."""
    kept = np.flatnonzero(automaton.variable < first)
    number = np.full(automaton.variable.size, -1)
    number[kept] = np.arange(len(kept))

    def entries(given: NDArray[np.int32]) -> NDArray[np.int32]:
        at = given.astype(np.int64)
        # Propositions about pairs are tested last, so their nodes lie below all others.
        while True:
            inner = np.flatnonzero(at >= 0)
            pairs = inner[automaton.variable[at[inner]] >= first]
            if not len(pairs):
                break
            node = at[pairs]
            holds = usual[automaton.variable[node] - first]
            at[pairs] = np.where(holds, automaton.high[node], automaton.low[node])
        at[at >= 0] = number[at[at >= 0]]
        return at.astype(np.int32)

    return Automaton(
        propositions=automaton.propositions[:first],
        semantics=automaton.semantics,
        state_names=automaton.state_names,
        initial=automaton.initial,
        accepting=automaton.accepting,
        root=entries(automaton.root),
        variable=automaton.variable[kept],
        low=entries(automaton.low[kept]),
        high=entries(automaton.high[kept]),
    )


def relevant_pairs(problem: Problem) -> NDArray[np.bool_]:
    """Return which pairs the automaton asks about in each of its states: bool (Q, number of pairs)."""
    automaton, first = problem.automaton, problem.labeling.first_pair
    result = np.zeros((automaton.n_states, len(problem.labeling.pairs)), dtype=bool)
    for q, root in enumerate(automaton.root.tolist()):
        stack, met = [root], set[int]()
        while stack:
            entry = stack.pop()
            if entry < 0 or entry in met:
                continue
            met.add(entry)
            if automaton.variable[entry] >= first:
                result[q, automaton.variable[entry] - first] = True
            stack += [int(automaton.low[entry]), int(automaton.high[entry])]
    return result
