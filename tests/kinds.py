"""Which cases are asked for at every commit: problems that have every trait once, and the first cases of many."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import pytest

import certigym as cg


def mostly_thorough(names: str | tuple[str, ...], cases: Iterable[Any], first: int = 1, **options: Any) -> Any:
    """``pytest.mark.parametrize``, of which ``make test`` runs the first cases and ``make thorough`` all others."""
    is_one = isinstance(names, str) and "," not in names
    marked = [
        case if i < first else pytest.param(*([case] if is_one else case), marks=pytest.mark.thorough)
        for i, case in enumerate(cases)
    ]
    return pytest.mark.parametrize(names, marked, **options)


def traits_of(problem: cg.Problem) -> tuple[Any, ...]:
    """What environments distinguish: motion, team, winds, neighbours, inputs, pairs, time and semantics."""
    agents = problem.agents
    return (
        frozenset(type(agent) for agent in agents),
        len(agents) > 1,
        any(isinstance(agent, cg.Agent) and agent.disturbances for agent in agents),
        any(isinstance(agent, cg.Agent) and agent.others for agent in agents),
        any(agent.n_inputs < agent.n_states for agent in agents),
        all(agent.has_identity_output for agent in agents),
        len({(agent.n_states, agent.n_inputs) for agent in agents}) > 1,
        bool(problem.labeling.pairs),
        problem.names_time,
        problem.automaton.semantics,
    )


def ids_of_kinds() -> list[str]:
    """The id with the fewest states and steps for each trait, in the order of the suite."""
    problems = {id: cg.make_problem(id) for id in cg.problem_ids()}
    found: dict[tuple[int, Any], str] = {}
    for id in sorted(problems, key=lambda id: problems[id].n_states * problems[id].horizon):
        for trait in enumerate(traits_of(problems[id])):
            found.setdefault(trait, id)
    return [id for id in problems if id in found.values()]


IDS_OF_KINDS = ids_of_kinds()


ALL_IDS = [id if id in IDS_OF_KINDS else pytest.param(id, marks=pytest.mark.thorough) for id in cg.problem_ids()]
"""Every id: those of kinds at every commit, the others in `make thorough`."""
