"""Synthesis of mixed teams: agents with few states on grids, the others along paths, and pairs between them.

The whole team is planned along paths first. Agents that are for grids are then taken off their paths: while the others
keep theirs, the task of the rest is a task on grids, whose policies answer to where the others are at each time. What
pairs of both kinds may spoil is subtracted. See docs/theory/pairs.md, "Mixed teams".
"""

from __future__ import annotations

import time
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from ..envs.problem import Problem
from .agreement import agreed_mixed, agreed_path
from .cells import CellCounts, RelationRefused, cells_of_agent
from .certificates import AlongPath, Certificate, MixedProof, Synthesis, known_letters, reached_states
from .certification import certificate_of
from .choosing import SOLVED, Way, refused
from .keeping_apart import evaluated_by, kept_apart, less_nearness
from .models import abstraction_of, join
from .nominal_paths import certified_paths, refuse_without_path
from .on_cells import Plan
from .pairs import (
    BesidePaths,
    Marginals,
    NearMass,
    agents_on_grids,
    part_of,
    relevant_pairs,
    task_on_grids,
    usual_values,
    what_asks,
    without_pairs,
)
from .search import FINAL, find_policies

PATH, GRID = 0.03, 2e-5
"""Work of paths for each step and state of a team, and of grids for each cell and step."""

MIXED_ENDS = 0.99
"""Bound from which a mixed team is not tried, or nothing after it."""


def mixed_way(problem: Problem, cells: CellCounts, plan: Plan) -> Way:
    """Return the way of mixed teams: some agents on grids, the others along paths."""
    try:
        on_grids = agents_on_grids(problem)
        refuse_without_path(problem)
    except RelationRefused as error:
        return refused("mixed", error)
    sizes = sum(float(np.prod(cells_of_agent(problem.agents[i], None))) for i in on_grids)
    work = 1.0 + problem.horizon * (PATH * problem.n_states + GRID * sizes * len(on_grids) ** 2)
    run = partial(mixed_certificate, problem, cells, plan)
    return Way("mixed", lambda results: run(), work, enough=MIXED_ENDS, ends=SOLVED)


def mixed_certificate(problem: Problem, cells: CellCounts, plan: Plan) -> Synthesis:
    """Return a certificate of a mixed team, with its controllers.

    Raises
    ------
    RelationRefused
        If the team is not mixed, no paths are found, or an agent or a pair is not for the bound by subtraction.
    """
    began = time.perf_counter()
    on_grids = agents_on_grids(problem)
    on_paths = [i for i in range(problem.n_agents) if i not in on_grids]
    paths, whereabouts = certified_paths(
        problem, on_paths, lambda steps: part_of(problem, on_paths, steps, None), plan.along_paths
    )
    paths = agreed_path(paths)
    if paths.lower_bound <= 0.0:
        raise RelationRefused("the paths of a mixed team keep to their letters with no probability that is proved")
    usual = usual_values(problem)
    known = known_letters(problem, paths, usual)
    grids = task_on_grids(problem, on_grids, known)
    reached = reached_states(problem, grids, known)
    asked = what_asks(grids, reached, relevant_pairs(problem))
    places = {i: Marginals(*each) for i, each in zip(on_paths, whereabouts, strict=True)}
    beside = BesidePaths(problem, on_grids, places, usual, asked)
    part, near, stats = _on_grids(grids, beside, cells, plan)
    certificate = agreed_mixed(_mixed(problem, part, paths, tuple(usual.tolist()), near))
    try:
        certificate.controller  # noqa: B018 controllers have to know which state of the task on grids they are in
    except ValueError as error:
        raise RelationRefused(str(error)) from None
    stats["seconds"] = {"abstract": 0.0, "synthesize": time.perf_counter() - began}
    held: Any = certificate
    return Synthesis(held, held.controller, stats)


def _mixed(
    problem: Problem,
    part: Certificate,
    paths: AlongPath,
    usual: tuple[bool, ...],
    near: float,
) -> Certificate[MixedProof]:
    """Return the certificate of a team; at its start pairs of both kinds of agents have to be as usual."""
    first = problem.labeling.first_pair
    letter = problem.labeling.at(0).letter([agent.initial.low for agent in problem.agents])
    asks = relevant_pairs(problem)[problem.automaton.initial]
    if np.any((letter[first:] != np.array(usual, dtype=bool)) & asks):
        raise RelationRefused("a pair of a mixed team is not as it should be at the start")
    settings = {**part.settings, "relation": "mixed", "weakest": paths.settings["weakest"]}
    return Certificate(problem, MixedProof(part, paths, usual, min(1.0, near)), settings)


def _on_grids(
    grids: Problem, beside: BesidePaths, cells: CellCounts, plan: Plan
) -> tuple[Certificate, float, dict[str, Any]]:
    """Return the certificate of the agents on grids, what pairs with others may spoil at most, and statistics."""
    pairs = bool(grids.labeling.pairs)
    usual = usual_values(grids)
    base = without_pairs(grids, usual) if pairs else grids
    kinds, search = ["exact"] * grids.n_agents, replace(plan.search, value="tree")
    own = {name: cells[name] for name in grids.agent_names if name in cells} if isinstance(cells, dict) else cells
    abstraction = abstraction_of(base, own, kinds, plan.settings.of_kinds(kinds))
    joint = replace(join(base, abstraction, search.device), finds_alike=True)
    masses = NearMass(grids, base, joint, relevant_pairs(grids), usual, beside)
    found = find_policies(base, joint, search)
    best, near, record = kept_apart(masses, found.best, search, evaluated_by(base, joint, search, found.relaxations))
    among, between = masses.bounds(best.policies) if np.isfinite(near) else (1.0, 1.0)
    used = {**abstraction.settings, **search.used(), "final_limits": vars(FINAL), "answers": record}
    name = "occupancy-weighted coordinate ascent, agents in turn answering to where the others are"
    part: Any = certificate_of(base, abstraction, joint, best, used, name)
    part = less_nearness(grids, part, usual, among, used) if pairs else part
    stats: dict[str, Any] = {
        "sweeps": found.values, "rank": part.proof.rank, "dropped": best.dropped, "near": between, "starts": {},
        **dict.fromkeys(("abstract_upper_bound", "continuous_upper_bound", "unilateral_gain")),
    }  # fmt: skip
    return part, between, stats
