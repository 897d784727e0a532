"""The opposite of a task: what is satisfied, at the horizon, where the task is not."""

from __future__ import annotations

from dataclasses import replace

from .joint_noise import refuse_joint_noise
from .record import Problem
from .specification import Specification


def opposite_of(problem: Problem) -> Problem:
    """Return the problem whose task is judged at the horizon, and satisfied where the one of ``problem`` is not.

    Its automaton moves as that of ``problem``, under the same numbers. No run satisfies both; one that leaves a
    workspace satisfies neither.

    Raises
    ------
    ValueError
        If agents share noise.
    """
    refuse_joint_noise(problem)
    automaton = replace(problem.automaton, semantics="finite-trace", accepting=~problem.automaton.accepting)
    return Problem(
        name=f"not {problem.name}",
        horizon=problem.horizon,
        agents=problem.written_agents,
        propositions=problem.declared,
        specification=Specification(automaton=automaton),
    )
