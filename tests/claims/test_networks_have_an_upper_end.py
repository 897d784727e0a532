"""One minus what is certified for the opposite task is above what deployed networks attain, and above their bound."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from scipy.stats import binom

import certigym as cg
from certigym.synthesis.certificates.proofs import changed
from certigym.synthesis.verbs.raw_networks import certify_network, differences
from network_problems import RNG, proportional, reach, with_network
from problems import scalar_agent

FALSE_ALARM = 1e-6
"""Probability with which a statistical test here fails although all is right."""


@pytest.fixture(scope="module")
def ends() -> tuple[cg.Problem, Any, Any]:
    """Two scalar agents whose network succeeds about as often as not, and its certificate with both ends."""
    problem = reach(scalar_agent("a"), scalar_agent("b"), horizon=2)
    actor = proportional(problem)
    return problem, actor, cg.certify(problem, actor, 150, above=True).certificate


def test_the_truth_is_between_both_ends(ends: tuple[cg.Problem, Any, Any]) -> None:
    """40,000 rollouts lie below the upper end and above the lower one; both are near."""
    problem, actor, certificate = ends
    lower, upper = certificate.lower_bound, certificate.upper_bound
    assert 0.1 < lower <= upper < 0.9
    assert upper - lower < 0.02
    successes = cg.rollout(problem, cg.as_controller(problem, actor), episodes=40_000, seed=2).successes
    assert binom.sf(successes - 1, 40_000, upper) > FALSE_ALARM
    assert binom.cdf(successes, 40_000, lower) > FALSE_ALARM
    # A bound that is too small by .03 is refuted.
    assert binom.sf(successes - 1, 40_000, upper - 0.03) < FALSE_ALARM
    assert cg.check(certificate) and differences(certificate, actor) == []


def test_upper_ends_that_are_wrong_are_refused(ends: tuple[cg.Problem, Any, Any]) -> None:
    """The task itself, a bound that is too small, other weights."""
    problem, actor, certificate = ends
    itself = certify_network(problem, actor, 150).certificate
    assert certificate.proof.complement.problem.automaton.n_states == problem.automaton.n_states + 1
    assert not cg.check(changed(certificate, complement=itself))
    lower = certificate.proof.complement.lower_bound + 0.01
    small = changed(certificate.proof.complement, lower_bound=lower, bounds={"nominal": lower})
    assert any("exceeds" in text for text in cg.check(changed(certificate, complement=small)).failures)
    squashed = changed(certificate, complement=with_network(certificate.proof.complement, squashed=True))
    assert "does not act" in cg.check(squashed).failures[0]
    RNG.random(7)  # from here on the draws are others than those of the fixture
    others = proportional(problem)
    assert any("other" in text for text in differences(certificate, others))


def test_a_network_that_fails_has_a_small_upper_end() -> None:
    """It goes away from its goal, and stays inside."""
    problem = reach(scalar_agent("a"), horizon=2)
    actor = proportional(problem)
    away = dataclasses.replace(actor.network, biases=(*actor.network.biases[:-1], np.full(1, -0.3, dtype=np.float32)))
    away = dataclasses.replace(away, weights=(*away.weights[:-1], 0.0 * away.weights[-1]))
    certificate = cg.certify(problem, type(actor)(problem, away), 100, above=True).certificate
    assert certificate.upper_bound < 0.1 and cg.check(certificate)
    assert "P <=" in repr(certificate)
