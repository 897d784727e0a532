"""From a problem to a certificate and its controllers: finite models, search, result."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

from ..envs.problem import Problem
from ..envs.suite import as_problem
from .cells import CellCounts
from .certificates import Certificate, Synthesis, checked_certificate
from .certification import certified
from .choosing import Budget, Tries, groups_of, policies_from, refine
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
from .parts import synthesize_parts
from .search import FINAL, Limits, Relaxation, Search, find_policies, stationary_best
from .values import HOST, device_put

Clock = tuple[float, float]
"""When the work began, and when the finite models were there, in seconds of ``perf_counter``."""


@dataclass(frozen=True)
class Plan:
    """How a task is to be synthesized, apart from its cells and relations.

    Parameters
    ----------
    settings : Settings
        Of the relations.
    search : Search
        For policies.
    budget : Budget or None
        If given, cells are made finer until it is used up.
    """

    settings: Settings
    search: Search
    budget: Budget | None


# The door of the package: its options are flat, as users and the command line have them, and become records at once.
def synthesize(
    problem: Any,
    cells: CellCounts = None,
    *,
    relation: Relations = "auto",
    max_sweeps: int = 8,
    limits: Limits | None = None,
    value: str = "auto",
    progress: Callable[[str, float], None] | None = None,
    memory: float | None = None,
    accuracy: float | None = None,
    device: str = HOST,
    restarts: int = 0,
    start: Certificate | None = None,
    stationary: bool = False,
    **settings: Any,
) -> Synthesis:
    """Per-agent controllers for ``problem`` and a certified lower bound on its satisfaction probability.

    Parameters
    ----------
    problem : Problem, id or path
        Agents with positive definite noise, to whom the relation applies. A task that decomposes into independent tasks
        (``problem.groups``) is certified part by part, and gives a ``ProductCertificate``.
    cells : int, sequence of int or mapping from agent name, optional
        Cells per axis; more of them cost time and raise the bound. Default: by dimension (see ``abstract``), doubled
        where relations are compared and none applies.
    relation : str, or mapping from agent name to str
        ``"exact"`` (B of full row rank), ``"tube"`` (stabilisable), ``"ellipsoid"`` (``delta`` >= 0 is the caller's
        choice), ``"paper"`` (scalar agents). ``"auto"``, also for agents that a mapping leaves out: ``exact`` where it
        leaves most of the inputs to the policy; elsewhere ``exact``, ``tube`` and ``ellipsoid`` as far as they apply,
        and the largest bound is kept (see ``relation_choice``). ``"best"``: the same without any shortcut, ``paper``
        included. ``"quick"``: ``exact`` or ``tube``, without comparing (see ``abstract``).
    max_sweeps : int
        Most improving sweeps after the first; the search stops earlier when nothing improves.
    limits : Limits, optional
        Pruning during the search.
    value : str
        How the value function is held: ``"tree"`` of products (exact up to what is pruned), ``"train"`` (tensor trains,
        rounded with a certified error: for tasks whose trees grow too many terms), or ``"auto"``.
    progress : callable, optional
        Called with a short text and the best value so far after each sweep.
    memory, accuracy : float, optional
        Instead of ``cells``: bytes that may be taken, and the change of the bound that is not worth finer cells. Cells
        are made finer until one of them is used up; how they were chosen is in ``stats["cells"]`` (see ``refine``).
    device : str
        Where sweeps over the value tree compute: ``"numpy"``, or a library and its device, such as ``"torch:cuda"``
        (extra ``device``; see ``devices``). Results agree to rounding, for which every bound has a reserve.
    restarts : int
        Further starts of the search, from the best policies with their plans advanced or delayed.
    start : Certificate, optional
        Policies to begin with, of the same agents, cells and relation, for any horizon (see ``horizons``); ``"auto"``
        is then their relation.
    stationary : bool
        Policies that do not look at the time, for tasks without a deadline (see ``without_deadline``).
    **settings
        Further settings of the relation (see ``Settings``).

    Returns
    -------
    Synthesis
        ``certificate.lower_bound`` holds from the problem's start: its initial state, or on average over its box. With
        delta > 0 all bounds that apply are computed and the best one is reported.

    Raises
    ------
    ValueError
        If the problem has no start, the relation does not apply to an agent, or the device is not there.
    """
    pruning = Limits() if limits is None else limits
    search = Search(max_sweeps, pruning, value, restarts, progress, stationary, device)
    check_settings(settings)
    device_put(device)  # refuses what is not there before any work is done
    budget = None if memory is None and accuracy is None else Budget(memory, accuracy)
    plan = Plan(Settings(**settings), search, budget)
    problem = as_problem(problem)
    if problem.groups:
        _refuse_start(start, "independent tasks")
        check_names("relation", relation, problem)
        return synthesize_parts(problem, cells, relation, lambda task, own, kinds: _of_task(task, own, kinds, plan))
    return _of_task(problem, cells, relation, plan, start)


def _of_task(
    problem: Problem, cells: CellCounts, relation: Relations, plan: Plan, start: Certificate | None = None
) -> Synthesis:
    """Synthesis of one task, by the procedure that relations, budget and start ask for."""
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
    if {"auto", "best"} & {*kinds}:
        return _compared(problem, cells, kinds, plan)
    return _plain(problem, cells, kinds, plan)


def _plain(
    problem: Problem, cells: CellCounts, kinds: Sequence[str], plan: Plan, start: Certificate | None = None
) -> Synthesis:
    """Synthesis on given cells under one given relation per agent."""
    began = time.perf_counter()
    abstraction = abstraction_of(problem, cells, kinds, plan.settings)
    abstracted = time.perf_counter()
    given = {} if start is None else policies_from(start, problem, abstraction)
    result = _on(problem, abstraction, join(problem, abstraction, plan.search.device), plan.search, given)
    return replace(result, stats={**result.stats, "seconds": _seconds((began, abstracted))})


def _continued(problem: Problem, cells: CellCounts, kinds: list[str], plan: Plan, start: Certificate) -> Synthesis:
    """Synthesis that begins with the policies of a certificate; what is not asked for is as it is there."""
    theirs = [part.relation["kind"] for part in checked_certificate(start).agents]
    if cells is None and len(theirs) == problem.n_agents:
        cells = dict(zip(problem.agent_names, (part.grid.shape for part in start.agents), strict=True))
    if len(theirs) == len(kinds) and "auto" in kinds:
        kinds = [other if kind == "auto" else kind for kind, other in zip(kinds, theirs, strict=True)]
        plan = replace(plan, settings=plan.settings.of_kinds(kinds))
    return _plain(problem, cells, kinds, plan, start)


def _compared(
    problem: Problem, cells: CellCounts, kinds: Sequence[str], plan: Plan, known: Synthesis | None = None
) -> Synthesis:
    """The synthesis with the largest bound among relations that apply; what was tried is kept with the certificate."""
    began = time.perf_counter()
    tries = Tries(problem, groups_of(problem, cells, kinds, plan.settings), plan.settings, plan.search.device)
    abstracted = time.perf_counter()

    def run(abstraction: Abstraction, joint: JointModel, relaxations: tuple[Relaxation, ...]) -> Synthesis:
        return _on(problem, abstraction, joint, plan.search, {}, relaxations)

    best, tried = tries.best(run, known, every="best" in kinds)
    stats = {**best.stats, "seconds": _seconds((began, abstracted))}
    certificate = best.certificate
    if len(tried) > 1:
        stats["tried"] = tried
        certificate = replace(certificate, settings={**certificate.settings, "relations_tried": tried})
    return Synthesis(certificate, certificate.controller, stats)


def _within(problem: Problem, kinds: Sequence[str], plan: Plan, budget: Budget) -> Synthesis:
    """The best synthesis within a budget; the record of its cells is kept with the settings of the certificate.

    Relations are compared on the last cells only; what led to them is the quick choice.
    """
    quick = ["quick" if kind in ("auto", "best") else kind for kind in kinds]
    first = replace(plan, settings=plan.settings.of_kinds(quick))
    best, record = refine(problem, lambda cells: _plain(problem, cells, quick, first), quick, budget)
    if quick != kinds:
        parts = zip(problem.agent_names, best.certificate.agents, strict=True)
        best = _compared(problem, {name: part.grid.shape for name, part in parts}, kinds, plan, best)
    certificate = best.certificate
    if isinstance(certificate, Certificate):
        certificate = replace(certificate, settings={**certificate.settings, "cells_chosen": record})
    return Synthesis(certificate, certificate.controller, {**best.stats, "cells": record})


def _on(
    problem: Problem,
    abstraction: Abstraction,
    joint: JointModel,
    search: Search,
    given: dict[str, Policies],
    relaxations: tuple[Relaxation, ...] | None = None,
) -> Synthesis:
    """Search on finite models, from the ``given`` policies if there are any, and certify what was found."""
    found = find_policies(problem, joint, search, given, relaxations)
    best = stationary_best(problem, joint, found, search.limits) if search.stationary else found.best
    name = f"{'stationary policies from ' if search.stationary else ''}occupancy-weighted coordinate ascent"
    used = {**abstraction.settings, **search.used(), "final_limits": vars(FINAL)}
    return certified(problem, abstraction, joint, found, best, used, name)


def _seconds(clock: Clock) -> dict[str, float]:
    """Seconds that the finite models took, and the rest until now."""
    began, abstracted = clock
    return {"abstract": abstracted - began, "synthesize": time.perf_counter() - abstracted}


def _refuse_start(start: Certificate | None, what: str) -> None:
    """Refuse policies to begin with where none can be taken."""
    if start is not None:
        raise ValueError(f"`start`: expected none for {what}, got a certificate; leave it out")
