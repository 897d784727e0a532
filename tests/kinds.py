"""Problems that have every trait once: each way to move and each way to be judged, in place of all their products."""

from __future__ import annotations

from typing import Any

import certigym as cg


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
