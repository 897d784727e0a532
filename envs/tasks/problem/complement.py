"""The opposite of a task: what is satisfied, at the horizon, where the task is not.

A run fails when an agent leaves its workspace. So the opposite reads exits: every agent has one more proposition,
which holds in all of its workspace, and outside of it no proposition of the agent holds. An undecided state goes on to
one more state, *lost*, as soon as such a proposition does not hold. That state is not left, and it accepts, as do all
states from which the task can no longer be satisfied. Every run satisfies exactly one of both (docs/theory/bounds.md,
"The other end of any certificate").
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace

import numpy as np

from ...systems.agents import AnyAgent
from ..automata import OPPOSITE, Automaton, automaton_from_diagrams, over_propositions
from ..regions import Proposition
from .joint_noise import refuse_joint_noise
from .record import Problem
from .specification import Specification

LONGEST_TITLE = 190
"""Characters of the name that are kept."""


def complement_of(problem: Problem) -> Problem:
    """Return the problem that is satisfied where the one of ``problem`` is not, exits from workspaces included.

    Its automaton moves as that of ``problem``, under the same numbers, and has one more state, the last one.

    Raises
    ------
    ValueError
        If agents share noise.
    """
    refuse_joint_noise(problem)
    inside = {_fresh(f"inside_{agent.name}", problem): _everywhere(agent) for agent in problem.written_agents}
    return Problem(
        name=f"not {problem.name[:LONGEST_TITLE]}",
        horizon=problem.horizon,
        agents=problem.written_agents,
        propositions={**problem.declared, **inside},
        specification=Specification(automaton=_complement(problem.automaton, tuple(inside))),
    )


def complement_inside(problem: Problem) -> Problem:
    """Return the problem that is satisfied where the one of ``problem`` is not and no agent leaves its workspace.

    No run satisfies both; one that leaves a workspace satisfies neither. Upper ends of earlier versions are about it.

    Raises
    ------
    ValueError
        If agents share noise.
    """
    refuse_joint_noise(problem)
    automaton = replace(problem.automaton, semantics="finite-trace", accepting=~problem.automaton.accepting)
    return Problem(
        name=f"not {problem.name[:LONGEST_TITLE]}",
        horizon=problem.horizon,
        agents=problem.written_agents,
        propositions=problem.declared,
        specification=Specification(automaton=automaton),
    )


def _complement(automaton: Automaton, inside: Collection[str]) -> Automaton:
    """Return the automaton of the opposite task; ``inside`` are the propositions that hold in workspaces."""
    tested = over_propositions(automaton, (*inside, *automaton.propositions))
    manager, roots = tested.diagrams()
    lost = manager.terminal(automaton.n_states)
    decided = np.flatnonzero(automaton.absorbing).tolist()
    for q, root in enumerate(roots):
        if q in decided:
            roots[q] = manager.terminal(q)
            continue
        # Whoever is outside decides, whatever the letters of the others are.
        for k in reversed(range(len(inside))):
            root = manager.node(k, lost, root)
        roots[q] = root
    return automaton_from_diagrams(
        tested.propositions,
        OPPOSITE,
        (*automaton.state_names, _new_name("lost", automaton.state_names)),
        automaton.initial,
        [*~automaton.accepting, True],
        manager,
        [*roots, lost],
    )


def _everywhere(agent: AnyAgent) -> Proposition:
    """Return a region that holds in all of the workspace of an agent."""
    low, high = agent.output_ends
    return Proposition(agent.name, low - np.abs(low) - 1.0, high + np.abs(high) + 1.0)


def _fresh(name: str, problem: Problem) -> str:
    """Return a name that no proposition has."""
    return _new_name(name, (*problem.propositions, *problem.written, *problem.families))


def _new_name(name: str, taken: Collection[str]) -> str:
    while name in taken:
        name += "_"
    return name
