"""Paths of agents whose noise is not Gaussian: moments, bounds, and what the check refuses."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.special import ndtri

import certigym as cg
from certigym.envs.systems.distributions import Law, Tail
from certigym.synthesis.certificates.proofs import PathProof, changed
from certigym.synthesis.checker.distributions import Envelope, read_distribution
from certigym.synthesis.checker.fields import Entry
from certigym.synthesis.trajectories.chance_constraints.nonlinear_model import NonlinearModel
from kinds import mostly_thorough

FALSE_ALARM = 1e-6
"""Probability that a test of rollouts fails although the claim is true."""

LAWS: dict[str, dict[str, Any]] = {
    "uniform": {"law": "uniform", "low": -0.1, "high": 0.1},
    "uniform with a mean": {"law": "uniform", "low": 0.0, "high": 0.2},
    "even triangle": {"law": "triangular", "low": -0.2, "mode": 0.0, "high": 0.2},
    "uneven triangle": {"law": "triangular", "low": -0.05, "mode": -0.05, "high": 0.15},
    "cut evenly": {"law": "truncated-gaussian", "spread": 0.1, "low": -0.15, "high": 0.15},
    "cut unevenly": {"law": "truncated-gaussian", "spread": 0.1, "low": -0.05, "high": 0.2},
    "mixture": {
        "law": "mixture",
        "parts": [
            {"weight": 0.8, "mean": -0.02, "law": "gaussian", "std": 0.03},
            {"weight": 0.2, "mean": 0.08, "law": "uniform", "low": -0.05, "high": 0.05},
        ],
    },
}


def robot(law: dict[str, Any], **changes: Any) -> cg.Agent:
    given: dict[str, Any] = {
        "name": "robot", "states": ["x", "y"], "inputs": ["u", "v"], "dynamics": ["x + 0.8*u", "y + 0.8*sin(v)"],
        "noise": [law, {"law": "gaussian", "std": 0.03}], "state_low": [-4, -4], "state_high": [4, 4],
        "input_low": [-1, -1], "input_high": [1, 1], "initial_state": [-3, 0],
    }  # fmt: skip
    return cg.Agent(**given | changes)


def around(agent: Any, horizon: int = 12) -> cg.Problem:
    """Around a pillar to a dock."""
    regions = {
        "pillar": cg.Proposition("robot", low=[-1.0, -1.5], high=[1.0, 0.5]),
        "dock": cg.Proposition("robot", low=[2.0, -1.2], high=[3.6, 1.2]),
    }
    task = cg.Specification("!pillar U dock", "co-safe")
    return cg.Problem(name="laws", horizon=horizon, agents=[agent], propositions=regions, specification=task)


def law_of(data: dict[str, Any]) -> Law:
    laws = robot(data).laws
    assert laws is not None
    return laws[0]


def moments_of(law: Law) -> Envelope:
    """Return what the checker puts above a law."""
    return read_distribution(Entry(law.to_dict(), "law"))


@mostly_thorough("name", LAWS, first=2)
def test_normal_laws_are_above_the_exponential_moments(name: str) -> None:
    """Against sums over a million quantiles, at arguments up to six deviations; search and check say the same."""
    law = law_of(LAWS[name])
    found = moments_of(law)
    searched = law.envelope
    assert searched is not None and searched.tail == Tail.LIGHT
    np.testing.assert_allclose(searched[:2], (found.mean, found.deviation), rtol=1e-9, atol=1e-12)
    n = 10**6
    numbers = law.ppf_of_normal(ndtri((np.arange(n) + 0.5) / n))
    assert abs(numbers.mean() - found.mean) <= 1e-6
    for share in np.linspace(-6.0, 6.0, 13):
        a = share / found.deviation
        moment = float(np.mean(np.exp(a * (numbers - found.mean))))
        assert moment <= np.exp(0.5 * share * share) * (1.0 + 1e-6)


def test_even_laws_have_their_own_variance() -> None:
    """Uniform and even triangular laws: nothing is lost but the form of the tail."""
    for name in ("uniform", "even triangle"):
        law, found = law_of(LAWS[name]), moments_of(law_of(LAWS[name]))
        np.testing.assert_allclose(found.deviation, law.std, rtol=1e-9)


@mostly_thorough("name", LAWS)
def test_certificates_are_valid_and_below_their_rollouts(name: str) -> None:
    problem = around(robot(LAWS[name]))
    result = cg.synthesize(problem, relation="path")
    assert result.certificate.lower_bound > 0.9
    assert cg.check(result.certificate, problem)
    rate = cg.validate(result, 20_000, seed=3, confidence=1.0 - FALSE_ALARM)
    assert rate.ci_high >= result.certificate.lower_bound


def test_noise_may_be_scaled_and_agents_linear() -> None:
    scaled = around(robot(LAWS["uniform"], noise_scale=["0.5 + 0.1*abs(x)", "1"]))
    axes = np.array([[0.8, 0.6], [-0.6, 0.8]])
    linear = cg.LinearAgent(
        name="robot", A=np.eye(2), B=0.8 * np.eye(2), noise=[LAWS["uniform"], LAWS["uneven triangle"]], noise_axes=axes,
        state_low=[-4, -4], state_high=[4, 4], input_low=[-1, -1], input_high=[1, 1], initial_state=[-3, 0],
    )  # fmt: skip
    for problem in (scaled, around(linear)):
        result = cg.synthesize(problem, relation="path")
        assert result.certificate.lower_bound > 0.9
        assert cg.check(result.certificate, problem)
        rate = cg.validate(result, 20_000, seed=4, confidence=1.0 - FALSE_ALARM)
        assert rate.ci_high >= result.certificate.lower_bound


LONG: dict[str, dict[str, Any]] = {
    "laplace": {"law": "laplace", "scale": 0.02},
    "logistic": {"law": "logistic", "scale": 0.02},
    "student-t": {"law": "student-t", "scale": 0.01, "df": 4.0},
    "mixture with laplace": {
        "law": "mixture",
        "parts": [
            {"weight": 0.3, "mean": -0.02, "law": "laplace", "scale": 0.02},
            {"weight": 0.7, "mean": 0.01, "law": "gaussian", "std": 0.03},
        ],
    },
}


@mostly_thorough("name", LONG)
def test_laplace_laws_are_above_heavier_exponential_moments(name: str) -> None:
    """Against sums over a million quantiles, without the rarest noise where it is given up; search and check agree."""
    law = law_of(LONG[name])
    found, searched = moments_of(law), law.envelope
    assert searched is not None and searched.tail == Tail.LONG
    np.testing.assert_allclose((found.mean, found.deviation), searched[:2], rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(found.lost, searched.lost, rtol=1e-4)
    n = 10**6
    numbers = law.ppf_of_normal(ndtri((np.arange(n) + 0.5) / n))
    # what is given up lies in both tails
    numbers = np.sort(numbers)[int(np.ceil(0.5 * found.lost * n)) : n - int(np.ceil(0.5 * found.lost * n))]
    assert abs(numbers.mean() - found.mean) <= 1e-6
    for share in np.linspace(-1.3, 1.3, 9):
        moment = float(np.mean(np.exp(share / found.deviation * (numbers - found.mean))))
        assert moment <= (1.0 + 1e-6) / (1.0 - 0.5 * share * share)


@mostly_thorough("name", LONG)
def test_paths_of_heavier_tails_are_valid_and_below_their_rollouts(name: str) -> None:
    problem = around(robot(LONG[name]))
    certificate = cg.synthesize(problem, relation="path").certificate
    assert isinstance(certificate.proof, PathProof) and certificate.lower_bound > 0.9
    assert cg.check(certificate, problem)
    rate = cg.validate(certificate, 20_000, seed=3, confidence=1.0 - FALSE_ALARM)
    assert rate.ci_high >= certificate.lower_bound
    # The same numbers for wider noise, and with a smaller failure.
    wider = around(robot({**LONG[name], "scale": 0.05} if "scale" in LONG[name] else LONG["laplace"] | {"scale": 0.1}))
    assert not cg.check(replace(certificate, problem=wider), wider)
    assert not cg.check(changed(certificate, failure=0.9 * certificate.proof.failure), problem)


@pytest.mark.usefixtures("search_alone")
@pytest.mark.parametrize("tail", [Tail.NORMAL, Tail.LIGHT])
def test_lighter_tails_than_those_of_the_noise_are_refused(tail: Tail, monkeypatch: pytest.MonkeyPatch) -> None:
    """A search that takes Laplace noise for lighter noise claims more than the check proves."""
    monkeypatch.setattr(NonlinearModel, "tail", tail)
    problem = around(robot({"law": "laplace", "scale": 0.06}))
    claimed = cg.synthesize(problem, relation="path").certificate
    assert claimed.lower_bound > 0.0
    assert not cg.check(claimed, problem)


@pytest.mark.thorough
@pytest.mark.usefixtures("search_alone")
def test_noise_that_is_given_up_is_charged(monkeypatch: pytest.MonkeyPatch) -> None:
    """Heavy tails cost what they are cut by; a search that forgets it claims more than the check proves."""
    problem = around(robot({"law": "student-t", "scale": 0.002, "df": 5.0}, noise=[
        {"law": "student-t", "scale": 0.002, "df": 5.0}, {"law": "gaussian", "std": 0.001}]))  # fmt: skip
    honest = cg.synthesize(problem, relation="path").certificate
    assert isinstance(honest.proof, PathProof) and len(honest.proof.letters) > 2
    assert 1e-7 < honest.proof.failure < 2e-6
    assert cg.check(honest, problem)
    monkeypatch.setattr(NonlinearModel, "lost", 0.0)
    claimed = cg.synthesize(problem, relation="path").certificate
    assert isinstance(claimed.proof, PathProof) and claimed.proof.failure < honest.proof.failure
    assert not cg.check(claimed, problem)


def test_laws_without_moments_are_refused() -> None:
    """Nothing is known of the moments of a law of scipy."""
    problem = around(robot({"law": "scipy", "name": "gumbel_r", "scale": 0.02, "cdf_error": 1e-9, "variation": 40.0}))
    with pytest.raises(ValueError, match="exponential moments are known, got scipy"):
        cg.synthesize(problem, relation="path")
    light = cg.synthesize(around(robot(LAWS["uniform"])), relation="path").certificate
    assert isinstance(light.proof, PathProof)
    report = cg.check(replace(light, problem=problem), problem)
    assert not report and "a distribution of scipy" in str(report)


def test_paths_of_another_law_are_refused() -> None:
    """A mean against which no feedback helps, wider laws, and a smaller failure than is proved."""
    honest = cg.synthesize(around(robot(LAWS["uniform"])), relation="path").certificate
    assert isinstance(honest.proof, PathProof)
    driven = {"law": "uniform", "low": 0.3, "high": 0.5}
    for law in (driven, LAWS["even triangle"], LAWS["mixture"]):
        other = around(robot(law))
        assert not cg.check(replace(honest, problem=other), other)
    assert not cg.check(changed(honest, failure=0.9 * honest.proof.failure), honest.problem)


@pytest.mark.thorough
@pytest.mark.usefixtures("search_alone")
def test_gaussian_tails_for_other_noise_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """A search that takes the noise for Gaussian claims more than the check proves."""
    monkeypatch.setattr(NonlinearModel, "tail", Tail.NORMAL)
    problem = around(robot({"law": "uniform", "low": -0.5, "high": 0.5}))
    claimed = cg.synthesize(problem, relation="path").certificate
    assert not cg.check(claimed, problem)
