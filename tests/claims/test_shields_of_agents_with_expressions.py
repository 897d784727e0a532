"""Shields keep their promise where the mean is not known: expressions, disturbances, neighbours, and networks."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from scipy.stats import binom

import certigym as cg
from certigym.synthesis.extended_check.claims import greedy_disturbance
from certigym.synthesis.extended_check.shields import Shield, shield_of, unknown_means
from certigym.synthesis.extended_check.shields.noise_probabilities import NoiseAxis
from certigym.synthesis.extended_check.shields.q_values import ActionValues
from certigym.synthesis.extended_check.shields.unknown_means import MeanBox
from certigym.synthesis.verbs.raw_networks import certify_network
from kinds import mostly_thorough
from network_problems import proportional, reach
from problems import scalar_agent
from shield_trials import anything, episodes, the_worst
from team_problems import ring, windy_team
from written_problems import oscillator_reach

FALSE_ALARM = 1e-6
"""Probability with which a statistical test here fails although all is right."""

EPISODES = 1_500
"""A rate that is .1 below p is refuted with probability above .99."""

WIND = {"disturbances": {"wind": [-0.1, 0.1]}, "dynamics": ["x + step*y", "y + step*(-x + (1 - x**2)*y) + u + wind"]}

WINDY = windy_team().replace(initial_state={"one": [-1.0], "two": [1.0]})


@cache
def certificate(kind: str) -> cg.Certificate:
    """Certificates of small problems with expressions."""
    makers: dict[str, Any] = {
        "wind, linear": lambda: cg.synthesize(WINDY, 50, relation="linear"),
        "wind, boxes": lambda: cg.synthesize(WINDY, 60, relation="boxes"),
        "two axes": lambda: cg.synthesize(oscillator_reach(6, **WIND), 24, relation="linear"),
        "neighbours": lambda: cg.synthesize(ring(3), 40),
    }
    found = makers[kind]().certificate
    assert isinstance(found, cg.Certificate) and found.lower_bound > 0.1
    return found


def refuted(success: np.ndarray, p: float) -> bool:
    """Whether so few successes have a probability below the false alarm if each has probability p or more."""
    return bool(binom.cdf(success.sum(), len(success), p) < FALSE_ALARM)


def made(kind: str, share: float, form: str = "joint") -> Shield:
    found = certificate(kind)
    shield = shield_of(found, share * found.lower_bound, form)
    assert isinstance(shield, Shield)
    return shield


@mostly_thorough("kind", ["wind, linear", "two axes", "neighbours"], first=2)
def test_least_values_are_below_those_of_every_disturbance(kind: str) -> None:
    """Expected factors at 200 states, against the mean under 50 disturbances each, corners among them."""
    shield, rng, count = made(kind, 0.5), np.random.default_rng(0), 200
    values, problem = shield.values, shield.problem
    spaces = [agent.workspace for agent in problem.agents]
    states = tuple(b.low[:, None] + (b.high - b.low)[:, None] * rng.random((len(b.low), count)) for b in spaces)
    q, tightest = int(np.flatnonzero(~problem.automaton.absorbing)[0]), np.inf
    assert isinstance(values, ActionValues)
    inputs = anything(shield, states, np.full(count, q), np.full(count, 2), rng)
    for i, agent in enumerate(problem.agents):
        assert isinstance(agent, cg.Agent)
        least = values.expected(2, q, i, states, inputs[i])
        seen = np.full(least.shape, np.inf)
        assert least.max() > 0.1
        for _ in range(50):
            share = rng.random((len(agent.disturbance_low), count))
            share = np.where(rng.random(share.shape) < 0.5, np.rint(share), share)
            low, high = agent.disturbance_low[:, None], agent.disturbance_high[:, None]
            mean = agent.mean(states[i], inputs[i], low + share * (high - low), values.beside(i, states))
            seen = np.minimum(seen, values.backed_up(2, q, i, mean))
        assert np.all(least <= seen + 1e-12)
        tightest = min(tightest, float(np.max(seen - least)))
    assert tightest < 0.05  # nothing much is given away


def test_charges_are_what_interpolation_may_miss() -> None:
    """The least of a smooth function over a box against the points and the charge; boxes of all widths."""
    rng = np.random.default_rng(1)
    for width in (0.0, 1e-12, 0.3, 2.0):
        low = rng.normal(size=(2, 40))
        axes = tuple(NoiseAxis(np.linspace(-4.0, 4.0, 9), deviation, False) for deviation in (1.0, 0.7))
        box = MeanBox(low, low + width * np.array([[1.0], [0.5]]), axes)
        smooth = lambda m: np.exp(-0.5 * (m[0] ** 2 + (m[1] / 0.7) ** 2))  # noqa: E731  # E of a spike, at most 1
        least = np.min([smooth(m) for m, _ in box.points], axis=0) - box.interpolation_error
        for _ in range(200):
            share = rng.random(low.shape)
            assert np.all(least <= smooth(box.low + share * (box.high - box.low)) + 1e-15)
        assert np.all(box.interpolation_error < 0.05)


@pytest.mark.thorough
@pytest.mark.parametrize("kind, form", [("wind, boxes", "joint"), ("two axes", "decentralised")])
def test_nobody_can_break_the_promise_in_the_worst_wind(kind: str, form: str) -> None:
    """Random and adversarial proposers, and a wind that looks one step ahead."""
    shield = made(kind, 0.95, form)
    wind = greedy_disturbance(shield.values.certificate)
    for number, propose in enumerate((anything, the_worst)):
        # What nobody steers against the shield needs fewer episodes to show that it is let through at all.
        count = EPISODES if propose is the_worst else EPISODES // 5
        found = episodes(shield, propose, count, number, disturbance=wind)
        assert not refuted(found["success"], shield.probability)
        assert found["slack"] >= 0.0
        assert np.all(found["budget"] <= found["success"])
        assert 0.0 < found["overridden"] and (propose is the_worst or found["overridden"] < 1.0)


@pytest.mark.thorough
def test_neighbours_are_seen_where_they_are() -> None:
    """Rooms on a ring: the joint shield knows all temperatures."""
    shield = made("neighbours", 0.9)
    found = episodes(shield, the_worst, EPISODES, 3)
    assert not refuted(found["success"], shield.probability)
    assert found["slack"] >= 0.0 and 0.0 < found["overridden"] < 1.0


@pytest.mark.thorough
def test_a_shield_that_forgets_the_wind_is_caught(monkeypatch: pytest.MonkeyPatch) -> None:
    """Means without wind, and an adversary that has the wind on its side."""
    shield = made("wind, linear", 0.95)
    wind = greedy_disturbance(shield.values.certificate)
    assert not refuted(episodes(shield, the_worst, EPISODES, 5, disturbance=wind)["success"], shield.probability)
    true = unknown_means.enclosed_means

    def calm(*arguments: Any) -> Any:
        low, high = true(*arguments)
        return 0.5 * (low + high), 0.5 * (low + high)

    monkeypatch.setattr(unknown_means, "enclosed_means", calm)
    assert refuted(episodes(shield, the_worst, EPISODES, 5, disturbance=wind)["success"], shield.probability)


@pytest.mark.thorough
def test_a_network_may_be_what_a_shield_falls_back_on() -> None:
    """The certificate of a network as it is, and a proposer that works against it."""
    problem = reach(scalar_agent("a"), scalar_agent("b"))
    found = certify_network(problem, proportional(problem), 80).certificate
    shield = shield_of(found, 0.5 * found.lower_bound)
    assert isinstance(shield, Shield)
    for propose in (anything, the_worst):
        result = episodes(shield, propose, EPISODES, 4)
        assert not refuted(result["success"], shield.probability)
        assert result["slack"] >= 0.0 and 0.0 < result["overridden"]
        assert propose is the_worst or result["overridden"] < 1.0
