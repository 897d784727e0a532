"""The task whatever agents do that nobody steers: for words that ask nothing of them.

A call comes at a random time, and what it asks for has to be done soon after. Hardly any run reads a word that says
when the call comes; one that says where the agents are that hear it may be accepted whenever it comes. Such words have
an automaton of their own. Its states are sets of states of that of the task: all to which letters lead that agree with
what is read of the steered (Rabin and Scott's construction, where every branch has to be accepted).
"""

from __future__ import annotations

import numpy as np

from ....envs.systems.agents import AnyAgent
from ....envs.tasks.automata import Automaton, automaton_from_diagrams
from ....envs.tasks.problem import Problem, Specification
from ..chance_constraints import corners_along
from .accepted_words import without_needless
from .automaton_paths import Plan
from .timed_words import fastest_moves, spans_of

MOST_SETS = 2_000
"""Sets of states beyond which no words are looked for in this way."""

States = frozenset[int]


def whatever_others_do(problem: Problem) -> Problem | None:
    """Return the problem with the task that nothing is asked of agents nobody steers; None where there is none.

    There is none where all agents are steered, or nothing of the task is about the others, or no word is accepted
    whatever they do.
    """
    start, left_alone = problem.initial_q, set[int]()
    for agent, own in zip(problem.agents, problem.labeling.agent_propositions, strict=True):
        if _is_left_alone(agent):
            left_alone |= {int(p) for p in own}
    left_alone &= {int(p) for p in problem.automaton.variable}
    if start is None or not left_alone:
        return None
    automaton = _of_sets(problem.automaton, start, left_alone)
    if automaton is None or automaton.dead[1]:
        return None
    result = Problem(
        name=problem.name,
        horizon=problem.horizon,
        agents=problem.agents,
        propositions=problem.propositions,
        specification=Specification(automaton=automaton),
        joint_noise=dict(problem.joint_noise) or None,
    )
    return result if result.labeling.names == problem.labeling.names else None


class Reach:
    """Where outputs may be at each time, as far as their largest moves say: a word may ask for a region too soon."""

    def __init__(self, problem: Problem) -> None:
        self.problem, self.names = problem, problem.labeling.names
        self.moves = [fastest_moves(agent) * spans_of(agent) for agent in problem.agents]
        self.corners = {
            int(p): corners_along(problem, self.names[p], problem.horizon + 1)
            for own in problem.labeling.agent_propositions
            for p in own
        }

    def has(self, plan: Plan) -> bool:
        """Return whether all regions that a plan asks for may be in reach, one axis by itself."""
        problem = self.problem
        letters = plan.way.letters(plan.times, plan.steps, len(self.names))
        if letters is None:
            return False
        letters = without_needless(problem, letters)
        for agent, own, move in zip(problem.agents, problem.labeling.agent_propositions, self.moves, strict=True):
            centre = agent.outputs(0.5 * (agent.initial.low + agent.initial.high)[:, None])[:, 0]
            low, high = centre, centre
            for t in range(1, len(letters)):
                low, high = low - move, high + move
                for p in own[letters[t, own] > 0]:
                    first, last = self.corners[int(p)]
                    low, high = np.maximum(low, first[t]), np.minimum(high, last[t])
                if np.any(low > high):
                    return False
        return True


def _is_left_alone(agent: AnyAgent) -> bool:
    """Return whether an agent goes its own way at random."""
    steered = bool(np.any(agent.input_low < agent.input_high))
    return not steered and bool(np.any(agent.noise_covariance)) and not getattr(agent, "others", ())


def _of_sets(automaton: Automaton, start: int, left_alone: set[int]) -> Automaton | None:
    """Return the automaton of sets; None if it has too many.

    State 0 reads the letter of the start, whatever it is, and state 1 is the set of the state after that letter.
    """
    manager, roots = automaton.diagrams()
    sets: list[States] = []
    numbers: dict[States, int] = {}
    accepting = frozenset(np.flatnonzero(automaton.accepting).tolist())
    memo: dict[tuple[int, int], int] = {}
    merged: dict[int, int] = {}

    def number(states: States) -> int:
        """Return the number of a set in the new automaton; what is lost for one is lost for all."""
        if any(automaton.dead[q] for q in states):
            states = frozenset()
        elif automaton.is_co_safe and states and states <= accepting:
            states = accepting
        if states not in numbers:
            numbers[states] = len(sets) + 1
            sets.append(states)
        return numbers[states]

    def both(first: int, second: int) -> int:
        states = sets[first - 1], sets[second - 1]
        return number(states[0] | states[1] if all(states) else frozenset())

    def of_state(root: int) -> int:
        """Return the diagram to sets below a node, without the tests of propositions that are left alone."""
        # Children test later propositions than their parents, so they come first.
        for node in sorted(manager.nodes(root), key=manager.variable, reverse=True):
            if node in merged:
                continue
            if manager.is_terminal(node):
                merged[node] = manager.terminal(number(frozenset({manager.value(node)})))
                continue
            low, high = merged[manager.low(node)], merged[manager.high(node)]
            p = manager.variable(node)
            merged[node] = manager.apply(both, low, high, memo) if p in left_alone else manager.node(p, low, high)
        return merged[root]

    first = number(frozenset({start}))
    assert first == 1
    made: list[int] = []
    while len(made) < len(sets):
        if len(sets) > MOST_SETS:
            return None
        states = sorted(sets[len(made)])
        own = len(made) + 1
        if not states or (automaton.is_co_safe and sets[len(made)] == accepting):
            made.append(manager.terminal(own))
            continue
        diagram = of_state(roots[states[0]])
        for q in states[1:]:
            diagram = manager.apply(both, diagram, of_state(roots[q]), memo)
        made.append(diagram)
    accepts = [False, *(bool(states) and states <= accepting for states in sets)]
    names = [f"set{k}" for k in range(len(accepts))]
    roots = [manager.terminal(first), *made]
    return automaton_from_diagrams(automaton.propositions, automaton.semantics, names, 0, accepts, manager, roots)
