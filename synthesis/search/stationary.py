"""Policies that do not look at the time, for tasks without a deadline.

From policies of a long horizon one choice is kept per automaton state and cell: the first one, or that of the time at
which a run is most likely to be there. Then all agents answer to the mass of all times together,

    argmax_u  sum_t sum_l omega_t,l(s) (P_u g_t,l)(s) ,

as long as that makes them better: for policies that are the same at all times this sum is the derivative of the value
by the choice in a cell. Every candidate is evaluated with frozen laws. For co-safe tasks the value of T steps is a
lower bound of the value without a deadline, and rises with T.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...envs.problem import Problem
from ..models import JointModel, Laws, start_of
from ..values import Occupancy, to_host
from .ascent import Limits, Stage, Sweep, forward, sweep
from .best_response import best_choices
from .policy_search import FINAL, Found
from .train_ascent import TrainSweep, sweep_trains

ROUNDS = 8
"""Most rounds of answers."""

LARGEST = 60_000_000
"""Most numbers that the answers of a round may hold; rounds that need more are left out."""


def stationary_best(problem: Problem, joint: JointModel, found: Found, limits: Limits) -> Sweep | TrainSweep:
    """The best stationary policies that come from what a search has found, evaluated with frozen laws."""
    start = start_of(problem, joint)
    evaluate = _evaluation(joint, start, found.best, limits)
    shape = (joint.horizon, joint.n_states)
    first = tuple(law[:1] for law in found.best.laws)
    candidates = [first, tuple(one.law[:1] for one in found.relaxations)]
    if isinstance(found.best, Sweep):
        candidates.append(_modal(joint, found.best.laws, forward(joint, found.best.laws, start, limits)))
    tried = [evaluate(_at_all_times(laws, shape)) for laws in candidates]
    best = max(tried, key=lambda one: one.value)
    if isinstance(best, TrainSweep):
        return best
    for _ in range(ROUNDS):
        answers = _answers(joint, best.laws, start, limits)
        better = None if answers is None else evaluate(_at_all_times(answers, shape))
        if better is None or better.value <= best.value * (1 + 1e-7):
            break
        assert isinstance(better, Sweep)
        best = better
    return _shared(sweep(joint, best.laws, start, FINAL, improve=False))


def time_invariant(law: NDArray[np.int32]) -> NDArray[np.int32]:
    """The law (1, Q, S) of a policy that was made the same at all times, any other one as it is."""
    return law[:1] if law.strides[0] == 0 else law


def _evaluation(
    joint: JointModel, start: Occupancy, best: Sweep | TrainSweep, limits: Limits
) -> Callable[[Laws], Sweep | TrainSweep]:
    """Evaluation of policies in the form in which they were found."""
    if isinstance(best, TrainSweep):
        tolerance = best.rounding.tolerance
        return lambda laws: _shared(sweep_trains(joint, laws, start, tolerance, improve=False))
    return lambda laws: sweep(joint, laws, start, limits, improve=False)


def _shared(found: Any) -> Any:
    """The sweep, its laws held once for all times."""
    shape = found.laws[0].shape[:2]
    return replace(found, laws=_at_all_times(tuple(law[:1] for law in found.laws), shape))


def _at_all_times(laws: Laws, shape: tuple[int, ...]) -> Laws:
    """Laws (1, Q, S) as (T, Q, S), held once."""
    return tuple(np.broadcast_to(law, (*shape, law.shape[-1])) for law in laws)


def _modal(joint: JointModel, laws: Laws, occupancies: list[Occupancy]) -> Laws:
    """Per automaton state and cell the choice of the time at which the agent is most likely there."""
    kept = []
    for i, law in enumerate(laws):
        mass = np.zeros(law.shape)
        for t, occupancy in enumerate(occupancies):
            for q, rows in enumerate(occupancy.terms.index):
                if len(rows):
                    weight, factors = np.ones(len(rows)), [to_host(own) for own in occupancy.terms.factors]
                    for j, own in enumerate(factors):
                        if j != i:
                            weight *= own.sum(axis=1)[rows[:, j]]
                    mass[t, q] = weight @ factors[i][rows[:, i]]
        time = np.argmax(mass, axis=0)  # the first of equals: where nobody comes, that is time 0
        kept.append(np.take_along_axis(law, time[None], axis=0))
    return tuple(kept)


def _answers(joint: JointModel, laws: Laws, start: Occupancy, limits: Limits) -> Laws | None:
    """Best answers of all agents to the mass of all times together; None if they would hold too many numbers."""
    stages: list[list[Stage]] = [[] for _ in range(joint.n_states)]
    sweep(joint, laws, start, limits, improve=False, watch=lambda stage: stages[stage.q].append(stage))
    answers = [law[:1].copy() for law in laws]
    for q, own in enumerate(stages):
        met = [stage for stage in own if stage.is_met and len(stage.rows)]
        if not met:
            continue
        size = sum(len(t) * (t.shape[1] + joint.n_cells[i]) for s in met for i, t in enumerate(s.smoothed))
        if size > LARGEST:
            return None
        weights = [stage.weights() for stage in met]
        for i, model in enumerate(joint.models):
            table = np.concatenate([to_host(stage.smoothed[i]) for stage in met])
            heavy = np.concatenate([to_host(each[i]) for each in weights], axis=1)
            answers[i][0, q] = best_choices(model.choices, heavy, table, answers[i][0, q])
    return tuple(answers)
