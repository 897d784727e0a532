"""From the policies that a search has found to their certificate and the statistics of the search.

``certificate_of`` turns the last evaluation of policies into a certificate. It takes the largest lower bound that
applies and, where the finite models lose nothing, says how far above the bound the probability can be.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ....envs.tasks.problem import Problem
from ...abstraction.models import Abstraction, JointModel, start_of
from ...certificates.beliefs import believed_on_cells
from ...certificates.cell_probabilities import AgentRecord
from ...certificates.proofs import Certificate, GridProof, OnGrid, Synthesis, delta_of
from ...certificates.value_functions import Terms, start_above
from ...relations.kinds import describe_relation
from ..ascent import FINAL, Relaxation, SearchResult, Sweep, TrainSweep, forward, sweep
from ..bounds import (
    Bound,
    a_posteriori_bound,
    abstract_bound,
    continuous_upper_bound,
    deadlocked_mass,
    evaluate_above,
    nominal_bound,
    relative_rounding,
    robust_bound,
    robust_loss,
    rounding_loss,
    train_bound,
    undecided_steps,
)

STORED_MARGIN = 1e-6
"""Share of the largest value of a factor by which it is stored lower: far above rounding, far below what matters."""

STORED_LOSS = 1e-10
"""What is taken off for every step besides: a remainder is a small difference of factors near 1, has the rounding of
these, and is the larger the more a step takes off one of them, of which the check may take off less."""


def certified(
    problem: Problem,
    abstraction: Abstraction,
    joint: JointModel,
    found: SearchResult,
    best: Sweep | TrainSweep,
    settings: dict[str, Any],
    search: str,
) -> Synthesis:
    """Certify the ``best`` policies of a search; the statistics also hold upper bounds for all policies."""
    certificate = certificate_of(problem, abstraction, joint, best, settings, search)
    stats: dict[str, object] = {
        "sweeps": found.values,
        "starts": found.starts,
        "rank": certificate.proof.rank,
        "dropped": best.dropped,
        "unilateral_gain": None if best.stationary else found.unilateral_gain,
        **bounds_from_above(problem, joint, found.relaxations, certificate),
    }
    return Synthesis(certificate, certificate.controller, stats)


def certificate_of(
    problem: Problem,
    abstraction: Abstraction,
    joint: JointModel,
    best: Sweep | TrainSweep,
    settings: dict[str, Any],
    search: str,
) -> OnGrid:
    """Return a certificate, with the largest lower bound that applies, of the policies of ``best``.

    ``best`` is a sweep that evaluated its policies without changing them.
    """
    grown: Sweep | TrainSweep
    if isinstance(best, TrainSweep):
        above = None
        if abstraction.is_exact:
            above = start_above(start_of(problem, joint), evaluate_above(joint, best.policies, best.rounding))
        grown, bound = best, train_bound(joint, best, rounding_loss(problem, joint), above)
        bounds = {bound.name: bound.lower}
    else:
        grown, bound, bounds = best_bound(problem, abstraction, joint, best)
    parts = []
    for i, model in enumerate(joint.models):
        part = AgentRecord(
            grid=model.grid,
            relation=describe_relation(model.relation),
            lattice=model.lattice,
            masks=model.of_cells(joint.masks[i]),
            start_masks=model.of_cells(joint.start_masks[i]),
            policy=best.policies[i][:1] if best.stationary else best.policies[i],
            input_set=model.choices.input_set,
        )
        parts.append(part)
    proof = GridProof(
        method=f"{settings['relation']} relation, {search}",
        bound=bound.name,
        bounds=bounds,
        lower_bound=bound.lower,
        gap=bound.gap,
        relative_rounding=relative_rounding(joint, grown.rank),
        agents=tuple(parts),
        guard_source=joint.guards.source,
        guard_target=joint.guards.target,
        guard_mask=joint.guards.mask,
        start_target=joint.start_guards.target,
        start_mask=joint.start_guards.mask,
        merge_log=grown.merge_log if isinstance(grown, Sweep) else (),
        terms=_stored(problem, joint, grown.terms) if isinstance(grown, Sweep) else None,
        rank=grown.rank,
        rounding=grown.rounding if isinstance(grown, TrainSweep) else None,
    )
    if abstraction.is_exact and isinstance(grown, Sweep) and bound.name == "nominal":
        # elsewhere search and checker interpolate, and cut trains, with charges of their own
        settings = {**settings, "believed": believed_on_cells(float(grown.value))}
    return Certificate(problem, proof, settings)


def _stored(problem: Problem, joint: JointModel, terms: Terms) -> Terms:
    """Return the value function to be stored: factors a little lower, unless all steps are additive: they are bounds.

    What remains after unions from below, and how much an image bends, depend on rounding in both directions; so do
    means, by what an execution may lose. A check that computes all of them anew must find no factor too large.
    """
    factors, additive = [], all(model.is_additive for model in joint.models)
    for agent, model, rows in zip(problem.agents, joint.models, terms.factors, strict=True):
        lost = model.relation.rounding_loss(agent, model.grid.edges) + model.kernel.loss + STORED_LOSS
        loss = STORED_MARGIN * rows.max(axis=1, initial=0.0)[:, None] + joint.horizon * lost
        lower = np.maximum(rows - loss, 0.0)
        factors.append(rows if additive else lower)  # unions from below leave remainders of any agent
    return Terms(tuple(factors), terms.index)


def best_bound(
    problem: Problem, abstraction: Abstraction, joint: JointModel, best: Sweep
) -> tuple[Sweep, Bound, dict[str, float]]:
    """The largest bound that applies to the policies of ``best``, the tree it was read off, and all bounds by name."""
    lost = rounding_loss(problem, joint)
    if all(model.delta == 0.0 for model in joint.models):
        deadlocked = 0.0
        if abstraction.is_exact and any(np.any(model.choices.resting_choice < 0) for model in joint.models):
            deadlocked = deadlocked_mass(
                joint, best.policies, forward(joint, best.policies, start_of(problem, joint), FINAL)
            )
        bound = nominal_bound(joint, best, lost, abstraction.is_exact, deadlocked)
        return best, bound, {bound.name: bound.lower}
    start = start_of(problem, joint)
    undecided = undecided_steps(joint, forward(joint, best.policies, start, FINAL))
    robust = sweep(joint, best.policies, start, FINAL, improve=False, loss=robust_loss)
    found = [(best, a_posteriori_bound(joint, best, lost, undecided)), (robust, robust_bound(joint, robust, lost))]
    grown, bound = max(found, key=lambda pair: pair[1].lower)
    return grown, bound, {other.name: other.lower for _, other in found}


def against_losses(
    problem: Problem, abstraction: Abstraction, joint: JointModel, best: Sweep
) -> tuple[Sweep, dict[str, float]]:
    """Return policies whose certified bound is the largest, and the largest lower bound of each kind that was met.

    A search looks at the nominal value. Where every step loses delta this is not what is certified: policies of one
    nominal value differ in how long they leave the task undecided. So agents answer once more, to the nominal value
    and to that of the robust operator, and all three are certified. ``best`` is a sweep with frozen policies.
    """
    start, frozen = start_of(problem, joint), [best]
    for loss in (None, robust_loss):
        answered = sweep(joint, best.policies, start, FINAL, improve=True, loss=loss)
        if any(np.any(new != old) for new, old in zip(answered.policies, best.policies, strict=True)):
            frozen.append(sweep(joint, answered.policies, start, FINAL, improve=False))
    bounds = [best_bound(problem, abstraction, joint, outcome)[2] for outcome in frozen]
    largest = {name: max(of_policies[name] for of_policies in bounds) for name in bounds[0]}
    return frozen[int(np.argmax([max(of_policies.values()) for of_policies in bounds]))], largest


def bounds_from_above(
    problem: Problem, joint: JointModel, relaxations: tuple[Relaxation, ...], certificate: OnGrid
) -> dict[str, object]:
    """Return upper bounds for all policies, of the same finite models and of the continuous system (None: unknown)."""
    start = start_of(problem, joint)
    anywhere = continuous_upper_bound(problem, joint, start)
    if not all(model.is_additive for model in joint.models):
        # Their values are lower bounds cell by cell, so the best of them bounds nothing from above.
        return {"abstract_upper_bound": None, "continuous_upper_bound": anywhere}
    most = abstract_bound(problem, joint, start, relaxations, certificate.lower_bound)
    # Continuous policies attain all that abstract ones attain, where nothing is lost.
    if anywhere is not None and delta_of(certificate) == 0.0:
        most = min(most, anywhere)
    return {"abstract_upper_bound": most, "continuous_upper_bound": anywhere}
