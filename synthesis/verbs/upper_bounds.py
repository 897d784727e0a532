"""Upper ends: at most how often certified controllers, or deployed networks, succeed.

They are certified for the *opposite* task, which is satisfied where the task is not; whoever leaves a workspace has
failed, and satisfies the opposite. So one minus a lower bound for the opposite is an upper bound for the task, and
relation, reading, tree and check are those of all certificates (docs/theory/bounds.md, "The other end of any
certificate").
"""

from __future__ import annotations

import json
import math
from dataclasses import replace
from typing import Any

import numpy as np

from ...envs.systems.backends import on_one_thread
from ...envs.tasks.problem import Problem, complement_inside, complement_of
from ..abstraction.models import Abstraction, Policies, Settings, abstraction_of, join, start_of, surrounded
from ..certificates.proofs import OnGrid, Synthesis, certificate_from, changed, with_claims
from ..extended_check.claims import check, checked_once
from ..policy_search.ascent import FINAL, Limits, Stage, sweep
from ..policy_search.cell_certificates import certificate_of
from ..policy_search.portfolio import Effort, OutOfTime, policies_from, settings_of
from ..relations.grids import RelationRefused
from .raw_networks import network_abstraction_of

LIMITS = Limits(contribution=1e-7, elsewhere=1e-2, mass=1e-8, rank=400)
"""What may be left out where steps are not additive: less than searches do, as every agent may leave at every time."""

CHOICES_PER_SECOND, POINTS_PER_SECOND, SMOOTHED_PER_SECOND = 2e5, 1e6, 2e7
"""Choices of cells, and lattice points, of which models are made in a core second, and numbers that are smoothed."""


@on_one_thread
def bound_above(certificate: Any) -> Any:
    """Return a certificate with a certified upper bound on how often its controllers satisfy its task.

    It is for all certificates on cells, and for what is put together of them; others are returned as they are, and
    those that have an upper end already. It takes about as long as an evaluation of the policies.

    The end becomes part of the certificate (``opposite``, ``gap``, ``upper_bound``): it is saved with it, verified by
    ``check``, and compared with rollouts by ``validate``.

    Parameters
    ----------
    certificate : Synthesis, Certificate or path
        Its policies, cells, relations and their settings are taken, and evaluated anew for the opposite task.

    Raises
    ------
    ValueError
        If its policies cannot be evaluated.
    """
    return _ended(certificate_from(certificate), math.inf)


def synthesis_above(synthesis: Synthesis, most: float = math.inf) -> Synthesis:
    """Return a synthesis whose certificate has an upper end, if it can have one.

    The end of each task may take ``most`` core seconds of work, as it is estimated; else there is none.
    """
    certificate = _ended(synthesis.certificate, most)
    return replace(synthesis, certificate=certificate, controller=certificate.controller)


def _ended(certificate: Any, most: float) -> Any:
    """Return a certificate whose parts have upper ends, where they are ends of the whole, too.

    What pairs may spoil counts the runs that the cells follow: where a cell has several classes others may succeed.
    """
    ended = with_claims(certificate, lambda one: _with_end(one, most))
    return ended if not ended.proof.parts or ended.gap == certificate.gap or checked_once(ended) else certificate


def _with_end(certificate: OnGrid, most: float = math.inf) -> OnGrid:
    """Return the certificate of one task with an upper end, if that takes no more than ``most`` core seconds."""
    if certificate.gap is not None or _work_of_models(certificate) > most:
        return certificate
    try:
        complement = _complement(certificate, Effort(allowance=most))
    except OutOfTime:
        return certificate
    except ValueError as error:
        if math.isfinite(most):
            return certificate  # nobody asked for it
        raise ValueError(f"`certificate`: its policies cannot be evaluated for the opposite task: {error}") from error
    if math.isfinite(most) and complement.lower_bound <= 0.0:
        return certificate  # it says nothing
    above = min(1.0, math.nextafter(1.0 - complement.lower_bound, 2.0))
    # Rounded up: the sum of bound and gap must not be below the end.
    gap = max(0.0, math.nextafter(above - certificate.lower_bound, 2.0))
    return changed(certificate, complement=complement, gap=gap)


def _work_of_models(certificate: OnGrid) -> float:
    """Return an estimate of what it takes to make the finite models of a certificate again, in core seconds."""
    different = {json.dumps(part.relation, sort_keys=True): part for part in certificate.proof.agents}
    return sum(
        part.grid.n_cells * max(1, len(part.relation.get("menu", ()))) / CHOICES_PER_SECOND
        + math.prod(part.lattice_shape) / POINTS_PER_SECOND
        for part in different.values()
    )


def _complement(certificate: OnGrid, effort: Effort) -> OnGrid:
    """Return the certificate of the same controllers for the opposite task, which separate code accepts.

    Raises
    ------
    OutOfTime
        If that takes too much.
    ValueError
        If separate code refuses it.
    """
    problem, abstraction = certificate.problem, abstraction_again(certificate)
    policies = tuple(
        np.broadcast_to(part.policy, (problem.horizon, *part.policy.shape[1:])) for part in certificate.proof.agents
    )
    # Unions from below rest on ratios of small numbers, of which separate code may find others. Without them trees are
    # larger, and nothing rests on ratios.
    for unites in (True, False) if any(model.is_linear for model in abstraction.models) else (True,):
        found = list[OnGrid]()
        try:
            other = complement_of(problem)
            found.append(evaluated(other, *surrounded(other, abstraction, policies), certificate, effort, unites))
        except RelationRefused:
            pass  # there would be too many cells around the workspaces
        if not found or any(model.delta > 0.0 for model in abstraction.models):
            # Runs that leave count as if they might have succeeded. Where relations may be lost, what is lost of exits
            # may be more than they are worth.
            found.append(evaluated(complement_inside(problem), abstraction, policies, certificate, effort, unites))
        for one in sorted(found, key=lambda one: -one.lower_bound):
            if check(one):
                return one
    raise ValueError("separate code does not find what it claims")


def abstraction_again(certificate: OnGrid) -> Abstraction:
    """Return the finite models that a certificate was made with."""
    problem, parts = certificate.problem, certificate.proof.agents
    if any("network" in part.relation for part in parts):
        return network_abstraction_of(certificate)
    kinds = [part.relation["kind"] for part in parts]
    settings = Settings(**settings_of(certificate, kinds))
    cells = dict(zip(problem.agent_names, (part.grid.shape for part in parts), strict=True))
    abstraction = abstraction_of(problem, cells, kinds, settings)
    policies_from(certificate, problem, abstraction)  # refuses models in which its choices mean something else
    return abstraction


def evaluated(
    problem: Problem,
    abstraction: Abstraction,
    policies: Policies,
    certificate: OnGrid,
    effort: Effort | None = None,
    unites: bool = True,
) -> OnGrid:
    """Return the certificate of given policies for another task of the agents of a certificate.

    Terms of steps that are not additive are united from below if ``unites``.
    """
    effort = Effort(allowance=math.inf) if effort is None else effort
    joint = replace(join(problem, abstraction), spend=effort.count)
    limits = LIMITS
    if all(model.is_additive for model in joint.models):
        limits = Limits() if math.isfinite(effort.allowance) else FINAL
    # Whether unions from below pay is not known before; with linear cells they hardly lose.
    lossy = [model for model in joint.models if not model.is_additive and not model.is_linear]
    climbs: tuple[float | None, ...] = (0.0,) if unites else (None,)
    climbs = (0.0, None) if lossy and len(joint.models) > 1 else climbs
    start = start_of(problem, joint)

    def watch(stage: Stage) -> None:
        effort.count(sum(table.size for table in stage.backed_up) / SMOOTHED_PER_SECOND)

    tries = [sweep(joint, policies, start, limits, improve=False, watch=watch, climb=climb) for climb in climbs]
    best = max(tries, key=lambda found: found.value)
    settings = {**certificate.settings, **abstraction.settings, "final_limits": vars(limits)}
    found = certificate_of(problem, abstraction, joint, best, settings, "policies of the task")
    # What is said of the opposite from above is of no use.
    return changed(found, gap=None)
