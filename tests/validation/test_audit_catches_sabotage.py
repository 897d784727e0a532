"""The step-wise audit refutes every sabotaged certificate within 20,000 rollouts and is silent on true ones.

False alarm 1e-6 per audit. Detectable: a fall of the value in expectation by about 0.03 per step at one (time, state),
or by about 0.005 at each of several.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import certigym as cg
from certigym.synthesis.certificates.proofs import OnGrid, changed
from certigym.synthesis.extended_check.claims import claimed_values
from certigym.synthesis.relations.kinds.exact import ExactRelation
from certigym.validation.statistical_tests.audit_report import AuditReport
from certigym.validation.statistical_tests.step_log import STAKES, StepLog
from certigym.validation.statistical_tests.step_tests import audit
from certigym.validation.statistical_tests.value_at import bound_by_steps_left, charge_of
from kinds import mostly_thorough
from problems import scalar_agent, two_agents

CONFIDENCE = 1 - 1e-6
EPISODES = 20_000
LOUD: dict[str, Any] = {"noise_covariance": [[0.8]]}


def regions(shrunk: float = 0.0, **changes: Any) -> cg.Problem:
    """Two loud agents; the goal regions can be cut back by ``shrunk`` at each side."""
    return cg.Problem(
        name="two",
        horizon=4,
        agents=[scalar_agent("one", **LOUD, **changes), scalar_agent("two", **LOUD, **changes)],
        propositions={
            "a": cg.Proposition("one", [1.0 + shrunk], [3.0 - shrunk]),
            "b": cg.Proposition("one", [-2.0], [0.0]),
            "c": cg.Proposition("two", [-3.0 + shrunk], [-1.0 - shrunk]),
        },
        specification=cg.Specification("(!b | !c) U (a & F c)", "co-safe"),
    )


@pytest.fixture(scope="module")
def certificate() -> OnGrid:
    result = cg.synthesize(regions(), 80, relation="quick").certificate
    assert 0.1 < result.lower_bound < 0.95
    return result


def made_for_another(system: cg.Problem, believed: cg.Problem) -> AuditReport:
    """A certificate whose synthesizer had ``believed`` in mind, audited on ``system``."""
    wrong = cg.synthesize(believed, 80, relation="quick").certificate
    return audit(replace(wrong, problem=system), EPISODES, seed=5, values=claimed_values(wrong), confidence=CONFIDENCE)


def variance_for_standard_deviation(_: OnGrid) -> AuditReport:
    return made_for_another(regions(), regions().replace(disturbance_scale=np.sqrt(0.8)))


def input_clipped(_: OnGrid) -> AuditReport:
    return made_for_another(regions(input_low=[-1.2], input_high=[1.2]), regions())


def label_not_shrunk(_: OnGrid) -> AuditReport:
    return made_for_another(regions(shrunk=0.05), regions())


def guards_overlap(c: OnGrid) -> AuditReport:
    first = c.proof.agents[0]
    wide = replace(first, masks=first.masks | np.roll(first.masks, 1, axis=0))
    return audit(changed(c, agents=(wide, *c.proof.agents[1:])), EPISODES, seed=5, confidence=CONFIDENCE)


def one_step_too_many(c: OnGrid) -> AuditReport:
    short = c.problem.replace(horizon=c.problem.horizon - 1)
    return audit(replace(c, problem=short), EPISODES, seed=5, values=claimed_values(c)[:-1], confidence=CONFIDENCE)


def policy_one_step_late(c: OnGrid) -> AuditReport:
    late = [replace(a, policy=np.concatenate([a.policy[:1], a.policy[:-1]])) for a in c.controller.agents]
    return audit(c, EPISODES, seed=5, controller=replace(c.controller, agents=tuple(late)), confidence=CONFIDENCE)


def wrong_feedback_sign(c: OnGrid) -> AuditReport:
    turned = []
    for agent in c.controller.agents:
        assert isinstance(agent.relation, ExactRelation)
        turned.append(replace(agent, relation=replace(agent.relation, A=-agent.relation.A)))
    return audit(c, EPISODES, seed=5, controller=replace(c.controller, agents=tuple(turned)), confidence=CONFIDENCE)


def bound_raised(c: OnGrid) -> AuditReport:
    return audit(changed(c, lower_bound=c.lower_bound + 0.01), EPISODES, seed=5, confidence=CONFIDENCE)


@pytest.mark.parametrize(
    "sabotage",
    [
        variance_for_standard_deviation,
        guards_overlap,
        one_step_too_many,
        policy_one_step_late,
        input_clipped,
        wrong_feedback_sign,
        label_not_shrunk,
        bound_raised,
    ],
)
def test_sabotage_is_refuted(certificate: OnGrid, sabotage: Any) -> None:
    report = sabotage(certificate)
    assert report.refuted, str(report)


TRUE = {
    "reach-avoid": (two_agents(horizon=4, **LOUD), 80),
    "sequence": (regions(), 80),
    "response": (two_agents("G (b -> X d)", "finite-trace", horizon=6, **LOUD), 60),
    "box": (two_agents(horizon=3, **LOUD, initial_state=None, initial_low=[-3.0], initial_high=[-1.0]), 80),
    "four": (cg.make_problem("reach-avoid-n-v0", n_agents=4), 60),
    "invariance": (cg.make_problem("invariance-4-v0"), 60),
    "cut cells": (regions(shrunk=0.05), 37),
}


@mostly_thorough("name", TRUE)
def test_true_certificates_pass(name: str) -> None:
    problem, cells = TRUE[name]
    for seed in (0, 1):
        report = audit(
            cg.synthesize(problem, cells, relation="quick").certificate, EPISODES, seed=seed, confidence=CONFIDENCE
        )
        assert not report.refuted, str(report)
        assert report.contradictions == 0
        assert report.verdict == "consistent" and report.episodes == EPISODES


def test_a_finding_names_time_state_agent_and_region() -> None:
    """Only agent two's noise is understated, and the fault shows where agent two stands."""
    loud = two_agents("F (a & F c)", horizon=4, **LOUD)
    agents = [loud.agents[0], loud.agents[1].replace(noise_covariance=[[1.6]])]
    system = cg.Problem(
        name="two", horizon=4, agents=agents, propositions=loud.propositions, specification=loud.specification
    )
    wrong = cg.synthesize(loud, 80, relation="quick").certificate
    report = audit(replace(wrong, problem=system), EPISODES, values=claimed_values(wrong), confidence=CONFIDENCE)
    assert report.findings, str(report)
    assert report.findings[0].agent == "two", str(report)
    assert report.findings[0].mean_increment < 0 and 0 <= report.findings[0].time < 4
    assert report.findings[0].automaton_state in system.automaton.state_names
    assert report.to_dict()["findings"][0]["region"] in str(report)


def test_bets_never_ruin_and_are_fair_at_the_boundary() -> None:
    """Wealth stays positive at the largest increment, and has mean at most 1 where the mean increment is 0."""
    from certigym.validation.statistical_tests.step_tests import _wealth

    for level in (0.0, 0.3, 0.9, 0.9999, 1.0):
        up, down = np.exp(_wealth(np.array([1.0 - level, -level]), np.full(2, 1.0 - level)))
        assert np.all(up > 0)
        assert np.all(level * up + (1.0 - level) * down <= 1.0 + 1e-12)
    assert len(STAKES) == up.size


def test_audits_do_not_depend_on_the_executor(certificate: OnGrid) -> None:
    from concurrent.futures import ThreadPoolExecutor

    alone = audit(certificate, 5000, chunk=700)
    with ThreadPoolExecutor(3) as pool:
        spread = audit(certificate, 5000, chunk=700, executor=pool)
    np.testing.assert_array_equal(alone.log_e, spread.log_e)
    assert alone.to_dict() == spread.to_dict()
    assert StepLog.empty(certificate.problem).worlds.sum() == 0


def test_bounds_by_steps_left_end_at_the_certified_bound(certificate: OnGrid) -> None:
    start = [a.initial.low[0] for a in certificate.problem.agents]
    curve = bound_by_steps_left(certificate, claimed_values(certificate), start)
    assert curve[-1] == pytest.approx(certificate.lower_bound, rel=1e-9)
    assert np.all(np.diff(curve) >= -1e-12)  # a co-safe task gains with every step


def test_value_functions_must_fit_the_horizon(certificate: OnGrid) -> None:
    with pytest.raises(ValueError, match="one value function per step"):
        audit(certificate, 10, values=claimed_values(certificate)[1:])


@pytest.mark.thorough
@pytest.mark.parametrize(("horizon", "cells"), [(3, 300), (4, 100)])
def test_coupled_controllers_pass_at_their_own_cells_and_louder_noise_is_refuted(horizon: int, cells: int) -> None:
    """The a-posteriori bound, with ``Delta Theta`` taken off and the run stopped where the relation is lost."""
    problem = two_agents("F (a & F c)", horizon=horizon, **LOUD)
    certificate = cg.synthesize(problem, cells, relation="paper").certificate
    assert certificate.proof.bound == "a-posteriori" and certificate.lower_bound > 0.3
    for seed in (0, 1):
        report = audit(certificate, EPISODES, seed=seed, confidence=CONFIDENCE)
        assert not report.refuted and report.tests > horizon, str(report)
    louder = replace(certificate, problem=problem.replace(disturbance_scale=2.0))
    values = claimed_values(certificate)
    charge = charge_of(certificate, values)
    report = audit(louder, EPISODES, values=values, charge=charge, confidence=CONFIDENCE)
    assert report.refuted, str(report)


def test_controllers_with_memory_pass_and_louder_noise_is_refuted() -> None:
    """The abstract state is remembered, delta is 0."""
    problem = cg.Problem(
        name="one",
        horizon=6,
        agents=[scalar_agent("one", noise_covariance=[[0.1]], initial_state=[-2.0])],
        propositions={"g": cg.Proposition("one", [0.0], [4.0])},
        specification=cg.Specification("F g", "co-safe"),
    )
    options = cg.SearchOptions(epsilon=0.2, feedback=-0.4)
    certificate = cg.synthesize(problem, 80, relation="paper", search=options).certificate
    assert certificate.lower_bound > 0.9 and certificate.controller.agents[0].relation.delta == 0.0
    report = audit(certificate, EPISODES, confidence=CONFIDENCE)
    assert not report.refuted and report.contradictions == 0, str(report)
    louder = replace(certificate, problem=problem.replace(disturbance_scale=2.5))
    assert audit(louder, EPISODES, values=claimed_values(certificate), confidence=CONFIDENCE).refuted
