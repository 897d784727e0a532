"""When grids whose vertices have inputs are tried, and the way that does it: what cells and paths know less closely."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...envs.systems.agents import Agent
from ...envs.tasks.problem import Problem
from ..abstraction.models import reaches_every_mean
from ..certificates.proofs import Synthesis
from ..policy_search.cell_certificates import Plan
from ..policy_search.portfolio import SOLVED, Results, Strategy, has_linear_cells, refused
from ..policy_search.vertex_values import (
    refuse_vertex_grid,
    refuse_vertex_team,
    refuse_without_guess,
    vertex_grid_certificate,
    vertex_team_certificate,
)
from ..relations.grids import RelationRefused

MOST_GRID_STATES = 3
"""States of an agent up to which it has a grid by default; certificates along a path need none."""

MOST_STILL_STATES = 2
"""States up to which grids of vertices are tried where some have no noise, by default."""

SHARE_OF_VERTICES = 0.9
"""Share of the effort that is left, which grids of vertices may take before others are tried."""


def may_have_vertices(problem: Problem) -> bool:
    """Return whether the noise is large enough for a grid of vertices, wherever runs are."""
    try:
        refuse_without_guess(problem)
    except RelationRefused:
        return False
    return True


def has_other_noise(problem: Problem) -> bool:
    """Return whether the problem is of one agent with noise that linear cells do not know: of other laws or sizes."""
    agent = problem.agents[0]
    return problem.n_agents == 1 and (agent.noise_scale is not None or agent.laws is not None)


def moves_with_runs(problem: Problem) -> bool:
    """Return whether one agent has a grid of vertices only if it moves with runs: of three states, or with angles."""
    agent, least = problem.agents[0], MOST_STILL_STATES if problem.agents[0].angles else MOST_GRID_STATES
    is_alone = problem.n_agents == 1 and least <= agent.n_states <= MOST_GRID_STATES
    return is_alone and not has_other_noise(problem)


def has_shared_noise(problem: Problem) -> bool:
    """Return whether both states of one agent share noise, which grids of vertices take apart."""
    agent = problem.agents[0]
    return problem.n_agents == 1 and agent.n_states == MOST_STILL_STATES and not agent.has_independent_noise


def has_vertices_only(problem: Problem) -> bool:
    """Return whether no cells but vertices know the noise of one agent closely: of other laws, or partly none."""
    agent = problem.agents[0]
    is_still = agent.n_states <= MOST_STILL_STATES and bool(np.any(agent.still_axes)) and not reaches_every_mean(agent)
    return has_other_noise(problem) or (problem.n_agents == 1 and is_still)


def is_disturbed(problem: Problem) -> bool:
    """Return whether one agent has few states, all with noise, and disturbances: vertices know the worst of them."""
    agent = problem.agents[0]
    few = problem.n_agents == 1 and agent.n_states <= MOST_STILL_STATES and not has_vertices_only(problem)
    return few and isinstance(agent, Agent) and bool(agent.disturbances)


def vertex_strategy(problem: Problem, plan: Plan) -> Strategy:
    """Return the way on grids whose vertices have inputs: agents with few states, noise of any size."""
    # Where the size of noise varies, or its law is another one, or it is beside disturbances, paths say little.
    alone, is_team = has_other_noise(problem) or is_disturbed(problem), problem.n_agents > 1
    try:
        (refuse_vertex_team if is_team else refuse_without_guess if alone else refuse_vertex_grid)(problem)
    except RelationRefused as error:
        return refused("vertices", error)
    effort, certificate_on = plan.effort, vertex_team_certificate if is_team else vertex_grid_certificate
    # What is told is proved, and Ctrl-C keeps it.
    work = replace(plan.along_paths, told=effort.tell_bound)

    def run(results: Results) -> Synthesis:
        with work.within(SHARE_OF_VERTICES * work.limit):
            path = None if is_disturbed(problem) else results.get("path")
            work.largest = max(work.largest, path.certificate.lower_bound if path else 0.0)
            found = certificate_on(problem, work, path.controller if path else None)
        effort.is_interrupted |= work.is_interrupted
        effort.spent += work.spent
        return found

    # Where a path does well it takes a fraction of the time; on a line, with disturbances, grids take a second.
    is_quick = is_disturbed(problem) and problem.agents[0].n_states == 1
    return Strategy("vertices", run, enough=SOLVED, after="" if is_quick else "path")


def has_vertices_of_team(problem: Problem) -> bool:
    """Return whether agents of a team have few states, and one has disturbances, or noise that only boxes know."""
    if problem.n_agents == 1 or any(agent.n_states > MOST_STILL_STATES for agent in problem.agents):
        return False
    return any(
        agent.disturbances or not (has_linear_cells(agent) or (reaches_every_mean(agent) and agent.noise_scale is None))
        for agent in problem.agents
    )


def beside_vertices(results: Results) -> str | None:
    """Return why boxes are left out beside a grid of vertices."""
    return "skipped: vertices bound values more closely" if "vertices" in results else None


def moving_strategy(problem: Problem, plan: Plan) -> Strategy:
    """Return the way on grids of vertices that move with the runs of a path, where there is one."""

    def why_not(results: Results) -> str | None:
        return None if "path" in results else "skipped: there is no path that a grid could move along"

    return replace(vertex_strategy(problem, plan), why_not=why_not)
