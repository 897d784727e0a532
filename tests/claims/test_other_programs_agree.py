"""Explicit joint models, as a model checker has them, get the same numbers."""

from __future__ import annotations

import numpy as np

import certigym as cg
from certigym.synthesis.abstraction.models.action_tables import Policies
from certigym.synthesis.abstraction.models.finite_models import AgentModel
from certigym.synthesis.abstraction.models.joint import join
from certigym.synthesis.policy_search.ascent.coordinate_ascent import resting_policies, sweep
from certigym.synthesis.policy_search.ascent.limits import Limits
from certigym.synthesis.policy_search.bounds.dense import dense_optimum, dense_value
from certigym.synthesis.verbs.abstract import abstract
from explicit_product import chain_under, decision_process

TOLERANCE = 1e-9


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
