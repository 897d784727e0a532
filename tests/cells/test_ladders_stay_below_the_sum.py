"""Whatever ladders unite, the sum of the terms is nowhere larger than before: exact fractions, no tolerance."""

from __future__ import annotations

import math
from fractions import Fraction
from itertools import product

import numpy as np
import pytest
from numpy.typing import NDArray

from certigym.synthesis.policy_search.ascent.pruning_schedule import apply_rest, pruning_schedules


def total(terms: list[NDArray], joint: tuple[int, ...]) -> Fraction:
    """The exact sum of products at one joint place."""
    rows = range(len(terms[0]))
    factors = ([Fraction(float(term[k][s])) for term, s in zip(terms, joint, strict=True)] for k in rows)
    return sum((math.prod(row, start=Fraction(1)) for row in factors), Fraction(0))


def random_terms(rng: np.random.Generator, n_agents: int, count: int) -> list[NDArray]:
    """Factors in 64ths, so that sums of two are exact; many are 0, and many agree."""
    terms = [rng.integers(0, 40, size=(count, 4)) / 64.0 for _ in range(n_agents)]
    for term in terms:
        term[rng.random(term.shape) < 0.3] = 0.0
        term[-1] = term[0]
    return terms


@pytest.mark.parametrize("n_agents", [1, 2, 3])
@pytest.mark.parametrize("seed", range(3))
def test_a_union_and_its_remainder_are_below_the_two_terms(n_agents: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    rests = [sign * (j + 1) for j in range(1, n_agents) for sign in (1, -1)] or [0]
    for rest in rests:
        terms = random_terms(rng, n_agents, 2)
        if n_agents == 1:
            terms = [terms[0][:2]]
        before = [term.copy() for term in terms]
        apply_rest(terms, 0, 0, 1, rest)
        for joint in product(range(4), repeat=n_agents):
            # With one agent the sum is the union, and what was absorbed does not count.
            after = total(terms, joint) if rest else total([term[:1] for term in terms], joint)
            assert after <= total(before, joint)


def test_a_remainder_of_the_wrong_term_would_be_caught() -> None:
    """Sabotage: the remainder of one term with the factor of the other exceeds the sum somewhere."""
    terms = [np.array([[0.75], [0.25]]), np.array([[0.25], [0.75]])]
    before = [term.copy() for term in terms]
    apply_rest(terms, 0, 0, 1, -2)
    assert total(terms, (0, 0)) <= total(before, (0, 0))
    terms[0][1] = before[0][0]
    assert total(terms, (0, 0)) > total(before, (0, 0))


@pytest.mark.parametrize("n_agents", [2, 3])
@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("spent", [0.0, 0.05])
def test_whole_ladders_stay_below(n_agents: int, seed: int, spent: float) -> None:
    rng, count = np.random.default_rng(100 + seed), 6
    factors = random_terms(rng, n_agents, count)
    before = [factor.copy() for factor in factors]
    rows = np.tile(np.arange(count)[:, None], n_agents)
    masses = [rng.random(4) for _ in range(n_agents)]
    merges = pruning_schedules(
        factors, rows, np.arange(count), np.zeros(count, dtype=np.int64), lambda q: masses, spent
    )
    assert len(merges.into)
    after = [factor[rows[:, i]] for i, factor in enumerate(factors)]
    assert all(np.all(factor >= 0.0) for factor in after)
    for joint in product(range(4), repeat=n_agents):
        # Sums of three and more 64ths are still exact; remainders are rounded, far below what is taken off them.
        assert total(after, joint) <= total(before, joint)


def test_the_edge_of_a_region_for_two_disappears() -> None:
    """In it together all is won, elsewhere u x u is left: three terms make one without an edge, and little more."""
    u, inside = np.array([0.7, 0.9, 0.95, 0.9]), np.array([0.0, 1.0, 1.0, 0.0])
    out = 1.0 - inside
    factors = [np.array([inside, inside * u, out * u]), np.array([inside, out * u, u])]
    rows, mass = np.tile(np.arange(3)[:, None], 2), np.array([0.1, 0.4, 0.4, 0.1])
    pruning_schedules(factors, rows, np.arange(3), np.zeros(3, dtype=np.int64), lambda q: [mass, mass], 0.0)
    after = [factor[rows[:, i]] for i, factor in enumerate(factors)]
    weights = np.prod([own @ mass for own in after], axis=0)
    head = int(np.argmax(weights))
    np.testing.assert_allclose(after[0][head], u, atol=1e-9)
    np.testing.assert_allclose(after[1][head], u, atol=1e-9)
    assert weights[head] > 0.85 * weights.sum()
