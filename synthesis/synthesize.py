"""From a problem to a certificate and its controllers."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from ..envs.problem import Problem, checked_problem
from .abstraction import RELATIONS, Abstraction, Cells, abstract, check_settings
from .arrays import HOST, device_put
from .ascent import Limits, Sweep, forward, sweep
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
from .certificate import EXACT_GAP, AgentPart, Certificate
from .choices import InputMenu
from .controller import Controller
from .described_relation import describe_relation
from .joint import JointModel, join, start_of
from .product import synthesize_parts
from .refine import refine
from .relaxation import upper_bound
from .search import FINAL, improve
from .train_ascent import TrainSweep

VALUES = ("auto", "tree", "train")


@dataclass(frozen=True, eq=False)
class Synthesis:
    """A certificate, the controllers it belongs to, and how they were found.

    Parameters
    ----------
    certificate : Certificate
    controller : Controller
    stats : dict
        ``seconds`` (abstract, synthesize), ``sweeps`` (value after each), ``rank``, ``dropped``,
        ``abstract_upper_bound`` (no policy of any kind does better on this abstraction; see ``relaxation``), and with
        ``relation="best"`` what was ``tried``: the lower bound of each relation, or why it does not apply.
    """

    certificate: Certificate
    controller: Controller
    stats: dict[str, object]


def synthesize(
    problem: Problem,
    cells: Cells = None,
    *,
    relation: str = "auto",
    max_sweeps: int = 8,
    limits: Limits | None = None,
    value: str = "auto",
    progress: Callable[[str, float], None] | None = None,
    memory: float | None = None,
    accuracy: float | None = None,
    device: str = HOST,
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
    relation : str
        ``"exact"`` (B of full row rank), ``"tube"`` (stabilisable), ``"ellipsoid"`` (``delta`` >= 0 is the caller's
        choice), ``"paper"`` (scalar agents), ``"auto"``: per agent ``exact`` where it applies and ``tube`` elsewhere
        (see ``abstract``), or ``"best"``: every one of these that applies, and the largest bound is kept.
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
    began = time.perf_counter()
    if isinstance(max_sweeps, bool) or not isinstance(max_sweeps, int) or max_sweeps < 0:
        raise ValueError(f"`max_sweeps`: expected a whole number of at least 0, got {max_sweeps!r}")
    if value not in VALUES:
        raise ValueError(f"`value`: expected one of {', '.join(VALUES)}, got {value!r}")
    check_settings(settings)
    device_put(device)  # refuses what is not there before any work is done
    if checked_problem(problem).groups:
        one = partial(synthesize, relation=relation, max_sweeps=max_sweeps, limits=limits, value=value,
                      progress=progress, memory=memory, accuracy=accuracy, device=device, **settings)  # fmt: skip
        return synthesize_parts(problem, cells, one)
    if memory is not None or accuracy is not None:
        how = {"max_sweeps": max_sweeps, "limits": limits, "value": value, "progress": progress, "relation": relation,
               "device": device}  # fmt: skip
        return _within(problem, cells, memory, accuracy, {**how, **settings})
    if relation == "best":
        how = {"max_sweeps": max_sweeps, "limits": limits, "value": value, "progress": progress, "device": device}
        return _best_relation(problem, cells, how, settings)
    abstraction = abstract(problem, cells, relation=relation, **settings)
    abstracted = time.perf_counter()
    joint = join(problem, abstraction, device)
    search = Limits() if limits is None else limits
    best, values, relaxations = improve(problem, joint, search, max_sweeps, progress, value)
    used = {**abstraction.settings, "max_sweeps": max_sweeps, "limits": vars(search), "final_limits": vars(FINAL)}
    certificate = certify(problem, abstraction, joint, best, used, "occupancy-weighted coordinate ascent")
    seconds = {"abstract": abstracted - began, "synthesize": time.perf_counter() - abstracted}
    most = upper_bound(joint, start_of(problem, joint), relaxations)
    stats = {"seconds": seconds, "sweeps": values, "rank": certificate.rank, "dropped": best.dropped,
             "abstract_upper_bound": most}  # fmt: skip
    return Synthesis(certificate, certificate.controller, stats)


def _within(
    problem: Problem, cells: Cells, memory: float | None, accuracy: float | None, how: dict[str, Any]
) -> Synthesis:
    """The best synthesis within a budget; the record of its cells is kept with the settings of the certificate."""
    if cells is not None:
        raise ValueError("`cells`: expected either cells or a budget `memory`, `accuracy`, got both; leave one out")
    best, record = refine(problem, lambda own: synthesize(problem, own, **how), how["relation"], memory, accuracy)
    certificate = best.certificate
    if isinstance(certificate, Certificate):
        certificate = replace(certificate, settings={**certificate.settings, "cells_chosen": record})
    return Synthesis(certificate, certificate.controller, {**best.stats, "cells": record})


def _best_relation(problem: Problem, cells: Cells, search: dict[str, Any], settings: dict[str, Any]) -> Synthesis:
    """The synthesis with the largest bound among all relations that apply; ``stats["tried"]`` lists them all.

    A relation that does not apply raises ``ValueError``, whose text is what is listed; other errors are not expected.
    """
    tried: dict[str, float | str] = {}
    best: Synthesis | None = None
    for relation in RELATIONS:
        try:
            found = synthesize(problem, cells, relation=relation, **search, **settings)
        except ValueError as error:
            tried[relation] = " ".join(str(error).split())
            continue
        tried[relation] = found.certificate.lower_bound
        if best is None or found.certificate.lower_bound > best.certificate.lower_bound:
            best = found
    if best is None:
        raise ValueError("`relation`: expected one that applies, got none: " + "; ".join(map(str, tried.values())))
    return Synthesis(best.certificate, best.controller, {**best.stats, "tried": tried})


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
        grown, bound = best, train_bound(joint, best)
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
            law=best.laws[i],
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
