"""The environment of independent tasks pays and ends as that of the whole does, where the whole is small enough."""

from __future__ import annotations

import pickle
from typing import Any

import numpy as np
import pytest
from pettingzoo.test import api_test, parallel_api_test, parallel_seed_test
from scipy.stats import binom

import certigym as cg
from certigym.envs.interfaces.problem_env import ProblemEnv
from certigym.envs.interfaces.tasks_env import TasksEnv
from certigym.envs.tasks.problem import groups as independent
from kinds import mostly_thorough
from team_problems import pairs


def both(monkeypatch: pytest.MonkeyPatch, semantics: str, **options: Any) -> tuple[TasksEnv, ProblemEnv]:
    """Environments of two pairs without noise, fallen apart and whole."""
    envs = []
    for most in (0, 10**9):
        monkeypatch.setattr(independent, "MOST_STATES", most)
        problem = pairs(2, horizon=5, semantics=semantics, starts=(-0.4,)).replace(disturbance_scale=0.0)
        envs.append(cg.parallel_env(problem, **options))
    apart, whole = envs
    assert isinstance(apart, TasksEnv) and isinstance(whole, ProblemEnv)
    return apart, whole


@pytest.mark.thorough
@pytest.mark.parametrize("semantics", ["finite-trace", "co-safe"])
def test_rewards_and_ends_are_those_of_the_whole(monkeypatch: pytest.MonkeyPatch, semantics: str) -> None:
    apart, whole = both(monkeypatch, semantics)
    rng, seen = np.random.default_rng(0), set[tuple[float, bool, bool]]()
    for _ in range(80):
        start = rng.uniform(-1.5, 1.5, 4) * rng.choice([0.3, 1.0, 2.6])
        options = {"initial_state": start}
        one: tuple[Any, ...] = apart.reset(seed=1, options=options)
        other: tuple[Any, ...] = whole.reset(seed=1, options=options)
        pull = rng.choice([0.0, 1.0], p=[0.3, 0.7])
        while True:
            assert apart.agents == whole.agents
            assert [info["satisfied"] for info in one[-1].values()] == [i["satisfied"] for i in other[-1].values()]
            if len(one) == 5:
                assert one[1:4] == other[1:4]
                reward, terminated, truncated = (next(iter(part.values())) for part in one[1:4])
                seen.add((reward, terminated, truncated))
            if not apart.agents:
                break
            actions = {
                name: np.clip(-pull * 1.8 * observation[:1] + rng.normal(0, 1.5 * (1 - pull), 1), -2, 2)
                for name, observation in one[0].items()
            }
            one, other = apart.step(actions), whole.step(actions)
            for name, observation in one[0].items():
                np.testing.assert_allclose(observation[[0, -1]], other[0][name][[0, -1]])
    assert apart.step({}) == whole.step({})
    satisfied = (1.0, semantics == "co-safe", semantics != "co-safe")
    assert seen == {(0.0, False, False), (0.0, True, False), satisfied} | ({(0.0, False, True)} & seen)


@mostly_thorough("discount", [1.0, 0.9])
def test_shaped_returns_differ_by_the_first_potential_only(monkeypatch: pytest.MonkeyPatch, discount: float) -> None:
    apart, _ = both(monkeypatch, "finite-trace", reward="shaped", discount=discount)
    rng = np.random.default_rng(1)
    for pull in (1.0, -1.0) * 20:
        observations, _ = apart.reset(seed=1, options={"initial_state": rng.uniform(-1.0, 1.0, 4)})
        first = np.mean([task.potential for task in apart.tasks])
        total, factor = 0.0, 1.0
        while apart.agents:
            actions = {name: np.clip(-pull * rng.uniform(0, 4) * x[:1], -2, 2) for name, x in observations.items()}
            observations, rewards, _, _, infos = apart.step(actions)
            total += factor * rewards["left_0"]
            last, factor = factor, factor * discount
        assert first > 0
        assert total == pytest.approx(last * infos["left_0"]["satisfied"] - first)


def test_many_pairs_keep_the_contract_of_pettingzoo() -> None:
    problem = pairs(10)
    env = cg.parallel_env(problem, "ansi")
    assert isinstance(env, TasksEnv) and len(env.tasks) == 10
    parallel_api_test(env, num_cycles=30)
    parallel_seed_test(lambda: cg.parallel_env(problem), num_cycles=20)
    api_test(cg.aec_env(problem), num_cycles=30)
    env.reset(seed=3)
    assert env.state() in env.state_space and str(env.render()).count("\n") == 9
    copied = pickle.loads(pickle.dumps(env))
    actions = {name: np.zeros(1) for name in env.agents}
    np.testing.assert_array_equal(env.step(actions)[0]["right_7"], copied.step(actions)[0]["right_7"])
    one, other = env.reset(seed=3)[0], env.reset()[0]
    assert one.keys() == other.keys() == set(env.possible_agents)


@pytest.mark.thorough
def test_controllers_act_in_the_environment_as_in_rollouts() -> None:
    """300 episodes, seed 7: each side is wrong with probability at most 1e-6."""
    problem = pairs(10, horizon=6, starts=(-1.0,))
    result = cg.synthesize(problem, 24)
    env, wins = cg.parallel_env(problem), 0
    for episode in range(300):
        observations, infos = env.reset(seed=7 + episode)
        result.controller.reset(observations, infos)
        while env.agents:
            observations, rewards, _, _, infos = env.step(result.controller.act(observations, infos))
        wins += int(rewards["left_0"])
    estimate = cg.rollout(problem, result.controller, 20_000, seed=1).successes / 20_000
    assert binom.cdf(wins, 300, result.certificate.lower_bound) > 1e-6
    slack = 5.0 * np.sqrt(0.25 / 20_000)
    assert binom.cdf(wins, 300, estimate - slack) > 1e-6 and binom.sf(wins - 1, 300, estimate + slack) > 1e-6
