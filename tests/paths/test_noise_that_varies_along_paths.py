"""Noise that grows with the state is certified by exponential moments, and by nothing that forgets how it grows."""

from __future__ import annotations

from functools import cache

import pytest

import certigym as cg
from certigym.synthesis.certificates.proofs import changed


@cache
def epidemic() -> cg.Synthesis:
    """Shares of susceptible and infected people, with noise that grows with the infected."""
    town = cg.Agent(
        name="town",
        states=["s", "i"],
        inputs=["distance"],
        dynamics=["s - 0.6*(1 - distance)*s*i", "i + 0.6*(1 - distance)*s*i - 0.25*i"],
        noise=[{"law": "gaussian", "std": 1.0}] * 2,
        noise_scale=["0.001 + 0.02*i", "0.001 + 0.03*i"],
        state_low=[0, -0.1],
        state_high=[1, 0.6],
        input_low=[0],
        input_high=[0.8],
        initial_state=[0.85, 0.12],
    )
    regions = {
        "crowded": cg.Proposition("town", of=["i"], low=[0.25], high=[0.6]),
        "calm": cg.Proposition("town", of=["i"], low=[-0.1], high=[0.05]),
    }
    problem = cg.Problem(
        name="epidemic",
        horizon=12,
        agents=[town],
        propositions=regions,
        specification=cg.Specification("!crowded U calm"),
    )
    return cg.synthesize(problem, relation="path", effort=15)


@pytest.mark.thorough
def test_an_epidemic_with_noise_that_grows_is_certified() -> None:
    certificate = epidemic().certificate
    assert certificate.lower_bound > 0.999
    assert cg.check(certificate)
    assert cg.validate(certificate, 4000, seed=1).verdict in ("consistent", "confirmed")
    # A claim that is a little larger is refused.
    assert not cg.check(changed(certificate, failure=0.3 * (1.0 - certificate.lower_bound)))
