"""The table of ways to certify one task: what may be tried, how much work it is, and from which bound it is left out.

What is asked for decides which rows there are: relations by name, cells, or nothing at
all. ``best_of`` tries the rows.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from ...envs.systems.agents import Agent, LinearAgent
from ...envs.tasks.problem import Problem, unrolled_in_time
from ..abstraction.models import (
    Abstraction,
    Policies,
    Settings,
    abstraction_of,
    count_of_decisions,
    join,
    reaches_every_mean,
)
from ..certificates.proofs import Synthesis
from ..policy_search.ascent import Limits
from ..policy_search.cell_certificates import Plan, along_path, compared, plain, searched
from ..policy_search.portfolio import (
    GOOD,
    SOLVED,
    Results,
    Run,
    Strategy,
    best_of,
    box_work,
    cells_where_scarce,
    finer_levels,
    first_cells,
    has_linear_cells,
    leading,
    linear_levels,
    linear_work,
    refused,
    with_settings,
    work_of,
)
from ..relations.grids import CellCounts, RelationRefused, cells_of_agent, fewest_cells
from ..trajectories.planning import refuse_without_path
from .vertex_strategies import (
    MOST_GRID_STATES,
    MOST_STILL_STATES,
    beside_vertices,
    has_other_noise,
    has_shared_noise,
    has_vertices_of_team,
    has_vertices_only,
    is_disturbed,
    may_have_vertices,
    moves_with_runs,
    moving_strategy,
    vertex_strategy,
)

PATH = 1.0 / 150.0
"""Work of a path for each agent, state and input, and for each pair of steps: it is a linear program after another."""

MOST_STEPS_OF_PROGRAM = 12
"""Steps from which work grows with their number alone: programs of long paths are sparse."""

PATH_ENDS = 0.99
"""Bound of a path from which no grid is tried: grids take minutes for what is left."""

WRITTEN_ENOUGH = 0.999
"""Bound of grids of agents with expressions from which no path is tried beside them."""

COMPARED, MANY_STATES, MANY_AGENTS = 30.0, 256, 4
"""Work of comparing relations of agents with several states, for so many automaton states and agents at most; those of
single states take next to nothing."""

DOUBLED = 20.0
"""Work of comparing them on twice as many cells per axis."""

MOST_LINEAR_TERMS = 32
"""Terms of the value trees of teams of single states up to which linear cells, which pay for every term, are tried."""

MANY_UNDECIDED, TERM, MOST_TREE_WORK = 8, 5e-4, 40.0
"""Undecided automaton states from which value trees of teams of single states are counted, the work of a term of an
agent at one time, and the most that is counted: what is left of the effort has to do for them all the same."""

FEW_AGENTS = 2
"""Agents up to which linear cells are tried unless others solve the task; in larger teams each pays for all terms."""

NEAR_PATH = 0.5
"""Share of the bound of a path from which the cells of other relations are made finer all the same; and bound of these
beside which a path need not be tried for long."""

MOST_CELLS_OF_LOST = 100_000
"""Cells of an agent up to which a task that is out of reach has a grid, where no run comes near."""

PATIENCE, LATER = 2.0, 15.0
"""Core seconds after which a path is left that proves nothing, for a grid of vertices or beside a good bound; and one
that has not come to PATH_ENDS, for a grid of vertices."""

MANY_TOGETHER = 8
"""Automaton states of a team above which independent tasks are certified one by one."""

GOOD_CARRIED = 0.5
"""Share of the upper bound from which policies of coarser cells are gone on with alone: those tried many starts."""


def strategies_of(problem: Problem, cells: CellCounts, kinds: Sequence[str], plan: Plan) -> list[Strategy]:
    """Return the ways to certify a task under the relations that are asked for, one for each agent."""
    asked, usual = {*kinds}, has_usual_search(plan)
    if not asked & {"auto", "best"}:
        if asked == {"linear"} and cells is None and usual:
            return [_linear(problem, plan, few=True)]
        name = "/".join(dict.fromkeys(kinds))
        return [Strategy(name, lambda results: plain(problem, cells, kinds, plan))]
    if cells is not None or asked != {"auto"} or not usual:
        first = Strategy("others", lambda results: compared(problem, cells, kinds, plan))
        given = cells is not None and len(asked) == 1 and may_be_linear(problem, plan)
        return [first, _linear_on(problem, cells, plan, every=asked == {"best"})] if given else [first]
    if plan.effort.lost:
        return _strategies_of_lost(problem, kinds, plan)
    if is_beyond_grids(problem):
        # Where a grid does not reach a path may. Without noise in some states neither is better as a rule.
        has_grid = has_shared_noise(problem)
        ends = GOOD if any(np.any(agent.still_axes) for agent in problem.agents) else 0.0
        path = replace(path_strategy(problem, plan), work=0.0, ends=PATH_ENDS if has_grid else ends)
        on_grids = Strategy("grids", lambda results: best_of(_on_grids(problem, kinds, plan), plan.effort), enough=GOOD)
        ways = [vertex_strategy(problem, plan)] if has_other_noise(problem) or has_grid else []
        if plan.paths and not ways and moves_with_runs(problem):
            ways, path = [moving_strategy(problem, plan)], replace(path, ends=PATH_ENDS)
        return [path, *ways, on_grids] if plan.paths else [*ways, on_grids]
    if not plan.paths:
        return _on_grids(problem, kinds, plan)
    moving = [moving_strategy(problem, plan)] if moves_with_runs(problem) else []
    return [*moving, *_on_grids(problem, kinds, plan), path_strategy(problem, plan)]


def _strategies_of_lost(problem: Problem, kinds: Sequence[str], plan: Plan) -> list[Strategy]:
    """Return the ways of a task that is out of reach: what comes near, or else a bound of 0 on as few cells as can be.

    A run that comes near shows what is missing. There is none if the start itself breaks the task.
    """
    cells = fewest_cells(problem)
    strategies = [replace(path_strategy(problem, plan), work=0.0)] if plan.paths else []
    if max(math.prod(counts) for counts in cells.values()) > MOST_CELLS_OF_LOST:
        return strategies
    return [*strategies, Strategy("few cells", lambda results: compared(problem, cells, kinds, plan))]


def still_problem(problem: Problem) -> Problem:
    """Return a problem that names the time, written out without it; refuse one that has no grid."""
    try:
        return unrolled_in_time(problem)
    except ValueError as error:
        raise RelationRefused(str(error)) from None


def strategies_in_time(problem: Problem, plan: Plan, on_grids: Callable[[], Synthesis]) -> list[Strategy]:
    """Return the ways of tasks that name the time: a path, and grids of the task written out where it leaves much."""
    path = replace(path_strategy(problem, plan), work=0.0, ends=PATH_ENDS)
    # cells of tasks that are written out in time are as many as there are steps, which costs little on a line
    few, of_team = (
        problem.n_agents == 1 and problem.agents[0].n_states == MOST_STILL_STATES,
        has_vertices_of_team(problem),
    )
    alone = of_team or has_vertices_only(problem)
    ways = [vertex_strategy(problem, plan)] if few or alone else []
    if not ways and moves_with_runs(problem):
        ways = [moving_strategy(problem, plan)]

    def beside(results: Results) -> str | None:
        # cells have inputs that jump, which is better for some
        found = results.get("vertices")
        return beside_vertices(results) if alone or (found and found.certificate.lower_bound >= GOOD) else None

    return [path, *ways, Strategy("grids", lambda results: on_grids(), 1.0, enough=PATH_ENDS, why_not=beside)]


def are_better_apart(problem: Problem) -> bool:
    """Return whether tasks of a team are independent, and the team as a whole costs much more, or knows less.

    An agent may have noise that only grids of vertices know closely, or the automaton may have many states, each a
    combination of those of the tasks. Other teams have one value of all states, which shields and plots read.
    """
    if problem.groups or not problem.apart:
        return False
    has_other = any(agent.noise_scale is not None or agent.laws is not None for agent in problem.agents)
    return has_other or problem.automaton.n_states > MANY_TOGETHER


def strategies_apart(
    problem: Problem, plan: Plan, one_by_one: Callable[[], Synthesis], in_time: Callable[[], Synthesis]
) -> list[Strategy]:
    """Return the ways of agents whose tasks are independent: a path, the tasks one by one, and the team as a whole."""
    path = replace(path_strategy(problem, plan), work=0.0, ends=PATH_ENDS)

    def why_not(results: Results) -> str | None:
        apart = results.get("tasks")
        return "skipped: the tasks of agents are independent" if apart and apart.certificate.lower_bound > 0.0 else None

    def together(results: Results) -> Synthesis:
        if problem.names_time:
            return in_time()
        ways = strategies_of(problem, None, ["auto"] * problem.n_agents, plan)
        return best_of([way for way in ways if way.name != path.name], plan.effort)

    apart = Strategy("tasks", lambda results: one_by_one(), 1.0, enough=PATH_ENDS)
    return [path, apart, Strategy("together", together, 2.0, enough=GOOD, why_not=why_not)]


def is_beyond_grids(problem: Problem) -> bool:
    """Return whether an agent has more states than a grid has room for, or states whose noise is that of others."""
    if not all(agent.has_independent_noise for agent in problem.agents):
        return True
    for agent in problem.agents:
        noisy = int(np.sum(~agent.still_axes))
        if agent.n_states > MOST_GRID_STATES or np.linalg.matrix_rank(agent.noise_covariance) < noisy:
            return True
    return False


def has_usual_search(plan: Plan) -> bool:
    """Return whether nothing was said about the search that levels of cells would not heed."""
    search = plan.search
    return not (search.stationary or search.value == "train" or search.limits != Limits())


def may_be_linear(problem: Problem, plan: Plan) -> bool:
    """Return whether linear cells apply to every agent, and no setting is about other relations."""
    plain_settings = replace(plan.settings, targets_per_cell=None) == Settings()
    return plain_settings and has_usual_search(plan) and all(map(has_linear_cells, problem.agents))


def has_linear_cells_only(problem: Problem) -> bool:
    """Return whether all agents are linear, with Gaussian noise, and have fewer inputs than states."""
    return all(
        isinstance(agent, LinearAgent) and agent.laws is None and not agent.has_full_rank for agent in problem.agents
    )


def is_scalar(problem: Problem) -> bool:
    """Return whether all agents are linear with a single state."""
    return all(agent.n_states == 1 and not isinstance(agent, Agent) for agent in problem.agents)


def _on_grids(problem: Problem, kinds: Sequence[str], plan: Plan) -> list[Strategy]:
    """Return the ways on grids where nothing but the problem is given."""
    linear = may_be_linear(problem, plan)
    on_vertices = plan.paths and any(
        asked(problem) for asked in (has_vertices_of_team, has_vertices_only, is_disturbed)
    )
    strategies = [] if linear and has_linear_cells_only(problem) else [_others(problem, kinds, plan, linear)]
    exact = 0.0
    if any(agent.n_states > 1 for agent in problem.agents) and all(map(reaches_every_mean, problem.agents)):
        # Linear cells lose less of what these leave: another start is for where these do not do well.
        share = min(plan.search.good_share, GOOD if linear and problem.n_agents == FEW_AGENTS else 1.0)
        strategies.append(_exact(problem, replace(plan, search=replace(plan.search, good_share=share))))
        exact = strategies[-1].work
    if linear:
        # The first level alone costs less than exact cells do, but it is the first of many.
        levels = _linear(problem, plan, few=problem.n_agents <= FEW_AGENTS or is_scalar(problem))
        # Trees of many terms take long whatever the cells are.
        levels = replace(levels, work=max(levels.work, exact, _tree_work(problem)))
        if plan.paths and not on_vertices and problem.n_agents > FEW_AGENTS and not is_scalar(problem):
            strategies += _vertices_or(levels, problem, plan)
        else:
            strategies.append(levels)
    # A task written out in time had its grid of vertices as it was written.
    if on_vertices:
        strategies.insert(0, vertex_strategy(problem, plan))
    elif plan.paths and _is_too_much_for_cells(problem, strategies, plan):
        strategies.insert(0, replace(vertex_strategy(problem, plan), enough=GOOD))
    if is_scalar(problem) and problem.n_agents > FEW_AGENTS:
        strategies.append(_doubled(problem, kinds, plan))
    elif not is_scalar(problem) or not linear:
        strategies.append(_finer(problem, plan))
    return strategies


def _vertices_or(levels: Strategy, problem: Problem, plan: Plan) -> list[Strategy]:
    """Return the ways of a large team on grids of vertices, and on linear cells where these give nothing."""
    vertices = vertex_strategy(problem, plan)
    if vertices.refusal:
        return [levels]

    def why_not(results: Results) -> str | None:
        beside = beside_vertices(results)
        return levels.why_not(results) if beside is None else beside

    return [replace(vertices, work=levels.work, enough=levels.enough, after=""), replace(levels, why_not=why_not)]


def _is_too_much_for_cells(problem: Problem, strategies: Sequence[Strategy], plan: Plan) -> bool:
    """Return whether the automaton of one agent with two states is so large that linear cells are out of reach.

    Boxes would be next, which take as long. Vertices share inputs among automaton states.
    """
    if problem.n_agents > 1 or problem.agents[0].n_states != MOST_STILL_STATES:
        return False
    return any(way.name == "linear" and not way.refusal and way.work > plan.effort.left for way in strategies)


def path_strategy(problem: Problem, plan: Plan) -> Strategy:
    """Return the way along a path: no grid, any number of states."""
    try:
        refuse_without_path(problem)
    except RelationRefused as error:
        return refused("path", error)
    sizes = sum(agent.n_states * max(1, agent.n_inputs) for agent in problem.agents)
    # Grids of vertices wait for it where there are disturbances, and other cells prove less then than either.
    waited = is_disturbed(problem) and may_have_vertices(problem)
    of_team = has_vertices_of_team(problem)
    work = PATH * problem.horizon * min(problem.horizon, MOST_STEPS_OF_PROGRAM) * sizes
    # Boxes and round regions cost grids of agents with expressions a hundredth that paths do not lose.
    enough = WRITTEN_ENOUGH if any(isinstance(agent, Agent) for agent in problem.agents) else GOOD
    alone = (has_vertices_only(problem) or has_shared_noise(problem)) and may_have_vertices(problem)
    has_vertices = waited or alone or of_team

    def run(results: Results) -> Synthesis:
        along = plan.along_paths
        best = leading(results)
        seconds_over, is_beside = along.is_broken_off, best is not None and best.certificate.lower_bound > NEAR_PATH

        def is_left() -> bool:
            has_nothing = along.largest <= 0.0 and along.spent > PATIENCE
            if has_vertices and along.largest < PATH_ENDS and along.spent > LATER:
                return True
            return seconds_over() or (
                has_nothing and (is_beside or (has_vertices and (waited or of_team or has_other_noise(problem))))
            )

        along.is_broken_off = is_left
        return along_path(problem, along)

    ends = SOLVED if waited else WRITTEN_ENOUGH if of_team else PATH_ENDS
    return Strategy("path", run, 0.0 if waited or of_team else work, enough=enough, ends=ends)


def _exact(problem: Problem, plan: Plan) -> Strategy:
    """Return the way of agents of several states whose inputs reach all means: often nothing is left to gain.

    Linear agents have as many cells as by default, narrower where inputs are scarce; those with expressions, whose
    targets are judged one by one, half as many along each axis.
    """
    kinds = ["exact"] * problem.n_agents
    halves = {
        agent.name: tuple(-(-n // 2) for n in cells_of_agent(agent, None))
        for agent in problem.agents
        if isinstance(agent, Agent)
    }
    try:
        abstraction = abstraction_of(problem, halves | cells_where_scarce(problem) or None, kinds, plan.settings)
    except RelationRefused as error:
        return refused("exact", error)
    return Strategy("exact", lambda results: _of_models(problem, abstraction, plan), work_of(abstraction, problem))


def _linear(problem: Problem, plan: Plan, few: bool) -> Strategy:
    """Return the way on linear cells, made finer level by level."""
    run = _run_of_levels(problem, plan)

    def levels(results: Results) -> Synthesis:
        best, record = linear_levels(problem, plan.settings, run, plan.effort)
        return with_settings(best, {"levels": record})

    def why_not(results: Results) -> str | None:
        first = results.get("others")
        if problem.n_agents <= FEW_AGENTS or first is None or not is_scalar(problem):
            return None
        if first.certificate.proof.rank > MOST_LINEAR_TERMS or first.certificate.proof.rounding is not None:
            return f"skipped: value trees of {first.certificate.proof.rank} terms cost linear cells too much"
        return None

    enough = SOLVED if few or any(isinstance(agent, Agent) for agent in problem.agents) else GOOD
    try:
        work = linear_work(problem, plan.settings, run)
    except RelationRefused as error:
        return refused("linear", error)
    return Strategy("linear", levels, work, enough=enough, why_not=why_not)


def _linear_on(problem: Problem, cells: CellCounts, plan: Plan, every: bool) -> Strategy:
    """Return the way on linear cells that are given."""
    try:
        abstraction = abstraction_of(problem, cells, ["linear"] * problem.n_agents, plan.settings)
    except RelationRefused as error:
        return refused("linear", error)

    def why_not(results: Results) -> str | None:
        return "" if any("linear" in result.stats.get("tried", {}) for result in results.values()) else None  # type: ignore[operator]

    work = 0.0 if every else work_of(abstraction, problem)
    enough = np.inf if every else GOOD
    return Strategy("linear", lambda results: _of_models(problem, abstraction, plan), work, enough, why_not=why_not)


def _others(problem: Problem, kinds: Sequence[str], plan: Plan, linear: bool) -> Strategy:
    """Return the way that compares the other relations, on cells so coarse that they show whether these come near."""
    written = [isinstance(agent, Agent) for agent in problem.agents]
    if linear and any(written):
        kinds = [
            kind if not isinstance(agent, Agent) else "exact" if reaches_every_mean(agent) else "boxes"
            for agent, kind in zip(problem.agents, kinds, strict=True)
        ]
    scalar = all(agent.n_states == 1 for agent in problem.agents)
    cells = first_cells(problem)
    # Guards of thousands of automaton states alone take minutes, and so do trees of many agents.
    many = max(problem.automaton.n_states / MANY_STATES, 0.0 if scalar else problem.n_agents / MANY_AGENTS)
    least = max(_tree_work(problem) if scalar else COMPARED, COMPARED * many if many > 1.0 else 0.0)
    # Where linear cells do not apply boxes are compared on default cells, too.
    usual = {} if linear else {a.name: cells_of_agent(a, None) for a in problem.agents if isinstance(a, Agent)}
    work = least if is_scalar(problem) else max(least, box_work(problem, usual | (cells or {})))

    def run(results: Results) -> Synthesis:
        return compared(problem, cells, kinds, plan, None if cells or any(written) else results.get("exact"))

    def why_not(results: Results) -> str | None:
        if "path" in results and results["path"].certificate.lower_bound > 0.0 and _is_for_paths(problem):
            return f"skipped: boxes of {MOST_GRID_STATES} states do not come near a path that proves something"
        return beside_vertices(results)

    enough = SOLVED if scalar or not linear else GOOD
    # Boxes of three states take a minute, and are for where no path proves anything.
    after = "path" if plan.paths and _is_for_paths(problem) else ""
    return Strategy("others", run, work, enough=enough, why_not=why_not, after=after)


def _is_for_paths(problem: Problem) -> bool:
    """Return whether an agent has as many states as a grid has room for, and inputs that do not reach all means."""
    return any(agent.n_states >= MOST_GRID_STATES and not reaches_every_mean(agent) for agent in problem.agents)


def _tree_work(problem: Problem) -> float:
    """Return an estimate of the work of value trees of teams of single states: next to nothing, or that of many terms.

    Groups with tasks of their own have a term for each set of those that are done, in each such state.
    """
    undecided = int((~problem.automaton.absorbing).sum())
    scalar = all(agent.n_states == 1 for agent in problem.agents)
    if not scalar or problem.n_agents <= FEW_AGENTS or undecided < MANY_UNDECIDED:
        return 0.0
    return min(MOST_TREE_WORK, TERM * problem.n_agents * undecided * count_of_decisions(problem))


def _finer(problem: Problem, plan: Plan) -> Strategy:
    """Return the way that makes the cells of the best of other relations finer, level by level."""

    def run(results: Results) -> Synthesis:
        first = results.get("others") or results["exact"]
        best, record = finer_levels(problem, plan.settings, first, _run_of_levels(problem, plan), plan.effort)
        kind = best.certificate.settings["relation"]
        named = replace(best, stats={**best.stats, "tried": {f"{kind}, finer cells": best.certificate.lower_bound}})
        return with_settings(named, {"levels": record})

    def why_not(results: Results) -> str | None:
        # A path that is better than coarse cells says little of finer ones, unless it is better by far. Where others
        # take too much, exact targets are made finer.
        first, path = results.get("others") or results.get("exact"), results.get("path")
        best = leading({name: result for name, result in results.items() if result is not path})
        if first is None or best is None or first.certificate.lower_bound < best.certificate.lower_bound:
            return ""
        if path is not None and first.certificate.lower_bound < NEAR_PATH * path.certificate.lower_bound:
            return ""
        return "" if plan.settings.delta is not None else None

    # Agents with expressions begin with cells so coarse that finer ones pay, until there is nothing left to gain.
    enough = SOLVED if any(isinstance(agent, Agent) for agent in problem.agents) else GOOD
    return Strategy("finer cells", run, enough=enough, why_not=why_not, after="others")


def _doubled(problem: Problem, kinds: Sequence[str], plan: Plan) -> Strategy:
    """Return the way that compares other relations on twice as many cells, where trees have too many terms for more."""

    def run(results: Results) -> Synthesis:
        parts = zip(problem.agent_names, results["others"].certificate.proof.agents, strict=True)
        found = compared(problem, {name: tuple(2 * n for n in part.grid.shape) for name, part in parts}, kinds, plan)
        kind = found.certificate.settings["relation"]
        return replace(found, stats={**found.stats, "tried": {f"{kind}, finer cells": found.certificate.lower_bound}})

    def why_not(results: Results) -> str | None:
        first = results.get("others")
        if first is None:
            return ""
        many = first.certificate.proof.rank > MOST_LINEAR_TERMS or first.certificate.proof.rounding is not None
        return None if many else ""

    return Strategy("finer cells", run, DOUBLED, enough=GOOD, why_not=why_not, after="others")


def _of_models(problem: Problem, abstraction: Abstraction, plan: Plan) -> Synthesis:
    """Return the synthesis on finite models."""
    return searched(problem, abstraction, join(problem, abstraction), plan.search, {})


def _run_of_levels(problem: Problem, plan: Plan) -> Run:
    """Return the synthesis of one level: with policies carried over two sweeps are enough."""

    def run(abstraction: Abstraction, carried: Policies | None) -> Synthesis:
        search, starts = plan.search, {}
        if carried is not None:
            search = replace(search, max_sweeps=min(search.max_sweeps, 2), restarts=0, good_share=GOOD_CARRIED)
            starts = {"carried over": carried}
        return searched(problem, abstraction, join(problem, abstraction), search, starts)

    return run
