"""Policies of teams whose agents keep apart, in turn answering to each other, and what is subtracted for them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...envs.tasks.problem import Problem
from ..abstraction.models import JointModel, Policies, start_of
from ..certificates.proofs import Certificate, OnGrid, UnionBoundProof, changed
from ..policy_search.ascent import FINAL, Relaxation, Search, Sweep, TrainSweep, find_policies, sweep
from ..relations.grids import RelationRefused
from .avoiding import Avoidance
from .collision_probability import CollisionProbability

ROUNDS = 6
"""Most times that every agent answers to the others: as a rule two are enough."""

MOST_RECORDED = 1e9
"""Largest sum that is recorded: files hold no infinities."""

WORTH = 1e-4
"""Probability of being near below which no further answers are tried."""


def less_proximity(
    problem: Problem, base: OnGrid, usual: NDArray[np.bool_], near: float, used: dict[str, Any]
) -> Certificate[UnionBoundProof]:
    """Return the certificate of a problem with pairs: that of the task without them, less what they may spoil."""
    # Where pairs that are not as usual may save what is lost without them, the base has no upper end for the problem.
    if not np.array_equal(base.problem.automaton.dead, problem.automaton.dead):
        base = changed(base, gap=None)
    return Certificate(problem, UnionBoundProof(base, tuple(usual.tolist()), min(1.0, near)), used)


Evaluated = Callable[[Policies], Sweep | TrainSweep]
"""The value of policies that are not changed, as a tree or as tensor trains."""


def evaluated_by(base: Problem, joint: JointModel, search: Search, relaxations: tuple[Relaxation, ...]) -> Evaluated:
    """Return how policies are evaluated: by trees, or by tensor trains where a search asks for them."""
    if search.value == "train":
        once = replace(search, max_sweeps=0)
        return lambda policies: find_policies(base, joint, once, {"answers": policies}, relaxations).best
    start = start_of(base, joint)
    return lambda policies: sweep(joint, policies, start, FINAL, improve=False)


def kept_apart(
    masses: CollisionProbability, first: Sweep | TrainSweep, search: Search, evaluated: Evaluated
) -> tuple[Sweep | TrainSweep, float, list[list[float]]]:
    """Return the best policies, evaluated frozen; how likely pairs are near; and value and nearness of all tried."""
    best, near = first, proximity(masses, first.policies)
    record = [[first.value, min(near, MOST_RECORDED)]]
    if near <= WORTH or not search.max_sweeps:
        return best, near, record
    avoidance, policies = Avoidance(masses), first.policies
    for k in range(min(ROUNDS, search.max_sweeps)):
        policies = avoidance.answers(policies, heed_all=k > 0)
        outcome, spoilt = evaluated(policies), proximity(masses, policies)
        record.append([outcome.value, min(spoilt, MOST_RECORDED)])
        gain = (outcome.value - spoilt) - (best.value - near)
        if gain > 0.0:
            best, near = outcome, spoilt
        search.tell("keeping apart", max(0.0, best.value - near))
        # A round that everybody has heeded and that gains nothing is the last, unless nothing is certified yet.
        if near <= WORTH or (k > 0 and gain <= WORTH and near < best.value):
            break
    return best, near, record


def proximity(masses: CollisionProbability, policies: Policies) -> float:
    """Return what pairs may spoil at most, a sum that may exceed 1; infinite where it would take too long to say."""
    try:
        return masses.bound(policies)
    except RelationRefused:
        return float("inf")
