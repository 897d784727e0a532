"""Certificates of problems that name the time: below the truth and near it, checked by other code, and not forged."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.stats import binom

import certigym as cg
from balls import check_rigorous
from certigym.envs.tasks.problem import groups, unrolled_in_time
from certigym.synthesis.abstraction.models import AgentModel
from certigym.synthesis.certificates.proofs import PathProof, TimedProof, changed, timed_certificate
from certigym.synthesis.extended_check.steps import RegionSpan
from kinds import mostly_thorough
from timed_problems import band, best_probability, follow, robot, still

FALSE_ALARM = 1e-6
"""Probability that a test of rollouts fails although the claim is true."""

WAYS: dict[str, tuple[Callable[..., Any], Any, str, float]] = {
    "exact": (still, 80, "exact", 0.02),
    "linear": (still, 60, "linear", 0.02),
    "boxes": (still, 80, "boxes", 0.06),
    "path": (still, None, "path", 0.2),
    "written, linear": (robot, 60, "linear", 0.02),
    "written, boxes": (robot, 80, "boxes", 0.06),
    "written, path": (robot, None, "path", 0.2),
}
"""Agent, cells, relation, and how far below the best probability the bound may be."""


@cache
def certified(way: str, formula: str = "G band", shift: int = 0, drift: str = "") -> Any:
    """Return the certificate of one way; with a shift that of a region of another time, or of another drift."""
    make, cells, relation, _ = WAYS[way]
    agent = make(dynamics=[drift]) if drift else make()
    return cg.synthesize(follow(agent, band(shift), formula=formula), cells, relation=relation).certificate


def lies(bound: float, successes: int, episodes: int) -> bool:
    """Whether so few successes are next to impossible if the bound is true."""
    return bool(binom.cdf(successes, episodes, bound) < FALSE_ALARM)


@mostly_thorough("way", WAYS, first=2)
def test_bounds_are_below_the_truth_and_near_it(way: str) -> None:
    certificate = certified(way)
    best, spare = best_probability(certificate.problem), 5e-3  # what the dense program is off by
    assert best - WAYS[way][3] <= certificate.lower_bound <= best + spare
    assert cg.check(certificate)
    rollouts = cg.rollout(certificate.problem, certificate.controller, 4000, seed=1)
    assert not lies(certificate.lower_bound, int(np.sum(rollouts.success)), 4000)


def test_a_task_that_may_be_done_early_is_certified() -> None:
    agent = still(initial_state=[-3.5], input_low=[-0.5], input_high=[0.5])
    problem = follow(agent, formula="F band")
    certificate = cg.synthesize(problem, 100, relation="exact").certificate
    best = best_probability(problem)
    assert best - 0.02 <= certificate.lower_bound <= best + 5e-3
    assert cg.check(certificate) and certificate.gap is not None


@pytest.mark.thorough
def test_without_options_a_path_or_a_grid_is_chosen() -> None:
    calm = cg.synthesize(follow(still(noise_covariance=[[0.01]])))
    assert isinstance(calm.certificate.proof, PathProof) and calm.certificate.lower_bound > 0.99
    rough = cg.synthesize(follow(robot(), horizon=3), effort=2)
    assert isinstance(rough.certificate.proof, TimedProof) and cg.check(rough.certificate)
    assert {"path", "linear"} <= set(dict[str, Any](rough.stats)["tried"])


@mostly_thorough("way", ["exact", "written, boxes", "written, linear"])
def test_every_number_is_proved_in_balls(way: str) -> None:
    pytest.importorskip("flint")
    report = check_rigorous(certified(way))
    assert report and report.low >= certified(way).lower_bound


# --- sabotage --------------------------------------------------------------------------------------------------
def transplanted(forged: Any, problem: cg.Problem) -> Any:
    """Return a certificate that claims of a problem what another one claims of a problem like it."""
    proof = timed_certificate(problem, forged.proof.base).proof if forged.proof.parts else forged.proof
    return replace(forged, problem=problem, proof=proof)


@mostly_thorough("way", ["exact", "linear", "boxes", "written, linear", "written, boxes", "path",
                                 "written, path"], first=3)  # fmt: skip
def test_the_region_of_t_in_place_of_t_plus_one_is_refused(way: str) -> None:
    # In the forged proof every step is judged by where the region was before it.
    problem = certified(way).problem
    for shift in (-1, 1):
        forged = certified(way, shift=shift)
        assert cg.check(forged) and forged.lower_bound > 0.1
        assert not cg.check(transplanted(forged, problem))


def test_a_region_that_stands_still_is_that_of_the_problem() -> None:
    wide, narrow = (
        follow(still(), formula="G (band & hall)", hall=cg.Proposition("robot", [-side], [side])) for side in (2.5, 1.0)
    )
    honest = cg.synthesize(wide, 60, relation="exact").certificate
    assert cg.check(honest) and not cg.check(replace(honest, problem=narrow))


@pytest.mark.parametrize("way", ["written, linear", "written, boxes", "written, path"])
@mostly_thorough("drift", ["x + u + 0.4*sin(0.9*(t + 1))", "x + u + 0.4*sin(0.9*t*0)"])
def test_dynamics_of_another_step_are_refused(way: str, drift: str) -> None:
    if drift.endswith("*0)"):
        make, cells, relation, _ = WAYS[way]
        forged = cg.synthesize(follow(make(dynamics=["x + u + 0*t"])), cells, relation=relation).certificate
    else:
        forged = certified(way, drift=drift)
    report = cg.check(transplanted(forged, certified(way).problem))
    assert not report


@pytest.mark.parametrize("way", ["written, boxes", "written, linear"])
@pytest.mark.parametrize("forgery", ["one step for all", "the step after", "any step"])
def test_a_clock_that_is_not_the_time_is_refused(way: str, forgery: str) -> None:
    certificate = certified(way)
    (part,) = certificate.proof.base.proof.agents
    horizon, count = certificate.problem.horizon, len(part.relation["menu"]) // certificate.problem.horizon
    policy = part.policy.copy()
    for t in range(horizon):
        other = {"one step for all": 0, "the step after": min(t + 1, horizon - 1), "any step": (3 * t) % horizon}
        chosen = policy[t] >= 0
        policy[t][chosen] = policy[t][chosen] % count + other[forgery] * count
    forged = changed(certificate, base=changed(certificate.proof.base, agents=(replace(part, policy=policy),)))
    report = cg.check(forged)
    assert not report and "clock is not the time" in str(report)


@pytest.mark.parametrize("way", ["exact", "written, boxes"])
def test_masks_of_one_step_for_all_are_refused(way: str) -> None:
    certificate = certified(way)
    base = certificate.proof.base
    (part,) = base.proof.agents
    sizes = part.masks.sum(axis=1)
    # Every guard lets through what the widest of them does.
    masks = np.repeat(part.masks[[int(sizes.argmax())]], len(part.masks), axis=0)
    forged = changed(certificate, base=changed(base, agents=(replace(part, masks=masks),)))
    assert not cg.check(forged)


def test_a_bound_that_is_a_little_too_large_is_refused() -> None:
    for way in ("exact", "written, boxes", "written, linear"):
        certificate = certified(way)
        base = changed(certificate.proof.base, lower_bound=certificate.lower_bound + 1e-6)
        assert not cg.check(changed(certificate, base=base))
    for way in ("path", "written, path"):
        certificate = certified(way)
        assert not cg.check(changed(certificate, failure=certificate.proof.failure * 0.999))


def test_certificates_of_other_kinds_do_not_pass_for_problems_in_time() -> None:
    certificate = certified("exact")
    assert not cg.check(replace(certificate.proof.base, problem=certificate.problem))
    along = cg.synthesize(follow(still(noise_covariance=[[0.01]])), relation="path").certificate
    assert not cg.check(replace(along, problem=follow(still(noise_covariance=[[0.01]]), band(2))))


def test_corners_are_enclosed_by_intervals_of_the_check() -> None:
    region = cg.Proposition("robot", ["2*sin(0.37*t)*exp(-t/9) - 0.1"], ["sqrt(t + 2) + 0.3*atan(t)"])
    for t in range(60):
        span, at = RegionSpan.of(region, t), region.at(t)
        for ends, corner in ((span.low, at.low), (span.high, at.high)):
            assert np.all(ends[0] <= corner) and np.all(corner <= ends[1])
            assert np.all(ends[1] - ends[0] < 1e-11)
    assert RegionSpan.of(cg.Proposition("robot", ["3 - t"], [2]), 0).is_empty


# --- refusals --------------------------------------------------------------------------------------------------
REFUSALS: dict[str, tuple[Callable[[], Any], str]] = {
    "no deadline": (lambda: cg.synthesize(follow(robot()), horizon=None), "the same at every step"),
    "stationary": (lambda: cg.synthesize(follow(robot()), 30, search=cg.SearchOptions(stationary=True)), "stationary"),
    "exact targets": (lambda: cg.synthesize(follow(robot()), 30, relation="exact"), "`linear`, `boxes` or `path`"),
    "coupled": (lambda: cg.synthesize(follow(robot()), 30, relation="paper"), "name the time|`t`"),
    "models": (lambda: cg.abstract(follow(still()), 30), "the same at every step"),
    "a rate": (lambda: cg.safety_rate(certified("exact")), "names the time"),
}


@pytest.mark.parametrize("what", REFUSALS)
def test_what_is_not_certified_is_refused_in_words(what: str) -> None:
    ask, words = REFUSALS[what]
    with pytest.raises(ValueError, match=words):
        ask()


def test_horizons_are_certified_one_by_one() -> None:
    results = cg.synthesize(follow(still()), 40, horizon=[2, 4], relation="exact")
    assert [r.certificate.problem.horizon for r in results] == [2, 4]
    assert all(cg.check(r.certificate) for r in results)
    assert results[0].certificate.lower_bound > results[1].certificate.lower_bound


# --- teams -----------------------------------------------------------------------------------------------------
@pytest.mark.thorough
def test_teams_of_both_kinds_are_certified_together() -> None:
    agents = robot("first"), still("second", initial_state=[-1.0])
    problem = cg.Problem(
        name="both", horizon=4, agents=agents,
        propositions={"band": band(name="first"), "gate": cg.Proposition("second", ["2 - 0.5*t"], [4])},
        specification=cg.Specification("(band U gate)", "co-safe"),
    )  # fmt: skip
    for cells, relation in ((40, {"first": "boxes", "second": "exact"}), (30, "linear"), (None, "path")):
        certificate = cg.synthesize(problem, cells, relation=relation).certificate
        assert cg.check(certificate) and certificate.lower_bound > 0.5
        rollouts = cg.rollout(problem, certificate.controller, 2000, seed=2)
        assert not lies(certificate.lower_bound, int(np.sum(rollouts.success)), 2000)


@pytest.mark.thorough
def test_what_else_changes_with_time_is_certified() -> None:
    wind = robot(dynamics=["x + u + gust*cos(t)"], disturbances={"gust": [-0.1, 0.1]})
    noisy = robot(dynamics=["x + u"], noise=[{"law": "gaussian", "std": 1.0}], noise_scale=["0.1 + 0.2*exp(-t/3)"])
    pulled = robot(dynamics=["0.98*x + 0.02*leader.x + u + 0.1*t"])
    told = cg.Problem(
        name="told", horizon=4, agents=[robot("leader"), pulled], propositions={"band": band()},
        specification=cg.Specification("G band", "finite-trace"),
    )  # fmt: skip
    for problem in (follow(wind), follow(noisy), told):
        for cells, relation in ((80, "boxes"), (None, "path")):
            certificate = cg.synthesize(problem, cells, relation=relation).certificate
            assert cg.check(certificate), (problem.name, relation)
            report = cg.validate(certificate, 2000, seed=3)
            assert report.verdict != "refuted"


@pytest.mark.thorough
def test_independent_tasks_in_time_are_certified_one_by_one(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(groups, "MOST_STATES", 0)
    region = cg.Proposition("d_*", ["sin(t) - 1.4"], ["sin(t) + 1.4"])
    fleet = cg.Problem(
        name="fleet", horizon=4, agents=still("d").copies(6), propositions={"safe": region, "home": region},
        specification=cg.Specification(
            " & ".join(f"F (safe_{k} & F home_{k})" for k in range(6)), "co-safe"
        ),
    )  # fmt: skip
    assert len(fleet.tasks) == 6
    result = cg.synthesize(fleet, 40, relation="exact")
    assert cg.check(result.certificate)
    cg.save(result.certificate, tmp_path / "fleet.npz")
    assert cg.check(tmp_path / "fleet.npz")
    assert cg.validate(result.certificate, 200, seed=0).verdict != "refuted"


def test_a_clock_that_is_free_would_claim_too_much(monkeypatch: pytest.MonkeyPatch) -> None:
    # Inputs are strong at even steps alone; a proof that may choose the time is strong at all of them.
    agent = robot(dynamics=["x + 0.5*(1 + cos(pi*t))*u"], noise=[{"law": "gaussian", "std": 0.4}])
    problem = follow(agent, cg.Proposition("robot", [-0.9], [0.9]))
    honest = cg.synthesize(problem, 80, relation="boxes").certificate
    monkeypatch.setattr(AgentModel, "offered", lambda self, time: (self.choices, 0))
    free = cg.synthesize(unrolled_in_time(problem), 80, relation="boxes").certificate
    assert cg.check(honest) and cg.check(free) and free.lower_bound > honest.lower_bound + 0.05
    forged = timed_certificate(problem, free)
    assert not cg.check(forged) and "clock is not the time" in str(cg.check(forged))
    rollouts = cg.rollout(problem, forged.controller, 4000, seed=0)
    assert lies(forged.lower_bound, int(np.sum(rollouts.success)), 4000)


def test_pairs_keep_apart_beside_regions_that_move() -> None:
    noise = {"noise": [{"law": "gaussian", "std": 0.1}]}
    agents = robot("first", **noise, initial_state=[-1.0]), robot("second", **noise, initial_state=[1.0])
    goal = cg.Proposition("first", ["-2 + 0.2*t"], ["0.2*t"])
    problem = cg.Problem(
        name="apart", horizon=5, agents=agents,
        propositions={"goal": goal, "near": cg.Pair(["first", "second"], [-0.6], [0.6])},
        specification=cg.Specification("G (goal & !near)", "finite-trace"),
    )  # fmt: skip
    certificate = cg.synthesize(problem, relation="path").certificate
    assert cg.check(certificate) and certificate.lower_bound > 0.99
    rollouts = cg.rollout(problem, certificate.controller, 2000, seed=2)
    assert not lies(certificate.lower_bound, int(np.sum(rollouts.success)), 2000)
    with pytest.raises(ValueError):
        cg.synthesize(problem, relation="exact")


def test_long_horizons_have_paths_alone() -> None:
    with pytest.raises(ValueError, match="relation `path`"):
        cg.synthesize(follow(still(), horizon=600), 30, relation="exact")
