"""What a mixed team's certificate knows of letters, and which states of both automata go together.

Agents along paths keep the letters of their path, pairs of an agent on a grid and one along a path are as usual. So the
automaton of the task and that of the agents on grids read the same letters, but for what the former reads besides.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...envs.logic import Automaton
from ...envs.problem import Problem

NOTHING = 2**31
"""What a state tests, which reads nothing more: it comes after all propositions."""


def known_letters(problem: Problem, paths: Any, usual: NDArray[np.bool_]) -> list[dict[int, bool]]:
    """Return, for each time 0 to S, what is known of propositions that agents on grids do not decide alone.

    Parameters
    ----------
    problem : Problem
        The whole problem.
    paths : Certificate
        Of the agents along paths.
    usual : (number of pairs,) bool array
        What pairs of an agent on a grid and one along a path are taken to be.
    """
    names, of_paths = problem.automaton.propositions, list(paths.problem.automaton.propositions)
    between = dict(pairs_between(problem, paths.problem.agent_names))
    result = []
    for letter in paths.proof.letters:
        known = {between[k]: bool(usual[k]) for k in between}
        for p, name in enumerate(names):
            if name in of_paths and (value := int(letter[of_paths.index(name)])) in (-1, 1):
                known[p] = value > 0
        result.append(known)
    return result


def pairs_between(problem: Problem, on_paths: tuple[str, ...]) -> list[tuple[int, int]]:
    """Return numbers, among pairs and among propositions, of pairs with one agent along a path and one on a grid."""
    labeling, along = problem.labeling, [name in on_paths for name in problem.agent_names]
    numbers = ((k, labeling.first_pair + k) for k in range(len(labeling.pairs)))
    return [(k, p) for k, p in numbers if along[labeling.pairs[k].first] != along[labeling.pairs[k].second]]


def reached_states(problem: Problem, base: Problem, known: list[dict[int, bool]]) -> list[set[tuple[int, int]]]:
    """Return, for times 0 to S, pairs of states in which the automata of a problem and of ``base`` are together."""
    place = {name: p for p, name in enumerate(problem.automaton.propositions)}
    columns = [place[name] for name in base.automaton.propositions]
    if problem.initial_q is None or base.initial_q is None:
        raise ValueError("where an automaton is after the first letter depends on the start")
    reached = [{(problem.initial_q, base.initial_q)}]
    for letters in known[1:]:
        following = set[tuple[int, int]]()
        for q, b in reached[-1]:
            following |= _read_both(problem.automaton, base.automaton, (q, b), columns, letters)
        reached.append(following)
    return reached


def _read_both(
    first: Automaton, second: Automaton, states: tuple[int, int], columns: list[int], known: dict[int, bool]
) -> set[tuple[int, int]]:
    """Return the pairs of states to which letters lead that agree with what is known."""
    found, seen = set[tuple[int, int]](), set[tuple[int, int]]()
    stack = [(int(first.root[states[0]]), int(second.root[states[1]]))]
    while stack:
        pair = stack.pop()
        if pair in seen:
            continue
        seen.add(pair)
        e, f = pair
        if e < 0 and f < 0:
            found.add((-1 - e, -1 - f))
            continue
        here = int(first.variable[e]) if e >= 0 else NOTHING
        there = columns[int(second.variable[f])] if f >= 0 else NOTHING
        tested = min(here, there)
        mine = (int(first.low[e]), int(first.high[e])) if here == tested else (e, e)
        theirs = (int(second.low[f]), int(second.high[f])) if there == tested else (f, f)
        for holds in (False, True):
            if known.get(tested, holds) == holds:
                stack.append((mine[holds], theirs[holds]))
    return found
