"""A training behind a shield keeps what is promised, and says so."""

from __future__ import annotations

import pytest
from scipy.stats import binom

import certigym as cg
from certigym.synthesis.extended_check.shields import Shield, shield_of

pytest.importorskip("stable_baselines3")

FALSE_ALARM = 1e-6


@pytest.fixture(scope="module")
def shield() -> Shield:
    problem = cg.make_problem("reach-avoid-v0", horizon=5).replace(initial_state=[-14.0, -4.0])
    made = shield_of(cg.synthesize(problem, 60, relation="exact"), 0.75)
    assert isinstance(made, Shield)
    return made


@pytest.mark.thorough
def test_training_episodes_succeed_as_promised(shield: Shield) -> None:
    """The steps of the training are fixed beforehand, and the episodes that are counted are a prefix."""
    training = cg.train(shield.problem, "ppo", 5000, shield=shield)
    episodes = sum(int(point["episodes"]) for point in training.curve)
    successes = sum(round(point["episodes"] * point["success"]) for point in training.curve)
    assert episodes > 300
    assert binom.cdf(successes, episodes, shield.probability) >= FALSE_ALARM
    assert "behind a shield that keeps 0.75" in training.information
    rate = cg.rollout(shield.problem, cg.shield(training, shield), 2000)
    assert binom.cdf(rate.successes, 2000, shield.probability) >= FALSE_ALARM


@pytest.mark.thorough
def test_a_learner_that_is_not_shielded_fails_more_often(shield: Shield) -> None:
    """The test above would notice."""
    training = cg.train(shield.problem, "ppo", 2500, reward="sparse")
    episodes = sum(int(point["episodes"]) for point in training.curve)
    successes = sum(round(point["episodes"] * point["success"]) for point in training.curve)
    assert binom.cdf(successes, episodes, shield.probability) < FALSE_ALARM


def test_shields_that_do_not_fit_are_refused(shield: Shield) -> None:
    with pytest.raises(ValueError, match="`shield`: expected one of 'reach-avoid-v0'"):
        cg.train(cg.make_problem("reach-avoid-v0"), shield=shield)
    with pytest.raises(ValueError, match="`shield`: expected a Shield of one task"):
        cg.train(shield.problem, shield=shield.values.certificate)  # type: ignore[arg-type]
