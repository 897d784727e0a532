"""The environments keep PettingZoo's contract, repeat themselves exactly, and pay satisfaction as the core has it."""

from __future__ import annotations

import pickle
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from pettingzoo.test import parallel_api_test, parallel_seed_test

import certigym as cg
from certigym.envs.interfaces.problem_env import ProblemEnv
from certigym.envs.simulation import batch_simulator as core
from kinds import IDS_OF_KINDS
from sample_problems import mixed_problem

PROBLEMS: dict[str, Any] = {**{id: id for id in cg.problem_ids()}, "mixed": mixed_problem()}
each_kind = pytest.mark.parametrize("name", [*IDS_OF_KINDS, "mixed"])


def actions_of(env: ProblemEnv, seed: int) -> Iterator[dict[str, np.ndarray]]:
    rng = np.random.default_rng(seed)
    while True:
        boxes = {agent.name: (agent.input_low, agent.input_high) for agent in env.problem.agents}
        yield {name: low + rng.random(low.shape) * (high - low) for name, (low, high) in boxes.items()}


def digest(record: list[Any]) -> bytes:
    def plain(value: Any) -> Any:
        if isinstance(value, dict):
            return {key: plain(item) for key, item in value.items()}
        if isinstance(value, (list, tuple)):
            return [plain(item) for item in value]
        return value.tolist() if isinstance(value, np.ndarray) else value

    return repr(plain(record)).encode()


def test_pettingzoo_takes_agents_of_several_sizes_that_no_id_has() -> None:
    parallel_api_test(cg.parallel_env(PROBLEMS["mixed"]), num_cycles=60)
    parallel_seed_test(lambda: cg.parallel_env(PROBLEMS["mixed"]))


@each_kind
def test_pickled_environments_go_on_alike(name: str) -> None:
    env = cg.parallel_env(PROBLEMS[name])
    env.reset(seed=3)
    moves = actions_of(env, 1)
    env.step(next(moves))
    twin = pickle.loads(pickle.dumps(env))
    while env.agents:
        actions = next(moves)
        assert digest(list(env.step(actions))) == digest(list(twin.step(actions)))
    assert twin.agents == []


@each_kind
def test_the_environment_is_the_core_with_one_world(name: str) -> None:
    env = cg.parallel_env(PROBLEMS[name])
    env.reset(seed=5)
    dynamics = core.Dynamics.of(env.problem)
    rng = np.random.default_rng(5)
    worlds = core.initial(dynamics, rng, 1)
    for actions in actions_of(env, 2):
        joint = core.joint(dynamics, worlds)[0]
        env_joint = np.concatenate([env._infos()[agent]["state"] for agent in env.possible_agents])
        assert (env_joint == joint).all()
        inputs = []
        for block in dynamics.blocks:
            stacked = np.stack([actions[env.possible_agents[i]] for i in block.agents], axis=1)
            inputs.append(stacked[..., None])
        _, rewards, terminations, truncations, infos = env.step(actions)
        worlds = core.transition(dynamics, worlds, inputs, core.noise(dynamics, rng, 1))
        verdict = bool(core.satisfied(dynamics, worlds)[0])
        assert set(rewards.values()) == {float(verdict)}
        for agent in env.possible_agents:
            assert infos[agent]["satisfied"] == verdict
            assert infos[agent]["automaton_state"] == worlds.q[0]
            assert infos[agent]["time"] == worlds.time
            assert not (terminations[agent] and truncations[agent])
        if not env.agents:
            return


def test_observations_hold_state_automaton_and_time() -> None:
    env = cg.parallel_env(cg.make_problem("reach-avoid-v0", initial_state=[-10.0, -4.0]))
    observations, infos = env.reset(seed=0)
    n_q = env.problem.automaton.n_states
    one_hot = np.eye(n_q)[env.problem.initial_q]
    assert observations["agent_0"].dtype == np.float64
    assert observations["agent_0"].tolist() == [-10.0, *one_hot, 1.0]
    assert env.state().tolist() == [-10.0, -4.0, *one_hot, 1.0]
    assert env.state_space.contains(env.state())
    observations, *_, infos = env.step({agent: np.zeros(1) for agent in env.agents})
    assert observations["agent_0"][-1] == 1.0 - 1.0 / 7.0
    assert infos["agent_0"]["state"][0] == observations["agent_0"][0]


def test_an_exit_terminates_and_the_observation_stays_in_its_space() -> None:
    problem = cg.make_problem("invariance-v0", n_agents=2, initial_state=[9.9, 9.9], setting="B")
    outside = problem.replace(initial_state=[50.0, 0.0])
    env = cg.parallel_env(outside, infos="words")
    observations, infos = env.reset(seed=0)
    assert env.observation_space("agent_0").contains(observations["agent_0"])
    assert infos["agent_0"]["state"].tolist() == [50.0] and infos["agent_0"]["letter"] == ()
    _, rewards, terminations, truncations, infos = env.step({agent: np.zeros(1) for agent in env.agents})
    assert rewards == {"agent_0": 0.0, "agent_1": 0.0} and terminations == {"agent_0": True, "agent_1": True}
    assert truncations == {"agent_0": False, "agent_1": False} and infos["agent_1"]["time"] == 0
    assert env.agents == [] and env.step({}) == ({}, {}, {}, {}, {})


def test_a_start_that_satisfies_pays_once_at_the_first_step() -> None:
    env = cg.parallel_env(cg.make_problem("reach-avoid-v0", initial_state=[0.0, -4.0]), infos="words")
    _, infos = env.reset(seed=0)
    assert infos["agent_0"]["satisfied"] and infos["agent_0"]["letter"] == ("p1",)
    _, rewards, terminations, _, _ = env.step({agent: np.zeros(1) for agent in env.agents})
    assert set(rewards.values()) == {1.0} and all(terminations.values()) and env.agents == []


def test_a_dead_automaton_state_terminates() -> None:
    env = cg.parallel_env(cg.make_problem("reach-avoid-v0", initial_state=[-3.0, -18.0]))
    env.reset(seed=0)
    _, rewards, terminations, _, _ = env.step({agent: np.zeros(1) for agent in env.agents})
    assert set(rewards.values()) == {0.0} and all(terminations.values())


def test_the_horizon_truncates_and_pays_finite_traces() -> None:
    env = cg.parallel_env("invariance-4-v0", horizon=3)
    _, _ = env.reset(seed=0)
    while env.agents:
        _, rewards, terminations, truncations, infos = env.step({agent: np.zeros(1) for agent in env.agents})
    assert all(truncations.values()) and not any(terminations.values())
    assert set(rewards.values()) == {1.0} and infos["agent_0"]["time"] == 3
