"""Agents of a team may be on grids while others follow paths: letters, drifts and pairs between them are charged."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.stats import multivariate_normal

import certigym as cg
from certigym.envs.problem import Specification
from certigym.synthesis import mixed_teams
from certigym.synthesis.cells import RelationRefused
from certigym.synthesis.certificates import Certificate, MixedProof, changed
from certigym.synthesis.checking.mixed_check import _least_determinant, _Side
from certigym.synthesis.choosing import Effort
from certigym.synthesis.models import Settings
from certigym.synthesis.on_cells import Plan
from certigym.synthesis.path_checking import Whereabouts
from certigym.synthesis.search import Search
from certigym.synthesis.synthesize import ways_ahead
from deployed import problem_of
from kinds import mostly_thorough
from small_problems import small_spec

FALSE_ALARM = 1e-6

HORIZON = 6


def crane(**other: Any) -> cg.LinearAgent:
    """One state, one input: for a grid."""
    given = {"A": [[1.0]], "B": [[0.9]], "noise_covariance": [[0.04]], "state_low": [0.0], "state_high": [6.0],
             "input_low": [-1.0], "input_high": [1.0], "initial_state": [1.0]}  # fmt: skip
    return cg.LinearAgent(**{"name": "crane", **given, **other})


def car(**other: Any) -> cg.Agent:
    """A unicycle, whose heading bends where it is: for a path."""
    given = {
        "states": ["x", "y", "heading"], "inputs": ["turn", "pace"],
        "dynamics": ["x + 0.5*pace*cos(heading)", "y + 0.5*pace*sin(heading)", "heading + 0.5*turn"],
        "noise_covariance": np.diag([0.01, 0.0025, 0.01]),
        "state_low": [-1.0, -3.0, -3.0], "state_high": [8.0, 3.0, 3.0], "input_low": [-1.0, 0.0],
        "input_high": [1.0, 2.0], "initial_state": [2.2, 0.0, 0.0],
    }  # fmt: skip
    return cg.Agent(**{"name": "car", **given, **other})


REGIONS = {
    "unloaded": cg.Proposition("crane", [3.5], [5.0]),
    "home": cg.Proposition("car", [4.5, -2.0, -3.0], [6.5, 2.0, 3.0]),
    "clash": cg.Pair(["crane", "car"], [-0.7], [0.7], outputs=[[0], [0]]),
}


def team(formula: str = "F unloaded & F home & G !clash", semantics: str = "finite-trace", **other: Any) -> cg.Problem:
    given = {"name": "yard", "horizon": HORIZON, "agents": [crane(), car()], "propositions": REGIONS}
    return cg.Problem(**{**given, **other}, specification=Specification(formula=formula, semantics=semantics))


def mixed(problem: cg.Problem) -> Certificate[MixedProof]:
    found: Any = cg.synthesize(problem, {"crane": 24}, relation="mixed").certificate
    assert isinstance(found.proof, MixedProof)
    return found


@pytest.fixture(scope="module")
def certificate() -> Certificate[MixedProof]:
    return mixed(team())


def test_a_mixed_team_is_certified_checked_kept_and_met_by_rollouts(
    certificate: Certificate[MixedProof], tmp_path: Path
) -> None:
    report = cg.check(certificate)
    assert report.valid and certificate.lower_bound <= report.recomputed <= certificate.lower_bound + 1e-4
    assert (
        0.9 < certificate.lower_bound < 0.999
        and certificate.proof.near > 1e-4
        and certificate.proof.paths.proof.failure > 1e-5
    )
    cg.save(certificate, tmp_path / "team.npz")
    again: Any = cg.load(tmp_path / "team.npz")
    assert cg.check(again, team()) and again.lower_bound == certificate.lower_bound
    rate = cg.validate(again, 20_000, seed=1, confidence=1.0 - FALSE_ALARM)
    assert rate.verdict != "refuted"
    assert "mixed team" in str(rate) and "on grids" in repr(certificate)


def test_one_world_moves_like_many(certificate: Certificate[MixedProof]) -> None:
    """In an environment the controllers give the inputs of batches."""
    env = cg.parallel_env(certificate.problem)
    observations, infos = env.reset(seed=3)
    certificate.controller.reset(observations, infos)
    for _ in range(3):
        plain = certificate.controller.act(observations)
        told = certificate.controller.act(observations, infos)
        assert all(np.allclose(plain[name], told[name], atol=1e-5) for name in plain)
        observations, _, _, _, infos = env.step(told)
    with pytest.raises(ValueError, match="expected agents of problem"):
        certificate.controller.act({"stranger": np.zeros(4)})


SABOTAGES = {
    "box not widened": lambda outputs, drifts, spread: (outputs, 0.0 * drifts, spread),
    "covariance of the step before": lambda outputs, drifts, spread: (outputs, drifts, np.roll(spread, 1, axis=0)),
    "conditioned on the tube": lambda outputs, drifts, spread: (outputs, drifts, 0.8 * spread),
    "nominal values of the step after": lambda outputs, drifts, spread: (np.roll(outputs, -1, axis=0), drifts, spread),
}


@mostly_thorough("name", SABOTAGES, first=2)
def test_a_charge_that_is_too_small_is_refused_by_the_check(
    name: str, certificate: Certificate[MixedProof], paths: tuple[Any, list[Any]], monkeypatch: pytest.MonkeyPatch
) -> None:
    def sabotaged(*_: Any) -> Any:
        return paths[0], [SABOTAGES[name](*one) for one in paths[1]]

    monkeypatch.setattr(mixed_teams, "certified_paths", sabotaged)
    # The search would notice: it asks the check what pairs spoil.
    monkeypatch.setattr(mixed_teams, "agreed_mixed", lambda certificate: certificate)
    forged = mixed(team())
    report = cg.check(forged)
    assert not report.valid and "pairs spoil" in str(report)


@pytest.mark.thorough
@pytest.mark.parametrize("seed", [22, 46])
def test_no_less_is_taken_off_than_the_check_takes_off(seed: int) -> None:
    """Search and check enclose how paths bend by code of their own: here the search's drifts are smaller."""
    spec = small_spec("mixed", seed)
    certificate = cg.synthesize(problem_of(spec), **spec["options"]).certificate
    assert type(certificate.proof) is MixedProof and cg.check(certificate)


@pytest.fixture(scope="module")
def paths(certificate: Certificate[MixedProof]) -> tuple[Any, list[Any]]:
    found = []

    def noted(*arguments: Any) -> Any:
        found.append(honest(*arguments))
        return found[-1]

    honest = mixed_teams.certified_paths
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(mixed_teams, "certified_paths", noted)
        assert mixed(team()).lower_bound == certificate.lower_bound, "deterministic"
    return found[0]


@pytest.mark.thorough
def test_what_is_left_out_of_a_part_is_refused_by_the_check(certificate: Certificate[MixedProof]) -> None:
    """The slabs of paths, letters, the task of those on grids, agents, regions, pairs taken otherwise."""
    paths, grids = certificate.proof.paths, certificate.proof.grids
    certain = changed(certificate, paths=changed(paths, failure=0.0))
    assert certain.lower_bound > certificate.lower_bound and "along paths" in str(cg.check(certain))
    open_letters = changed(certificate, paths=changed(paths, letters=0 * paths.proof.letters))
    assert "accepted where the task is not" in str(cg.check(open_letters))
    assert not cg.check(changed(certificate, usual=(True,)))
    easy = mixed(team("F home & G !clash"))
    assert cg.check(easy)
    assert not cg.check(changed(certificate, grids=easy.proof.grids))
    other = mixed(team(propositions={**REGIONS, "unloaded": cg.Proposition("crane", [2.0], [5.0])}))
    assert "region" in str(cg.check(changed(certificate, grids=other.proof.grids)))
    strong = mixed(team(agents=[crane(input_low=[-3.0], input_high=[3.0]), car()]))
    assert "is not that of the problem" in str(cg.check(changed(certificate, grids=strong.proof.grids)))
    assert not cg.check(changed(certificate, near=0.5 * certificate.proof.near))
    assert grids.problem.horizon == HORIZON


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("formula", "semantics"),
    [("F (unloaded & F home)", "co-safe"), ("!home U unloaded", "co-safe"), ("F G unloaded & F home", "finite-trace")],
)
def test_tasks_that_tie_both_kinds_of_agents_are_certified(formula: str, semantics: str) -> None:
    """Letters of paths are read by the automaton at their times, and what they leave open in both ways."""
    propositions = {name: REGIONS[name] for name in ("unloaded", "home")}
    problem = team(formula, semantics, propositions=propositions)
    found = mixed_teams.mixed_certificate(
        problem, {"crane": 24}, Plan(Settings(), Search(), None, Effort())
    ).certificate
    report = cg.check(found)
    assert report.valid and found.lower_bound > 0.3
    rate = cg.validate(found, 10_000, seed=2, confidence=1.0 - FALSE_ALARM)
    assert rate.verdict != "refuted" and rate.estimate >= found.lower_bound - 0.01


def test_a_mixed_team_is_a_way_by_default() -> None:
    """With pairs it stands beside paths, subtraction and joint agents; without them beside the path of the team."""
    four = cg.LinearAgent(
        name="car", A=np.eye(4), B=np.eye(4)[:, :2], noise_covariance=0.01 * np.eye(4), state_low=[-5.0] * 4,
        state_high=[9.0] * 4, input_low=[-1, -1], input_high=[1, 1], initial_state=[2.2, 0.0, 0.0, 0.0],
    )  # fmt: skip
    home = cg.Proposition("car", [3.0, -3.0, -3.0, -3.0], [8.0, 3.0, 3.0, 3.0])
    for formula, agents in (
        ("F unloaded & F home & G !clash", [crane(), car()]),
        ("F (unloaded & home)", [crane(), four]),
    ):
        regions = {**REGIONS, **({} if "clash" in formula else {"home": home})}
        kept = {name: region for name, region in regions.items() if name in formula}
        ((_, ways),) = list(ways_ahead(team(formula, agents=agents, propositions=kept)))
        assert [way.refusal for way in ways if way.name == "mixed"] == [""]


@pytest.mark.parametrize("correlation", [0.0, 0.4, -0.9])
def test_bounds_on_being_near_are_above_the_truth(correlation: float) -> None:
    """Two outputs, against a multivariate normal law: exact without correlation, above it with one."""
    spread = np.array([[0.04, correlation * 0.06], [correlation * 0.06, 0.09]])
    noise, drift, centre = np.array([0.01, 0.02]), np.array([0.05, 0.0]), np.array([0.3, -0.2])
    place = Whereabouts(np.stack([centre, centre]), drift, spread, np.zeros((2, 2)))
    problem = cg.Problem(
        name="two", horizon=1, agents=[flat("a"), flat("b")],
        propositions={"near": cg.Pair(["a", "b"], [-0.5, -0.4], [0.5, 0.4])},
        specification=Specification(formula="G !near", semantics="finite-trace"),
    )  # fmt: skip
    pair, lattice = problem.labeling.pairs[0], np.linspace(-1.0, 1.0, 5)
    bounds = _Side(pair, 1.0, False, place).bounds([lattice, lattice], noise)
    for i, j in np.ndindex(5, 5):
        mean = np.array([lattice[i], lattice[j]]) - centre
        law = multivariate_normal(mean, spread + np.diag(noise))
        truth = law.cdf([0.55, 0.4], lower_limit=[-0.55, -0.4])
        assert bounds[i, j] >= truth - 1e-6
        assert correlation or bounds[i, j] <= truth + 1e-6
    far = _Side(pair, 1.0, True, place).bounds([lattice, lattice], noise)
    law = multivariate_normal(np.array([lattice[2], lattice[2]]) - centre, spread + np.diag(noise))
    assert far[2, 2] >= 1.0 - law.cdf([0.45, 0.4], lower_limit=[-0.45, -0.4]) - 1e-6


def flat(name: str) -> cg.LinearAgent:
    return cg.LinearAgent(
        name=name, A=np.eye(2), B=np.eye(2), noise_covariance=0.01 * np.eye(2), state_low=[-5, -5], state_high=[5, 5],
        input_low=[-1, -1], input_high=[1, 1], initial_state=[0.0, 0.0],
    )  # fmt: skip


def test_determinants_are_bounded_from_below() -> None:
    rng = np.random.default_rng(0)
    for p in (1, 2, 3):
        root = rng.standard_normal((p, p))
        matrix = root @ root.T
        truth, off = float(np.linalg.det(matrix)), np.full((p, p), 1e-3)
        assert _least_determinant(matrix, 0.0 * off) == pytest.approx(truth, rel=1e-9)
        for _ in range(20):
            moved = matrix + off * rng.choice([-1.0, 1.0], (p, p))
            assert _least_determinant(matrix, off) <= float(np.linalg.det(moved)) + 1e-12


def test_what_a_mixed_team_is_not_for_is_said(certificate: Certificate[MixedProof]) -> None:
    alike = team("F unloaded & G !clash", agents=[crane(), crane(name="car")],
                 propositions={name: REGIONS[name] for name in ("unloaded", "clash")})  # fmt: skip
    with pytest.raises(RelationRefused, match="not for grids, but all are"):
        cg.synthesize(alike, relation="mixed")
    lifts = cg.Agent(name="crane", states=["at"], inputs=["pull"], dynamics=["at + 0.9*pull"],
                     noise_covariance=[[0.04]], state_low=[0.0], state_high=[6.0], input_low=[-1.0], input_high=[1.0],
                     initial_state=[1.0])  # fmt: skip
    told = car(dynamics=["x + 0.5*pace*cos(heading) + 0.01*crane.at", "y", "heading + 0.5*turn"])
    with pytest.raises(RelationRefused, match="name agents of the other kind"):
        cg.synthesize(team(agents=[lifts, told]), relation="mixed")
    with pytest.raises(ValueError, match="mixed team"):
        certificate.at(np.zeros(4))
