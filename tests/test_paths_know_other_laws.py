"""Paths of agents whose noise is not Gaussian, but below a normal law: moments, bounds, and what the check refuses."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.special import ndtri

import certigym as cg
from certigym.envs.agents import Law
from certigym.synthesis.certificates import PathCertificate
from certigym.synthesis.path_checking.gaussian_inequalities import Inequalities, light_tails
from certigym.synthesis.path_checking.law_moments import moments_of
from certigym.synthesis.path_checking.nonlinear_check import Noise

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


@pytest.mark.parametrize("name", LAWS)
def test_normal_laws_are_above_the_exponential_moments(name: str) -> None:
    """Against sums over a million quantiles, at arguments up to six deviations; search and check say the same."""
    law = law_of(LAWS[name])
    found = moments_of(law)
    assert found is not None and law.sub_gaussian is not None
    np.testing.assert_allclose(law.sub_gaussian, (found.mean, found.deviation), rtol=1e-9, atol=1e-12)
    n = 10**6
    numbers = law.from_normal(ndtri((np.arange(n) + 0.5) / n))
    assert abs(numbers.mean() - found.mean) <= 1e-6
    for share in np.linspace(-6.0, 6.0, 49):
        a = share / found.deviation
        moment = float(np.mean(np.exp(a * (numbers - found.mean))))
        assert moment <= np.exp(0.5 * share * share) * (1.0 + 1e-6)


def test_even_laws_have_their_own_variance() -> None:
    """Uniform and even triangular laws: nothing is lost but the form of the tail."""
    for name in ("uniform", "even triangle"):
        law, found = law_of(LAWS[name]), moments_of(law_of(LAWS[name]))
        assert found is not None
        np.testing.assert_allclose(found.deviation, law.std, rtol=1e-9)


@pytest.mark.parametrize("name", LAWS)
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


def test_tails_are_above_sums_of_uniform_numbers() -> None:
    """Twelve uniform numbers with weights, against a million draws."""
    rng, weights = np.random.default_rng(5), np.linspace(0.2, 1.0, 12)
    sums = rng.uniform(-1.0, 1.0, (10**6, 12)) @ weights
    variance = float(np.sum(weights**2)) / 3.0
    for distance in np.linspace(0.1, 4.0, 14) * np.sqrt(variance):
        tail = float(light_tails(np.array([distance]), np.array([variance]))[0])
        met = float(np.mean(sums > distance))
        assert tail >= met - 5.0 * np.sqrt(met / 1e6 + 1e-12)
    assert light_tails(np.array([-0.1, 0.0, np.inf]), np.array([1.0, 1.0, 1.0])).tolist() == [1.0, 1.0, 0.0]
    assert light_tails(np.array([0.1, -np.inf]), np.array([0.0, 0.0])).tolist() == [0.0, 1.0]


@pytest.mark.parametrize(
    "law",
    [
        {"law": "laplace", "scale": 0.02},
        {"law": "student-t", "scale": 0.02, "df": 5.0},
        {"law": "mixture", "parts": [{"weight": 1.0, "law": "logistic", "scale": 0.02}]},
    ],
)
def test_heavier_tails_are_refused(law: dict[str, Any]) -> None:
    problem = around(robot(law))
    with pytest.raises(ValueError, match="tails are below those of a normal law"):
        cg.synthesize(problem, relation="path")
    light = cg.synthesize(around(robot(LAWS["uniform"])), relation="path").certificate
    assert isinstance(light, PathCertificate)
    report = cg.check(replace(light, problem=problem), problem)
    assert not report and "no normal law" in str(report)


def test_paths_of_another_law_are_refused() -> None:
    """A mean that is forgotten, wider laws, and a smaller failure than is proved."""
    honest = cg.synthesize(around(robot(LAWS["uniform"])), relation="path").certificate
    assert isinstance(honest, PathCertificate)
    for name in ("uniform with a mean", "even triangle", "mixture"):
        other = around(robot(LAWS[name]))
        assert not cg.check(replace(honest, problem=other), other)
    assert not cg.check(replace(honest, failure=0.9 * honest.failure), honest.problem)


def test_gaussian_tails_for_other_noise_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """A search that takes the noise for Gaussian claims more than the check proves."""
    from certigym.synthesis.nominal_paths.nonlinear_model import NonlinearModel

    monkeypatch.setattr(NonlinearModel, "is_light", False)
    problem = around(robot({"law": "uniform", "low": -0.5, "high": 0.5}))
    claimed = cg.synthesize(problem, relation="path").certificate
    assert not cg.check(claimed, problem)


def test_the_check_reads_the_noise_itself() -> None:
    noise = Noise.of(robot(LAWS["uniform with a mean"]))
    assert noise.is_light
    np.testing.assert_allclose(noise.means, [0.1, 0.0])
    np.testing.assert_allclose(noise.deviations, [0.1 / np.sqrt(3.0), 0.03])
    rows = Inequalities(is_light=True)
    rows.add(np.array([0.3]), np.array([0.3]), np.array([np.inf]), np.array([0.01]))
    np.testing.assert_allclose(rows.failure(), 2.0 * np.exp(-4.5), rtol=1e-9)


def test_claims_are_proved_in_balls() -> None:
    pytest.importorskip("flint")
    for name in LAWS:
        result = cg.synthesize(around(robot(LAWS[name])), relation="path")
        report = cg.check_rigorous(result.certificate)
        assert report, str(report)
