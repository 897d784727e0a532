"""Environments of the suite have Gymnasium's specification: horizon, threshold, and how to make them again."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec

import certigym as cg
from certigym.envs.suite.certified_bounds import CERTIFIED
from certigym.envs.suite.ids import gymnasium_id
from kinds import IDS_OF_KINDS

DEFAULTS = Path(__file__).parents[2] / "docs" / "defaults.json"


@pytest.mark.parametrize("id", IDS_OF_KINDS)
def test_ids_say_how_long_episodes_are_and_what_can_be_reached(id: str) -> None:
    problem = cg.make_problem(id)
    doors: list[Any] = [gymnasium.make(f"certigym/{id}"), gymnasium.make(gymnasium_id(id)), cg.central_env(id)]
    doors += [cg.vector_env(id, 2), gymnasium.make_vec(gymnasium_id(id), num_envs=2)]
    for env in doors:
        assert env.spec is not None
        assert env.spec.max_episode_steps == problem.horizon
        assert env.spec.reward_threshold == CERTIFIED[id]


def test_thresholds_are_the_recorded_bounds_rounded_down() -> None:
    recorded = json.loads(DEFAULTS.read_text(encoding="utf-8"))
    assert {id: math.floor(1e9 * recorded[id]["certified"]) / 1e9 for id in cg.problem_ids()} == CERTIFIED


@pytest.mark.parametrize("changes", [{"horizon": 9}, {"reward": "progress"}, {"sensor_noise": 0.1}, {"discount": 0.9}])
def test_what_is_changed_has_no_threshold(changes: dict[str, Any]) -> None:
    env = gymnasium.make("certigym/ReachAvoid-v0", **changes)
    assert env.spec is not None
    assert env.spec.reward_threshold is None
    assert env.spec.max_episode_steps == changes.get("horizon", 7)


def test_a_specification_makes_the_same_environment_again() -> None:
    env = gymnasium.make("certigym/ReachAvoid-v0", horizon=9, preset="learner")
    assert env.spec is not None
    again = gymnasium.make(EnvSpec.from_json(env.spec.to_json()))
    assert again.unwrapped.problem.fingerprint == env.unwrapped.problem.fingerprint  # type: ignore[attr-defined]
    assert again.observation_space == env.observation_space
    many = gymnasium.make_vec(EnvSpec.from_json(env.spec.to_json()), num_envs=2)
    assert many.single_observation_space == env.observation_space


def test_one_preset_gives_learners_the_same_spaces_by_every_door() -> None:
    central, many = (
        cg.central_env("reach-avoid-v0", preset="learner"),
        cg.vector_env("reach-avoid-v0", preset="learner"),
    )
    parallel, team = (
        cg.parallel_env("reach-avoid-v0", preset="learner"),
        cg.team_env("reach-avoid-v0", 2, preset="learner"),
    )
    spaces: list[Any] = [central.observation_space, central.action_space]
    spaces += [many.single_observation_space, many.single_action_space]
    spaces += [parallel.observation_space("agent_0"), parallel.action_space("agent_0")]
    for space in spaces:
        assert space.dtype == np.float32
        assert np.all(np.abs(space.low) <= 1.0)
        assert np.all(np.abs(space.high) <= 1.0)
    observations, _ = parallel.reset(seed=0)
    assert np.allclose(team.reset(seed=0).observations["agent_0"][0], observations["agent_0"])
    assert cg.central_env("reach-avoid-v0", preset="learner", dtype="float64").observation_space.dtype == np.float64
    with pytest.raises(ValueError, match="`preset`: expected None or 'learner'"):
        cg.central_env("reach-avoid-v0", preset="fast")
