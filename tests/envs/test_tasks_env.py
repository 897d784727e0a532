"""The environment of independent tasks pays and ends as that of the whole does, where the whole is small enough."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.stats import binom

import certigym as cg
from certigym.envs.interfaces.problem_env import ProblemEnv
from certigym.envs.interfaces.tasks_env import TasksEnv
from certigym.envs.tasks.problem import groups as independent
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
