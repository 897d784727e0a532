"""From a problem to a certificate and its controllers: build finite models, search policies, certify them."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from typing import Any, overload

import numpy as np

from ...envs.suite import as_problem
from ...envs.systems.backends import on_one_thread
from ...envs.tasks.problem import JOINT_NOISE_REFUSAL, OutOfReach, Problem, out_of_reach, why_unsatisfiable
from ..abstraction.models import RELATIONS, Relations, Settings, check_names, relations_of
from ..certificates.proofs import (
    Certificate,
    OnGrid,
    Synthesis,
    UnionBoundProof,
    certificate_from,
    checked_certificate,
    nameless,
    on_cells,
    timed_certificate,
)
from ..composition import each_horizon, horizons_of, joint_strategies, synthesize_parts, without_deadline
from ..policy_search.ascent import Search
from ..policy_search.cell_certificates import Plan, along_path, continued, judged, with_textbook_feedback
from ..policy_search.portfolio import Effort, Strategy, best_of, in_order, settings_of, sweep_bar
from ..policy_search.vertex_values import vertex_grid_certificate, vertex_team_certificate
from ..relations.grids import CellCounts, RelationRefused, to_who_asked_for_none
from .search_options import SearchOptions, options_of
from .task_strategies import (
    are_better_apart,
    has_usual_search,
    path_strategy,
    still_problem,
    strategies_apart,
    strategies_in_time,
    strategies_of,
)
from .upper_bounds import synthesis_above

OWN = "own"
"""Stands for the horizon of the problem."""

KEYWORDS = (
    "problem", "cells", "horizon", "relation", "effort", "seconds", "until", "progress", "start", "above", "search",
)  # fmt: skip
"""Names in the signature of ``synthesize``."""


@overload
def synthesize(problem: Any, cells: CellCounts = None, *, horizon: int | None = None, **options: Any) -> Synthesis: ...


@overload
def synthesize(
    problem: Any, cells: CellCounts = None, *, horizon: Iterable[int], **options: Any
) -> list[Synthesis]: ...


@on_one_thread
@judged
def synthesize(
    problem: Any,
    cells: CellCounts = None,
    *,
    horizon: int | Iterable[int] | str | None = OWN,
    relation: Relations = "auto",
    effort: float | None = None,
    seconds: float | None = None,
    until: float | None = None,
    progress: Callable[[str, float], None] | bool | None = None,
    start: Any = None,
    above: bool | None = None,
    search: SearchOptions | None = None,
    **old: Any,
) -> Any:
    """Compute per-agent controllers for ``problem`` and a certified lower bound on its satisfaction probability.

    Parameters
    ----------
    problem : Problem, id or path
        Agents with positive definite noise, to whom the relation applies. A task that decomposes into independent tasks
        (``problem.groups``) is certified task by task, and gives a certificate that is a product.
    cells : int, sequence of int or mapping from agent name, optional
        Cells per axis. More cells cost time and raise the bound. The default depends on the dimension (see
        ``abstract``).
    horizon : int, iterable of int or None, optional
        Control steps (default: the problem's). Several give a list of syntheses, in their order: each search begins
        with the policies of the next shorter one. None: no deadline. Then policies do not look at the time, and the
        horizon is doubled until the bound, or the rate at which a safety task is kept (``safety_rate``), gains less
        than 1e-6.
    relation : str, or mapping from agent name to str
        ``"exact"`` (inputs reach every mean), ``"linear"`` and ``"boxes"`` (any agent), ``"path"`` (no cells, any
        number of states), ``"vertices"`` (agents of few states; inputs interpolated between vertices), or
        ``"paper"`` (scalar agents; may be lost with a probability delta per step). ``"auto"``,
        which also holds for agents that a mapping leaves out, takes ``exact`` where it leaves most of the inputs to the
        policy, tries ``linear`` and ``boxes`` where much is left open, and keeps the largest bound (see
        ``relation_choice``); agents that no grid can hold get a path. ``"best"`` tries all of these without any
        shortcut, and ``paper``. ``"quick"`` takes ``exact`` or ``linear`` without comparing (see ``abstract``).
    effort : float, optional
        Work that may be spent, in core seconds: what one core of 2024 does in about a second (default: 80, of each
        independent task). It is estimated before anything is computed, and not taken from a clock: the same problem and
        effort give the same certificate on every machine. Ways to certify the task are tried as long as it
        lasts, the cheapest first (see ``best_of``); ``stats["tried"]`` says what each gave, and what was left out.
    seconds : float, optional
        Seconds of the clock after which the best certificate so far is returned, or the first one, if that takes
        longer. It depends on the machine what they are enough for. Work is then limited only by ``effort``, if given.
    until : float, optional
        Lower bound in (0, 1] that is enough: the search ends with the first certificate that has it.
    progress : callable or True, optional
        Called with a short text and the best value so far after each sweep; True: a bar, in notebooks, too.
    start : Synthesis, Certificate or path, optional
        Certificate whose policies the search begins with, of any kind on cells. Its agents, cells and relations must
        be the same, its horizon need not (see ``horizons``); ``"auto"`` then stands for its relations, and settings
        that are not given are its own. Its policies are evaluated anew, and nothing that it claims is trusted.
    above : bool, optional
        Whether the certificate is to say, too, how often its controllers succeed at most (``upper_bound``). That takes
        about as long as an evaluation of the policies. By default it does where this is little work beside the effort,
        for one horizon; relations in which nothing is lost say so in any case.
    search : SearchOptions, optional
        Everything else that a search can be told: sweeps, restarts, the form of values, pruning, and the
        settings of relations. Nobody needs it for a good bound.
    **old
        The same options as keywords, as until 0.3: they work until 0.5, with a DeprecationWarning.

    Returns
    -------
    Synthesis, or list of Synthesis
        ``certificate.lower_bound`` holds at the problem's start: at its initial state, or on average over its start
        box. With delta > 0 all bounds that apply are computed and the
        largest one is reported. ``checked`` is what ``check`` says of it.

    Raises
    ------
    ValueError
        If the problem has no start, the relation does not apply to an agent, or an option does not exist.
    """
    options = options_of(search, old, "synthesize", KEYWORDS)
    told = sweep_bar() if progress is True else progress or None
    problem = as_problem(problem)
    endless = horizon is None
    enough = math.inf if until is None else until
    ascent = options.search(progress=told, stationary=options.stationary or endless, enough=enough)

    is_single = isinstance(horizon, int | np.integer) or horizon == OWN

    def once(task: Problem, begun: Certificate | None) -> Synthesis:
        _refuse_outside(task)
        settings = options.of_relations
        if begun is not None and not task.groups and not task.labeling.pairs:
            settings = {**_settings_of_start(task, relation, checked_certificate(begun, "start")), **settings}
        plan = Plan(Settings(**settings), ascent, Effort(effort, seconds, progress=told, until=until))
        try:
            found = _of_problem(task, cells, relation, plan, begun)
            if above or (above is None and is_single and not plan.effort.is_over):
                return synthesis_above(found, math.inf if above else plan.effort.for_above)
            return found
        except RelationRefused as refusal:
            raise RelationRefused(to_who_asked_for_none(refusal) if cells is None else str(refusal)) from None

    def carried(task: Problem, begun: Certificate | None) -> Synthesis:
        # Cells and relation that are chosen anew at every horizon have nothing to begin with.
        return once(task, None if relation == "best" else begun)

    begun = None if start is None else certificate_from(start, "start")
    if isinstance(horizon, int | np.integer):
        problem, horizon = problem.replace(horizon=horizon), OWN
    if horizon == OWN:
        return once(problem, begun)
    if begun is not None:
        raise ValueError("`horizon`: expected one number with `start`, got several, or None; leave it out")
    if endless:
        return without_deadline(problem, carried)
    asked = horizons_of(horizon)
    of_horizon = {found.certificate.problem.horizon: found for found in each_horizon(problem, asked, carried)}
    return [of_horizon[number] for number in asked]


def _of_problem(
    problem: Problem, cells: CellCounts, relation: Relations, plan: Plan, start: Certificate | None
) -> Synthesis:
    """Synthesize a problem: task by task, if its tasks are independent."""
    if problem.groups and not problem.labeling.pairs:
        _refuse_start(start, "independent tasks")
        check_names("relation", relation, problem)

        def of_part(task: Problem, sizes: CellCounts, kinds: Relations) -> Synthesis:
            return _or_textbook(task, sizes, kinds, plan.anew())

        return synthesize_parts(problem, cells, relation, of_part)
    return _or_textbook(problem, cells, relation, plan.anew(), start)


def _or_textbook(
    problem: Problem, cells: CellCounts, relation: Relations, plan: Plan, start: Certificate | None = None
) -> Synthesis:
    """Synthesize one task; where nothing is certified and nothing was asked for, textbook feedback is tried, too."""
    found = _of_task(problem, cells, relation, plan, start)
    asked = cells is not None or relation != "auto" or start is not None or not has_usual_search(plan)
    return found if asked else with_textbook_feedback(found, plan)


def _of_task(
    problem: Problem, cells: CellCounts, relation: Relations, plan: Plan, start: Certificate | None = None
) -> Synthesis:
    """Synthesize one task, in the ways that relations and start leave open."""
    if cells is None and relation == "auto" and start is None and plan.paths:
        never = why_unsatisfiable(problem)
        if lost := OutOfReach(never, 0.0) if never else out_of_reach(problem):
            plan.effort.give_up(lost.why)
    if problem.joint_noise:
        return best_of(_under_joint_noise(problem, cells, relation, plan, start), plan.effort)
    if problem.labeling.pairs:
        if start is None:
            return best_of(joint_strategies(problem, cells, relation, plan), plan.effort)
        if type(start.proof) is not UnionBoundProof:
            raise ValueError(
                "`start`: expected a certificate by subtraction for a task about pairs, got one of the kind "
                f"{start.proof.kind!r}; other ways begin anew; leave it out"
            )
        base: OnGrid = start.proof.base
        plan = replace(plan, settings=Settings(**settings_of(base, ["exact"] * problem.n_agents)))
        return best_of(joint_strategies(problem, cells, relation, plan, base), plan.effort)
    if relation in ("path", "vertices"):
        if cells is not None or start is not None:
            raise ValueError(f"`relation`: expected no cells or start with {relation!r}, which needs none; leave out")
        on_vertices = vertex_grid_certificate if problem.n_agents == 1 else vertex_team_certificate
        return (along_path if relation == "path" else on_vertices)(problem, plan.along_paths)
    is_free = cells is None and relation == "auto" and start is None and plan.paths and has_usual_search(plan)
    if is_free and not plan.effort.lost and are_better_apart(problem):
        ways = (lambda: _apart(problem, plan)), (lambda: _in_time(problem, None, "auto", plan, None))
        return best_of(strategies_apart(problem, plan, *ways), plan.effort)
    return _together(problem, cells, relation, plan, start)


def _apart(problem: Problem, plan: Plan) -> Synthesis:
    """Synthesize independent tasks one by one, each with an equal share of what those before it left."""
    waiting = len({nameless(task) for task in problem.tasks_apart})

    def of_part(task: Problem, sizes: CellCounts, kinds: Relations) -> Synthesis:
        nonlocal waiting
        own = plan.anew()
        own.effort.limit, own.effort.until = plan.effort.left / waiting, None
        own.effort.seconds = own.effort.seconds and own.effort.seconds / waiting
        waiting -= 1
        found = _of_task(task, sizes, kinds, own)
        plan.effort.spent += own.effort.spent
        plan.effort.is_interrupted |= own.effort.is_interrupted
        return found

    found = synthesize_parts(problem, None, "auto", of_part)
    try:
        found.certificate.controller.states  # noqa: B018
    except ValueError as reason:
        raise RelationRefused(str(reason)) from None
    return found


def _together(
    problem: Problem, cells: CellCounts, relation: Relations, plan: Plan, start: Certificate | None
) -> Synthesis:
    """Synthesize one task as a whole."""
    if problem.names_time:
        return _in_time(problem, cells, relation, plan, start)
    kinds = ["best"] * problem.n_agents if relation == "best" else relations_of(problem, relation)
    if start is not None:
        _refuse_beside(start, relation)
        return continued(problem, cells, kinds, plan, start)
    return best_of(strategies_of(problem, cells, kinds, plan), plan.effort)


def strategies_ahead(problem: Problem) -> Iterator[tuple[Problem, list[Strategy]]]:
    """Yield the ways that ``synthesize`` tries for a problem without options, in order, for each independent task.

    A way with a ``refusal`` does not apply; the others are tried while effort is left and something is to gain.
    """
    if problem.groups and not problem.labeling.pairs:
        for task in problem.tasks:
            yield from strategies_ahead(task)
        return
    plan = Plan(Settings(), Search(), Effort())

    def nothing(*arguments: object) -> Synthesis:
        raise AssertionError("a way that is looked at was taken")

    if problem.joint_noise:
        strategies = _under_joint_noise(problem, None, "auto", plan, None)
    elif problem.labeling.pairs:
        strategies = joint_strategies(problem, None, "auto", plan)
    elif are_better_apart(problem):
        strategies = strategies_apart(problem, plan, nothing, nothing)
    elif problem.names_time:
        strategies = strategies_in_time(problem, plan, nothing)
    else:
        strategies = strategies_of(problem, None, ["auto"] * problem.n_agents, plan)
    yield problem, in_order(strategies)


def _under_joint_noise(
    problem: Problem, cells: CellCounts, relation: Relations, plan: Plan, start: Certificate | None
) -> list[Strategy]:
    """Return the ways of teams that share noise: a path. Whatever multiplies over agents takes them for independent."""
    grids = cells is not None or start is not None or not has_usual_search(plan)
    if grids or relation not in ("auto", "best", "path"):
        raise RelationRefused(JOINT_NOISE_REFUSAL)
    return [path_strategy(problem, plan)]


def _in_time(
    problem: Problem, cells: CellCounts, relation: Relations, plan: Plan, start: Certificate | None
) -> Synthesis:
    """Synthesize a task that names the time: along a path, or on grids as the task written out without it."""
    if plan.search.stationary:
        raise ValueError(
            "`stationary`: expected False for a problem that names the time `t`, whose policies have to look at it"
        )

    def on_grids(sizes: CellCounts, chosen: Plan) -> Synthesis:
        # Along a path of the problem written out the time would be an input to choose.
        begun = None if start is None else on_cells(start)
        found = _of_task(still_problem(problem), sizes, relation, replace(chosen, paths=False), begun)
        certificate = timed_certificate(problem, found.certificate)
        return Synthesis(certificate, certificate.controller, found.stats)

    if relation not in ("auto", "best") or cells is not None or start is not None:
        return on_grids(cells, plan)
    return best_of(strategies_in_time(problem, plan, lambda: on_grids(None, plan)), plan.effort)


def _refuse_outside(problem: Problem) -> None:
    """Refuse starts at points outside the workspace: no controller satisfies any task from there."""
    points = {agent.name for agent in problem.agents if agent.initial.is_point}
    for name in problem.starts_outside:
        if name in points:
            raise ValueError(
                f"`initial_state`: expected a start in the workspace of agent `{name}`, got one outside; no task is "
                "satisfied from there; correct the start, or `state_low` and `state_high`"
            )


def _settings_of_start(problem: Problem, relation: Relations, start: OnGrid) -> dict[str, Any]:
    """Return the settings with which a certificate was made, for the relations that its agents are to have again."""
    if isinstance(relation, str) and relation not in RELATIONS:
        return {}
    certified = [part.relation["kind"] for part in checked_certificate(start, "start").proof.agents]
    kinds = relations_of(problem, relation)
    if len(certified) == len(kinds):
        kinds = [was if kind == "auto" else kind for kind, was in zip(kinds, certified, strict=True)]
    return settings_of(start, kinds)


def _refuse_beside(start: Certificate, relation: Relations) -> None:
    """Refuse a certificate to start from beside several relations."""
    if relation == "best":
        _refuse_start(start, "several relations")


def _refuse_start(start: Certificate | None, what: str) -> None:
    """Refuse a certificate to start from where the search cannot use one."""
    if start is not None:
        raise ValueError(f"`start`: expected none for {what}, got a certificate; leave it out")
