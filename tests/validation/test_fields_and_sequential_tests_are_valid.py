"""Simultaneous and sequential tests keep their error rates, find what is wrong, and stop when they know."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import beta, binom

import certigym as cg
from certigym.synthesis.certificates.proofs import OnGrid, changed
from certigym.synthesis.certificates.value_functions.terms import Terms
from certigym.validation.statistical_tests.binomial import (
    CONFIRMED,
    CONSISTENT,
    REFUTED,
    VACUOUS,
    holm,
    p_at_least,
    p_at_most,
)
from certigym.validation.statistical_tests.fields import find_weakest, validate_field
from certigym.validation.statistical_tests.sequential import (
    SequentialState,
    confidence_sequence,
    log_e_at_least,
    log_e_at_most,
)
from certigym.validation.statistical_tests.starts import (
    corner_starts,
    neighbours,
    random_starts,
    slice_starts,
    workspace_box,
)
from problems import two_agents

CONFIDENCE = 1 - 1e-6
LOUD: dict[str, Any] = {"noise_covariance": [[0.8]]}


@pytest.fixture(scope="module")
def certificate() -> OnGrid:
    return cg.synthesize(two_agents("F (a & F c)", horizon=4, **LOUD), 80, relation="exact").certificate


def inflated(c: OnGrid, factor: float) -> OnGrid:
    """The same certificate with every claim multiplied."""
    factors = (c.proof.tree.factors[0] * factor, *c.proof.tree.factors[1:])
    return changed(c, terms=Terms(factors, c.proof.tree.index), lower_bound=min(1.0, c.lower_bound * factor))


def test_p_values_are_binomial_tails() -> None:
    k, n = np.array([0, 3, 17, 50, 50]), np.array([50, 50, 50, 50, 60])
    for bound in (0.0, 0.01, 0.4, 0.999, 1.0):
        np.testing.assert_allclose(p_at_least(k, n, bound), binom.cdf(k, n, bound), rtol=1e-9, atol=1e-300)
        np.testing.assert_allclose(p_at_most(k, n, bound), binom.sf(k - 1, n, bound), rtol=1e-9, atol=1e-300)


def test_holm_is_bonferroni_for_the_smallest_and_never_decreases() -> None:
    p = np.random.default_rng(0).random(50) ** 3
    adjusted = holm(p)
    assert adjusted.min() == pytest.approx(min(1.0, 50 * p.min()))
    assert np.all(np.diff(adjusted[np.argsort(p)]) >= 0) and np.all(adjusted >= p)


def test_true_fields_are_never_refuted_and_false_ones_are(certificate: OnGrid) -> None:
    """False alarm 1e-6. 300 episodes at each of 144 starts notice a claim that is 8 % too large somewhere."""
    states = slice_starts(certificate.problem, (0, 1), (12, 12))
    field = validate_field(certificate, states, 300, seed=1, confidence=CONFIDENCE, shape=(12, 12))
    assert field.verdict == CONSISTENT, str(field)
    assert np.array_equal(field.episodes, np.full(144, 300)) and field.shape == (12, 12)
    bad = validate_field(inflated(certificate, 1.3), states, 300, seed=1, confidence=CONFIDENCE)
    assert bad.verdict == REFUTED and 0 < bad.fraction_refuted < 1, str(bad)
    assert bad.refuted[bad.weakest] and bad.margins[bad.weakest] < 0
    np.testing.assert_array_equal(field.successes, bad.successes)


def test_one_start_of_a_field_agrees_with_validate(certificate: OnGrid) -> None:
    state = [1.5, 0.5]
    field = validate_field(certificate, [state], 4000, seed=3)
    report = cg.validate(certificate, 4000, seed=3, initial_state=state)
    assert (int(field.successes[0]), float(field.lower_bounds[0])) == (report.successes, report.lower_bound)


def test_the_weakest_start_is_found(certificate: OnGrid) -> None:
    """Claims are too large only where agent one starts right of 3.4, a tenth of the axis."""
    grid, factor = certificate.proof.agents[0].grid, certificate.proof.tree.factors[0].copy()
    factor[:, grid.centres[:, 0] > 3.4] *= 1.25
    wrong = changed(
        certificate, terms=Terms((factor, *certificate.proof.tree.factors[1:]), certificate.proof.tree.index)
    )
    field = find_weakest(wrong, 60_000, seed=4, confidence=CONFIDENCE)
    assert field.verdict == REFUTED, str(field)
    assert field.states[field.weakest, 0] > 3.4
    assert find_weakest(certificate, 60_000, seed=4, confidence=CONFIDENCE).verdict == CONSISTENT


def test_starts_lie_where_they_should(certificate: OnGrid) -> None:
    low, high = workspace_box(certificate.problem)
    for states in (corner_starts(certificate.problem), random_starts(certificate.problem, 50, 1)):
        assert np.all((low <= states) & (states <= high))
    assert len(corner_starts(certificate.problem)) == 4
    assert len(corner_starts(cg.make_problem("invariance-20-v0"))) == 64
    moved = neighbours(certificate, random_starts(certificate.problem, 50, 1), np.random.default_rng(0))
    assert np.all((low <= moved) & (moved <= high))
    line = slice_starts(certificate.problem, (1,), (4,), base=[2.0, 0.0])
    np.testing.assert_allclose(line, [[2, -3], [2, -1], [2, 1], [2, 3]])
    with pytest.raises(ValueError, match="joint coordinates"):
        slice_starts(certificate.problem, (2,), (4,))
    with pytest.raises(ValueError, match="`shape`"):
        validate_field(certificate, line, 10, shape=(3,))


@pytest.mark.parametrize(("k", "n", "bound"), [(0, 1, 0.5), (3, 9, 0.6), (40, 50, 0.9), (49, 50, 0.9)])
def test_e_values_are_the_integrals_they_stand_for(k: int, n: int, bound: float) -> None:
    def ratio(p: float) -> float:
        return float((p / bound) ** k * ((1 - p) / (1 - bound)) ** (n - k) * beta.pdf(p, 0.5, 0.5))

    below, above = quad(ratio, 0, bound)[0], quad(ratio, bound, 1)[0]
    mass = beta.cdf(bound, 0.5, 0.5)
    assert np.exp(log_e_at_least(k, n, bound)) == pytest.approx(below / mass, rel=1e-6)
    assert np.exp(log_e_at_most(k, n, bound)) == pytest.approx(above / (1 - mass), rel=1e-6)


@pytest.mark.parametrize("truth", [0.3, 0.6, 0.9])
def test_e_values_have_mean_at_most_one_under_the_hypothesis(truth: float) -> None:
    """Exact expectation over Bin(n, truth) for every bound that is true."""
    for n in (1, 10, 200):
        k = np.arange(n + 1)
        weights = binom.pmf(k, n, truth)
        for bound in (0.5 * truth, truth):
            assert weights @ np.exp(log_e_at_least(k, n, bound)) <= 1 + 1e-9
        for bound in (truth, 0.5 * (1 + truth)):
            assert weights @ np.exp(log_e_at_most(k, n, bound)) <= 1 + 1e-9


def test_edges_of_sequential_claims() -> None:
    assert np.all(log_e_at_least(0, np.arange(1, 50), 0.0) == 0)  # P >= 0 is never refuted
    assert float(log_e_at_least(4, 5, 1.0)) == np.inf  # P >= 1 is refuted by the first failure
    some, every = np.array([True, False]), np.ones(5000, dtype=bool)
    assert SequentialState(1.0, None, 0.999).advance(some).verdict == REFUTED
    assert SequentialState(1.0, None, 0.999).advance(every).verdict == CONSISTENT
    empty = SequentialState(0.0, None, 0.999).advance(some)
    assert empty.verdict == VACUOUS and empty.episodes == 1  # nothing is left to be learned
    assert SequentialState(0.0, 0.1, 0.999).advance(every).verdict == REFUTED  # its upper end says something
    low, high = confidence_sequence(0, 10, 0.999)
    assert low == 0 and 0 < high < 1


def test_sequential_validation_stops_early_and_for_the_right_reason(certificate: OnGrid) -> None:
    modest = changed(certificate, lower_bound=0.5 * certificate.lower_bound, gap=None)
    early = cg.validate(modest, 100_000, seed=1, sequential=True)
    assert early.verdict == CONFIRMED and early.episodes < 500
    assert early.details["sequential"] and "tested after every episode" in str(early)
    wrong = cg.validate(inflated(certificate, 1.1), 100_000, seed=1, sequential=True)
    assert wrong.verdict == REFUTED and wrong.episodes < 20_000 and wrong.ci_high < wrong.lower_bound + 0.02
    right = cg.validate(certificate, 20_000, seed=1, sequential=True, confidence=CONFIDENCE)
    assert right.verdict == CONSISTENT and right.episodes == 20_000
    assert right.ci_low <= right.lower_bound <= right.ci_high
    again = cg.validate(wrong_chunks := inflated(certificate, 1.1), 100_000, seed=1, sequential=True)
    assert (again.episodes, again.successes) == (wrong.episodes, wrong.successes) and wrong_chunks.lower_bound < 1
