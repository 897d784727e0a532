"""Audit: does the value function rise as it must, step by step, along rollouts of the continuous system?

Let ``Y_t = max(0, V_{T-t} - Delta Theta_{T-t})(q_t, xhat_t)`` at the controller's cells. It is 0 after failure, 1 after
acceptance, 0 from the step on in which a relation is lost, and the outcome itself at the horizon. A certificate is true
only if ``E[Y_{t+1} - Y_t | past] >= 0`` at every step (docs/theory/evidence.md, "The audit"). Each pair (t, q) is
tested with *bets*: with ``D = Y_{t+1} - Y_t <= 1 - Y_t`` and a stake s fixed before the step, such that
``0 <= s (1 - Y_t) <= 1``, the wealth

    W = prod over episodes (1 - s D)

has expectation at most 1 if the hypothesis is true, so ``P(W >= 1/alpha) <= alpha`` exactly, for any number of
episodes (Markov). W is averaged over a fixed set of stakes, in absolute size and in shares of ``1 / (1 - Y_t)``. The
pairs are tested by Holm's method at half of the level; the other half is for the product over all steps, which sees
defects that are too thin for any single pair. A false certificate is found here with far fewer rollouts than by
counting outcomes, and the audit says where it is false: the fall at a pair is divided among the agents
(``agent_steps``), and split by the region in which the agent is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Unpack

import numpy as np
from numpy.typing import NDArray

from ...envs.simulation import Dynamics
from ...envs.simulation import batch_simulator as core
from ...envs.tasks.problem import Problem
from ...synthesis.certificates.proofs import (
    Certificate,
    OnGrid,
    ProductProof,
    alike_members,
    certificate_on_grids,
    on_cells,
)
from ...synthesis.certificates.value_functions import Terms, Trains
from ...synthesis.extended_check.claims import claimed_values, wrong_in_time
from .agent_steps import agents_outside, levels_by_agent, terminal_values, tree_fits
from .audit_report import AuditReport, joined_report, report_of
from .binomial import check_confidence
from .chunks import Frame, chunks_of, frames
from .loop import Batchable, Loop
from .spread import in_order
from .step_log import STAKES, StepLog
from .trials import Plan, TrialOptions, TrialPlan, collect, names_plan, planned
from .value_at import Charge, charge_of, remembers, standing_cells, values_between

INCREMENT_SLACK = 1e-9
"""Added to every increment: more than rounding takes from a true certificate, less than any test can see."""

ROUNDING_OF_FALLS = 1e-7
"""Relative part of a fall that counts as rounding: far above the error of a sum of products of float64."""

LEAST_ROOM = 1e-3
"""Smallest ``1 - Y_t`` by which an increment is divided; a larger divisor means a smaller stake, which is allowed."""


@dataclass(frozen=True, eq=False)
class _Setup:
    """The data that every chunk of an audit needs."""

    loop: Loop
    certificate: OnGrid
    values: tuple[Terms | Trains, ...]
    charge: Charge | None


@names_plan
def audit(
    certificate: Any,
    plan: TrialPlan | int | None = None,
    *,
    problem: Problem | None = None,
    controller: Batchable | None = None,
    values: Sequence[Terms | Trains] | None = None,
    charge: Charge | None = None,
    **trial: Unpack[TrialOptions],
) -> AuditReport:
    """Test a certificate step by step; a true one is refuted with probability at most ``1 - confidence``.

    Parameters
    ----------
    certificate : Synthesis, Certificate or path
        Independent tasks are audited one by one; of tasks that differ in names alone, one is audited. Of a team that is
        certified as one agent, the problem of this agent is audited: its steps are not split among the team's members.
        Of a problem that names the time, the problem written out is.
    plan, **trial
        Episodes (default 20,000), seed, confidence (.999), chunk, executor, progress; see ``TrialPlan``. After Ctrl-C
        the report is about the episodes finished by then.
    problem : Problem, optional
        The continuous system; default: the certificate's problem.
    controller : optional
        Controller of the continuous system; default: the certificate's.
    values : sequence of Terms or Trains, optional
        Value functions at times 0 .. T - 1; default: ``claimed_values(certificate)``.
    charge : Charge, optional
        ``Delta * Theta``; default: the charge of the certificate, which is 0 unless its bound is the a-posteriori one.
        With a charge the start is not tested: the bound there may rest on a smaller Theta.

    Raises
    ------
    ValueError
        If a number is out of range, or if there is not one value function per step.
    """
    settled = planned(plan, trial, 20_000)
    check_confidence(settled.confidence)
    certificate = certificate_on_grids(certificate)
    if (held := on_cells(certificate)) not in (None, certificate):
        if not problem is controller is values is charge is None:
            raise ValueError(
                "`certificate`: expected one about the problem itself beside other arguments, got one that rests on "
                "the same problem written in another way; give its `.proof.base`, and the problem of that"
            )
        # Values are functions of the states of an automaton that counts steps.
        if wrong := wrong_in_time(certificate):
            raise ValueError(
                f"`certificate`: expected one whose `.proof.base` is about its problem, got another: {wrong[0]}"
            )
        return audit(held, settled)
    if held is None:
        if not problem is controller is values is charge is None:
            raise ValueError(
                "`certificate`: expected the certificate of one task beside other arguments, got one of independent "
                "tasks; give one of its `.parts`"
            )
        return _audit_of_product(certificate, settled)
    # The system, the controller and the value function can each be replaced, to test one against the others.
    problem = certificate.problem if problem is None else problem
    values = tuple(claimed_values(certificate) if values is None else values)
    if len(values) != problem.horizon:
        raise ValueError(f"`values`: expected one value function per step, {problem.horizon}, got {len(values)}")
    driver = certificate.controller if controller is None else controller
    loop = Loop(problem, driver, settled.seed, settled.chunk)
    charge = charge_of(certificate, values) if charge is None else charge
    setup, step_log, done = _Setup(loop, certificate, values, charge), StepLog.empty(problem), 0

    def take(result: tuple[int, StepLog]) -> None:
        nonlocal step_log, done
        step_log, done = step_log.plus(result[1]), done + result[0]
        settled.tell(result[0])

    chunks = chunks_of(settled.episodes, settled.chunk)
    interrupted = collect(in_order(audit_chunk, setup, chunks, settled.executor), take)
    return report_of(problem, step_log, replace(settled, episodes=done), interrupted, certificate.lower_bound)


def _audit_of_product(product: Certificate[ProductProof], plan: Plan) -> AuditReport:
    """Audit each of the tasks that differ; together they share the probability of a false alarm."""
    distinct = [product.proof.parts[group[0]] for group in alike_members(product)]
    each = replace(plan, confidence=1.0 - (1.0 - plan.confidence) / len(distinct))
    reports: list[AuditReport] = []
    for certificate in distinct:
        reports.append(audit(certificate, each))
        if reports[-1].interrupted:
            break
    return joined_report(product.problem, reports, plan.confidence, product.lower_bound)


def audit_chunk(setup: _Setup, job: tuple[int, int]) -> tuple[int, StepLog]:
    """Return the number of episodes and the ledger of one chunk (number, episodes that count)."""
    number, count = job
    dynamics, policy = setup.loop.arranged
    step_log = StepLog.empty(setup.loop.problem)
    before: _Moment | None = None
    for frame in frames(setup.loop, dynamics, policy, number):
        moment = _moment(setup, dynamics, frame, count, None if before is None else before.open)
        # The first bet: the value at the start is at least the certified bound.
        if before is None and setup.charge is None:
            certified = setup.certificate.lower_bound
            step_log.start[:] = _wealth(moment.level - certified, np.full(count, 1.0 - certified)).sum(axis=0)
        if before is not None and np.any(before.open):
            _enter(setup, step_log, dynamics, before, moment)
        before = moment
    return count, step_log


@dataclass(frozen=True, eq=False)
class _Moment:
    """A frame with its levels ``Y_t`` (n,), cells (n, I), and whether each episode is undecided and related so far."""

    frame: Frame
    level: NDArray[Any]
    cells: NDArray[Any]
    open: NDArray[np.bool_]


def _moment(setup: _Setup, dynamics: Dynamics, frame: Frame, count: int, was_open: NDArray[np.bool_] | None) -> _Moment:
    """Return the levels of the first ``count`` episodes of a frame; ``was_open`` says which were open before."""
    worlds, time = frame.worlds, int(frame.worlds.time)
    # An episode is open while it is undecided and no relation has been lost; at the horizon all are decided.
    open_ = ~(worlds.failed | worlds.accepted)[:count]
    if getattr(frame.memory, "lost", None) is not None:
        open_ = open_ & ~np.asarray(frame.memory.lost)[:count]
    if was_open is not None:
        open_ = open_ & was_open
    if time >= setup.loop.problem.horizon:
        open_ = np.zeros(count, dtype=bool)
    # Decided episodes are worth their outcome, open ones the value less the charge.
    level = np.asarray(core.satisfied(dynamics, worlds), dtype=float)[:count]
    cells = standing_cells(setup.certificate, dynamics, worlds, setup.loop.arranged[1], frame.memory)[:count]
    here = np.flatnonzero(open_)
    if len(here):
        states = core.joint(dynamics, worlds)[here]
        value = values_between(setup.certificate, setup.values[time], worlds.q[here], cells[here], states)
        if setup.charge is not None:
            value = value - setup.charge(time, worlds.q[here], cells[here])
        level[here] = np.clip(value, 0.0, 1.0)
    return _Moment(frame, level, cells, open_)


def _wealth(increments: NDArray[Any], room: NDArray[Any]) -> NDArray[Any]:
    """Return ``log(1 - s D)``, shape (n, G), for every stake; ``room`` (n,) is the largest value that D can have."""
    # Relative stakes suit falls in proportion to the room that is left, absolute ones suit falls of a fixed size.
    shares, absolute = np.split(STAKES, 2)
    d = (increments + INCREMENT_SLACK)[:, None]
    relative = np.clip(d / np.maximum(room, LEAST_ROOM)[:, None], None, 1.0)
    return np.concatenate([np.log1p(-shares * relative), np.log1p(-absolute * np.minimum(d, 1.0))], axis=1)


def _enter(setup: _Setup, step_log: StepLog, dynamics: Dynamics, before: _Moment, after: _Moment) -> None:
    """Enter into the ledger the step from one moment to the next, for the episodes that were open before it."""
    rows, time, problem = np.flatnonzero(before.open), int(before.frame.worlds.time), setup.loop.problem
    q, level = before.frame.worlds.q[rows].astype(np.int64), before.level[rows]
    step = after.level[rows] - level
    wealth = _wealth(step, 1.0 - level)
    _add(q, wealth, step, step_log.wealth[time], step_log.worlds[time], step_log.increments[time])
    # Split the step among the agents where the value is the certificate's tree, read at the cells of the states. What
    # is united at corners is not united at points between them, and boxes hide the mean: such agents are left out.
    levels, certificate, now = None, setup.certificate, setup.values[time]
    following = setup.values[time + 1] if time + 1 < problem.horizon else terminal_values(certificate)
    if (
        isinstance(now, Terms)
        and isinstance(following, Terms)
        and not remembers(before.frame.memory)
        and setup.charge is None
        and all(part.is_additive for part in certificate.proof.agents)
        and tree_fits(certificate, time, now, following)
    ):
        outside = agents_outside(dynamics, after.frame.worlds)[rows]
        cells, next_cells = before.cells[rows], after.cells[rows]
        levels = levels_by_agent(certificate, time, now, following, q, cells, next_cells, outside)
        levels = np.clip(levels, 0.0, 1.0)
        wrong = after.level[rows] < levels[-1] * (1.0 - ROUNDING_OF_FALLS) - INCREMENT_SLACK
        step_log.contradictions[time] += np.bincount(q[wrong], minlength=problem.automaton.n_states)
    # Bets on each agent's share of the step (or on the whole step), by the region in which the agent stood.
    for i, (block, place) in enumerate(dynamics.position):
        if levels is not None:
            step = levels[i + 1] - levels[i]
            wealth = _wealth(step, 1.0 - levels[i])
        here = class_numbers(problem, i, before.frame.worlds.states[block][:, place, rows])
        flat = (a[i][time] for a in (step_log.split, step_log.split_worlds, step_log.split_increments))
        split, worlds, increments = (a.reshape(-1, *a.shape[2:]) for a in flat)
        _add(q * len(problem.labeling.classes[i]) + here, wealth, step, split, worlds, increments)


def _add(
    keys: NDArray[Any],
    wealth: NDArray[Any],
    d: NDArray[Any],
    sums: NDArray[Any],
    worlds: NDArray[Any],
    increments: NDArray[Any],
) -> None:
    """Add wealth (n, G) and increments d (n,) of episodes to the entries that ``keys`` (n,) name, in place."""
    # Sorting the keys fixes the order of the sums, so that the bits do not depend on numpy's scatter.
    order = np.argsort(keys, kind="stable")
    present, first = np.unique(keys[order], return_index=True)
    sums[present] += np.add.reduceat(wealth[order], first, axis=0)
    worlds[present] += np.bincount(keys, minlength=len(worlds))[present]
    increments[present] += np.add.reduceat(d[order], first)


def class_numbers(problem: Problem, i: int, states: NDArray[Any]) -> NDArray[np.int64]:
    """Return the row of ``labeling.classes[i]`` that holds at each state (d, M) of agent i; 0 for states outside."""
    holds, classes = problem.labeling.class_at(i, states), problem.labeling.classes[i]
    result = np.zeros(states.shape[1], dtype=np.int64)
    for number, row in enumerate(classes):
        result[np.all(holds == row[:, None], axis=0)] = number
    return result
