"""A share of the episodes of a learner begins anywhere, undecided, and tells no success."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import certigym as cg

pytest.importorskip("stable_baselines3", reason="needs the extra `rl`")

from certigym.baselines import shared_vec_env
from certigym.validation.policies import training
from certigym.validation.policies.scattered_batches import ScatteredVectorEnv


@pytest.mark.parametrize(("id", "stages"), [("patrol-robot-v0", {0, 1, 2}), ("swarm-v0", {0}), ("invariance-v0", None)])
def test_starts_are_undecided_and_elsewhere(id: str, stages: set[int] | None) -> None:
    problem = cg.make_problem(id)
    envs = ScatteredVectorEnv(problem, 0.5, 400, autoreset_mode="SameStep", reward="progress")
    _, infos = envs.reset(seed=0)
    away = envs.scattered
    assert (infos["time"][~away] == 0).all()
    if stages is None:  # survival has no later stages
        assert not away.any()
        return
    assert 0.25 < away.mean() < 0.6 and set(infos["automaton_state"][away].tolist()) == stages
    assert (infos["time"][away] < problem.horizon).all() and len(np.unique(infos["time"][away])) > 5
    assert (infos["state"][away].std(axis=0) > 0.1 * infos["state"].std(axis=0)).all()


def test_episodes_that_begin_anywhere_tell_no_success() -> None:
    env, told = shared_vec_env(cg.make_problem("patrol-robot-v0"), 50, reward="progress", spread=0.4), [0, 0]
    env.seed(0), env.reset()
    for _ in range(40):
        before = env.worlds.scattered.copy()
        _, _, ended, infos = env.step(np.zeros((50, 2), np.float32))
        for world in np.flatnonzero(ended):
            assert ("is_success" in infos[world]) != before[world] and "episode" in infos[world]
            told[int(before[world])] += 1
    assert min(told) > 10


@pytest.mark.parametrize(
    ("id", "successes", "again"),
    [("patrol-robot-v0", 0.0, True), ("patrol-robot-v0", 0.5, False), ("invariance-v0", 0.0, False)],
)
def test_a_learner_without_success_begins_again_with_such_episodes(
    id: str, successes: float, again: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    spreads, weights = list[float](), list[np.ndarray]()

    def learned(model: Any, view: Any, piece: Any, watcher: Any) -> None:
        weights.append(training.networks_of(training.actor_now(model, view))[0].weights[0])
        spreads.append(piece.spread)
        learn(model, view, piece, watcher)

    learn = training.learn
    monkeypatch.setattr(training, "learn", learned)
    monkeypatch.setattr(training, "score", lambda *_, **__: successes)
    training.train(id, steps=7680, seed=3, worlds=4, n_steps=128, n_epochs=1)
    alone = training.PATIENCE
    assert not any(spreads[:alone])
    assert any(spreads) == again == np.array_equal(weights[alone], weights[0])
    if again:
        assert spreads[alone] == 0.6 and all(np.diff(spreads[alone:-2]) < 0.0)
    assert not np.array_equal(weights[alone - 1], weights[0])
