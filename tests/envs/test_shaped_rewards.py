"""Shaping adds what no policy influences: the discounted return is the sparse one less the start's potential."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

import certigym as cg
from certigym.envs.interfaces.central_env import CentralEnv
from certigym.envs.interfaces.shaping import Potential
from certigym.envs.simulation import batch_simulator as core
from kinds import ALL_IDS, mostly_thorough

IDS = ["reach-avoid-v0", "patrol-recharge-v0", "package-delivery-v0", "meeting-v0", "invariance-4-v0"]


def run(env: CentralEnv, seed: int) -> tuple[list[float], bool]:
    env.reset(seed=seed)
    rng = np.random.default_rng(seed)
    rewards: list[float] = []
    while True:
        _, reward, terminated, truncated, info = env.step(rng.uniform(-1.0, 1.0, env.action_space.shape))
        rewards.append(reward)
        if terminated or truncated:
            return rewards, info["is_success"]


def start_potential(problem: cg.Problem, seed: int) -> float:
    env, dynamics, potential = of_start(problem)
    state = env.reset(seed=seed)[1]["state"]
    return float(potential.at(core.initial_at(dynamics, state[None]))[0])


@cache
def of_start(problem: cg.Problem) -> tuple[Any, core.Dynamics, Potential]:
    """An environment, the dynamics and the potential of a problem, made once."""
    dynamics = core.Dynamics.of(problem)
    return cg.central_env(problem), dynamics, Potential.of(dynamics)


@mostly_thorough("id", IDS)
@mostly_thorough("discount", [1.0, 0.9])
def test_the_return_differs_from_the_sparse_one_by_the_potential_of_the_start(id: str, discount: float) -> None:
    problem = cg.make_problem(id)
    shaped = cg.central_env(problem, reward="shaped", discount=discount)
    satisfied = set()
    for seed in range(40):
        rewards, success = run(shaped, seed)
        satisfied.add(success)
        weights = discount ** np.arange(len(rewards))
        sparse = weights[-1] * success
        assert abs(weights @ rewards - (sparse - start_potential(problem, seed))) < 1e-12
    assert len(satisfied) == 2 or id != "reach-avoid-v0"


@pytest.mark.parametrize("reward", ["shaped", "progress"])
@mostly_thorough("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP])
@mostly_thorough("id", [*IDS, "building-automation-v0"], first=2)
def test_batch_parallel_and_centralised_environments_pay_alike(id: str, mode: AutoresetMode, reward: str) -> None:
    options: dict[str, Any] = {"reward": reward, "horizon": 5, **({"discount": 0.95} if reward == "shaped" else {})}
    envs = cg.vector_env(id, 1, autoreset_mode=mode, **options)
    central, parallel = cg.central_env(id, **options), cg.parallel_env(id, actions="unit", **options)
    envs.reset(seed=2), central.reset(seed=2), parallel.reset(seed=2)
    slices = np.cumsum([agent.n_inputs for agent in central.problem.agents])[:-1]
    rng, ends = np.random.default_rng(0), 0
    while ends < 3:
        action = rng.uniform(-1.0, 1.0, central.action_space.shape)
        _, rewards, terminated, truncated, _ = envs.step(action[None])
        split = dict(zip(parallel.possible_agents, np.split(action, slices)))
        _, paid, *_ = central.step(action)
        assert rewards[0] == paid and set(parallel.step(split)[1].values()) == {paid}
        if terminated[0] or truncated[0]:
            ends += 1
            central.reset(), parallel.reset()
            if mode is AutoresetMode.NEXT_STEP:
                assert envs.step(action[None])[1][0] == 0.0


@pytest.mark.parametrize("id", ALL_IDS)
def test_the_potential_lies_between_0_and_1_and_knows_the_ends(id: str) -> None:
    problem = cg.make_problem(id)
    dynamics = core.Dynamics.of(problem)
    potential = Potential.of(dynamics)
    rng = np.random.default_rng(0)
    low = np.concatenate([agent.state_low for agent in problem.agents])
    high = np.concatenate([agent.state_high for agent in problem.agents])
    joint = low + (high - low) * rng.uniform(-0.1, 1.1, (300, low.size))
    worlds = core.initial_at(dynamics, joint)
    values = potential.at(worlds)
    assert ((-1e-12 < values) & (values <= 1.0)).all()
    assert np.allclose(potential.at(worlds, own=True).mean(axis=0), values, rtol=0.0, atol=1e-12)
    assert not values[worlds.failed | problem.automaton.dead[worlds.q]].any()
    assert (values[~worlds.failed & problem.automaton.accepting[worlds.q]] == 1.0).all()
