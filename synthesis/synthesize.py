"""From a problem to a certificate and its controllers."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from ..envs.problem import Problem, checked_problem
from .abstraction import (
    Abstraction,
    Cells,
    Relations,
    Settings,
    abstract,
    check_names,
    check_settings,
    relations_of,
)
from .arrays import HOST, device_put
from .ascent import Laws, Limits, Sweep, forward, sweep
from .bounds import (
    Bound,
    a_posteriori_bound,
    nominal_bound,
    relative_rounding,
    robust_bound,
    robust_loss,
    stranded_mass,
    train_bound,
    undecided_steps,
)
from .certificate import EXACT_GAP, AgentPart, Certificate, checked_certificate
from .choices import InputMenu
from .continuous_bound import continuous_upper_bound
from .controller import Controller
from .described_relation import describe_relation
from .horizons import laws_from
from .joint import JointModel, join, start_of
from .optimum import abstract_bound
from .product import synthesize_parts
from .refine import refine
from .relation_choice import Tries, groups_of
from .search import FINAL, Search, improve
from .stationary import stationary_best, time_invariant
from .train_above import evaluate_above, start_above
from .train_ascent import TrainSweep


@dataclass(frozen=True, eq=False)
class Synthesis:
    """A certificate, the controllers it belongs to, and how they were found.

    Parameters
    ----------
    certificate : Certificate
    controller : Controller
    stats : dict
        ``seconds`` (abstract, synthesize), ``sweeps`` (value after each), ``starts`` (the best value from each),
        ``rank``, ``dropped``, ``abstract_upper_bound`` (no policy of any kind does better on this abstraction; see
        ``optimum``), ``continuous_upper_bound`` (no policy of the continuous system does better; None where there is
        no bound), ``unilateral_gain`` (what one agent alone could gain by other choices at one time and automaton
        state; None for tensor trains and stationary policies), and, where relations were compared, what was
        ``tried``: the lower bound of each, or why there is none.
    """

    certificate: Certificate
    controller: Controller
    stats: dict[str, object]


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
        Cells per axis; more of them cost time and raise the bound.
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
        if len(kinds) == len(asked):
            asked = [kind if own == "auto" else own for own, kind in zip(asked, kinds, strict=True)]
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
    how = "stationary policies from " if stationary else ""
    certificate = certify(problem, abstraction, joint, best, used, f"{how}occupancy-weighted coordinate ascent")
    start = start_of(problem, joint)
    anywhere = continuous_upper_bound(problem, joint, start)
    most = abstract_bound(problem, joint, start, found.relaxations, certificate.lower_bound)
    if anywhere is not None and certificate.delta == 0.0:  # what abstract policies attain, continuous ones do
        most = min(most, anywhere)
    stats: dict[str, object] = {
        "sweeps": found.values,
        "starts": found.starts,
        "rank": certificate.rank,
        "dropped": best.dropped,
        "abstract_upper_bound": most,
        "continuous_upper_bound": anywhere,
        "unilateral_gain": None if stationary else found.unilateral_gain,
    }
    return Synthesis(certificate, certificate.controller, stats)


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
    if not {"ellipsoid", "paper"} & {*quick}:
        how = {name: value for name, value in how.items() if name not in ("delta", "share")}
    best, record = refine(problem, lambda own: synthesize(problem, own, relation=first, **how), first, memory, accuracy)
    if quick != asked:
        parts = zip(problem.agent_names, best.certificate.agents, strict=True)
        best = compare({name: part.grid.shape for name, part in parts}, best)
    certificate = best.certificate
    if isinstance(certificate, Certificate):
        certificate = replace(certificate, settings={**certificate.settings, "cells_chosen": record})
    return Synthesis(certificate, certificate.controller, {**best.stats, "cells": record})


def certify(
    problem: Problem,
    abstraction: Abstraction,
    joint: JointModel,
    best: Sweep | TrainSweep,
    settings: dict[str, Any],
    search: str,
) -> Certificate:
    """Certificate of the policies of ``best``, a sweep with frozen policies, with the largest bound that applies."""
    grown: Sweep | TrainSweep
    if isinstance(best, TrainSweep):
        above = None
        if abstraction.is_exact:
            above = start_above(start_of(problem, joint), evaluate_above(joint, best.laws, best.rounding))
        grown, bound = best, train_bound(joint, best, above)
        bounds = {bound.name: bound.lower}
    else:
        grown, bound, bounds = best_bound(problem, abstraction, joint, best)
    parts = []
    for i, model in enumerate(joint.models):
        part = AgentPart(
            grid=model.grid,
            coordinates=model.relation.coordinates,
            relation=describe_relation(model.relation),
            lattice=model.lattice,
            masks=joint.masks[i],
            start_masks=joint.start_masks[i],
            law=time_invariant(best.laws[i]),
            menu=model.choices.leads_to if isinstance(model.choices, InputMenu) else None,
        )
        parts.append(part)
    point = all(np.array_equal(agent.initial.low, agent.initial.high) for agent in problem.agents)
    return Certificate(
        problem=problem,
        method=f"{settings['relation']} relation, {search}",
        bound=bound.name,
        bounds=bounds,
        start="point" if point else "mean",
        lower_bound=bound.lower,
        gap=bound.gap,
        exact=bound.gap is not None and bound.gap <= EXACT_GAP,
        relative_rounding=relative_rounding(joint, grown.rank),
        agents=tuple(parts),
        guard_source=joint.guards.source,
        guard_target=joint.guards.target,
        guard_mask=joint.guards.mask,
        start_target=joint.start_guards.target,
        start_mask=joint.start_guards.mask,
        skeleton=grown.skeleton if isinstance(grown, Sweep) else (),
        terms=grown.terms if isinstance(grown, Sweep) else None,
        rank=grown.rank,
        settings=settings,
        rounding=grown.rounding if isinstance(grown, TrainSweep) else None,
    )


def best_bound(
    problem: Problem, abstraction: Abstraction, joint: JointModel, best: Sweep
) -> tuple[Sweep, Bound, dict[str, float]]:
    """The largest bound that applies to the policies of ``best``, the tree it was read off, and all bounds by name."""
    if all(model.delta == 0.0 for model in joint.models):
        stranded = 0.0
        if abstraction.is_exact and any(np.any(model.choices.resting_law < 0) for model in joint.models):
            stranded = stranded_mass(joint, best.laws, forward(joint, best.laws, start_of(problem, joint), FINAL))
        bound = nominal_bound(joint, best, abstraction.is_exact, stranded)
        return best, bound, {bound.name: bound.lower}
    start = start_of(problem, joint)
    undecided = undecided_steps(joint, forward(joint, best.laws, start, FINAL))
    robust = sweep(joint, best.laws, start, FINAL, improve=False, loss=robust_loss)
    found = [(best, a_posteriori_bound(joint, best, undecided)), (robust, robust_bound(joint, robust))]
    grown, bound = max(found, key=lambda pair: pair[1].lower)
    return grown, bound, {other.name: other.lower for _, other in found}
