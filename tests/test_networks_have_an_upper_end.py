"""One minus what is certified for the opposite task is above what deployed networks attain, and above their bound."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from scipy.stats import binom

import certigym as cg
from certigym.baselines import RandomController
from certigym.synthesis.checking import wrong_opposite
from certigym.synthesis.raw_networks import certify_network
from certigym.synthesis.upper_ends import UpperEnd, bound_network_above, opposite_of, wrong_upper_end
from network_problems import RNG, changed, proportional, reach
from problems import scalar_agent, two_agents

FALSE_ALARM = 1e-6
"""Probability with which a statistical test here fails although all is right."""


@pytest.fixture(scope="module")
def ends() -> tuple[cg.Problem, Any, UpperEnd]:
    """Two scalar agents whose network succeeds about as often as not."""
    problem = reach(scalar_agent("a"), scalar_agent("b"), horizon=2)
    actor = proportional(problem)
    return problem, actor, bound_network_above(problem, actor, 150)


def test_the_truth_is_between_both_ends(ends: tuple[cg.Problem, Any, UpperEnd]) -> None:
    """40,000 rollouts lie below the upper end and above the lower one; both are near."""
    problem, actor, end = ends
    lower = certify_network(problem, actor, 150).certificate.lower_bound
    assert 0.1 < lower <= end.upper_bound < 0.9
    assert end.upper_bound - lower < 0.02
    successes = cg.rollout(problem, cg.as_controller(problem, actor), episodes=40_000, seed=2).successes
    assert binom.sf(successes - 1, 40_000, end.upper_bound) > FALSE_ALARM
    assert binom.cdf(successes, 40_000, lower) > FALSE_ALARM
    # A bound that is too small by .03 is refuted.
    assert binom.sf(successes - 1, 40_000, end.upper_bound - 0.03) < FALSE_ALARM
    assert wrong_upper_end(end, actor) == []


@pytest.mark.parametrize(
    "formula, semantics", [("F (a & F c) & G[0,2] !b", "co-safe"), ("G (b -> X d)", "finite-trace")]
)
def test_opposite_tasks_are_never_both_satisfied(formula: str, semantics: str) -> None:
    """2000 random walks: exactly one of both, unless a workspace was left."""
    problem = two_agents(formula, semantics, horizon=4)
    other = opposite_of(problem)
    assert wrong_opposite(problem, other) == []
    policy = RandomController()
    pairs = [cg.rollout(task, policy, episodes=2000, seed=3).success for task in (problem, other)]
    both = np.sum(pairs, axis=0)
    assert both.max() == 1 and 0 < pairs[0].sum() < 2000
    assert wrong_opposite(problem, problem) != []


def test_upper_ends_that_are_wrong_are_refused(ends: tuple[cg.Problem, Any, UpperEnd]) -> None:
    """Another horizon, the task itself, a bound that is too small, other weights."""
    problem, actor, end = ends
    longer = dataclasses.replace(end, problem=problem.replace(horizon=problem.horizon + 1))
    assert any("horizon" in text for text in wrong_upper_end(longer))
    itself = UpperEnd(problem, certify_network(problem, actor, 60).certificate)
    assert any("accept" in text for text in wrong_upper_end(itself))
    elsewhere = dataclasses.replace(end, problem=problem.replace(initial_state={"a": [0.5]}))
    assert any("agents" in text for text in wrong_upper_end(elsewhere))
    lower = end.opposite.lower_bound + 0.01
    small = dataclasses.replace(end.opposite, lower_bound=lower, bounds={end.opposite.bound: lower})
    assert any("exceeds" in text for text in wrong_upper_end(UpperEnd(problem, small)))
    assert wrong_upper_end(UpperEnd(problem, changed(end.opposite, squashed=True))) != []
    RNG.random(7)  # from here on the draws are others than those of the fixture
    others = proportional(problem)
    assert any("other" in text for text in wrong_upper_end(end, others))


def test_a_network_that_fails_has_a_small_upper_end() -> None:
    """It goes away from its goal, and stays inside."""
    problem = reach(scalar_agent("a"), horizon=2)
    actor = proportional(problem)
    away = dataclasses.replace(actor.network, biases=(*actor.network.biases[:-1], np.full(1, -0.3, dtype=np.float32)))
    away = dataclasses.replace(away, weights=(*away.weights[:-1], 0.0 * away.weights[-1]))
    end = bound_network_above(problem, type(actor)(problem, away), 100)
    assert end.upper_bound < 0.1 and wrong_upper_end(end) == []
    assert "P <=" in repr(end)
