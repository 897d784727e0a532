"""The certified value does not depend on names and order, and every sabotage of the mathematics is noticed."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import certigym as cg
from certigym.synthesis.abstraction.kernels import kernel as kernel_module
from certigym.synthesis.abstraction.models.guards import compile_guards
from certigym.synthesis.certificates.value_functions.terms import Guards
from certigym.synthesis.relations.kinds import exact as relation_exact
from problems import scalar_agent, two_agents

LOUD: dict[str, Any] = {"noise_covariance": [[0.8]]}
FALSE_ALARM = 1e-6


def value(problem: cg.Problem, cells: int = 60) -> float:
    return cg.synthesize(problem, cells).certificate.lower_bound


@pytest.fixture
def problem() -> cg.Problem:
    return two_agents("F (a & F c)", horizon=4, **LOUD)


def test_the_order_of_the_agents_does_not_matter(problem: cg.Problem) -> None:
    swapped = cg.Problem(
        name="swapped",
        horizon=problem.horizon,
        agents=problem.agents[::-1],
        propositions=problem.propositions,
        specification=problem.specification,
    )
    assert value(swapped) == pytest.approx(value(problem), rel=1e-6)


@pytest.mark.thorough
def test_splitting_guards_and_renaming_states_does_not_matter(problem: cg.Problem) -> None:
    rows = [
        ("idle", "a & c & b", "done"),
        ("idle", "a & c & !b", "done"),
        ("idle", "a & !c & d", "half"),
        ("idle", "a & !c & !d", "half"),
        ("idle", "!a", "idle"),
        ("half", "c", "done"),
        ("half", "!c", "half"),
    ]
    table = {"states": ["idle", "half", "done"], "initial": "idle", "accepting": ["done"], "transitions": rows}
    by_hand = cg.translate(table, ["a", "b", "c", "d"])
    other = cg.Problem(
        name="by-hand",
        horizon=problem.horizon,
        agents=problem.agents,
        propositions=problem.propositions,
        specification=cg.Specification(automaton=by_hand),
    )
    assert value(other) == pytest.approx(value(problem), rel=1e-9)


def test_a_start_outside_the_workspace_is_worth_nothing_and_a_decided_one_everything() -> None:
    inside = two_agents(horizon=3)
    outside = inside.replace(initial_state=[9.0, 0.0])
    with pytest.raises(ValueError, match="expected a start in the workspace"):
        cg.synthesize(outside, 40)
    certificate = cg.synthesize(inside, 40).certificate
    assert certificate.at([9.0, 0.0])[0] == 0.0
    assert cg.rollout(outside, certificate.controller, 1000).successes == 0
    decided = two_agents("F a", horizon=3).replace(initial_state=[2.0, 0.0])
    assert value(decided) == pytest.approx(1.0, abs=1e-9)
    lost = two_agents("G b", "finite-trace", horizon=3).replace(initial_state=[2.0, 0.0])
    assert value(lost) == 0.0


def refuted_or_refused(problem: cg.Problem) -> bool:
    """Whether the check or 20,000 rollouts at a false alarm of 1e-6 notice that something is wrong."""
    result = cg.synthesize(problem, 60)
    report = cg.validate(result, 20_000, seed=1, confidence=1 - FALSE_ALARM)
    return report.refuted or not cg.check(result.certificate)


def test_nothing_is_noticed_without_sabotage(problem: cg.Problem) -> None:
    assert not refuted_or_refused(problem)


def test_variance_for_standard_deviation_is_noticed(problem: cg.Problem, monkeypatch: pytest.MonkeyPatch) -> None:
    right = kernel_module.gaussian_masses
    monkeypatch.setattr(kernel_module, "gaussian_masses", lambda means, edges, std: right(means, edges, std**2))
    quiet = two_agents("F (a & F c)", horizon=4)  # variance .25, standard deviation .5
    result = cg.synthesize(quiet, 60)
    assert not cg.check(result.certificate)
    loud = two_agents("F (a & F c)", horizon=3, noise_covariance=[[0.25]]).replace(initial_state=[-0.5, 0.3])
    assert cg.validate(cg.synthesize(loud, 60), 20_000, confidence=1 - FALSE_ALARM).refuted


def test_overlapping_guards_are_noticed(problem: cg.Problem, monkeypatch: pytest.MonkeyPatch) -> None:
    def doubled(*arguments: Any) -> Guards:
        guards = compile_guards(*arguments)
        twice = (np.concatenate([own, own]) for own in (guards.source, guards.target, guards.mask))
        return Guards(guards.masks, *twice)

    monkeypatch.setattr("certigym.synthesis.abstraction.models.joint.compile_guards", doubled)
    result = cg.synthesize(problem, 60)
    assert not cg.check(result.certificate)
    assert "overlap" in str(cg.check(result.certificate))


def test_a_forgotten_input_reserve_is_noticed(problem: cg.Problem, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        relation_exact.ExactRelation, "reserve", lambda self, half: np.tile(self.input_half_width, (len(half), 1))
    )
    assert not cg.check(cg.synthesize(problem, 60).certificate)


def test_a_wrong_feedback_sign_is_noticed(problem: cg.Problem, monkeypatch: pytest.MonkeyPatch) -> None:
    result = cg.synthesize(problem, 60, relation="exact")
    right = relation_exact.ExactRelation.inputs

    def wrong(self: Any, targets: np.ndarray, states: np.ndarray, beside: Any = None) -> np.ndarray:
        return np.asarray(right(self, targets, -states))

    monkeypatch.setattr(relation_exact.ExactRelation, "inputs", wrong)
    assert cg.validate(result, 20_000, confidence=1 - FALSE_ALARM).refuted


def test_a_certificate_with_a_formula_per_agent_is_the_product_of_its_parts() -> None:
    """Two agents that do not share a guard: the joint certificate is the product of the single ones."""
    both = two_agents("G (b | a | !a) & G !a", "finite-trace", horizon=4, **LOUD)
    single = cg.Problem(
        name="one",
        horizon=4,
        agents=[scalar_agent("one", **LOUD)],
        propositions={"a": cg.Proposition("one", [1.0], [3.0])},
        specification=cg.Specification("G !a", "finite-trace"),
    )
    free = cg.Problem(
        name="two",
        horizon=4,
        agents=[scalar_agent("two", **LOUD)],
        propositions={"d": cg.Proposition("two", [0.0], [4.0])},
        specification=cg.Specification("G (d | !d)", "finite-trace"),
    )
    assert value(both, 64) == pytest.approx(value(single, 64) * value(free, 64), rel=1e-6)
