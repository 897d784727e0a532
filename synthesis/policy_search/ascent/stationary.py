"""Policies that do not look at the time, for tasks without a deadline.

From policies of a long horizon one choice is kept per automaton state and cell: the first one, or that of the time at
which a run is most likely to be there. Then all agents answer to the mass of all times together,

    argmax_u  sum_t sum_l omega_t,l(s) (P_u g_t,l)(s) ,

as long as the answers make the policies better: for policies that are the same at all times this sum is the derivative
of the value by the choice in a cell. Every candidate is evaluated with frozen policies. For co-safe tasks the value of
T steps is a lower bound on the value without a deadline, and rises with T.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from ....envs.tasks.problem import Problem
from ...abstraction.models import JointModel, Policies, start_of
from ...certificates.value_functions import Occupancy
from .coordinate_ascent import Stage, Sweep, sweep
from .limits import Limits
from .multistart import FINAL, SearchResult
from .occupancy import forward
from .train_ascent import TrainLimits, TrainSweep, sweep_trains

MOST_ROUNDS = 8
"""Most rounds of answers."""

MOST_HELD_NUMBERS = 60_000_000
"""Most numbers that the answers of a round may hold, 480 MB; rounds that need more are left out."""

LEAST_IMPROVEMENT = 1e-7
"""Relative improvement below which a round was the last."""


def stationary_best(problem: Problem, joint: JointModel, found: SearchResult, limits: Limits) -> Sweep | TrainSweep:
    """Return the best stationary policies that come from what a search has ``found``, evaluated frozen."""
    start = start_of(problem, joint)
    evaluate = _evaluation(joint, start, found.best, limits)
    shape = (joint.horizon, joint.n_states)
    # Candidates: the choices of the first step, those of the relaxations, and those of the most likely times.
    first = tuple(policy[:1] for policy in found.best.policies)
    candidates = [first, tuple(relaxation.policy[:1] for relaxation in found.relaxations)]
    if isinstance(found.best, Sweep):
        candidates.append(_modal(joint, found.best.policies, forward(joint, found.best.policies, start, limits)))
    tried = [evaluate(_at_all_times(policies, shape)) for policies in candidates]
    best = max(tried, key=lambda outcome: outcome.value)
    if isinstance(best, TrainSweep):
        return best
    for _ in range(MOST_ROUNDS):
        answers = _answers(joint, best.policies, start, limits)
        better = None if answers is None else evaluate(_at_all_times(answers, shape))
        if better is None or better.value <= best.value * (1 + LEAST_IMPROVEMENT):
            break
        assert isinstance(better, Sweep)
        best = better
    return _shared(sweep(joint, best.policies, start, FINAL, improve=False))


def _evaluation(
    joint: JointModel, start: Occupancy, best: Sweep | TrainSweep, limits: Limits
) -> Callable[[Policies], Sweep | TrainSweep]:
    """Return a function that evaluates policies in the form, tree or trains, in which ``best`` was found."""
    if isinstance(best, TrainSweep):
        train_limits = TrainLimits(best.rounding.tolerance)
        return lambda policies: _shared(sweep_trains(joint, policies, start, train_limits, improve=False))
    return lambda policies: sweep(joint, policies, start, limits, improve=False)


def _shared(outcome: Any) -> Any:
    """Return the sweep with its policies held once for all times."""
    shape = outcome.policies[0].shape[:2]
    policies = _at_all_times(tuple(policy[:1] for policy in outcome.policies), shape)
    return replace(outcome, policies=policies, stationary=True)


def _at_all_times(policies: Policies, shape: tuple[int, ...]) -> Policies:
    """Return policies (1, Q, S) as (T, Q, S), held once."""
    return tuple(np.broadcast_to(policy, (*shape, policy.shape[-1])) for policy in policies)


def _modal(joint: JointModel, policies: Policies, occupancies: list[Occupancy]) -> Policies:
    """Return, per automaton state and cell, the choice of the time at which the agent is most likely there."""
    modal_policies = []
    for i, policy in enumerate(policies):
        # The marginal of agent i: its factor, times the masses of the other agents.
        mass = np.zeros(policy.shape)
        for t, occupancy in enumerate(occupancies):
            for q, rows in enumerate(occupancy.terms.index):
                if len(rows):
                    weight, factors = np.ones(len(rows)), occupancy.terms.factors
                    for j, masses in enumerate(factors):
                        if j != i:
                            weight *= masses.sum(axis=1)[rows[:, j]]
                    mass[t, q] = joint.models[i].summed(weight @ factors[i][rows[:, i]])
        time = np.argmax(mass, axis=0)  # the first of equals: where nobody comes, that is time 0
        modal_policies.append(np.take_along_axis(policy, time[None], axis=0))
    return tuple(modal_policies)


def _answers(joint: JointModel, policies: Policies, start: Occupancy, limits: Limits) -> Policies | None:
    """Return the best answers of all agents to the mass of all times; None if they would hold too many numbers."""
    # Keep the stages of all times while one sweep passes over them.
    stages: list[list[Stage]] = [[] for _ in range(joint.n_states)]
    sweep(joint, policies, start, limits, improve=False, watch=lambda stage: stages[stage.q].append(stage))
    answers = [policy[:1].copy() for policy in policies]
    for q, of_state in enumerate(stages):
        met = [stage for stage in of_state if stage.is_met and len(stage.rows)]
        if not met:
            continue
        size = sum(len(t) * (t.shape[1] + joint.n_cells[i]) for s in met for i, t in enumerate(s.backed_up))
        if size > MOST_HELD_NUMBERS:
            return None
        # The objectives of all times side by side, each with its weights: their sum is maximised.
        weights = [stage.weights() for stage in met]
        for i in range(len(joint.models)):
            table = np.concatenate([stage.backed_up[i] for stage in met])
            heavy = np.concatenate([each[i] for each in weights], axis=1)
            answers[i][0, q] = met[0].best(i, heavy, table)
    return tuple(answers)
