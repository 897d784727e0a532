"""Stable-Baselines3 learns on the worlds of a problem: contract of the rows, seeds, saved actors, small budgets."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import certigym as cg
from certigym.synthesis.relations.kinds import inputs_of
from certigym.validation.policies.actors import load_actor, networks_of
from certigym.validation.policies.views import CentralView, SharedView

pytest.importorskip("stable_baselines3", reason="needs the extra `rl`")

from stable_baselines3.common.vec_env import VecEnv

from certigym.validation.policies.learners import WorldsVecEnv, central_vec_env, shared_vec_env
from kinds import mostly_thorough

RA2 = cg.make_problem("reach-avoid-v0")
MAKERS: list[Callable[..., WorldsVecEnv]] = [shared_vec_env, central_vec_env]


def played(env: WorldsVecEnv, seed: int, steps: int = 30) -> list[Any]:
    """Observations, rewards, dones and infos of a fixed sequence of actions."""
    env.seed(seed)
    record: list[Any] = [env.reset()]
    rng = np.random.default_rng(1)
    for _ in range(steps):
        record.append(env.step(rng.uniform(-1, 1, (env.num_envs, *env.action_space.shape))))  # type: ignore[misc]
    return record


@pytest.mark.parametrize("make", MAKERS)
def test_rows_keep_the_contract(make: Callable[..., WorldsVecEnv]) -> None:
    env = make(RA2, worlds=5)
    per = env.view.rows
    assert isinstance(env, VecEnv) and env.num_envs == 5 * per
    first, *steps = played(env, 0)
    assert first.dtype == np.float32 and first.shape == (5 * per, *env.observation_space.shape)  # type: ignore[misc]
    ends = 0
    for observations, rewards, dones, infos in steps:
        assert env.observation_space.contains(observations[0]) and observations.dtype == np.float32
        assert rewards.dtype == np.float32 and dones.dtype == np.bool_
        assert len(infos) == 5 * per
        for row, info in enumerate(infos):
            assert ("terminal_observation" in info) == bool(dones[row])
            if dones[row]:
                ends += 1
                left = info["terminal_observation"][per_time(env)]
                assert env.observation_space.contains(info["terminal_observation"])
                assert isinstance(info["is_success"], bool)
                assert info["TimeLimit.truncated"] == (left == 0.0 and not settled(env, info))
                assert observations[row][per_time(env)] == 1.0
                assert info["episode"]["l"] == round((1 - left) * RA2.horizon)
        for world in range(5):
            assert len({bool(d) for d in dones[world * per : (world + 1) * per]}) == 1
    assert ends > 5 * per


def per_time(env: WorldsVecEnv) -> int:
    """Column of the time left."""
    width = env.view.width if isinstance(env.view, SharedView) else RA2.n_states
    return width + RA2.automaton.n_states


def settled(env: WorldsVecEnv, info: dict[str, Any]) -> bool:
    """Whether success, or an exit or a dead state in the last observation, decided the episode."""
    last = info["terminal_observation"]
    states = last[: per_time(env) - RA2.automaton.n_states]
    q = int(np.argmax(last[per_time(env) - RA2.automaton.n_states : per_time(env)]))
    return bool(info["is_success"] or RA2.automaton.dead[q] or np.any(np.abs(states) == 1.0))


@pytest.mark.parametrize("make", MAKERS)
def test_a_seed_decides_every_number(make: Callable[..., WorldsVecEnv]) -> None:
    one, two, other = (played(make(RA2, worlds=4), seed) for seed in (0, 0, 1))
    assert np.array_equal(one[0], two[0]) and not np.array_equal(one[0], other[0])
    for a, b in zip(one[1:], two[1:]):
        for x, y in zip(a[:3], b[:3]):
            assert np.array_equal(x, y)
        assert str(a[3]) == str(b[3])


def test_shared_rows_hold_what_each_agent_may_know_and_no_more() -> None:
    """Moving another agent changes nothing in an agent's row; moving the agent itself does."""
    view = SharedView(RA2)
    q, time = np.array([0]), np.array([2])
    rows = view.observations(np.array([[-7.5, -2.5]]), q, time)
    moved = view.observations(np.array([[-7.5, 4.0]]), q, time)
    assert np.array_equal(rows[0], moved[0]) and not np.array_equal(rows[1], moved[1])
    assert rows[0].tolist() == pytest.approx([0.0, 1.0, 0.0, 0.0, 5 / 7, 1.0, 0.0])
    assert rows[1][-2:].tolist() == [0.0, 1.0]
    assert CentralView(RA2).observations(np.array([[-7.5, 5.0]]), q, time)[0].tolist() == pytest.approx(
        [0.0, 1.0, 1.0, 0.0, 0.0, 5 / 7]
    )


def test_rows_of_actions_reach_their_agents() -> None:
    big = cg.make_problem("door-formation-v0")
    view = SharedView(big)
    actions = np.arange(2 * view.rows * view.n_actions, dtype=float).reshape(-1, view.n_actions)
    assert np.array_equal(view.joint_actions(actions), actions.reshape(2, -1))
    agent = RA2.agents[0]
    assert inputs_of(agent.input_box, np.array([[-3.0, -1.0, 0.0, 0.5, 9.0]])).tolist() == [[-5.0, -5.0, 0.0, 2.5, 5.0]]


@mostly_thorough("algorithm", ["ppo", "central-ppo", "sac"])
def test_the_actor_in_numbers_is_that_of_the_learner(algorithm: str, tmp_path: Path) -> None:
    settings: dict[str, Any] = {} if algorithm == "sac" else {"n_steps": 16}
    training = cg.train(RA2, algorithm, 400, 3, worlds=8, **settings)
    view = SharedView(RA2) if algorithm == "ppo" else CentralView(RA2)
    rng = np.random.default_rng(0)
    joint = rng.uniform(-20.0, 5.0, (50, 2))
    rows = view.observations(joint, rng.integers(0, 3, 50), rng.integers(0, 7, 50))
    expected, _ = training.model.predict(rows, deterministic=True)
    assert networks_of(training.actor)[0].actions(rows) == pytest.approx(np.clip(expected, -1, 1), abs=1e-5)
    path = training.save(tmp_path / "kept")
    assert {file.name for file in path.parent.iterdir()} == {"actor.npz", "training.json", "curve.csv", "model.zip"}
    again = load_actor(path, RA2)
    assert np.array_equal(networks_of(again)[0].actions(rows), networks_of(training.actor)[0].actions(rows))
    assert np.array_equal(cg.rollout(RA2, again, 300).success, cg.rollout(RA2, training.actor, 300).success)
    record = json.loads((path.parent / "training.json").read_text())
    assert record["algorithm"] == algorithm and record["seed"] == 3 and record["curve"]
    assert ("own state" in record["information"]) == (algorithm == "ppo")


@pytest.mark.thorough
def test_ppo_learns_the_two_agent_task_and_its_certificate_holds() -> None:
    """8,000 world steps; the untrained policy succeeds in fewer than half of the episodes."""
    training = cg.train(RA2, "ppo", 8_000, 0)
    before = cg.rollout(RA2, cg.train(RA2, "ppo", 1, 0, worlds=2, n_steps=2, batch_size=4).actor, 2000)
    after = cg.rollout(RA2, training.actor, 2000)
    assert before.successes < 1000 < 1600 < after.successes
    assert after.inadmissible == 0
    rates = [point["success"] for point in training.curve]
    assert np.mean(rates[:5]) < 0.5 < np.mean(rates[-5:])
    actor: Any = training.actor
    certified, improved = cg.certify(RA2, actor, 100, wrap=True), cg.improve(RA2, actor, 100)
    assert cg.check(certified.certificate, RA2)
    assert cg.validate(certified, 20_000, confidence=1 - 1e-6).verdict != "refuted"
    assert improved.certificate.lower_bound >= certified.certificate.lower_bound > 0.7
