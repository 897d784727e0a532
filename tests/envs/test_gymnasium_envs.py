"""The Gymnasium environments keep their contract for every id: checkers, seeds, batches, autoreset, rewards."""

from __future__ import annotations

import hashlib
import pickle
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env, data_equivalence
from gymnasium.vector import AutoresetMode, SyncVectorEnv

import certigym as cg
import fake_pygame
from certigym.envs.interfaces.central_env import CentralEnv
from certigym.envs.interfaces.observation import batch_inputs
from certigym.envs.interfaces.vector_env import ProblemVectorEnv
from certigym.envs.simulation import batch_simulator as core
from certigym.envs.suite.ids import gymnasium_id
from kinds import IDS_OF_KINDS
from sample_problems import mixed_problem

each_kind = pytest.mark.parametrize("id", IDS_OF_KINDS)


def episode(env: CentralEnv, seed: int | None) -> str:
    """Digest of a whole episode under seeded actions."""
    rng = np.random.default_rng(0)
    record: list[Any] = [env.reset(seed=seed)]
    ended = False
    while not ended:
        record.append(env.step(rng.uniform(-1.0, 1.0, env.action_space.shape)))
        ended = record[-1][2] or record[-1][3]
    plain = repr([[part.tolist() if isinstance(part, np.ndarray) else part for part in step] for step in record])
    return hashlib.sha256(plain.encode()).hexdigest()


@each_kind
def test_gymnasium_accepts_windows_and_pictures(id: str, monkeypatch: pytest.MonkeyPatch) -> None:
    fake_pygame.install(monkeypatch)
    env = gymnasium.make(gymnasium_id(id))
    assert env.spec is not None and gymnasium.spec(gymnasium_id(id)) is not None
    check_env(env.unwrapped)


@each_kind
def test_whole_episodes_repeat_with_a_seed_also_with_seed_zero(id: str) -> None:
    env = cg.central_env(id)
    digests = [episode(env, 0), episode(env, 1)]
    assert digests[0] != digests[1]
    assert [episode(env, 0), episode(env, 1)] == digests
    assert episode(env, None) not in digests
    twin = pickle.loads(pickle.dumps(cg.central_env(id)))
    assert episode(twin, 0) == digests[0]


@each_kind
@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP])
def test_one_world_of_the_batch_is_the_scalar_environment_across_resets(id: str, mode: AutoresetMode) -> None:
    ours = gymnasium.make_vec(gymnasium_id(id), num_envs=1, autoreset_mode=mode, horizon=6)
    assert isinstance(ours, ProblemVectorEnv) and ours.metadata["autoreset_mode"] is mode
    scalar = SyncVectorEnv([lambda: cg.central_env(id, horizon=6)], autoreset_mode=mode)
    rng = np.random.default_rng(4)
    assert data_equivalence(ours.reset(seed=0)[0], scalar.reset(seed=0)[0], exact=True)
    ends = 0
    for _ in range(25):
        action = rng.uniform(-1.2, 1.2, ours.action_space.shape)
        mine, theirs = ours.step(action), scalar.step(action)
        assert data_equivalence(list(mine[:4]), list(theirs[:4]), exact=True)
        for key in ("state", "automaton_state", "satisfied", "time"):
            assert np.array_equal(mine[4][key], theirs[4][key]) and mine[4][f"_{key}"].all()
        if mode is AutoresetMode.SAME_STEP and (mine[2] | mine[3]).any():
            assert np.array_equal(mine[4]["final_obs"][0], theirs[4]["final_obs"][0]) and mine[4]["_final_obs"].all()
            assert np.array_equal(mine[4]["final_info"]["state"], theirs[4]["final_info"]["state"])
            assert mine[4]["final_info"]["time"][0] == theirs[4]["final_info"]["time"][0]
        ends += int((mine[2] | mine[3]).sum())
    assert ends >= 3


@each_kind
def test_a_batch_is_the_core_until_a_world_ends(id: str) -> None:
    envs = cg.vector_env(id, 16, actions="input")
    dynamics = core.Dynamics.of(envs.problem)
    rng, moves = np.random.default_rng(7), np.random.default_rng(8)
    envs.reset(seed=7)
    worlds = core.initial(dynamics, rng, 16)
    for _ in range(envs.problem.horizon):
        box = envs.action_space
        assert isinstance(box, gymnasium.spaces.Box)
        action = np.asarray(moves.uniform(box.low, box.high))
        inputs = []
        for block in dynamics.blocks:
            ends = np.cumsum([0, *(agent.n_inputs for agent in envs.problem.agents)])
            columns = ends[block.agents] + np.arange(block.n_inputs)[:, None]
            inputs.append(action.T[columns])
        observations, rewards, terminated, truncated, infos = envs.step(action)
        worlds = core.transition(dynamics, worlds, inputs, core.noise(dynamics, rng, 16))
        assert (infos["state"] == core.joint(dynamics, worlds)).all() and (infos["automaton_state"] == worlds.q).all()
        assert (rewards == core.satisfied(dynamics, worlds)).all()
        assert envs.observation_space.contains(observations)
        if (terminated | truncated).any():
            return
    raise AssertionError


@each_kind
@pytest.mark.parametrize("mode", AutoresetMode)
@pytest.mark.parametrize("reward", ["sparse", "shaped"])
def test_rewards_and_observations_stay_in_bounds(id: str, mode: AutoresetMode, reward: str) -> None:
    envs = cg.vector_env(id, 8, autoreset_mode=mode, reward=reward, disturbance_scale=3.0)
    low, high = (0.0, 1.0) if reward == "sparse" else (-1.0, 2.0)
    envs.action_space.seed(0)
    envs.reset(seed=0)
    for _ in range(12):
        observations, rewards, terminated, truncated, _ = envs.step(envs.action_space.sample())
        assert envs.observation_space.contains(observations)
        assert ((low <= rewards) & (rewards <= high)).all() and not (terminated & truncated).any()
        if mode is AutoresetMode.DISABLED and (terminated | truncated).any():
            with pytest.raises(RuntimeError, match="reset_mask"):
                envs.step(envs.action_space.sample())
            _, infos = envs.reset(options={"reset_mask": terminated | truncated})
            assert (infos["time"][terminated | truncated] == 0).all()
            assert (infos["_time"] == (terminated | truncated)).all()


def test_after_an_exit_observation_and_info_are_the_true_state() -> None:
    problem = cg.make_problem("reach-avoid-v0", initial_state=[-10.0, 4.9])
    env, envs = cg.central_env(problem), cg.vector_env(problem, 400)
    env.reset(seed=0)
    envs.reset(seed=0)
    observations, _, terminated, _, infos = envs.step(np.ones((400, 2)))
    out = infos["state"][:, 1] > 5.0
    assert out.sum() > 300 and (terminated == out).all() and (observations[out, 1] > 5.0).all()
    assert (observations[:, :2] == infos["state"]).all()
    observation, _, terminated_one, _, info = env.step(np.ones(2))
    assert terminated_one and info["state"][1] > 5.0 and observation[1] == info["state"][1] and not info["is_success"]


def test_after_an_end_the_next_step_starts_anew_and_ignores_the_action() -> None:
    envs = cg.vector_env("invariance-4-v0", 3, horizon=2)
    envs.reset(seed=0)
    zero = np.zeros((3, 4))
    assert not envs.step(zero)[3].any()
    observations, rewards, _, truncated, infos = envs.step(zero)
    assert truncated.all() and (rewards == 1.0).all() and (infos["time"] == 2).all() and "final_obs" not in infos
    first, rewards, terminated, truncated, infos = envs.step(zero + 1.0)
    assert (infos["time"] == 0).all() and (infos["state"] == 0.0).all() and (first[:, -1] == 1.0).all()
    assert not rewards.any() and not terminated.any() and not truncated.any()
    assert (observations[:, -1] == 0.0).all()


def test_scaled_actions_never_leave_the_input_box_by_rounding() -> None:
    problem, rng = cg.make_problem("reach-avoid-v0"), np.random.default_rng(0)
    skipped = 0
    for _ in range(300):
        low = rng.normal(size=2) * 10.0 ** rng.integers(-3, 4, 2)
        high = low + rng.random(2) * 10.0 ** rng.integers(-3, 4, 2)
        agents = [
            agent.replace(input_low=[a], input_high=[b]) for agent, a, b in zip(problem.agents, low, high, strict=True)
        ]
        boxed = cg.Problem(
            name="boxed",
            horizon=2,
            agents=agents,
            propositions=dict(problem.propositions),
            specification=cg.Specification("F p1", "co-safe"),
        )
        dynamics = core.Dynamics.of(boxed)
        skipped += dynamics.blocks[0].middle_stays_inside
        actions = np.concatenate([[[-1.0] * 2, [1.0] * 2, [-2.0, 2.0]], rng.uniform(-1, 1, (20, 2))])
        (u,) = batch_inputs(dynamics, actions, "unit")
        assert ((low[:, None] <= u[0]) & (u[0] <= high[:, None])).all()
    assert 0 < skipped < 300  # both with the second clip and without it


def test_actions_are_scaled_clipped_and_checked() -> None:
    problem = cg.make_problem("package-delivery-single-v0", disturbance_scale=0.0)
    for given, unit in (([1.0, -0.5], [1.0, -0.5]), ([7.0, -0.25], [9.0, -0.25])):
        states = []
        for env, action in ((cg.central_env(problem, actions="input"), given), (cg.central_env(problem), unit)):
            env.reset(seed=0)
            states.append(env.step(np.array(action))[4]["state"])
        assert (states[0] == states[1]).all()
    env = cg.central_env(problem)
    with pytest.raises(RuntimeError, match="reset"):
        env.step(np.zeros(2))
    env.reset(seed=0)
    for bad in (np.zeros(3), np.array([np.nan, 0.0])):
        with pytest.raises(ValueError, match="`action`: expected"):
            env.step(bad)
    envs = cg.vector_env(problem, 2)
    with pytest.raises(RuntimeError, match="reset"):
        envs.step(np.zeros((2, 2)))
    envs.reset(seed=[1, 2])
    for bad in (np.zeros((2, 3)), np.full((2, 2), np.inf)):
        with pytest.raises(ValueError, match="`actions`: expected finite numbers of shape"):
            envs.step(bad)
    with pytest.raises(ValueError, match="`reset_mask`: expected 2 Booleans"):
        envs.reset(options={"reset_mask": np.zeros(2, dtype=bool)})


def test_observations_are_local_or_full_in_either_precision() -> None:
    problem = mixed_problem()
    local, full = (cg.parallel_env(problem, observation=scope) for scope in ("local", "full"))
    small = cg.parallel_env(problem, observation="full", dtype="float32")
    seen = [env.reset(seed=3)[0] for env in (local, full, small)]
    states = {name: info["state"] for name, info in full.reset(seed=3)[1].items()}
    n_q = problem.automaton.n_states
    for name in problem.agent_names:
        others = [states[other] for other in problem.agent_names if other != name]
        d = len(states[name])
        assert (seen[0][name][:d] == states[name]).all() and len(seen[0][name]) == d + n_q + 1
        assert (seen[1][name] == np.concatenate([states[name], *others, seen[0][name][d:]])).all()
        assert seen[2][name].dtype == np.float32 and (seen[2][name] == seen[1][name].astype(np.float32)).all()
        for env, observations in zip((local, full, small), seen):
            assert env.observation_space(name).contains(observations[name])
    assert small.state_space.contains(small.state()) and small.state().dtype == np.float32


def test_reset_options_replace_the_start_of_every_form() -> None:
    options = {"initial_state": [-7.0, -3.0]}
    env, envs = cg.central_env("reach-avoid-v0"), cg.vector_env("reach-avoid-v0", 2)
    assert env.reset(seed=0, options=options)[1]["state"].tolist() == [-7.0, -3.0]
    assert envs.reset(seed=0, options=options)[1]["state"].tolist() == [[-7.0, -3.0]] * 2
    assert envs.reset(seed=0)[1]["state"][0].tolist() != [-7.0, -3.0]


@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
def test_worlds_rest_that_a_start_has_settled(mode: str) -> None:
    """A start of `reset` may settle a task that no start of the problem settles."""
    envs = cg.vector_env("reach-avoid-v0", 2, autoreset_mode=mode)
    envs.reset(seed=0)
    envs.reset(options={"initial_state": [4.0, 4.0], "reset_mask": np.array([False, True])})
    _, rewards, terminated, _, infos = envs.step(np.zeros((2, 2)))
    last = infos["final_info"] if mode == "SameStep" else infos
    assert terminated.tolist() == [False, True] and rewards.tolist() == [0.0, 1.0]
    assert last["state"][1].tolist() == [4.0, 4.0] and last["time"].tolist() == [1, 0]


@pytest.mark.parametrize("start", [[-10.0, -3.0], [4.0, 4.0]], ids=["at the horizon", "by the verdict"])
def test_no_step_follows_the_end_of_an_episode(start: list[float]) -> None:
    env = cg.central_env("reach-avoid-v0", horizon=2, initial_state=start)
    env.reset(seed=0)
    ended = False
    while not ended:
        _, _, terminated, truncated, _ = env.step(np.zeros(2))
        ended = terminated or truncated
    with pytest.raises(RuntimeError, match="the episode has ended; call `reset` before `step`"):
        env.step(np.zeros(2))
    env.reset(seed=1)
    assert env.step(np.zeros(2))[4]["time"] <= 1
