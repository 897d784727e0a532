"""From a problem to a certificate and its controllers."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ..envs.problem import Problem
from .abstraction import Abstraction, Cells, abstract
from .ascent import Limits, Sweep, resting_laws, sweep
from .bounds import Bound, nominal_bound
from .certificate import EXACT_GAP, AgentPart, Certificate
from .controller import Controller
from .joint import JointModel, join, start_of

FINAL = Limits(contribution=1e-12, elsewhere=1e-6, mass=1e-12, rank=4000)
"""What the last pass, with frozen policies, may leave out."""


@dataclass(frozen=True, eq=False)
class Synthesis:
    """A certificate, the controllers it belongs to, and how they were found.

    Parameters
    ----------
    certificate : Certificate
    controller : Controller
    stats : dict
        ``seconds`` (abstract, synthesize), ``sweeps`` (value after each), ``rank``, ``rounding``, ``dropped``.
    """

    certificate: Certificate
    controller: Controller
    stats: dict[str, object]


def synthesize(
    problem: Problem,
    cells: Cells = None,
    *,
    targets_per_cell: int = 1,
    max_sweeps: int = 8,
    limits: Limits | None = None,
    progress: Callable[[str, float], None] | None = None,
) -> Synthesis:
    """Per-agent controllers for ``problem`` and a certified lower bound on its satisfaction probability.

    Parameters
    ----------
    problem : Problem
        Agents with full-row-rank ``B`` and positive definite noise.
    cells : int, sequence of int or mapping from agent name, optional
        Cells per axis; more of them cost time and raise the bound.
    targets_per_cell : int
        Target means per cell and axis.
    max_sweeps : int
        Most improving sweeps after the first; the search stops earlier when nothing improves.
    limits : Limits, optional
        Pruning during the search.
    progress : callable, optional
        Called with a short text and the best value so far after each sweep.

    Returns
    -------
    Synthesis
        ``certificate.lower_bound`` holds from the problem's start: its initial state, or on average over its box.

    Raises
    ------
    ValueError
        If the problem has no start, or the ``exact`` relation does not apply to an agent.
    """
    began = time.perf_counter()
    if isinstance(max_sweeps, bool) or not isinstance(max_sweeps, int) or max_sweeps < 0:
        raise ValueError(f"`max_sweeps`: expected a whole number of at least 0, got {max_sweeps!r}")
    abstraction = abstract(problem, cells, targets_per_cell)
    abstracted = time.perf_counter()
    joint = join(problem, abstraction)
    search = Limits() if limits is None else limits
    best, values = improve(problem, joint, search, max_sweeps, progress)
    bound = nominal_bound(joint, best, abstraction.is_exact)
    settings = {**abstraction.settings, "max_sweeps": max_sweeps, "limits": vars(search), "final_limits": vars(FINAL)}
    certificate = certify(problem, abstraction, joint, best, bound, settings)
    seconds = {"abstract": abstracted - began, "synthesize": time.perf_counter() - abstracted}
    stats = {
        "seconds": seconds,
        "sweeps": values,
        "rank": best.rank,
        "rounding": bound.rounding,
        "dropped": best.dropped,
    }
    return Synthesis(certificate, certificate.controller, stats)


def improve(
    problem: Problem,
    joint: JointModel,
    limits: Limits,
    max_sweeps: int,
    progress: Callable[[str, float], None] | None = None,
) -> tuple[Sweep, list[float]]:
    """Best policies found by coordinate ascent, evaluated with frozen laws; and the value after each sweep.

    The first sweep has no occupancy to go by and weighs all cells alike; every later one starts from the policies of
    the one before. The best policies are kept, whatever pruning did to a later sweep.
    """
    start = start_of(problem, joint)
    best = sweep(joint, resting_laws(joint), None, limits, improve=True)
    best = replace(best, value=-1.0)
    current, values = best, []
    for k in range(max_sweeps):
        current = sweep(joint, current.laws, start, limits, improve=True)
        values.append(current.value)
        if progress is not None:
            progress(f"sweep {k + 1}", max(current.value, best.value))
        gained = current.value > best.value * (1 + 1e-9)
        if current.value > best.value:
            best = current
        if not gained:
            break
    return sweep(joint, best.laws, start, FINAL, improve=False), values


def certify(
    problem: Problem, abstraction: Abstraction, joint: JointModel, best: Sweep, bound: Bound, settings: dict
) -> Certificate:  # fmt: skip
    """Put everything a certificate holds together."""
    parts = [
        AgentPart(model.grid, model.relation.coordinates, model.lattice, mask.astype(bool), law)
        for model, mask, law in zip(joint.models, joint.masks, best.laws, strict=True)
    ]
    point = all(np.array_equal(agent.initial.low, agent.initial.high) for agent in problem.agents)
    relative = 1.0 - bound.lower / best.value if best.value > 0 else 0.0
    return Certificate(
        problem=problem,
        method="exact relation, occupancy-weighted coordinate ascent",
        bound=bound.name,
        start="point" if point else "mean",
        lower_bound=bound.lower,
        gap=bound.gap,
        exact=bound.gap is not None and bound.gap <= EXACT_GAP,
        relative_rounding=max(relative, 0.0),
        agents=tuple(parts),
        guard_source=joint.guards.source,
        guard_target=joint.guards.target,
        guard_mask=joint.guards.mask,
        skeleton=best.skeleton,
        terms=best.terms,
        rank=best.rank,
        settings=settings,
    )
