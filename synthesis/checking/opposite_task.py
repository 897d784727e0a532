"""That one task is the opposite of another: same agents, same steps, and acceptance the other way round.

A run that stays in the workspaces satisfies exactly one of both at the horizon, so that what is certified for the
opposite is taken off 1 for an upper bound (docs/theory/networks.md, "The upper end").
"""

from __future__ import annotations

import numpy as np

from ...envs.problem import Problem
from ..certificates import OnGrid

MOVES = ("root", "variable", "low", "high")
"""Arrays of an automaton that say how it moves."""


def wrong_opposite(problem: Problem, opposite: Problem) -> list[str]:
    """Why a task is not the opposite of ``problem`` with the same automaton states; empty if it is."""
    mine, other = problem.automaton, opposite.automaton
    here, there = problem.to_dict(), opposite.to_dict()
    failures = [
        f"its {name} are not those of the task" for name in ("agents", "propositions") if here[name] != there[name]
    ]
    if problem.horizon != opposite.horizon:
        failures.append("its horizon is not that of the task")
    # Networks are told the number of the automaton state: states must move alike under the same numbers.
    same = mine.initial == other.initial and mine.propositions == other.propositions
    if not same or any(not np.array_equal(getattr(mine, name), getattr(other, name)) for name in MOVES):
        failures.append("its automaton does not move like that of the task")
    elif other.is_co_safe or not np.array_equal(mine.accepting, ~other.accepting):
        failures.append("it does not accept at the horizon what the task rejects")
    return failures


def other_controllers(certificate: OnGrid, opposite: OnGrid) -> list[str]:
    """Why the controllers of two certificates act differently before the task of the first is decided; empty if not.

    What they do afterwards changes nothing: an accepting state of a co-safe task, or a dead state, is not left.
    """
    if len(certificate.proof.agents) != len(opposite.proof.agents):
        return ["they are not the same agents"]
    undecided = np.flatnonzero(~certificate.problem.automaton.absorbing)
    horizon, failures = certificate.problem.horizon, []
    for agent, mine, other in zip(
        certificate.problem.agents, certificate.proof.agents, opposite.proof.agents, strict=True
    ):
        ours, theirs = ([part.coordinates, *part.grid.edges, *part.lattice] for part in (mine, other))
        same = len(ours) == len(theirs) and all(map(np.array_equal, ours, theirs)) and mine.acting == other.acting
        if mine.menu is None or other.menu is None:
            same = same and mine.menu is other.menu
        else:
            same = same and np.array_equal(mine.menu, other.menu)
        shape = (horizon, *mine.policy.shape[1:])
        if not same or not np.array_equal(
            np.broadcast_to(mine.policy, shape)[:, undecided], np.broadcast_to(other.policy, shape)[:, undecided]
        ):
            failures.append(f"agent `{agent.name}` does not act as it does under the certificate")
    return failures
