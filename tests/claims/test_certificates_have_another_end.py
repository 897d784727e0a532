"""Upper ends by the opposite task: part of certificates, saved, checked, and met by rollouts."""

from __future__ import annotations

import dataclasses
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from scipy.stats import binom

import certigym as cg
from certigym.envs.tasks.problem import complement_of
from certigym.synthesis.certificates.proofs import changed
from certigym.synthesis.policy_search.portfolio import effort
from certigym.synthesis.verbs.upper_bounds import bound_above
from problems import two_agents
from written_problems import oscillator_reach

FALSE_ALARM = 1e-6
"""Probability with which a statistical test here fails although all is right."""


@cache
def parked(cells: int, relation: str = "linear") -> Any:
    """The controllers that park, with both ends."""
    return cg.synthesize("car-park-v0", cells, relation=relation, above=True).certificate


MADE = {
    "linear": lambda: parked(60),
    "boxes": lambda: parked(100, "boxes"),
    "expressions": lambda: cg.synthesize(oscillator_reach(8), 30, relation="linear", above=True).certificate,
    "two agents": lambda: (
        cg.synthesize(two_agents("F (a & F c)", horizon=5), 40, relation="linear", above=True).certificate
    ),
}


@pytest.mark.thorough
@pytest.mark.parametrize("kind", MADE)
def test_rollouts_lie_between_both_ends(kind: str) -> None:
    certificate = MADE[kind]()
    report = cg.check(certificate)
    assert report and 0.05 < certificate.lower_bound <= report.above <= certificate.upper_bound
    validation = cg.validate(certificate, 20_000, seed=4, confidence=1.0 - FALSE_ALARM)
    assert not validation.refuted and validation.gap == certificate.gap
    successes = round(validation.estimate * 20_000)
    assert binom.sf(successes - 1, 20_000, certificate.upper_bound) > FALSE_ALARM


def test_a_claim_whose_upper_end_is_too_small_is_refuted_by_rollouts() -> None:
    good = parked(60)
    low = changed(good, lower_bound=0.5, bounds={good.proof.bound: 0.5}, gap=0.2)
    assert cg.validate(low, 20_000, seed=4, confidence=1.0 - FALSE_ALARM).refuted and not cg.check(low)


def test_the_upper_end_is_near_that_of_exact_claims() -> None:
    """Claims of `exact` have an upper end of their own, to which that by the opposite task comes."""
    certificate = cg.synthesize(two_agents("F (a & F c)", horizon=5), 60, relation="exact").certificate
    assert bound_above(certificate) is certificate
    bare = changed(certificate, gap=None)
    end = bound_above(bare)
    assert cg.check(end) and abs(end.upper_bound - certificate.upper_bound) < 1e-7


@pytest.mark.thorough
def test_other_controllers_are_refused() -> None:
    """The upper end of better or worse controllers says nothing about these."""
    good = parked(60)
    # Controllers made for the opposite task avoid what these reach, so that 1 - L' is far below the truth.
    worst = cg.synthesize(complement_of(good.problem), 60, relation="linear").certificate
    above = 1.0 - worst.lower_bound
    assert cg.check(worst) and above < good.lower_bound
    for complement in (worst, parked(40).proof.complement):
        assert "does not act as it does" in cg.check(changed(good, complement=complement)).failures[0]
    (part,) = good.proof.agents
    policy = part.policy.copy()
    policy[0, 0] = (policy[0, 0] + 1) % 2
    assert not cg.check(changed(good, agents=(dataclasses.replace(part, policy=policy),)))


@cache
def forgeries() -> dict[str, Any]:
    """Upper ends that do not hold, by what is wrong with them."""
    good = parked(60)
    larger = good.proof.complement.lower_bound + 0.01
    stated = changed(good.proof.complement, lower_bound=larger, bounds={good.proof.complement.proof.bound: larger})
    shorter = cg.synthesize(good.problem.replace(horizon=good.problem.horizon - 1), 60, relation="linear", above=True)
    return {
        "exceeds the recomputed": changed(good, complement=stated),
        "says that the probability is at most": changed(good, gap=0.5 * good.gap),
        "do not fit together|does not act": changed(good, complement=shorter.certificate.proof.complement),
        "names a vertex that is not there|recomputed": changed(
            good, complement=changed(good, complement=None, gap=None)
        ),
        "an upper end again": changed(good, complement=changed(good.proof.complement, complement=good)),
        "says nothing of an upper end": changed(good, gap=None),
        "are not additive": changed(good, complement=None),
    }


@pytest.mark.parametrize("said", range(7))
def test_upper_ends_that_do_not_hold_are_refused(said: int) -> None:
    pattern, forged = list(forgeries().items())[said]
    report = cg.check(forged)
    assert not report
    assert any(word in " ".join(report.failures) for word in pattern.split("|")), report.failures


def test_both_ends_are_saved_and_products_have_them(tmp_path: Path) -> None:
    certificate = parked(60)
    cg.save(certificate, tmp_path / "both.npz")
    loaded: Any = cg.load(tmp_path / "both.npz")
    assert loaded.upper_bound == certificate.upper_bound and cg.check(loaded)
    apart = two_agents("G !a & G !c", "finite-trace", horizon=4)
    both = cg.synthesize(apart, 30, relation="linear", above=True).certificate
    assert cg.check(both) and both.lower_bound <= both.upper_bound < 1.0
    cg.save(both, tmp_path / "both.npz")
    assert cg.load(tmp_path / "both.npz").upper_bound == both.upper_bound


@pytest.mark.thorough
@pytest.mark.full_search(effort)
def test_quick_upper_ends_are_there_by_default() -> None:
    """Where they take little beside the effort, for one horizon, and the same ones as if they were asked for."""

    def made(**options: Any) -> Any:
        return cg.synthesize("car-park-v0", 60, relation="linear", **options)

    by_default: Any = made().certificate
    assert by_default.gap == parked(60).gap and cg.check(by_default)
    for options in ({"above": False}, {"effort": 0.01}):
        assert made(**options).certificate.gap is None
    assert made(effort=0.01, above=True).certificate.gap == by_default.gap
    assert all(found.certificate.gap is None for found in made(horizon=[50, 60]))
    apart = two_agents("G !a & G !c", "finite-trace", horizon=4)
    both = cg.synthesize(apart, 30, relation="linear").certificate
    assert both.lower_bound <= both.upper_bound < 1.0 and cg.check(both)


def test_paths_have_no_upper_end() -> None:
    along: Any = cg.synthesize("integrator-chain-v0", relation="path", above=True).certificate
    assert along.gap is None and along.upper_bound == 1.0
