"""Observations show what was asked for: neighbours, scaled states, noisy readings; certificates refuse the latter."""

from __future__ import annotations

from statistics import NormalDist
from typing import Any

import gymnasium
import numpy as np
import pytest
from pettingzoo.test import parallel_api_test, parallel_seed_test

import certigym as cg
from certigym.envs.interfaces.nearest import nearest_seen
from certigym.envs.interfaces.problem_env import ProblemEnv
from certigym.envs.interfaces.sensors import READING
from certigym.synthesis.certificates.controllers import communicated
from certigym.synthesis.certificates.controllers.path_controller import PathController
from certigym.synthesis.certificates.controllers.product_controller import ProductController
from sample_problems import mixed_problem

WHOLE: dict[str, Any] = {
    "reach-avoid": "reach-avoid-v0",
    "meeting": "meeting-v0",
    "mixed": mixed_problem(),
}
each = pytest.mark.parametrize("name", WHOLE)
SIGHTS: dict[str, dict[str, Any]] = {
    "neighbours": {"observation": "neighbours"},
    "one neighbour, scaled": {"observation": "neighbours", "neighbours": 1, "scale": "unit"},
    "noisy": {"observation": "full", "sensor_noise": 0.3},
    "noisy, scaled, hidden": {"sensor_noise": 0.3, "scale": "unit", "automaton": "hidden", "dtype": "float32"},
    "number": {"observation": "relative", "automaton": "number", "scale": "unit"},
}


def actions_of(env: Any, seed: int) -> Any:
    rng = np.random.default_rng(seed)
    while True:
        agents = env.problem.agents
        yield {a.name: a.input_low + rng.random(a.n_inputs) * (a.input_high - a.input_low) for a in agents}


@each
@pytest.mark.parametrize("sight", SIGHTS)
def test_pettingzoo_accepts_every_sight(name: str, sight: str) -> None:
    parallel_api_test(cg.parallel_env(WHOLE[name], **SIGHTS[sight]), num_cycles=20)
    parallel_seed_test(lambda: cg.parallel_env(WHOLE[name], **SIGHTS[sight]), num_cycles=10)


def test_neighbours_are_the_nearest_ones() -> None:
    # Places 0, 1, 5, 1 in world 0 and 0, 9, 2, 4 in world 1; of the equals at distance 1 the first counts as nearer.
    places = np.array([[[0.0, 0.0]], [[1.0, 9.0]], [[5.0, 2.0]], [[-1.0, 4.0]]])
    assert nearest_seen(places, places, 0, 2).tolist() == [[1.0, 2.0], [-1.0, 4.0]]
    assert nearest_seen(places, places, 2, 3).tolist() == [[-4.0, -2.0], [-5.0, 2.0], [-6.0, 7.0]]
    # States are shown, outputs decide: velocities stand in the second component.
    states = np.array([[[0.0], [7.0]], [[4.0], [1.0]], [[-3.0], [2.0]]])
    assert nearest_seen(states, states[:, :1], 0, 1).tolist() == [[-3.0], [-5.0]]
    assert nearest_seen(states, states, 0, 0).shape == (0, 1)


def test_scaled_observations_are_those_of_the_space() -> None:
    problem = mixed_problem()
    for scope in ("local", "full", "relative", "neighbours"):
        plain = cg.parallel_env(problem, observation=scope, automaton="number")
        unit = cg.parallel_env(problem, observation=scope, automaton="hidden", scale="unit")
        seen, scaled = (env.reset(seed=4)[0] for env in (plain, unit))
        for name in problem.agent_names:
            space, k = plain.observation_space(name), len(seen[name]) - 2
            assert isinstance(space, gymnasium.spaces.Box) and len(scaled[name]) == k + 1
            assert np.all(space.low[:k] == -np.inf) and np.all(space.high[:k] == np.inf)
            low, high = plain._bounds[name]  # of the workspaces, which [-1, 1] stands for
            assert scaled[name][:k] == pytest.approx((2.0 * seen[name][:k] - low - high) / (high - low), abs=1e-12)
            # Behind the states: the automaton state as a number, or nothing; then the time left.
            assert seen[name][k:].tolist() == [problem.automaton.initial, 1.0] and scaled[name][k] == 1.0
            assert space.high[k] == problem.automaton.n_states - 1


@each
def test_neighbours_are_the_same_in_one_world_and_in_many(name: str) -> None:
    options: dict[str, Any] = {"observation": "neighbours", "sensor_noise": 0.4}
    env = cg.parallel_env(WHOLE[name], dtype="float32", **options)
    assert isinstance(env, ProblemEnv)
    raw, unit = (cg.team_env(WHOLE[name], 1, actions="input", scale=scale, **options) for scale in ("raw", "unit"))
    scaled = cg.parallel_env(WHOLE[name], dtype="float32", scale="unit", **options)
    seen = env.reset(seed=5)[0], scaled.reset(seed=5)[0], raw.reset(seed=5), unit.reset(seed=5)
    for actions in actions_of(env, 0):
        for n in env.agents:
            # The batch shows raw readings as they are, the single world moves them into the workspace.
            own = env.problem.agents[env.possible_agents.index(n)].n_states
            assert np.array_equal(seen[0][n][own:], seen[2].observations[n][0, own:])
            assert np.array_equal(seen[1][n], seen[3].observations[n][0])
            assert env.observation_space(n).contains(seen[0][n]) and np.abs(seen[1][n]).max() <= 1.0
        batch = {n: u[None] for n, u in actions.items()}
        seen = env.step(actions)[0], scaled.step(actions)[0], raw.step(batch), unit.step(batch)
        if not env.agents:
            return


def test_noise_of_sensors_moves_nothing_and_has_the_stated_size() -> None:
    problem, worlds, sigma = cg.make_problem("integrator-chain-v0"), 20_000, 0.25
    exact, noisy = cg.vector_env(problem, worlds), cg.vector_env(problem, worlds, sensor_noise=sigma)
    exact.reset(seed=1), noisy.reset(seed=1)
    actions = np.random.default_rng(0).uniform(-1.0, 1.0, (worlds, problem.n_inputs))
    for _ in range(3):
        _, rewards, _, _, infos = exact.step(actions)
        _, same, _, _, told_infos = noisy.step(actions)
        assert np.array_equal(rewards, same) and np.array_equal(infos["state"], told_infos["state"])
    errors = (told_infos[READING] - told_infos["state"]).ravel() / sigma
    # Mean and variance of n standard normal numbers are nearly normal, with deviations 1/sqrt(n) and sqrt(2/n): a
    # false alarm of 1e-6 is shared by both. An error of 3.5 % in sigma would be seen.
    limit = NormalDist().inv_cdf(1.0 - 1e-6 / 4.0)
    assert abs(errors.mean()) <= limit / np.sqrt(errors.size)
    assert abs(errors.var() - 1.0) <= limit * np.sqrt(2.0 / errors.size)


def test_certified_controllers_and_shields_refuse_noisy_sensors() -> None:
    assert communicated.READING == READING
    problem = cg.make_problem("reach-avoid-v0", horizon=4)
    result = cg.synthesize(problem, 40)
    env = cg.parallel_env(problem, sensor_noise=0.1)
    observations, infos = env.reset(seed=0)
    for call in (result.controller.reset, result.controller.act):
        with pytest.raises(ValueError, match=r"`infos`: expected those of .* exact sensors.*true states"):
            call(observations, infos)
    exact = cg.parallel_env(problem, scale="unit", observation="neighbours")
    observations, infos = exact.reset(seed=0)
    plain, told_infos = cg.parallel_env(problem).reset(seed=0)
    # Scaled observations with a neighbour in them do no harm, since infos tell the state.
    actions = result.controller.act(observations, infos), result.controller.act(plain, told_infos)
    assert all(np.array_equal(actions[0][name], actions[1][name]) for name in plain)
    for make in (cg.parallel_env, cg.central_env, cg.vector_env, cg.team_env):
        with pytest.raises(ValueError, match="`guarded`: expected exact sensors"):
            cg.shield(make(problem, sensor_noise=0.1), result, probability=0.1)


@pytest.mark.parametrize("kind", ["path", "product"])
def test_all_controllers_look_for_readings_first(kind: str) -> None:
    problem = cg.make_problem("reach-avoid-v0")
    names, path = problem.agent_names, [(np.zeros((3, 1)), np.zeros((3, 1, 1)), np.zeros((4, 1)))] * 2
    inner: Any = PathController(problem, tuple(path))
    controller: Any = inner if kind == "path" else ProductController(problem, (inner,))
    _, infos = cg.parallel_env(problem, sensor_noise=0.1).reset(seed=0)
    for call in (controller.reset, controller.act):
        with pytest.raises(ValueError, match="exact sensors"):
            call(dict.fromkeys(names, np.zeros(6)), infos)
