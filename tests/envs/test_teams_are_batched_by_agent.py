"""`team_env` is `vector_env` with one array per agent: the same worlds, rewards and ends, to the last bit."""

from __future__ import annotations

import numpy as np
import pytest

import certigym as cg
from kinds import mostly_thorough

IDS = ["reach-avoid-v0", "patrol-recharge-v0"]
WORLDS = 60


def split(problem: cg.Problem, joint: np.ndarray) -> dict[str, np.ndarray]:
    """Joint actions (M, sum of m_i) as one array per agent."""
    return {name: joint[:, columns] for name, columns in zip(problem.agent_names, problem.input_columns, strict=True)}


@mostly_thorough("id", IDS)
@mostly_thorough("reward", ["sparse", "progress"])
def test_worlds_rewards_and_ends_are_those_of_the_vector_environment(id: str, reward: str) -> None:
    problem = cg.make_problem(id)
    envs = cg.vector_env(problem, WORLDS, reward=reward, autoreset_mode="SameStep")
    team = cg.team_env(problem, WORLDS, reward=reward, scale="raw", automaton="number")
    _, infos = envs.reset(seed=3)
    step = team.reset(seed=3)
    rng, ends = np.random.default_rng(0), 0
    for _ in range(2 * problem.horizon + 3):
        for i, name in enumerate(problem.agent_names):
            seen, n = step.observations[name], problem.agents[i].n_states
            assert seen.dtype == np.float32 and seen.shape == (WORLDS, n + 2)
            assert np.array_equal(seen[:, :n], infos["state"][:, problem.columns[i]].astype(np.float32))
            assert np.array_equal(seen[:, n], infos["automaton_state"])
            assert seen[:, -1] == pytest.approx(step.time_left / problem.horizon, abs=1e-6)
        assert np.array_equal(step.automaton_state, infos["automaton_state"])
        assert np.array_equal(step.time_left, problem.horizon - infos["time"])
        actions = rng.uniform(-1.3, 1.3, (WORLDS, problem.n_inputs))
        _, rewards, terminated, truncated, infos = envs.step(actions)
        step = team.step(split(problem, actions))
        assert np.array_equal(step.rewards, rewards)
        assert np.array_equal(step.terminated, terminated) and np.array_equal(step.truncated, truncated)
        last = infos.get("final_info", {"satisfied": np.zeros(WORLDS, dtype=bool)})["satisfied"]
        assert np.array_equal(step.satisfied, last & step.ended)
        ends += int(step.ended.sum())
    assert ends > WORLDS


def test_observations_are_what_was_asked_for() -> None:
    problem = cg.make_problem("meeting-v0")
    first, second = problem.agent_names
    n_q, size = problem.automaton.n_states, problem.agents[0].n_states
    one_hot = cg.team_env(problem, 5).reset(seed=0).observations[second]
    assert one_hot.shape == (5, size + n_q + 1) and np.abs(one_hot).max() <= 1.0
    assert np.array_equal(one_hot[:, size : size + n_q].sum(axis=1), np.ones(5))
    agent = problem.agents[1]
    raw = cg.team_env(problem, 5, scale="raw", automaton="hidden").reset(seed=0).observations[second]
    assert raw.shape == (5, size + 1)
    unit = 2.0 * (raw[:, :size] - agent.state_low) / (np.array(agent.state_high) - agent.state_low) - 1.0
    assert one_hot[:, :size] == pytest.approx(unit, abs=1e-5)
    joint = cg.team_env(problem, 5, observation="joint").reset(seed=0).observations
    assert joint[first].shape == (5, problem.n_states + n_q + 1)
    assert np.array_equal(joint[first], joint[second])


def test_zero_actions_stand_for_the_middle_of_the_input_box() -> None:
    problem = cg.make_problem("reach-avoid-v0")
    unit, given = cg.team_env(problem, 4), cg.team_env(problem, 4, actions="input")
    middles = {n: np.tile(0.5 * (a.input_low + a.input_high), (4, 1)) for n, a in zip(unit.agents, problem.agents)}
    for env in (unit, given):
        env.reset(seed=1)
    steps = unit.step({name: np.zeros((4, 1)) for name in unit.agents}), given.step(middles)
    for name in unit.agents:
        assert np.array_equal(steps[0].observations[name], steps[1].observations[name])
