"""From a problem to a certificate and its controllers: finite models, search, result."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

from ..envs.problem import Problem, checked_problem
from .certificates import Certificate, Synthesis, checked_certificate
from .certification import bounds_from_above, certificate_of
from .choosing import Tries, groups_of, laws_from, refine
from .models import (
    Abstraction,
    Cells,
    JointModel,
    Laws,
    Relations,
    Settings,
    abstract,
    check_names,
    check_settings,
    join,
    relations_of,
)
from .parts import synthesize_parts
from .search import FINAL, Limits, Search, improve, stationary_best
from .values import HOST, device_put


def synthesize(
    problem: Problem,
    cells: Cells = None,
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
    problem : Problem
        Agents with positive definite noise, to whom the relation applies. A task that falls apart into independent ones
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
        (extra ``device``; see ``arrays``). Results agree to rounding, for which every bound has a reserve.
    restarts : int
        Further starts of the search, from the best policies with their plans advanced or delayed.
    start : Certificate, optional
        Policies to begin with, of the same agents, cells and relation, for any horizon (see ``horizons``); ``"auto"``
        is then their relation.
    stationary : bool
        Policies that do not look at the time, for tasks without a deadline (see ``without_deadline``).
    **settings
        Further settings of the relation, passed to ``abstract``.

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
    search = Search(max_sweeps, Limits() if limits is None else limits, value, restarts, progress)
    check_settings(settings)
    device_put(device)  # refuses what is not there before any work is done
    how = {"max_sweeps": max_sweeps, "limits": limits, "value": value, "restarts": restarts, "progress": progress,
           "stationary": stationary, "device": device, **settings}  # fmt: skip
    if checked_problem(problem).groups:
        _refuse_start(start, "independent tasks")
        check_names("relation", relation, problem)
        one = partial(synthesize, memory=memory, accuracy=accuracy, **how)
        return synthesize_parts(problem, cells, relation, one)
    asked = ["best"] * problem.n_agents if relation == "best" else relations_of(problem, relation)
    compare = partial(_compared, problem, asked=asked, settings=Settings(**settings), search=search, device=device,
                      stationary=stationary)  # fmt: skip
    if memory is not None or accuracy is not None:
        _refuse_start(start, "a budget")
        if cells is not None:
            raise ValueError("`cells`: expected either cells or a budget `memory`, `accuracy`, got both; leave one out")
        return _within(problem, memory, accuracy, asked, how, compare)
    if start is not None:
        if relation == "best":
            _refuse_start(start, "several relations")
        kinds = [part.relation["kind"] for part in checked_certificate(start).agents]
        if cells is None and len(kinds) == problem.n_agents:
            cells = dict(zip(problem.agent_names, (part.grid.shape for part in start.agents), strict=True))
        if len(kinds) == len(asked) and "auto" in asked:
            asked = [kind if own == "auto" else own for own, kind in zip(asked, kinds, strict=True)]
            settings = _taken(settings, asked)
    began = time.perf_counter()
    if {"auto", "best"} & {*asked} and start is None:
        return compare(cells)
    abstraction = abstract(problem, cells, relation=_one_or_each(problem, asked), **settings)
    abstracted = time.perf_counter()
    given = {} if start is None else laws_from(start, problem, abstraction)
    result = _on(problem, abstraction, join(problem, abstraction, device), search, given, stationary)
    result.stats["seconds"] = {"abstract": abstracted - began, "synthesize": time.perf_counter() - abstracted}
    return result


def _one_or_each(problem: Problem, asked: list[str]) -> Relations:
    """What is asked for of all agents alike, or of each."""
    return asked[0] if len({*asked}) == 1 else dict(zip(problem.agent_names, asked, strict=True))


def _compared(
    problem: Problem, cells: Cells, known: Synthesis | None = None, *, asked: list[str], settings: Settings,
    search: Search, device: str, stationary: bool,
) -> Synthesis:  # fmt: skip
    """The synthesis with the largest bound among relations that apply; what was tried is kept with the certificate."""
    began = time.perf_counter()
    tries = Tries(problem, groups_of(problem, cells, asked, settings), settings, device)
    abstracted = time.perf_counter()

    def run(abstraction: Abstraction, joint: JointModel) -> Synthesis:
        return _on(problem, abstraction, joint, search, {}, stationary)

    best, tried = tries.best(run, known, "best" in asked)
    stats = {**best.stats, "seconds": {"abstract": abstracted - began, "synthesize": time.perf_counter() - abstracted}}
    certificate = best.certificate
    if len(tried) > 1:
        stats["tried"] = tried
        certificate = replace(certificate, settings={**certificate.settings, "relations_tried": tried})
    return Synthesis(certificate, certificate.controller, stats)


def _on(
    problem: Problem, abstraction: Abstraction, joint: JointModel, search: Search, given: dict[str, Laws],
    stationary: bool,
) -> Synthesis:  # fmt: skip
    """Search, from the ``given`` policies if there are any, and certify."""
    found = improve(problem, joint, search, given)
    best = found.best
    if stationary:
        best = stationary_best(problem, joint, found, search.limits)
    used = {**abstraction.settings, "max_sweeps": search.max_sweeps, "restarts": search.restarts,
            "stationary": stationary, "limits": vars(search.limits), "final_limits": vars(FINAL)}  # fmt: skip
    name = f"{'stationary policies from ' if stationary else ''}occupancy-weighted coordinate ascent"
    certificate = certificate_of(problem, abstraction, joint, best, used, name)
    stats: dict[str, object] = {
        "sweeps": found.values,
        "starts": found.starts,
        "rank": certificate.rank,
        "dropped": best.dropped,
        "unilateral_gain": None if stationary else found.unilateral_gain,
        **bounds_from_above(problem, joint, found.relaxations, certificate),
    }
    return Synthesis(certificate, certificate.controller, stats)


def _taken(settings: dict[str, Any], kinds: list[str]) -> dict[str, Any]:
    """Settings without those that were for relations which are not among the chosen ones."""
    foreign = {"delta": {"ellipsoid", "paper"}, "share": {"ellipsoid"}}
    return {name: value for name, value in settings.items() if foreign.get(name, {*kinds}) & {*kinds}}


def _refuse_start(start: Certificate | None, what: str) -> None:
    if start is not None:
        raise ValueError(f"`start`: expected none for {what}, got a certificate; leave it out")


def _within(
    problem: Problem, memory: float | None, accuracy: float | None, asked: list[str], how: dict[str, Any],
    compare: Callable[[Cells, Synthesis], Synthesis],
) -> Synthesis:  # fmt: skip
    """The best synthesis within a budget; the record of its cells is kept with the settings of the certificate.

    Relations are compared on the last cells only; what led to them is the quick choice.
    """
    quick = ["quick" if own in ("auto", "best") else own for own in asked]
    first = _one_or_each(problem, quick)
    how = _taken(how, quick)
    best, record = refine(problem, lambda own: synthesize(problem, own, relation=first, **how), first, memory, accuracy)
    if quick != asked:
        parts = zip(problem.agent_names, best.certificate.agents, strict=True)
        best = compare({name: part.grid.shape for name, part in parts}, best)
    certificate = best.certificate
    if isinstance(certificate, Certificate):
        certificate = replace(certificate, settings={**certificate.settings, "cells_chosen": record})
    return Synthesis(certificate, certificate.controller, {**best.stats, "cells": record})
