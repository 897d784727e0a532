"""The bound belongs to the controller that is deployed: its matrices, its inputs and its rounding, in any units."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

import certigym as cg
from certigym.synthesis.certificates.proofs import changed
from certigym.synthesis.certificates.value_functions import MergeLog
from certigym.synthesis.extended_check.steps.carrying_out import wrong_actions
from certigym.synthesis.extended_check.steps.execution import execution_of
from problems import linear

EPISODES = 40_000
SURE = 1 - 1e-6
"""False alarms of a refutation: a bound that is .01 too large near .95 is seen with 40,000 episodes."""


def one_agent(task: str, horizon: int, low: Any, high: Any, **agent: Any) -> cg.Problem:
    """Return a problem of a single agent and one region, ``goal``."""
    return cg.Problem(
        name="one",
        horizon=horizon,
        agents=[cg.LinearAgent(name="robot", **agent)],
        propositions={"goal": cg.Proposition("robot", low, high)},
        specification=cg.Specification(task, "finite-trace"),
    )


def refuted(certificate: Any) -> bool:
    """Return whether rollouts of the certificate's own controller contradict it."""
    return cg.validate(certificate, EPISODES, confidence=SURE).verdict == "refuted"


def large_units() -> cg.Problem:
    """Position in units of 1e-8, velocity in ordinary ones: the couplings differ by 2e15."""
    return one_agent(
        "G goal",
        5,
        [1.5e8, -2.5],
        [2.5e8, 2.5],
        A=[[0.9, 1e7], [-5e-9, 0.9]],
        B=np.diag([1e8, 1.0]),
        noise_covariance=np.diag([2.5e11, 0.49]),
        state_low=[-3e8, -3.0],
        state_high=[3e8, 3.0],
        input_low=[-12.0, -12.0],
        input_high=[12.0, 12.0],
        initial_state=[2e8, 2.0],
    )


def test_couplings_are_kept_whatever_the_units() -> None:
    """The controller that left out ``-5e-9 x`` satisfied in .9528 of its runs what was certified with .998226."""
    result = cg.synthesize(large_units(), 30, relation="exact")
    assert result.certificate.lower_bound > 0.9
    assert cg.check(result.certificate), cg.check(result.certificate)
    assert not refuted(result.certificate)
    relation: Any = result.certificate.controller.agents[0].relation
    agent = linear(result.certificate.problem.agents[0])
    assert np.allclose(agent.B @ relation.right_inverse @ relation.A, agent.A, rtol=1e-9, atol=0.0)


def test_a_controller_without_the_small_coupling_is_refused() -> None:
    """Sabotage: the very matrix of version 0.1, in a certificate whose kernel and policies are honest."""
    certificate = cg.synthesize(large_units(), 30, relation="exact").certificate
    controller: Any = certificate.controller.agents[0]
    entries = controller.relation.A.copy()
    entries[1, 0] = 0.0
    # The controller is computed from problem and part, so the sabotage is of the object that is deployed.
    broken = replace(controller, relation=replace(controller.relation, A=entries))
    part = certificate.proof.agents[0]
    agent = certificate.problem.agents[0]
    honest = execution_of(agent, part, controller.relation)
    assert honest.loss < 1e-9
    assert wrong_actions(agent, part, controller, honest) == []
    assert execution_of(agent, part, broken.relation).loss > 0.5
    assert wrong_actions(agent, part, broken, honest) != []


def ordinary() -> cg.Problem:
    """A robot in a box with couplings of .1 and .3."""
    return one_agent(
        "G goal",
        4,
        [-1.0, -1.0],
        [1.0, 1.0],
        A=[[0.9, 0.1], [0.3, 0.9]],
        B=np.eye(2),
        noise_covariance=0.04 * np.eye(2),
        state_low=[-2.0, -2.0],
        state_high=[2.0, 2.0],
        input_low=[-1.5, -1.5],
        input_high=[1.5, 1.5],
        initial_state=[0.5, 0.5],
    )


def test_vertices_that_are_listed_twice_are_refused() -> None:
    """Twice the same vertices would count their probability twice: .6093 became .9999."""
    certificate = cg.synthesize(cg.make_problem("reach-avoid-v0", horizon=4), 100).certificate

    def doubled(step: MergeLog) -> MergeLog:
        kept = tuple(np.concatenate([rows, rows + len(o)]) for rows, o in zip(step.kept, step.origin, strict=True))
        return replace(step, origin=tuple(np.concatenate([rows, rows]) for rows in step.origin), kept=kept)

    for time in range(len(certificate.proof.merge_log)):
        merge_log = list(certificate.proof.merge_log)
        merge_log[time] = doubled(merge_log[time])
        report = cg.check(changed(certificate, merge_log=tuple(merge_log)))
        assert not report, time


def test_rounding_of_inputs_is_paid_for_or_refused() -> None:
    """At 1e12 the last place of a state is 1.2e-4, a quarter of the noise: .95005 was claimed, .9450 true."""
    offset, sigma = 1e12, 5e-4
    problem = one_agent(
        "G goal",
        3,
        [offset - 2 * sigma],
        [offset + 2 * sigma],
        A=[[1.0]],
        B=[[1.0]],
        offset=[0.0],
        noise_covariance=[[sigma**2]],
        state_low=[offset - 10 * sigma],
        state_high=[offset + 10 * sigma],
        input_low=[-10 * sigma],
        input_high=[10 * sigma],
        initial_state=[offset],
    )
    try:
        result = cg.synthesize(problem, 40, relation="exact")
    except ValueError as error:
        assert "rounding" in str(error) or "cells" in str(error)
        return
    assert not refuted(result.certificate)
    assert result.certificate.lower_bound < 0.9
