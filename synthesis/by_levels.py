"""Which cells to search on: levels of linear cells, finer levels of other relations, or the cells that are given."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from ..envs.agents import Agent
from ..envs.problem import Problem
from .cells import CellCounts, RelationRefused, cells_of_agent
from .certificates import Synthesis
from .choosing import (
    GOOD,
    GUESSED_RANK,
    MOST_LINEAR_AGENTS,
    SOLVED,
    Run,
    finer_levels,
    first_cells,
    has_linear_cells,
    least_above,
    linear_levels,
    seconds_of,
)
from .models import (
    Abstraction,
    Policies,
    Settings,
    abstraction_of,
    join,
    reaches_every_mean,
)
from .on_cells import Plan, compared, plain, searched, with_record
from .search import Limits
from .values import HOST

MOST_LINEAR_TERMS = 32
"""Terms of the value trees of further agents up to which linear cells, which pay for every term, are tried."""


MOST_SECONDS_GIVEN = 60.0
"""Estimate up to which linear cells are tried on cells that were given, next to other relations."""

GOOD_CARRIED = 0.5
"""Share of the upper bound from which policies of coarser cells are gone on with alone: those tried many starts."""


def may_be_linear(problem: Problem, kinds: Sequence[str], plan: Plan) -> bool:
    """Return whether cells and relation are left to us, and linear cells are worth trying first.

    Every agent must have noise in all of its states. Trees of many agents grow many terms, each of which costs linear
    agents something: tensor trains on other relations are better there.
    """
    if not has_usual_search(plan):
        return False
    if {*kinds} == {"linear"}:
        return True
    if not all(map(has_linear_cells, problem.agents)):
        return False
    scalar = all(agent.n_states == 1 and not isinstance(agent, Agent) for agent in problem.agents)
    few = problem.n_agents <= MOST_LINEAR_AGENTS or scalar or has_few_written_terms(problem)
    return {*kinds} == {"auto"} and few and replace(plan.settings, targets_per_cell=None) == Settings()


def has_few_written_terms(problem: Problem) -> bool:
    """Return whether agents by expressions that are alike, but for a few, have a task of one undecided state.

    Trees of such tasks mostly have a single term, and what is read for one agent holds for all that are alike.
    """
    written = all(isinstance(agent, Agent) for agent in problem.agents)
    kinds = {agent.model_key for agent in problem.agents}
    return written and len(kinds) <= MOST_LINEAR_AGENTS and int((~problem.automaton.absorbing).sum()) == 1


def has_usual_search(plan: Plan) -> bool:
    """Return whether nothing was said about the search that levels of cells would not heed."""
    search = plan.search
    return not (search.stationary or search.value == "train" or search.device != HOST or search.limits != Limits())


def by_levels(problem: Problem, kinds: Sequence[str], plan: Plan) -> Synthesis:
    """Return the better of what linear cells, made finer level by level, and the other relations certify."""
    began = time.perf_counter()
    run = _run_of_levels(problem, plan)
    if "auto" in kinds and problem.n_agents > MOST_LINEAR_AGENTS and not has_few_written_terms(problem):
        # The other relations are quick for single states, and show whether the tree grows many terms.
        first = compared(problem, None, kinds, plan)
        if first.certificate.rank > MOST_LINEAR_TERMS or first.certificate.rounding is not None:
            return first if first.certificate.lower_bound >= GOOD else _doubled(problem, kinds, plan, first)
    exact = _exact(problem, kinds, plan)
    if exact is not None and exact.certificate.lower_bound >= SOLVED:
        return exact
    linear, record = linear_levels(problem, plan.settings, run)
    if linear is None and any(isinstance(agent, Agent) for agent in problem.agents):
        return finer(problem, kinds, plan)
    if linear is None:
        return compared(problem, None, kinds, plan) if "auto" in kinds else plain(problem, None, kinds, plan)
    best = linear
    tried: dict[str, Any] = {"linear": linear.certificate.lower_bound}
    is_scalar = all(agent.n_states == 1 for agent in problem.agents)
    if "auto" in kinds and (linear.certificate.lower_bound < GOOD or is_scalar):
        try:
            other = _others(problem, kinds, plan)
        except ValueError as refusal:
            tried["others"] = str(refusal)
        else:
            kind = other.certificate.settings["relation"]
            tried |= other.stats.get("tried", {kind: other.certificate.lower_bound})  # type: ignore[call-overload]
            best = max(linear, other, key=lambda result: result.certificate.lower_bound)
            best = replace(best, stats={**best.stats, **least_above(linear, other)})
    if exact is not None:
        tried.setdefault("exact", exact.certificate.lower_bound)
        best = max(best, exact, key=lambda result: result.certificate.lower_bound)
    more = {"levels": record} if best.certificate is linear.certificate else {}
    return with_record(best, {**more, "relations_tried": tried}, began)


def _exact(problem: Problem, kinds: Sequence[str], plan: Plan) -> Synthesis | None:
    """Return what exact relations certify for agents of several states whose inputs reach all means, or None.

    That takes a tenth of the time of linear cells, and often nothing is left to gain. Linear agents have default cells;
    those with expressions, whose targets are judged one by one, half as many along each axis.
    """
    many = any(agent.n_states > 1 for agent in problem.agents)
    if not (many and {*kinds} == {"auto"} and all(map(reaches_every_mean, problem.agents))):
        return None
    halves = {
        agent.name: tuple(-(-n // 2) for n in cells_of_agent(agent, None))
        for agent in problem.agents
        if isinstance(agent, Agent)
    }
    try:
        return plain(problem, halves or None, ["exact"] * problem.n_agents, plan)
    except RelationRefused:
        return None


def on_given_cells(problem: Problem, cells: CellCounts, kinds: Sequence[str], plan: Plan) -> Synthesis:
    """Return the best that relations certify on given cells; linear ones are tried where the others leave much open."""
    began = time.perf_counter()
    first = compared(problem, cells, kinds, plan)
    usual = ["auto" if kind == "best" else kind for kind in kinds]
    every = "best" in kinds
    if (
        cells is None
        or not may_be_linear(problem, usual, plan)
        or (first.certificate.lower_bound >= GOOD and not every)
    ):
        return first
    kind = first.certificate.settings["relation"]
    tried: dict[str, Any] = dict(first.stats.get("tried", {kind: first.certificate.lower_bound}))  # type: ignore[call-overload]
    if "linear" in tried:
        return first
    try:
        abstraction = abstraction_of(problem, cells, ["linear"] * problem.n_agents, plan.settings)
    except RelationRefused as refusal:
        return with_record(first, {"relations_tried": tried | {"linear": " ".join(str(refusal).split())}}, began)
    undecided = int((~problem.automaton.absorbing).sum())
    seconds = seconds_of(abstraction, problem.horizon, undecided, 1 if problem.n_agents == 1 else GUESSED_RANK)
    if seconds > MOST_SECONDS_GIVEN and not every:
        too_long = f"about {seconds:.0f} s, not computed: ask for it by `relation`"
        return with_record(first, {"relations_tried": tried | {"linear": too_long}}, began)
    joint = join(problem, abstraction, plan.search.device)
    linear = searched(problem, abstraction, joint, plan.search, {})
    tried["linear"] = float(linear.certificate.lower_bound)
    best = max(first, linear, key=lambda result: result.certificate.lower_bound)
    best = replace(best, stats={**best.stats, **least_above(first, linear)})
    return with_record(best, {"relations_tried": tried}, began)


def _others(problem: Problem, kinds: Sequence[str], plan: Plan) -> Synthesis:
    """Return the best of other relations; boxes of expressions have coarse cells that show whether they come near."""
    written = [isinstance(agent, Agent) for agent in problem.agents]
    others = [
        kind if not isinstance(agent, Agent) else "exact" if reaches_every_mean(agent) else "boxes"
        for agent, kind in zip(problem.agents, kinds, strict=True)
    ]
    return compared(problem, first_cells(problem) if any(written) else None, others, plan)


def finer(problem: Problem, kinds: Sequence[str], plan: Plan) -> Synthesis:
    """Return the best of what the relations that are compared certify on coarse cells, and on finer ones."""
    began = time.perf_counter()
    first = compared(problem, first_cells(problem), kinds, plan)
    certificate = first.certificate
    # Agents with expressions begin with cells so coarse that finer ones pay, until there is nothing left to gain.
    enough = SOLVED if any(isinstance(agent, Agent) for agent in problem.agents) else GOOD
    if certificate.lower_bound >= enough or certificate.rounding is not None or plan.settings.delta is not None:
        return first
    best, record = finer_levels(problem, plan.settings, first, _run_of_levels(problem, plan))
    if best.certificate is certificate:
        return first
    best = replace(best, stats={**best.stats, **least_above(first, best)})
    tried = certificate.settings.get("relations_tried")
    more = {} if tried is None else {"relations_tried": tried}
    return with_record(best, {"levels": record, **more}, began)


def _run_of_levels(problem: Problem, plan: Plan) -> Run:
    """Return the synthesis of one level: with policies carried over two sweeps are enough."""

    def run(abstraction: Abstraction, carried: Policies | None) -> Synthesis:
        search, starts = plan.search, {}
        if carried is not None:
            search = replace(search, max_sweeps=min(search.max_sweeps, 2), restarts=0, good_share=GOOD_CARRIED)
            starts = {"carried over": carried}
        return searched(problem, abstraction, join(problem, abstraction, search.device), search, starts)

    return run


def _doubled(problem: Problem, kinds: Sequence[str], plan: Plan, first: Synthesis) -> Synthesis:
    """Return the better of a synthesis and one on twice as many cells per axis."""
    parts = zip(problem.agent_names, first.certificate.agents, strict=True)
    cells = {name: tuple(2 * n for n in part.grid.shape) for name, part in parts}
    second = compared(problem, cells, kinds, plan)
    best = max(first, second, key=lambda result: result.certificate.lower_bound)
    return replace(best, stats={**best.stats, **least_above(first, second)})
