"""A recording holds the episodes of `rollout` with its seed: verdicts, transitions, and what environments show."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import certigym as cg
from certigym.baselines import RandomController, Recording, record_tiers
from certigym.cli.main import main
from certigym.validation.policies import recording
from certigym.validation.policies.rollout_policies import NoisyController, as_controller
from problems import linear

TIERED = "reach-avoid-20-v0"
IDS = ["invariance-v0", "meeting-v0"]


def recorded(id: str, episodes: int = 250) -> Recording:
    return cg.record(id, RandomController(), episodes, seed=5, chunk=100)


@pytest.mark.parametrize("id", IDS)
def test_verdicts_are_those_of_the_rollouts(id: str) -> None:
    found, run = recorded(id), cg.rollout(id, RandomController(), 250, seed=5, chunk=100)
    assert np.array_equal(found.satisfied, run.success)
    # Only an episode without a verdict lasts to the horizon for sure.
    assert (found.lengths[~found.decided] == found.problem.horizon).all()


@pytest.mark.parametrize("id", IDS)
def test_episodes_are_whole_and_stop_where_they_are_decided(id: str) -> None:
    problem, found = cg.make_problem(id), recorded(id)
    times = np.arange(problem.horizon + 1)
    held = times <= found.lengths[:, None]
    assert np.array_equal(np.isfinite(found.states).all(axis=2), held)
    assert np.array_equal(found.automaton_states >= 0, held)
    assert np.array_equal(np.isfinite(found.inputs).all(axis=2), times[:-1] < found.lengths[:, None])
    for agent, columns in zip(problem.agents, problem.input_columns, strict=True):
        given = found.inputs[..., columns]
        assert np.nanmin(given) >= np.min(agent.input_low) and np.nanmax(given) <= np.max(agent.input_high)


def test_states_follow_from_inputs_and_noise_of_the_right_size() -> None:
    """x' - (A x + B u) is the noise: its mean square over 1,000 or more numbers strays by less than a third (a chi
    square quantile of 1e-6 on either side)."""
    problem, found = cg.make_problem("reach-avoid-v0"), recorded("reach-avoid-v0", 1000)
    for agent, x_columns, u_columns in zip(problem.agents, problem.columns, problem.input_columns, strict=True):
        before, after = found.states[:, :-1, x_columns], found.states[:, 1:, x_columns]
        mean = before @ linear(agent).A.T + found.inputs[..., u_columns] @ linear(agent).B.T
        noise = (after - mean)[np.isfinite(after)]
        assert len(noise) >= 1000
        deviation = float(np.sqrt(np.sum(np.square(agent.noise_factor))))
        assert 2 / 3 < np.mean(noise**2) / deviation**2 < 4 / 3


def test_observations_are_those_of_the_environment() -> None:
    found = recorded("meeting-v0", 20)
    env = cg.central_env("meeting-v0")
    seen = found.observations()
    for k in range(20):
        for t in range(int(found.lengths[k]) + 1):
            assert env.observation_space.contains(seen[k, t])
    first, _ = env.reset(options={"initial_state": found.states[0, 0]})
    assert np.array_equal(first, seen[0, 0])


def test_files_name_problem_policy_and_seed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "data.npz"
    words = ["record", "reach-avoid-v0", "--policy", "random", "--episodes", "120", "--seed", "3"]
    assert main([*words, "--out", str(path)]) == 0
    assert "120 episodes" in capsys.readouterr().out
    again = cg.record("reach-avoid-v0", RandomController(), 120, seed=3)
    with np.load(path, allow_pickle=False) as stored:
        header = json.loads(str(stored["header"]))
        assert np.array_equal(stored["states"], again.states, equal_nan=True)
        assert np.array_equal(stored["inputs"], again.inputs, equal_nan=True)
    assert header["fingerprint"] == again.problem.fingerprint and header["seed"] == 3
    assert header["information"] == again.information and header["format"] == "certigym recording 1"


def test_a_dataset_of_minari_holds_the_same(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    minari: Any = pytest.importorskip("minari", reason="needs the extra `data`")
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    found = recorded("reach-avoid-v0", 30)
    about = {"author": "a", "author_email": "b", "code_permalink": "c"}  # Minari warns without
    dataset = found.to_minari("certigym/reach-avoid/random-v0", **about)
    assert dataset.total_episodes == 30 and dataset.total_steps == found.lengths.sum()
    for k, episode in enumerate(minari.load_dataset("certigym/reach-avoid/random-v0").iterate_episodes()):
        n = int(found.lengths[k])
        assert np.array_equal(episode.actions, found.inputs[k, :n])
        assert np.array_equal(episode.observations, found.observations()[k, : n + 1])
        assert episode.rewards.sum() == found.satisfied[k]
        assert episode.terminations[-1] != episode.truncations[-1]
    recovered = minari.load_dataset("certigym/reach-avoid/random-v0").recover_environment()
    assert recovered.unwrapped.problem.fingerprint == found.problem.fingerprint
    assert recovered.action_space == dataset.action_space
    assert recovered.observation_space == dataset.observation_space


def expert(x: np.ndarray, q: int, t: int) -> np.ndarray:
    """Bring agents back to the middle: .98 on this problem, where random inputs have .005."""
    return np.clip(-x, -2.0, 2.0)


@pytest.mark.thorough
def test_tiers_are_random_inputs_half_of_the_gain_and_the_expert(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recording, "HALVINGS", 5)
    monkeypatch.setattr(recording, "rollout", partial(cg.rollout, chunk=500))
    found = record_tiers(TIERED, expert, 400, seed=5, chunk=400)
    rates = {tier: float(data.satisfied.mean()) for tier, data in found.items()}
    assert list(rates) == ["random", "medium", "expert"]
    # The share is found with 1,000 episodes: three deviations of a rate on 400 are .075.
    assert abs(rates["medium"] - 0.5 * (rates["random"] + rates["expert"])) < 0.1, rates
    assert rates["expert"] > 0.9 > 0.1 > rates["random"]
    assert "random inputs at" in found["medium"].information


@pytest.mark.parametrize("share", [0.0, 0.25, 1.0])
def test_noisy_controllers_draw_as_many_inputs_as_they_say(share: float) -> None:
    """Within five deviations of the share of inputs that are not the expert's."""
    problem = cg.make_problem(TIERED)
    found = cg.record(problem, NoisyController(as_controller(problem, expert), share, "x"), 200, seed=3, chunk=200)
    own = np.isclose(found.inputs, np.clip(-found.states[:, :-1], -2.0, 2.0))[np.isfinite(found.inputs)]
    assert abs((1.0 - own.mean()) - share) <= 5.0 * np.sqrt(share * (1.0 - share) / own.size)


def test_exits_are_seen_where_they_happen() -> None:
    """Inputs that push outwards: all episodes that left their workspace seemed to end at its edge."""
    problem = cg.make_problem("reach-avoid-v0")
    found = cg.record(problem, lambda x, q, t: np.full_like(x, 4.0), 400)
    last = found.states[np.arange(400), found.lengths]
    low, high = (np.concatenate([getattr(a, end) for a in problem.agents]) for end in ("state_low", "state_high"))
    out = np.any((last < low) | (last > high), axis=1)
    assert out.sum() > 100
    seen = found.observations()
    d = problem.n_states
    for k in range(400):
        assert np.array_equal(seen[k, : found.lengths[k] + 1, :d], found.states[k, : found.lengths[k] + 1])
        assert cg.central_env(problem).observation_space.contains(seen[k, found.lengths[k]])
