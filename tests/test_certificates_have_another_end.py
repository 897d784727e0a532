"""Upper ends by the opposite task: for relations without one, of the very controllers of a certificate."""

from __future__ import annotations

import dataclasses
from functools import cache

import pytest
from scipy.stats import binom

import certigym as cg
from certigym.synthesis.upper_ends import UpperEnd, bound_above, opposite_of, wrong_upper_end
from problems import two_agents
from written_problems import oscillator_reach

FALSE_ALARM = 1e-6
"""Probability with which a statistical test here fails although all is right."""


@cache
def parked(cells: int, relation: str = "linear") -> cg.Synthesis:
    return cg.synthesize("car-park-v0", cells, relation=relation)


MADE = {
    "linear": lambda: parked(60),
    "boxes": lambda: parked(100, "boxes"),
    "expressions": lambda: cg.synthesize(oscillator_reach(8), 30, relation="linear"),
    "two agents": lambda: cg.synthesize(two_agents("F (a & F c)", horizon=5), 40, relation="linear"),
}


@pytest.mark.parametrize("kind", MADE)
def test_rollouts_lie_between_both_ends(kind: str) -> None:
    certificate = MADE[kind]().certificate
    assert isinstance(certificate, cg.Certificate)
    end = bound_above(certificate)
    assert 0.05 < certificate.lower_bound <= end.upper_bound and wrong_upper_end(end, certificate) == []
    episodes = 20_000
    successes = round(cg.validate(certificate, episodes, seed=4).estimate * episodes)
    assert binom.sf(successes - 1, episodes, end.upper_bound) > FALSE_ALARM
    assert binom.cdf(successes, episodes, certificate.lower_bound) > FALSE_ALARM


def test_the_upper_end_is_near_that_of_exact_claims() -> None:
    """Claims of `exact` have an upper end of their own; that by the opposite task adds what leaves the workspace."""
    certificate = cg.synthesize(two_agents("F (a & F c)", horizon=5), 60, relation="exact").certificate
    assert isinstance(certificate, cg.Certificate)
    assert 0.0 <= bound_above(certificate).upper_bound - certificate.lower_bound < 0.1


def test_other_controllers_are_refused() -> None:
    """The upper end of better or worse controllers says nothing about these."""
    good = parked(60).certificate
    assert isinstance(good, cg.Certificate)
    # Controllers made for the opposite task avoid what these reach, so that 1 - L' is far below the truth.
    worst = cg.synthesize(opposite_of(good.problem), 60, relation="linear").certificate
    assert isinstance(worst, cg.Certificate)
    end = UpperEnd(good.problem, worst)
    assert end.upper_bound < good.lower_bound and wrong_upper_end(end) == []
    assert "does not act as it does" in wrong_upper_end(end, good)[0]
    (part,) = good.agents
    coarse = parked(40).certificate
    assert isinstance(coarse, cg.Certificate)
    assert wrong_upper_end(bound_above(coarse), good) != []
    changed = part.policy.copy()
    changed[0, 0] = (changed[0, 0] + 1) % 2
    assert wrong_upper_end(
        bound_above(good), dataclasses.replace(good, agents=(dataclasses.replace(part, policy=changed),))
    )


def test_an_end_of_another_problem_is_refused() -> None:
    """Its controllers may be the same; what they are promised is not."""
    first = parked(40).certificate
    assert isinstance(first, cg.Certificate)
    shorter = first.problem.replace(horizon=first.problem.horizon - 1)
    other = cg.synthesize(shorter, 40, relation="linear").certificate
    assert isinstance(other, cg.Certificate)
    assert wrong_upper_end(bound_above(other), first) == ["it is for another problem than the certificate"]


def test_what_has_no_single_certificate_is_refused_in_words() -> None:
    along = cg.synthesize("integrator-chain-v0", relation="path").certificate
    assert not isinstance(along, cg.Certificate)
    with pytest.raises(ValueError, match="expected one of a single task on cells"):
        bound_above(along)
