"""Synthesis of tasks with propositions about pairs of agents.

By *subtraction* the task without its pairs is certified, and what pairs may spoil is subtracted: any number of agents,
each of which looks at its own state alone. Along *paths* agents of any dynamics are planned together, and each looks at
its own state alone, too. See docs/theory/pairs.md.
"""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np

from ...envs.tasks.problem import Problem
from ..abstraction.models import Relations, Settings, abstraction_of, check_names, join
from ..certificates.proofs import OnGrid, Synthesis
from ..policy_search.ascent import FINAL, Search, find_policies
from ..policy_search.cell_certificates import Plan, along_path, certificate_of
from ..policy_search.portfolio import SOLVED, Results, Strategy, policies_from, refused
from ..relations.grids import CellCounts, RelationRefused, cells_of_agent
from ..trajectories.planning import refuse_without_path
from .base import relevant_pairs, usual_values, without_pairs
from .collision_avoidance import evaluated_by, kept_apart, less_proximity
from .collision_probability import CollisionProbability

WAYS = ("auto", "exact", "path")
"""Relations that a problem with pairs can be asked for; ``exact`` is the bound by subtraction."""

PATH = 0.012
"""Work of paths for each step and state of a team."""

SUBTRACTION = 1e-5
"""Work of subtraction for each cell and step of two agents."""

ENOUGH = 0.99
"""Bound from which no further way is tried."""


def joint_strategies(
    problem: Problem, cells: CellCounts, relation: Relations, plan: Plan, start: OnGrid | None = None
) -> list[Strategy]:
    """Return the ways to certify a problem with pairs.

    ``start`` is a certificate of the task without pairs that the search on grids begins with.
    """
    if problem.groups:
        raise ValueError(
            "`problem`: expected one task where propositions are about pairs, got independent tasks whose joint "
            "automaton would be too large; take the problems of `problem.tasks` one by one"
        )
    if not isinstance(relation, str) or relation not in WAYS:
        raise ValueError(f"`relation`: expected one of {', '.join(WAYS)} for a task about pairs, got {relation!r}")
    check_names("cells", cells, problem)

    def subtraction(results: Results) -> Synthesis:
        if plan.search.stationary:
            raise RelationRefused(
                "what pairs may spoil grows with every step, and nothing is left of a bound by subtraction without a "
                "deadline"
            )
        return by_subtraction(problem, cells, plan.search, plan.settings, start)

    def path(results: Results) -> Synthesis:
        if cells is not None or _asks_for_grid(plan, start is not None):
            raise RelationRefused("paths have no grid, and need no `cells` or start")
        return along_path(problem, plan.along_paths)

    along = Strategy("path", path, 1.0 + PATH * problem.horizon * problem.n_states, ENOUGH, ENOUGH)
    try:
        refuse_without_path(problem)
    except RelationRefused as error:
        along = replace(refused("path", error), work=along.work)
    subtracted = Strategy("exact", subtraction, _subtraction_work(problem), ENOUGH, ENOUGH)
    if subtracted.work > along.work:
        # A path in seconds comes before grids in minutes, which are left out only where nothing is left to gain.
        subtracted, along = replace(subtracted, enough=SOLVED), replace(along, ends=SOLVED)
    if any(pair.moves for pair in problem.labeling.pairs):
        why = RelationRefused("grids know pairs that stand still, got some whose box or distance names the time `t`")
        subtracted = refused("exact", why)
    return [strategy for strategy in (subtracted, along) if relation in ("auto", strategy.name)]


def _subtraction_work(problem: Problem) -> float:
    """Return about how much work grids of all agents are: next to nothing where each has a single state.

    Trees grow with the agents that answer to each other.
    """
    if all(agent.n_states == 1 for agent in problem.agents):
        return 0.0
    cells = sum(float(np.prod(cells_of_agent(agent, None))) for agent in problem.agents)
    return SUBTRACTION * cells * problem.horizon * (problem.n_agents - 1) ** 2


def _asks_for_grid(plan: Plan, has_start: bool) -> bool:
    """Return whether something is asked for that only grids have."""
    return has_start or plan.search.stationary or plan.search.value == "train"


def by_subtraction(
    problem: Problem, cells: CellCounts, search: Search, settings: Settings, start: OnGrid | None = None
) -> Synthesis:
    """Certify the task without pairs, with policies that keep apart, and subtract what pairs may spoil.

    With ``start``, a certificate of the task without pairs, its policies are tried as they are and further on.

    Raises
    ------
    RelationRefused
        If an agent has no ``exact`` relation, or an output that a pair compares is no state.
    """
    began = time.perf_counter()
    usual = usual_values(problem)
    base = without_pairs(problem, usual)
    kinds = ["exact"] * problem.n_agents
    if start is not None and cells is None and len(start.proof.agents) == base.n_agents:
        cells = dict(zip(base.agent_names, (part.grid.shape for part in start.proof.agents), strict=True))
    abstraction = abstraction_of(base, cells, kinds, settings.of_kinds(kinds))
    given = {} if start is None else policies_from(start, base, abstraction)
    joint = replace(join(base, abstraction), finds_alike=True)
    masses = CollisionProbability(problem, base, joint, relevant_pairs(problem), usual)
    abstracted = time.perf_counter()
    search = replace(search, value="train" if search.value == "train" else "tree")
    found = find_policies(base, joint, search, given)
    evaluated = evaluated_by(base, joint, search, found.relaxations)
    tries = [kept_apart(masses, first, search, evaluated) for first in (found.best, *map(evaluated, given.values()))]
    best, near, record = max(tries, key=lambda tried: tried[0].value - tried[1])
    used = {**abstraction.settings, **search.used(), "final_limits": vars(FINAL)}
    name = "occupancy-weighted coordinate ascent, agents in turn answering to where the others are"
    part = certificate_of(base, abstraction, joint, best, used, name)
    certificate = less_proximity(problem, part, usual, near, {**used, "answers": record})
    stats: dict[str, object] = {
        "seconds": {"abstract": abstracted - began, "synthesize": time.perf_counter() - abstracted},
        "sweeps": found.values,
        "rank": part.proof.rank,
        "dropped": best.dropped,
        "near": certificate.proof.near,
    }
    return Synthesis(certificate, certificate.controller, stats)
