"""Noise that grows with the state is certified by exponential moments, and by nothing that forgets how it grows."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

import certigym as cg
from certigym.synthesis.certificates import changed
from certigym.synthesis.path_bounds.exponential_moments import ExponentialMoments
from certigym.synthesis.path_bounds.limit_rows import Worth
from certigym.synthesis.path_checking.linear_deviations import Chain, Tilted

B, A, STEPS, RUNS, FALSE_ALARM_DEVIATIONS = 0.1, 0.2, 10, 400_000, 5.0
"""A number that walks with steps of the size ``B + A g``."""


def walks(far: float) -> tuple[np.ndarray, np.ndarray]:
    """Return where walks are at the end, and which were within ``far`` of 0 before."""
    rng = np.random.default_rng(5)
    g, kept = np.zeros(RUNS), np.ones(RUNS, dtype=bool)
    for _ in range(STEPS):
        kept &= np.abs(g) <= far
        g = g + (B + A * g) * rng.standard_normal(RUNS)
    return g, kept


def chain(square: float, tilt: float, far: float) -> Chain:
    """Return the walk as the check sees it, with squares below ``square + tilt g``."""
    result = Chain(np.ones(1), np.zeros(1))
    for _ in range(STEPS):
        tilted = Tilted(np.array([square]), np.array([[tilt]]), np.array([far]))
        result.advance(np.eye(1), np.zeros(1), np.zeros(1), np.array([[(B + A * far) ** 2]]), tilted)
    return result


@pytest.mark.parametrize("far", [1.0, 1.3])
def test_tails_hold_of_walks_and_would_not_without_tilts(far: float) -> None:
    ends, kept = walks(far)
    distances = np.array([0.8, 1.1, 1.4])

    def bounds(square: float, tilt: float) -> tuple[np.ndarray, np.ndarray]:
        found = chain(square, tilt, far)
        sides = [found.exponential_tails(np.ones((1, 1)), np.array([d]), np.array([d])) for d in distances]
        return np.array([low[0] for low, _ in sides]), np.array([high[0] for _, high in sides])

    seen = [np.array([np.mean(kept & (sign * ends >= d)) for d in distances]) for sign in (-1.0, 1.0)]
    least = [p - FALSE_ALARM_DEVIATIONS * np.sqrt(p / RUNS) for p in seen]
    below, above = bounds(B**2 + (A * far) ** 2, 2.0 * A * B)
    assert np.all(below >= least[0]) and np.all(above >= least[1])
    # Better than the largest scale all the time, below more than above.
    largest = 2.0 * np.exp(-(distances**2) / (2.0 * STEPS * (B + A * far) ** 2))
    assert np.all(below < largest) and np.all(above < largest) and np.all(below < above)
    # The nominal scale alone is refuted.
    assert np.any(bounds(B**2, 0.0)[1] < least[1])


def test_search_and_check_compute_the_same_tails() -> None:
    far, d = 0.6, np.array([0.5])
    moments, worth = ExponentialMoments(1, 1), Worth()
    for _ in range(STEPS):
        scale = (np.array([[B]]), np.zeros((1, 1)), np.array([[A * far]]), np.array([[[A]]]))
        moments.tilt(scale, np.ones(1), np.array([[np.inf]]))
        moments.advance(np.eye(1)[None])
    worth.add(d[None], d[None], np.array([[np.inf]]), np.ones((1, 1)), ["row"])
    moments.ask(0, STEPS, np.eye(1))
    moments.bound(worth, np.array([True]))
    found = chain(B**2 + (A * far) ** 2, 2.0 * A * B, far).exponential_tails(np.ones((1, 1)), d, d)
    np.testing.assert_allclose([worth.below[0][0, 0], worth.above[0][0, 0]], np.ravel(found), rtol=0.05)


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


@pytest.mark.slow
def test_an_epidemic_with_noise_that_grows_is_certified() -> None:
    certificate = epidemic().certificate
    assert certificate.lower_bound > 0.999
    assert cg.check(certificate)
    assert cg.validate(certificate, 4000, seed=1).verdict in ("consistent", "confirmed")
    # A claim that is a little larger is refused.
    assert not cg.check(changed(certificate, failure=0.3 * (1.0 - certificate.lower_bound)))


def test_the_largest_scale_alone_would_certify_less(monkeypatch: pytest.MonkeyPatch) -> None:
    certificate = changed(epidemic().certificate, failure=1.0)
    with_moments = cg.check(certificate).recomputed
    monkeypatch.setattr(
        Chain, "exponential_tails", lambda self, rows, low, high: (np.ones(len(low)), np.ones(len(high)))
    )
    assert 1.0 - cg.check(certificate).recomputed > 1.5 * (1.0 - with_moments)


@pytest.mark.parametrize(("law", "is_light"), [("uniform", True), ("laplace", False), ("logistic", False)])
def test_laws_with_longer_tails_go_without_moments(law: str, is_light: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of Laplace's law exponential moments are larger than those of the normal law of its variance."""
    numbers = {"low": -0.1, "high": 0.1} if law == "uniform" else {"scale": 0.04}
    agent = cg.Agent(
        name="one", states=["x"], inputs=["u"], dynamics=["0.9*x + u"], noise=[{"law": law, **numbers}],
        noise_scale=["1 + 0.5*x"], state_low=[-5], state_high=[5], input_low=[-1], input_high=[1], initial_state=[1.0],
    )  # fmt: skip
    problem = cg.Problem(
        name="one", horizon=8, agents=[agent], propositions={"goal": cg.Proposition("one", [2.5], [4.0])},
        specification=cg.Specification("F goal", "co-safe"),
    )  # fmt: skip
    certificate = changed(cg.synthesize(problem, relation="path", effort=5).certificate, failure=1.0)
    with_moments = cg.check(certificate).recomputed
    monkeypatch.setattr(
        Chain, "exponential_tails", lambda self, rows, low, high: (np.ones(len(low)), np.ones(len(high)))
    )
    assert (cg.check(certificate).recomputed < with_moments) == is_light
