"""Verbs that compute another guarantee from a certificate check it first: a forged one gives no number."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import certigym as cg
from certigym.synthesis.certificates.proofs import changed
from certigym.synthesis.extended_check.claims import invariance_rate, standing
from certigym.synthesis.extended_check.shields import shield_of
from problems import scalar_agent


def lasting() -> cg.Certificate:
    """One agent that noise drives out of its interval, with stationary policies."""
    problem = cg.Problem(
        name="drift",
        horizon=12,
        agents=[scalar_agent("a", A=[[0.8]], input_low=[-0.6], input_high=[0.6], noise_covariance=[[0.5]])],
        propositions={"safe": cg.Proposition("a", [-2.0], [2.0])},
        specification=cg.Specification("G safe", "finite-trace"),
    )
    return cg.synthesize(problem, 40, relation="exact", search=cg.SearchOptions(stationary=True)).certificate


@pytest.fixture(scope="module")
def safe() -> cg.Certificate:
    return lasting()


@pytest.fixture(scope="module")
def exact() -> cg.Certificate:
    return cg.synthesize(cg.make_problem("reach-avoid-v0", horizon=4), 40, relation="exact").certificate


def with_other_targets(certificate: cg.Certificate) -> cg.Certificate:
    """Every cell aims at the middle of the workspace, which no input of the box reaches from most of them."""
    parts = []
    for part in certificate.proof.agents:
        middle = int(np.argmin(np.abs(part.lattice[0])))
        parts.append(replace(part, policy=np.full_like(part.policy, middle)))
    return changed(certificate, agents=tuple(parts))


def with_other_guards(certificate: cg.Certificate) -> cg.Certificate:
    """Every cell counts as if every letter were certain in it."""
    parts = [
        replace(part, masks=np.ones_like(part.masks), start_masks=np.ones_like(part.start_masks))
        for part in certificate.proof.agents
    ]
    return changed(certificate, agents=tuple(parts))


@pytest.mark.parametrize("forge", [with_other_targets, with_other_guards])
def test_rates_of_forged_certificates_are_refused(
    forge: Callable[[Any], Any], safe: cg.Certificate, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Sabotage: grown by the code of the check alone, the forged certificate would have a rate that is too large."""
    honest, forged = cg.safety_rate(safe), forge(safe)
    file = tmp_path / "forged.npz"
    cg.save(forged, file)
    for given in (forged, file):
        with pytest.raises(ValueError, match="`check` verifies, got one that it refuses"):
            cg.safety_rate(given)
    monkeypatch.setattr(invariance_rate, "standing", lambda certificate: certificate)
    assert cg.safety_rate(forged).rate > honest.rate


VERBS: dict[str, Callable[[Any], Any]] = {
    "a shield": lambda certificate: shield_of(certificate, 0.2),
    "values in time": cg.value_in_time,
}


@pytest.mark.parametrize("verb", VERBS)
def test_other_guarantees_from_forged_guards_are_refused(verb: str, exact: cg.Certificate) -> None:
    assert VERBS[verb](exact)
    with pytest.raises(ValueError, match="`check` verifies, got one that it refuses"):
        VERBS[verb](with_other_guards(exact))


def test_the_check_is_asked_once(exact: cg.Certificate, monkeypatch: pytest.MonkeyPatch) -> None:
    calls: list[Any] = []

    def counted(certificate: Any) -> Any:
        calls.append(certificate)
        return cg.check(certificate)

    fresh = replace(exact)
    monkeypatch.setitem(standing.__globals__, "check", counted)
    for _ in range(3):
        assert standing(fresh) is fresh
    assert len(calls) == 1
    with pytest.raises(ValueError, match="refuses"):
        standing(with_other_guards(exact))
    assert len(calls) == 2


def correlated(start: Any) -> cg.Certificate:
    """One agent with correlated noise, whose cells lie along other axes than its states."""
    agent = cg.LinearAgent(
        name="a", A=0.9 * np.eye(2), B=np.eye(2), noise_covariance=[[0.04, 0.02], [0.02, 0.05]],
        state_low=[-2.0, -2.0], state_high=[2.0, 2.0], input_low=[-0.5, -0.5], input_high=[0.5, 0.5],
        initial_state=[*start],
    )  # fmt: skip
    problem = cg.Problem(
        name="correlated",
        horizon=3,
        agents=[agent],
        propositions={"safe": cg.Proposition("a", [-1.5, -1.5], [1.5, 1.5])},
        specification=cg.Specification("G safe", "finite-trace"),
    )
    return cg.synthesize(problem, 24, relation="exact").certificate


def test_starts_on_a_face_that_rounding_decides_are_refused() -> None:
    """The controller and the check could stand in different cells; beside the face, and at 0, they cannot."""
    certificate = correlated([0.1, 0.2])
    assert cg.check(certificate)
    part = certificate.proof.agents[0]
    skewed = 1
    assert np.count_nonzero(part.coordinates[skewed]) == 2 and np.count_nonzero(part.coordinates[0]) == 1
    place = [part.grid.edges[0][14], part.grid.edges[skewed][14]]
    on_both = part.coordinates @ place
    forged = replace(certificate, problem=certificate.problem.replace(initial_state=on_both))
    report = cg.check(forged)
    assert not report and "lies on a face of cells to rounding" in report.failures[0]
    # The search keeps off such faces; a coordinate that is a state is read without rounding.
    assert cg.check(correlated(on_both))
    beside = part.coordinates @ [place[0], place[1] + 1e-6]
    assert cg.check(correlated(beside)) and cg.check(correlated([0.0, 0.0]))
