"""From a problem to a certificate and its controllers: build finite models, search policies, certify them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ..envs.agents import Agent
from ..envs.problem import Problem
from ..envs.suite import as_problem
from .by_levels import by_levels, finer, has_usual_search, may_be_linear, on_given_cells
from .cells import CellCounts, RelationRefused
from .certificates import Certificate, Synthesis, checked_certificate
from .choosing import (
    GOOD,
    Budget,
    refine,
    settings_of,
)
from .in_common import either_way, names_inputs
from .models import (
    RELATIONS,
    Relations,
    Settings,
    check_names,
    check_settings,
    relations_of,
)
from .nominal_paths import path_certificate
from .on_cells import Plan, compared, plain
from .parts import synthesize_parts
from .search import Limits, Search, sweep_bar
from .together import synthesize_together
from .values import HOST, device_put

MOST_GRID_STATES = 3
"""States of an agent up to which it has a grid by default; certificates along a path need none."""


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
        ``"exact"`` (inputs reach every mean), ``"tube"`` (stabilisable), ``"ellipsoid"`` (``delta`` >= 0 is the
        caller's choice), ``"paper"`` (scalar agents), ``"path"`` (Gaussian noise, no cells, any number of states),
        ``"linear"`` and ``"boxes"`` (any agent). ``"auto"``, which also holds for agents that a mapping leaves out,
        takes ``exact`` where it leaves most of the inputs to the policy; elsewhere it tries those of ``exact``,
        ``tube`` and ``ellipsoid`` that apply, and ``linear`` where these leave much open, and keeps the largest bound
        (see ``relation_choice``); agents that no grid can hold get a path. ``"best"`` tries all of these without any
        shortcut, and ``paper``. ``"quick"`` takes ``exact`` or ``tube`` without comparing (see ``abstract``).
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
        need not (see ``horizons``); ``"auto"`` then stands for its relations, and settings that are not given are its
        own. Its policies are evaluated anew, and nothing that it claims is trusted.
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
    problem = as_problem(problem)
    _refuse_outside(problem)
    if start is not None and not problem.groups and not problem.labeling.pairs:
        settings = {**_settings_of_start(problem, relation, start), **settings}
    plan = Plan(Settings(**settings), search, budget)
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
    # Grids of three bent states take minutes: a path is tried before.
    is_usual = has_usual_search(plan) and plan.settings == Settings()
    along = _along_a_path(problem) if is_usual and _is_quicker_along_a_path(problem) else None
    if along is not None and along.certificate.lower_bound >= GOOD:
        return along
    # Where a grid does not reach, or no relation applies on it, a path may.
    ways = [lambda: _on_grids(problem, None, relation, plan, None), lambda: path_certificate(problem)]
    first, second = reversed(ways) if _beyond_grids(problem) else ways
    try:
        found = first()
    except RelationRefused as refusal:
        if along is not None:
            return along
        try:
            return second()
        except RelationRefused:
            raise refusal from None
    if along is not None:
        return max(found, along, key=lambda each: each.certificate.lower_bound)
    if not any(np.any(agent.still_axes) for agent in problem.agents) or found.certificate.lower_bound >= GOOD:
        return found
    # Without noise in some states neither way is better as a rule.
    try:
        return max(found, second(), key=lambda each: each.certificate.lower_bound)
    except RelationRefused:
        return found


def _refuse_outside(problem: Problem) -> None:
    """Refuse starts at points outside the workspace: no controller satisfies any task from there."""
    points = {agent.name for agent in problem.agents if agent.initial.is_point}
    for name in problem.starts_outside:
        if name in points:
            raise ValueError(
                f"`initial_state`: expected a start in the workspace of agent `{name}`, got one outside; no task is "
                "satisfied from there; correct the start, or `state_low` and `state_high`"
            )


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
    if plan.settings.common is None and start is None and names_inputs(problem):
        return either_way(plan, lambda chosen: _on_grids(problem, cells, relation, chosen, None))
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
    if cells is None and may_be_linear(problem, kinds, plan):
        return by_levels(problem, kinds, plan)
    if cells is None and {*kinds} == {"auto"} and has_usual_search(plan):
        return finer(problem, kinds, plan)
    if {"auto", "best"} & {*kinds}:
        return on_given_cells(problem, cells, kinds, plan)
    return plain(problem, cells, kinds, plan)


def _is_quicker_along_a_path(problem: Problem) -> bool:
    """Return whether an agent written as expressions has as many states as grids have room for, and starts are points.

    With more states a path comes first anyway.
    """
    at_points = all(agent.initial.is_point for agent in problem.agents)
    bent = any(isinstance(agent, Agent) and agent.n_states == MOST_GRID_STATES for agent in problem.agents)
    return at_points and bent and not _beyond_grids(problem)


def _along_a_path(problem: Problem) -> Synthesis | None:
    """Return a certificate along a path, or None."""
    try:
        return path_certificate(problem)
    except RelationRefused:
        return None


def _beyond_grids(problem: Problem) -> bool:
    """Return whether an agent has more states than a grid has room for, or states whose noise is that of others."""
    for agent in problem.agents:
        noisy = int(np.sum(~agent.still_axes))
        if agent.n_states > MOST_GRID_STATES or np.linalg.matrix_rank(agent.noise_covariance) < noisy:
            return True
    return False


def _continued(problem: Problem, cells: CellCounts, kinds: list[str], plan: Plan, start: Certificate) -> Synthesis:
    """Synthesize from the policies of a certificate; cells and relations default to those of the certificate."""
    start_kinds = [part.relation["kind"] for part in checked_certificate(start, "start").agents]
    if cells is None and len(start_kinds) == problem.n_agents:
        cells = dict(zip(problem.agent_names, (part.grid.shape for part in start.agents), strict=True))
    if plan.settings.common is None and any("common" in part.relation for part in start.agents):
        plan = replace(plan, settings=replace(plan.settings, common=True))
    if len(start_kinds) == len(kinds) and "auto" in kinds:
        kinds = [from_start if kind == "auto" else kind for kind, from_start in zip(kinds, start_kinds, strict=True)]
        plan = replace(plan, settings=plan.settings.of_kinds(kinds))
    return plain(problem, cells, kinds, plan, start)


def _settings_of_start(problem: Problem, relation: Relations, start: Certificate) -> dict[str, Any]:
    """Return the settings with which a certificate was made, for the relations that its agents are to have again."""
    if isinstance(relation, str) and relation not in RELATIONS:
        return {}
    certified = [part.relation["kind"] for part in checked_certificate(start, "start").agents]
    kinds = relations_of(problem, relation)
    if len(certified) == len(kinds):
        kinds = [was if kind == "auto" else kind for kind, was in zip(kinds, certified, strict=True)]
    return settings_of(start, kinds)


def _within(problem: Problem, kinds: Sequence[str], plan: Plan, budget: Budget) -> Synthesis:
    """Return the best synthesis within a budget; the settings of its certificate record how the cells were chosen.

    Linear cells come first where they are worth trying. Other relations are compared on the last cells only, which are
    chosen under the relations of the quick choice.
    """
    linear = None
    if may_be_linear(problem, kinds, plan):
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
        best = _recorded(compared(problem, cells, kinds, plan, best), record)
    if linear is not None and linear.certificate.lower_bound > best.certificate.lower_bound:
        return linear
    return best


def _refined(problem: Problem, kinds: Sequence[str], plan: Plan, budget: Budget) -> Synthesis:
    """Return the best synthesis under given relations, on cells that are made finer until the budget is used up."""
    best, record = refine(problem, lambda cells: plain(problem, cells, kinds, plan), kinds, budget)
    return _recorded(best, record)


def _recorded(result: Synthesis, record: Any) -> Synthesis:
    """Return a synthesis whose certificate records how its cells were chosen."""
    certificate = result.certificate
    if isinstance(certificate, Certificate):
        certificate = replace(certificate, settings={**certificate.settings, "cells_chosen": record})
    return Synthesis(certificate, certificate.controller, {**result.stats, "cells": record})


def _refuse_start(start: Certificate | None, what: str) -> None:
    """Refuse a certificate to start from where the search cannot use one."""
    if start is not None:
        raise ValueError(f"`start`: expected none for {what}, got a certificate; leave it out")
