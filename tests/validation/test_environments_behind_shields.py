"""Environments behind shields are environments, say what is owed, and keep it; policies behind shields do, too."""

from __future__ import annotations

import pickle
from typing import Any

import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from pettingzoo.test import parallel_api_test
from scipy.stats import binom

import certigym as cg
from certigym.baselines import RandomController
from certigym.synthesis.extended_check.shields import Shield, shield_of
from kinds import mostly_thorough
from team_problems import pairs

FALSE_ALARM = 1e-6


@pytest.fixture(scope="module")
def problem() -> cg.Problem:
    return cg.make_problem("reach-avoid-v0", horizon=5).replace(initial_state=[-14.0, -4.0])


@pytest.fixture(scope="module")
def shield(problem: cg.Problem) -> Shield:
    made = shield_of(cg.synthesize(problem, 60, relation="exact"), 0.75)
    assert isinstance(made, Shield)
    return made


def refuted(successes: int, count: int, p: float) -> bool:
    """Whether so few successes have a probability below the false alarm if each has probability p or more."""
    return bool(binom.cdf(successes, count, p) < FALSE_ALARM)


@mostly_thorough("autoreset", ["NextStep", "SameStep"])
def test_batches_keep_the_probability_over_many_episodes(problem: cg.Problem, shield: Shield, autoreset: str) -> None:
    envs = cg.shield(cg.vector_env(problem, 500, autoreset_mode=autoreset), shield)
    _, infos = envs.reset(seed=0)
    rng, ended, successes = np.random.default_rng(0), 0, 0
    for _ in range(40):
        _, rewards, terminated, truncated, infos = envs.step(rng.uniform(-1.0, 1.0, (500, 2)))
        over = terminated | truncated
        ended, successes = ended + int(over.sum()), successes + int(rewards[over].sum())
        assert np.all(infos["budget"] <= infos["value"])
        assert infos["overridden"].shape == (500, 2) and infos["overridden"].dtype == np.bool_
    assert ended > 1500
    assert not refuted(successes, ended, shield.probability)
    assert refuted(successes, ended, 0.95)  # the test would notice


def test_one_world_is_a_batch_of_one(problem: cg.Problem, shield: Shield) -> None:
    """The centralised environment and the batched one move alike, shield and budget included."""
    env = cg.shield(cg.central_env(problem), shield)
    batch = cg.shield(cg.vector_env(problem, 1), shield)
    rng = np.random.default_rng(1)
    seen, info = env.reset(seed=3)
    rows, infos = batch.reset(seed=3)
    for _ in range(problem.horizon):
        assert info["budget"] == infos["budget"][0] and info["value"] == infos["value"][0]
        action = rng.uniform(-1.0, 1.0, 2)
        seen, reward, terminated, truncated, info = env.step(action)
        rows, rewards, *_, infos = batch.step(action[None])
        np.testing.assert_array_equal(seen, rows[0])
        assert reward == rewards[0] and info["overridden"] == infos["overridden"][0].any()
        if terminated or truncated:
            break


def test_the_environments_pass_their_checkers(problem: cg.Problem, shield: Shield) -> None:
    parallel_api_test(cg.shield(problem, shield), num_cycles=50)
    check_env(cg.shield(cg.central_env(problem), shield), skip_render_check=True)
    env = pickle.loads(pickle.dumps(cg.shield(problem, shield)))
    _, infos = env.reset(seed=0)
    assert all(
        info["budget"] == pytest.approx(shield.risk_budget) and info["overridden"] is False for info in infos.values()
    )
    assert env.observation_space("agent_0") == cg.parallel_env(problem).observation_space("agent_0")


def test_unit_actions_and_inputs_are_judged_alike(problem: cg.Problem, shield: Shield) -> None:
    for actions, limit in (("unit", 1.0), ("input", 5.0)):
        env = cg.shield(cg.parallel_env(problem, actions=actions), shield)
        env.reset(seed=0)
        *_, infos = env.step({name: np.array([-limit]) for name in env.agents})
        assert infos["agent_0"]["overridden"] is True  # away from the target
        assert infos["agent_0"]["budget"] <= infos["agent_0"]["value"]


def test_teams_see_budgets_of_their_worlds(problem: cg.Problem, shield: Shield) -> None:
    team = cg.shield(cg.team_env(problem, 300, automaton="number"), shield)
    team.reset(seed=0)
    rng, ended, successes = np.random.default_rng(0), 0, 0
    for _ in range(30):
        step = team.step({name: rng.uniform(-1.0, 1.0, (300, 1)) for name in team.agents})
        ended, successes = ended + int(step.ended.sum()), successes + int(step.satisfied.sum())
        assert team.overridden.shape == (300, 2) and np.all(team.budget <= team.value)
    assert not refuted(successes, ended, shield.probability)
    assert step.observations["agent_0"].shape == (300, 3)


@pytest.mark.thorough
def test_tasks_side_by_side_are_shielded_one_by_one() -> None:
    certificate = cg.synthesize(
        pairs(10, starts=(-2.0, -1.5)), 24, relation="exact", search=cg.SearchOptions(value="tree")
    ).certificate
    env = cg.shield(certificate.problem, certificate, probability=0.9 * certificate.lower_bound)
    _, infos = env.reset(seed=0)
    risk_budget = np.prod([infos[task.possible_agents[0]]["budget"] for task in env.tasks])
    assert risk_budget >= env.shield.probability
    rng = np.random.default_rng(0)
    while env.agents:
        *_, infos = env.step({name: rng.uniform(-2.0, 2.0, 1) for name in env.agents})
        assert all(info["budget"] <= info["value"] for info in infos.values())
    policy = cg.shield(RandomController(), env.shield)
    assert not refuted(cg.rollout(certificate.problem, policy, 2000).successes, 2000, env.shield.probability)


def test_policies_behind_shields_are_compared_with_what_they_keep(problem: cg.Problem, shield: Shield) -> None:
    policies: dict[str, Any] = {"random": RandomController(), "shielded": cg.shield(RandomController(), shield)}
    found = cg.compare(problem, policies, 4000, confidence=1 - FALSE_ALARM)
    assert found.entry("shielded").lower_bound == shield.probability <= found.entry("shielded").ci_high
    assert found.entry("random").ci_high < shield.probability
    assert "the shield: states of all agents" in found.entry("shielded").information


def test_what_does_not_fit_is_refused_in_words(problem: cg.Problem, shield: Shield) -> None:
    other = cg.make_problem("reach-avoid-v0", horizon=4)
    certificate = shield.values.certificate
    cases: list[tuple[tuple[Any, Any], dict[str, Any], str]] = [
        ((other, shield), {}, "`certificate`: expected one of 'reach-avoid-v0'"),
        ((problem, certificate), {}, "`probability`: expected the success probability"),
        ((problem, shield), {"probability": 0.5}, "`probability`: expected none with a shield"),
        ((problem, certificate), {"probability": 0.9}, "`probability`: expected at most 0.79"),
        ((object(), shield), {}, "`policy`: expected a function or a table"),
    ]
    for arguments, named, words in cases:
        with pytest.raises(ValueError, match=words):
            cg.shield(*arguments, **named)
    with pytest.raises(ValueError, match=r"`initial_state`: expected a start from which 0[.]75 can be kept"):
        cg.shield(problem, shield).reset(seed=0, options={"initial_state": [-19.0, -4.0]})
    with pytest.raises(ValueError, match=r"`starts`: expected starts from which 0[.]75"):
        cg.rollout(problem, cg.shield(RandomController(), shield), 10, initial_state=[-19.0, -4.0])
    with pytest.raises(ValueError, match="`policy`: expected a function or a table, or a model"):
        cg.shield(3, shield)
