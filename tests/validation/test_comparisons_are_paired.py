"""Comparisons: common random numbers, exact limits and tests, stated information."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.stats import binomtest

import certigym as cg
from certigym.baselines import IdleController, RandomController
from certigym.validation.policies.comparison import mcnemar
from problems import two_agents

PROBLEM = two_agents(horizon=4, noise_covariance=[[0.8]])


def head(x: Any, q: int, time: int) -> Any:
    return np.clip((2.0 - 0.9 * x) / 0.5, -2.0, 2.0)


def test_policies_meet_the_same_episodes() -> None:
    result = cg.compare(PROBLEM, {"one": head, "other": head, "idle": IdleController()}, 4000, seed=7)
    same, against, _ = result.pairs
    assert (same.only_first, same.only_second, same.p_value) == (0, 0, 1.0)
    assert result.entry("one").successes == cg.rollout(PROBLEM, cg.as_controller(PROBLEM, head), 4000, seed=7).successes
    assert against.only_first - against.only_second == (result.entry("one").successes - result.entry("idle").successes)
    assert result.seed == 7 and result.chunk == 2000


def test_numbers_agree_with_scipy() -> None:
    result = cg.compare(PROBLEM, {"head": head, "random": RandomController()}, 3000, confidence=0.95)
    for entry in result.entries:
        limits = binomtest(entry.successes, 3000).proportion_ci(0.95, "exact")
        assert (entry.ci_low, entry.ci_high) == pytest.approx((limits.low, limits.high), rel=1e-9)
    for a, b in ((0, 1), (3, 9), (9, 3), (40, 80), (7, 7)):
        assert mcnemar(a, b) == pytest.approx(binomtest(a, a + b).pvalue, rel=1e-9)


def test_the_paired_test_keeps_its_level() -> None:
    """Two policies without effect on success: at most 5 % of 400 comparisons reject at 5 %, binomially (1e-6)."""
    rng = np.random.default_rng(0)
    wins = rng.random((400, 200, 2)) < 0.3
    rejected = 0
    for outcome in wins:
        first, second = outcome.T
        rejected += mcnemar(int((first & ~second).sum()), int((second & ~first).sum())) <= 0.05
    assert binomtest(rejected, 400, 0.05, "greater").pvalue > 1e-6


def test_bounds_seconds_and_information_are_stated() -> None:
    synthesis = cg.synthesize(PROBLEM, 40, search=cg.SearchOptions(max_sweeps=1))
    coupled = cg.synthesize(PROBLEM, 80, relation="paper", search=cg.SearchOptions(epsilon=0.3, max_sweeps=0))
    policies = {"ours": synthesis, "saved": synthesis.certificate, "coupled": coupled, "again": [head, head]}
    result = cg.compare(PROBLEM, policies, 500)
    ours, saved, remembering, *seeds = result.entries
    assert ours.lower_bound == saved.lower_bound == synthesis.certificate.lower_bound
    assert ours.seconds is not None and ours.seconds > 0.0 and saved.seconds is None
    assert ours.information == "own state, automaton state, time"
    assert remembering.information == "own state, automaton state, time, own abstract state"
    assert [entry.name for entry in seeds] == ["again (seed 0)", "again (seed 1)"]
    assert "again: mean" in str(result) and "over 2 training seeds" in str(result)
    assert len(result.pairs) == 10
