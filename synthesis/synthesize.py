"""From a problem to a certificate and its controllers: build finite models, search policies, certify them."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..envs.agents import Agent
from ..envs.problem import Problem
from ..envs.suite import as_problem
from .cells import CellCounts, RelationRefused
from .certificates import Certificate, Synthesis, checked_certificate
from .certification import certified
from .choosing import (
    GOOD,
    MOST_LINEAR_AGENTS,
    SOLVED,
    Budget,
    Run,
    Tries,
    finer_levels,
    first_cells,
    groups_of,
    has_linear_cells,
    least_above,
    linear_levels,
    policies_from,
    refine,
)
from .models import (
    Abstraction,
    JointModel,
    Policies,
    Relations,
    Settings,
    abstraction_of,
    check_names,
    check_settings,
    join,
    relations_of,
)
from .nominal_paths import path_certificate
from .parts import synthesize_parts
from .search import FINAL, Limits, Relaxation, Search, find_policies, stationary_best, sweep_bar
from .together import synthesize_together
from .values import HOST, device_put

MOST_GRID_STATES = 3
"""States of an agent up to which it has a grid by default; certificates along a path need none."""

MOST_LINEAR_TERMS = 32
"""Terms of the value trees of further agents up to which linear cells, which pay for every term, are tried."""

GOOD_CARRIED = 0.5
"""Share of the upper bound from which policies of coarser cells are gone on with alone: those tried many starts."""

Clock = tuple[float, float]
"""When the work began, and when the finite models were finished, in seconds of ``perf_counter``."""


@dataclass(frozen=True)
class Plan:
    """How a task is to be synthesized, apart from its cells and relations.

    Parameters
    ----------
    settings : Settings
        Settings of the relations.
    search : Search
        How policies are searched for.
    budget : Budget or None
        If there is one, cells are made finer until it is used up.
    """

    settings: Settings
    search: Search
    budget: Budget | None


# Thirteen parameters, because this is the door of the package: its options are flat, as users and the command line have
# them, and become records (`Plan`) at once.
def synthesize(
    problem: Any,
    cells: CellCounts = None,
    *,
    relation: Relations = "auto",
    max_sweeps: int = 8,
    limits: Limits | None = None,
    value: str = "auto",
    progress: Callable[[str, float], None] | bool | None = None,
    memory: float | None = None,
    accuracy: float | None = None,
    device: str = HOST,
    restarts: int = 0,
    start: Certificate | None = None,
    stationary: bool = False,
    **settings: Any,
) -> Synthesis:
    """Compute per-agent controllers for ``problem`` and a certified lower bound on its satisfaction probability.

    Parameters
    ----------
    problem : Problem, id or path
        Agents with positive definite noise, to whom the relation applies. A task that decomposes into independent tasks
        (``problem.groups``) is certified task by task, and gives a ``ProductCertificate``.
    cells : int, sequence of int or mapping from agent name, optional
        Cells per axis. More cells cost time and raise the bound. The default depends on the dimension (see
        ``abstract``); it is doubled where relations are compared and none applies.
    relation : str, or mapping from agent name to str
        ``"exact"`` (B of full row rank), ``"tube"`` (stabilisable), ``"ellipsoid"`` (``delta`` >= 0 is the caller's
        choice), ``"paper"`` (scalar agents), ``"path"`` (Gaussian noise, no cells, any number of states),
        ``"linear"`` and ``"boxes"`` (any agent). ``"auto"``, which also holds for agents that a mapping leaves out,
        takes ``exact`` where it leaves most of the inputs to the policy; elsewhere it tries those of ``exact``,
        ``tube`` and ``ellipsoid`` that apply and keeps the largest bound (see ``relation_choice``); agents that no grid
        can hold get a path. ``"best"`` tries all of these without any shortcut, and ``paper``. ``"quick"`` takes
        ``exact`` or ``tube`` without comparing (see ``abstract``).
    max_sweeps : int
        Largest number of improving sweeps after the first; the search stops earlier when nothing improves.
    limits : Limits, optional
        How trees are pruned during the search.
    value : str
        How the value function is stored: as a ``"tree"`` of products (exact up to what is pruned), as a ``"train"``
        (tensor trains, rounded with a certified error, for tasks whose trees grow too many terms), or ``"auto"``.
    progress : callable or True, optional
        Called with a short text and the best value so far after each sweep; True: a bar, in notebooks, too.
    memory, accuracy : float, optional
        A budget instead of ``cells``: the memory in bytes that may be used, and the gain of the bound that is not worth
        finer cells. Cells are made finer until the first of the two is reached; ``stats["cells"]`` says how they were
        chosen (see ``refine``).
    device : str
        Where sweeps over the value tree are computed: ``"numpy"``, or a library and its device, such as
        ``"torch:cuda"`` (extra ``device``; see ``devices``). Results agree up to rounding, for which every bound has a
        reserve.
    restarts : int
        Number of further starts of the search, from the best policies with their plans advanced or delayed.
    start : Certificate, optional
        Certificate whose policies the search begins with. Its agents, cells and relations must be the same, its horizon
        need not (see ``horizons``); ``"auto"`` then stands for its relations.
    stationary : bool
        Whether policies must not depend on the time, for tasks without a deadline (see ``without_deadline``).
    **settings
        Further settings of the relation (see ``Settings``).

    Returns
    -------
    Synthesis
        ``certificate.lower_bound`` holds at the problem's start: at its initial state, or on average over its start
        box. With delta > 0 all bounds that apply are computed and the largest one is reported.

    Raises
    ------
    ValueError
        If the problem has no start, the relation does not apply to an agent, or the device does not exist.
    """
    pruning = Limits() if limits is None else limits
    told = sweep_bar() if progress is True else progress or None
    search = Search(max_sweeps, pruning, value, restarts, told, stationary, device)
    check_settings(settings)
    device_put(device)  # refuses a device that does not exist before any work is done
    budget = None if memory is None and accuracy is None else Budget(memory, accuracy)
    plan = Plan(Settings(**settings), search, budget)
    problem = as_problem(problem)
    if problem.groups and not problem.labeling.pairs:
        _refuse_start(start, "independent tasks")
        check_names("relation", relation, problem)
        return synthesize_parts(problem, cells, relation, lambda task, sizes, kinds: _of_task(task, sizes, kinds, plan))
    return _of_task(problem, cells, relation, plan, start)


def _of_task(
    problem: Problem, cells: CellCounts, relation: Relations, plan: Plan, start: Certificate | None = None
) -> Synthesis:
    """Synthesize one task, by the procedure that relations, budget and start ask for."""
    if problem.labeling.pairs:
        _refuse_for_pairs(plan, start)
        return synthesize_together(
            problem,
            cells,
            relation,
            plan.search,
            plan.settings,
            lambda task, sizes, kinds: _of_task(task, sizes, kinds, plan),
        )
    if relation == "path":
        if cells is not None or plan.budget is not None or start is not None:
            raise ValueError("`relation`: expected no cells, budget or start with 'path', which has no grid; leave out")
        return path_certificate(problem)
    is_open = relation == "auto" and cells is None and plan.budget is None and start is None
    if not is_open:
        return _on_grids(problem, cells, relation, plan, start)
    # Where a grid does not reach, or no relation applies on it, a path may.
    ways = [lambda: _on_grids(problem, None, relation, plan, None), lambda: path_certificate(problem)]
    first, second = reversed(ways) if _beyond_grids(problem) else ways
    try:
        return first()
    except RelationRefused as refusal:
        try:
            return second()
        except RelationRefused:
            raise refusal from None


def _refuse_for_pairs(plan: Plan, start: Certificate | None) -> None:
    """Refuse what tasks about pairs have no answer to."""
    _refuse_start(start, "tasks about pairs")
    if plan.budget is not None or plan.search.stationary or plan.search.value == "train":
        raise ValueError(
            "`problem`: expected no budget, no `stationary` and no tensor trains with propositions about pairs of "
            "agents; leave them out"
        )


def _on_grids(
    problem: Problem, cells: CellCounts, relation: Relations, plan: Plan, start: Certificate | None
) -> Synthesis:
    """Synthesize one task on grids."""
    kinds = ["best"] * problem.n_agents if relation == "best" else relations_of(problem, relation)
    if plan.budget is not None:
        _refuse_start(start, "a budget")
        if cells is not None:
            raise ValueError("`cells`: expected either cells or a budget `memory`, `accuracy`, got both; leave one out")
        return _within(problem, kinds, plan, plan.budget)
    if start is not None:
        if relation == "best":
            _refuse_start(start, "several relations")
        return _continued(problem, cells, kinds, plan, start)
    if cells is None and _may_be_linear(problem, kinds, plan):
        return _by_levels(problem, kinds, plan)
    if cells is None and {*kinds} == {"auto"} and _has_usual_search(plan):
        return _finer(problem, kinds, plan)
    if {"auto", "best"} & {*kinds}:
        return _compared(problem, cells, kinds, plan)
    return _plain(problem, cells, kinds, plan)


def _beyond_grids(problem: Problem) -> bool:
    """Return whether an agent has more states than a grid has room for, or states without noise."""
    for agent in problem.agents:
        if agent.n_states > MOST_GRID_STATES or np.linalg.matrix_rank(agent.noise_covariance) < agent.n_states:
            return True
    return False


def _plain(
    problem: Problem, cells: CellCounts, kinds: Sequence[str], plan: Plan, start: Certificate | None = None
) -> Synthesis:
    """Synthesize on given cells under one given relation per agent."""
    began = time.perf_counter()
    abstraction = abstraction_of(problem, cells, kinds, plan.settings)
    abstracted = time.perf_counter()
    policies = {} if start is None else policies_from(start, problem, abstraction)
    result = _on(problem, abstraction, join(problem, abstraction, plan.search.device), plan.search, policies)
    return replace(result, stats={**result.stats, "seconds": _seconds((began, abstracted))})


def _continued(problem: Problem, cells: CellCounts, kinds: list[str], plan: Plan, start: Certificate) -> Synthesis:
    """Synthesize from the policies of a certificate; cells and relations default to those of the certificate."""
    start_kinds = [part.relation["kind"] for part in checked_certificate(start).agents]
    if cells is None and len(start_kinds) == problem.n_agents:
        cells = dict(zip(problem.agent_names, (part.grid.shape for part in start.agents), strict=True))
    if len(start_kinds) == len(kinds) and "auto" in kinds:
        kinds = [from_start if kind == "auto" else kind for kind, from_start in zip(kinds, start_kinds, strict=True)]
        plan = replace(plan, settings=plan.settings.of_kinds(kinds))
    return _plain(problem, cells, kinds, plan, start)


def _compared(
    problem: Problem, cells: CellCounts, kinds: Sequence[str], plan: Plan, quick_result: Synthesis | None = None
) -> Synthesis:
    """Return the synthesis with the largest bound among all relations that apply.

    The certificate records which relations were tried. ``quick_result`` is a synthesis on the same cells, if there is
    one already.
    """
    began = time.perf_counter()
    tries = Tries(problem, groups_of(problem, cells, kinds, plan.settings), plan.settings, plan.search.device)
    abstracted = time.perf_counter()

    def run(abstraction: Abstraction, joint: JointModel, relaxations: tuple[Relaxation, ...]) -> Synthesis:
        return _on(problem, abstraction, joint, plan.search, {}, relaxations)

    best, tried = tries.best(run, quick_result, every="best" in kinds)
    stats = {**best.stats, "seconds": _seconds((began, abstracted))}
    certificate = best.certificate
    if len(tried) > 1:
        stats["tried"] = tried
        certificate = replace(certificate, settings={**certificate.settings, "relations_tried": tried})
    return Synthesis(certificate, certificate.controller, stats)


def _may_be_linear(problem: Problem, kinds: Sequence[str], plan: Plan) -> bool:
    """Return whether cells and relation are left to us, and linear cells are worth trying first.

    Every agent must have noise in all of its states. Trees of many agents grow many terms, each of which costs linear
    agents something: tensor trains on other relations are better there.
    """
    if not _has_usual_search(plan):
        return False
    if {*kinds} == {"linear"}:
        return True
    if not all(map(has_linear_cells, problem.agents)):
        return False
    scalar = all(agent.n_states == 1 and not isinstance(agent, Agent) for agent in problem.agents)
    few = problem.n_agents <= MOST_LINEAR_AGENTS or scalar
    return {*kinds} == {"auto"} and few and replace(plan.settings, targets_per_cell=None) == Settings()


def _has_usual_search(plan: Plan) -> bool:
    """Return whether nothing was said about the search that levels of cells would not heed."""
    search = plan.search
    return not (search.stationary or search.value == "train" or search.device != HOST or search.limits != Limits())


def _by_levels(problem: Problem, kinds: Sequence[str], plan: Plan) -> Synthesis:
    """Return the better of what linear cells, made finer level by level, and the other relations certify."""
    began = time.perf_counter()
    run = _run_of_levels(problem, plan)
    if "auto" in kinds and problem.n_agents > MOST_LINEAR_AGENTS:
        # The other relations are quick for single states, and show whether the tree grows many terms.
        first = _compared(problem, None, kinds, plan)
        if first.certificate.rank > MOST_LINEAR_TERMS or first.certificate.rounding is not None:
            return first if first.certificate.lower_bound >= GOOD else _doubled(problem, kinds, plan, first)
    linear, record = linear_levels(problem, plan.settings, run)
    if linear is None and any(isinstance(agent, Agent) for agent in problem.agents):
        return _finer(problem, kinds, plan)
    if linear is None:
        return _compared(problem, None, kinds, plan) if "auto" in kinds else _plain(problem, None, kinds, plan)
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
    more = {"levels": record} if best.certificate is linear.certificate else {}
    return _with_record(best, {**more, "relations_tried": tried}, began)


def _others(problem: Problem, kinds: Sequence[str], plan: Plan) -> Synthesis:
    """Return the best of other relations; boxes of expressions have coarse cells that show whether they come near."""
    written = [isinstance(agent, Agent) for agent in problem.agents]
    others = ["boxes" if flag else kind for flag, kind in zip(written, kinds, strict=True)]
    return _compared(problem, first_cells(problem) if any(written) else None, others, plan)


def _finer(problem: Problem, kinds: Sequence[str], plan: Plan) -> Synthesis:
    """Return the best of what the relations that are compared certify on coarse cells, and on finer ones."""
    began = time.perf_counter()
    first = _compared(problem, first_cells(problem), kinds, plan)
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
    return _with_record(best, {"levels": record, **more}, began)


def _with_record(result: Synthesis, more: Mapping[str, Any], began: float) -> Synthesis:
    """Return a synthesis whose certificate records how it was chosen."""
    certificate = replace(result.certificate, settings={**result.certificate.settings, **more})
    stats = {**result.stats, "seconds": {"abstract": 0.0, "synthesize": time.perf_counter() - began}}
    if "relations_tried" in more:
        stats["tried"] = more["relations_tried"]
    return Synthesis(certificate, certificate.controller, stats)


def _run_of_levels(problem: Problem, plan: Plan) -> Run:
    """Return the synthesis of one level: with policies carried over two sweeps are enough."""

    def run(abstraction: Abstraction, carried: Policies | None) -> Synthesis:
        search, starts = plan.search, {}
        if carried is not None:
            search = replace(search, max_sweeps=min(search.max_sweeps, 2), restarts=0, good_share=GOOD_CARRIED)
            starts = {"carried over": carried}
        return _on(problem, abstraction, join(problem, abstraction, search.device), search, starts)

    return run


def _doubled(problem: Problem, kinds: Sequence[str], plan: Plan, first: Synthesis) -> Synthesis:
    """Return the better of a synthesis and one on twice as many cells per axis."""
    parts = zip(problem.agent_names, first.certificate.agents, strict=True)
    cells = {name: tuple(2 * n for n in part.grid.shape) for name, part in parts}
    second = _compared(problem, cells, kinds, plan)
    best = max(first, second, key=lambda result: result.certificate.lower_bound)
    return replace(best, stats={**best.stats, **least_above(first, second)})


def _within(problem: Problem, kinds: Sequence[str], plan: Plan, budget: Budget) -> Synthesis:
    """Return the best synthesis within a budget; the settings of its certificate record how the cells were chosen.

    Linear cells come first where they are worth trying. Other relations are compared on the last cells only, which are
    chosen under the relations of the quick choice.
    """
    linear = None
    if _may_be_linear(problem, kinds, plan):
        try:
            linear = _refined(problem, ["linear"] * problem.n_agents, plan, budget)
        except RelationRefused:
            if "auto" not in kinds:
                raise
        if linear is not None and ("auto" not in kinds or linear.certificate.lower_bound >= GOOD):
            return linear
    quick = ["quick" if kind in ("auto", "best") else kind for kind in kinds]
    best = _refined(problem, quick, replace(plan, settings=plan.settings.of_kinds(quick)), budget)
    record = best.stats["cells"]
    if quick != kinds:
        parts = zip(problem.agent_names, best.certificate.agents, strict=True)
        cells = {name: part.grid.shape for name, part in parts}
        best = _recorded(_compared(problem, cells, kinds, plan, best), record)
    if linear is not None and linear.certificate.lower_bound > best.certificate.lower_bound:
        return linear
    return best


def _refined(problem: Problem, kinds: Sequence[str], plan: Plan, budget: Budget) -> Synthesis:
    """Return the best synthesis under given relations, on cells that are made finer until the budget is used up."""
    best, record = refine(problem, lambda cells: _plain(problem, cells, kinds, plan), kinds, budget)
    return _recorded(best, record)


def _recorded(result: Synthesis, record: Any) -> Synthesis:
    """Return a synthesis whose certificate records how its cells were chosen."""
    certificate = result.certificate
    if isinstance(certificate, Certificate):
        certificate = replace(certificate, settings={**certificate.settings, "cells_chosen": record})
    return Synthesis(certificate, certificate.controller, {**result.stats, "cells": record})


def _on(
    problem: Problem,
    abstraction: Abstraction,
    joint: JointModel,
    search: Search,
    starts: dict[str, Policies],
    relaxations: tuple[Relaxation, ...] | None = None,
) -> Synthesis:
    """Search on finite models, from the policies ``starts`` if there are any, and certify the result."""
    result = find_policies(problem, joint, search, starts, relaxations)
    best = stationary_best(problem, joint, result, search.limits) if search.stationary else result.best
    name = f"{'stationary policies from ' if search.stationary else ''}occupancy-weighted coordinate ascent"
    used = {**abstraction.settings, **search.used(), "final_limits": vars(FINAL)}
    return certified(problem, abstraction, joint, result, best, used, name)


def _seconds(clock: Clock) -> dict[str, float]:
    """Return the seconds that the finite models took, and those from then until now."""
    began, abstracted = clock
    return {"abstract": abstracted - began, "synthesize": time.perf_counter() - abstracted}


def _refuse_start(start: Certificate | None, what: str) -> None:
    """Refuse a certificate to start from where the search cannot use one."""
    if start is not None:
        raise ValueError(f"`start`: expected none for {what}, got a certificate; leave it out")
