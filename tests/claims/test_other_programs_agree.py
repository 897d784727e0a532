"""Other programs get the same numbers: one vertex at a time, explicit joint models, and Storm where it is installed."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import certigym as cg
from certigym.synthesis.bounds.dense import dense_optimum, dense_value
from certigym.synthesis.models.abstraction import AgentModel, abstract
from certigym.synthesis.models.choices import Policies
from certigym.synthesis.models.joint import join
from certigym.synthesis.search.ascent import resting_policies, sweep
from certigym.synthesis.search.limits import Limits
from certigym.validation.paper.heuristics import paper_steps
from explicit_product import chain_under, decision_process
from per_vertex import per_vertex_steps, value_at
from same_machine import PARKING, by_storm, robust_value
from storm_check import storm_model, storm_reach_within

TOLERANCE = 1e-9


CASES = [
    ("reach-avoid-v0", 150, 8, True, range(1, 9)),
    ("reach-avoid-v0", 150, 8, False, range(3, 9)),  # with two steps to go a tie falls as rounding has it
    ("package-delivery-v0", 50, 8, True, range(1, 9)),
    ("package-delivery-v0", 50, 12, False, range(1, 13)),
]


@pytest.mark.parametrize(("name", "cells", "horizon", "robust", "compared"), CASES)
def test_one_vertex_at_a_time_gives_the_same_value(
    name: str, cells: int, horizon: int, robust: bool, compared: range
) -> None:
    problem = cg.make_problem(name, horizon=horizon)
    joint = join(problem, abstract(problem, cells, relation="paper", epsilon=25 / cells))
    where = np.random.default_rng(0).integers(0, cells, (400, len(joint.models)))
    steps = zip(paper_steps(joint, "robust tree" if robust else "base"), per_vertex_steps(joint, robust), strict=True)
    for ours, plain in steps:
        for q in range(joint.n_states) if ours.steps in compared else ():
            value = ours.terms.at(q, where)
            np.testing.assert_allclose(value_at(plain[q], where), value, rtol=0, atol=TOLERANCE * value.max())


def small_case(cells: int = 8, horizon: int = 4) -> tuple[cg.Problem, tuple[AgentModel, ...], Policies]:
    problem = cg.make_problem("reach-avoid-v0", horizon=horizon)
    abstraction = abstract(problem, cells, relation="exact")
    joint = join(problem, abstraction)
    policies = sweep(joint, resting_policies(joint), None, Limits(0, 0, 0, 10**6), improve=True).policies
    return problem, abstraction.models, policies


def test_explicit_models_are_the_dense_program() -> None:
    problem, models, policies = small_case()
    dense = dense_value(problem, models, policies).ravel()
    chain = chain_under(problem, models, policies)
    np.testing.assert_allclose(chain.transitions.sum(axis=1), 1.0, rtol=0, atol=1e-12)
    np.testing.assert_allclose(chain.reach_within(problem.horizon)[: dense.size], dense, rtol=0, atol=TOLERANCE)
    optimum = decision_process(problem, models).reach_within(problem.horizon)[:-1]
    assert np.all(dense <= optimum + TOLERANCE) and optimum.max() > 0.1
    assert np.all(optimum <= dense_optimum(problem, models).ravel() + TOLERANCE)


def test_storm_gets_the_same_values() -> None:
    pytest.importorskip("stormpy", reason="needs the extra `storm`")
    problem, models, policies = small_case()
    dense = dense_value(problem, models, policies).ravel()
    chain = storm_model(chain_under(problem, models, policies))
    found = storm_reach_within(chain, problem.horizon)[: dense.size]
    np.testing.assert_allclose(found, dense, rtol=0, atol=TOLERANCE)
    process = decision_process(problem, models)
    optimum = process.reach_within(problem.horizon)
    found = storm_reach_within(storm_model(process), problem.horizon)
    np.testing.assert_allclose(found, optimum, rtol=0, atol=TOLERANCE)


def test_storm_gets_the_value_of_interval_models() -> None:
    pytest.importorskip("stormpy", reason="needs the extra `storm`")
    problem = cg.load(PARKING)
    for row in by_storm(problem, 80, 1.0):
        assert row["bound"] == pytest.approx(robust_value(problem, 80), rel=0, abs=TOLERANCE)


def test_interval_models_stay_below_what_any_policy_attains() -> None:
    """Bounds of our interval model rise with its cells, and stay below the upper bound of the continuous system."""
    problem = cg.load(PARKING)
    above: Any = cg.synthesize(problem, 80, relation="linear").stats["continuous_upper_bound"]
    coarse, fine = robust_value(problem, 80), robust_value(problem, 240)
    assert 0.8 < coarse < fine < above < 0.93
