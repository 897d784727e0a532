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
from certigym.synthesis.extended_check.claims import invariance_rate
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
