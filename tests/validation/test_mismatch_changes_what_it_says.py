"""Mismatches keep mean and covariance of the noise, move inputs and observations as they say, and bounds fall."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import certigym as cg
from certigym.envs.simulation import batch_simulator as core
from certigym.envs.simulation.batch_simulator import Dynamics
from certigym.synthesis.certificates.proofs import OnGrid, is_exact
from certigym.validation.statistical_tests.chunks import frames
from certigym.validation.statistical_tests.loop import Loop
from certigym.validation.statistical_tests.mismatch import FAMILIES, Mismatch, as_family, degraded, disturbed
from certigym.validation.statistical_tests.stress_test import stress
from problems import two_agents

LOUD: dict[str, Any] = {"noise_covariance": [[0.8]]}


@pytest.fixture(scope="module")
def certificate() -> OnGrid:
    return cg.synthesize(two_agents("F (a & F c)", horizon=4, **LOUD), 80, relation="exact").certificate


@pytest.mark.parametrize("family", FAMILIES)
def test_families_have_unit_variance_and_are_symmetric(family: str) -> None:
    """Quantiles on a fine grid of probabilities: no random numbers, errors of the grid only."""
    from scipy.special import ndtri

    z = ndtri((np.arange(400_000) + 0.5) / 400_000)
    x = as_family(z, family)
    assert abs(x.mean()) < 1e-9
    assert x.var() == pytest.approx(1.0, abs=5e-3)
    np.testing.assert_allclose(x, -x[::-1], atol=1e-9)
    assert np.all(np.diff(x) > 0)


def test_no_mismatch_is_no_change(certificate: OnGrid) -> None:
    plain = cg.rollout(certificate.problem, certificate.controller, 3000, seed=1)
    same = cg.rollout(certificate.problem, certificate.controller, 3000, seed=1, mismatch=Mismatch())
    np.testing.assert_array_equal(plain.success, same.success)
    assert plain.inadmissible == same.inadmissible == 0


def test_noise_scale_is_the_same_as_a_scaled_model(certificate: OnGrid) -> None:
    louder = certificate.problem.replace(disturbance_scale=1.5)
    a = cg.rollout(certificate.problem, certificate.controller, 5000, seed=1, mismatch=Mismatch(noise_scale=1.5))
    b = cg.rollout(louder, certificate.controller, 5000, seed=1)
    assert np.mean(a.success != b.success) < 1e-3  # rounding of the square root, nothing else


def test_bias_moves_inputs_and_saturates() -> None:
    dynamics = Dynamics.of(two_agents())
    (block,) = dynamics.blocks
    u = np.zeros((1, 2, 3))
    u[..., 1], u[..., 2] = 1.9, 7.0
    (moved,), _ = disturbed(dynamics, Mismatch(actuator_bias=0.25), [u], [np.zeros((1, 2, 3))])
    np.testing.assert_allclose(moved[0, 0], [0.5, 2.4, 2.5])  # half width 2; the dynamics saturate afterwards at 2
    assert block.input_high.max() == 2


class Echo:
    """A policy whose inputs are the states that it sees."""

    def begin(self, worlds: core.Worlds, rng: np.random.Generator) -> None: ...

    def act(self, worlds: core.Worlds, memory: None) -> tuple[tuple[np.ndarray, ...], None]:
        return worlds.states, None


@pytest.mark.parametrize("delay", [0, 1, 3])
def test_delayed_observations_lag(delay: int) -> None:
    dynamics, rng = Dynamics.of(two_agents(horizon=9)), np.random.default_rng(0)
    policy = degraded(Echo(), Mismatch(delay=delay), rng)
    worlds = [core.initial_at(dynamics, rng.normal(size=(4, 2))) for _ in range(8)]
    memory = policy.begin(worlds[0], rng)
    for t, now in enumerate(worlds):
        (seen,), memory = policy.act(now, memory)
        np.testing.assert_array_equal(seen, worlds[max(0, t - delay)].states[0])


def test_dropped_observations_hold_the_last_one() -> None:
    dynamics, rng = Dynamics.of(two_agents(horizon=9)), np.random.default_rng(0)
    policy = degraded(Echo(), Mismatch(dropout=0.5), np.random.default_rng(1))
    worlds = [core.initial_at(dynamics, rng.normal(size=(400, 2))) for _ in range(6)]
    memory, last = policy.begin(worlds[0], rng), worlds[0].states[0]
    for now in worlds:
        (seen,), memory = policy.act(now, memory)
        fresh = seen == now.states[0]
        assert np.all(fresh | (seen == last))
        last = seen
    assert 0.4 < fresh.mean() < 0.6
    silent = degraded(Echo(), Mismatch(dropout=1.0), np.random.default_rng(1))
    memory = silent.begin(worlds[0], rng)
    for now in worlds:
        (seen,), memory = silent.act(now, memory)
        np.testing.assert_array_equal(seen, worlds[0].states[0])


def test_inputs_beyond_the_box_saturate_and_are_counted(certificate: OnGrid) -> None:
    class Wild:
        def batch(self, dynamics: Dynamics) -> Any:
            return self

        def begin(self, worlds: core.Worlds, rng: np.random.Generator) -> None: ...

        def act(self, worlds: core.Worlds, memory: None) -> tuple[tuple[np.ndarray, ...], None]:
            return (np.full((1, 2, worlds.n_worlds), 50.0),), None

    runs = cg.rollout(certificate.problem, Wild(), 100)
    assert runs.inadmissible == 100
    dynamics = Dynamics.of(certificate.problem)
    loop = Loop(certificate.problem, Wild(), 0, 10)
    first, second = [f.worlds.states[0] for f in frames(loop, dynamics, Wild(), 0)][:2]
    assert np.all(np.abs(second - 0.9 * first - 0.5 * 2.0) < 8)  # not 0.5 * 50


def test_stress_reports_how_far_the_bound_survives(certificate: OnGrid) -> None:
    """False alarm 1e-6; 4,000 episodes tell .87 from .82."""
    rungs = {
        "noise scale": [Mismatch(noise_scale=s) for s in (1.001, 1.6, 3.0)],
        "delay": [Mismatch(delay=3)],
        "quiet": [Mismatch(noise_scale=0.3)],
    }
    report = stress(certificate, 4000, ladders=rungs, confidence=1 - 1e-6)
    assert report.survives("noise scale") == Mismatch(noise_scale=1.001)
    assert report.survives("delay") is None
    assert [rung.verdict for rung in report.rungs if rung.ladder == "quiet"] == ["confirmed"]
    assert abs(report.nominal - certificate.lower_bound) < 0.03
    data = report.to_dict()
    assert data["survives"]["noise scale"] == "noise_scale=1.001" and len(data["rungs"]) == 5
    assert "noise_scale=3.0" in str(report)


def test_under_a_mismatch_only_the_lower_bound_is_tested(certificate: OnGrid) -> None:
    assert is_exact(certificate)
    quiet = cg.validate(certificate, 4000, mismatch=Mismatch(noise_scale=0.3))
    assert quiet.verdict == "confirmed" and not quiet.exact
