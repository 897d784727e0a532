"""Agents with own parameters share none, and a central critic stays out of the actors."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import certigym as cg
from certigym.envs.simulation import Dynamics, joint
from certigym.envs.simulation.batch_simulator import initial
from certigym.validation.policies import imitation
from certigym.validation.policies.actors import TeamActor, load_actor, networks_of
from certigym.validation.policies.learning import new_learner
from certigym.validation.policies.settings import settings_for
from certigym.validation.policies.views import SharedView, TeamView
from certigym.validation.statistical_tests import mean_limits

pytestmark = pytest.mark.thorough

pytest.importorskip("stable_baselines3", reason="needs the extra `rl`")

RA2 = cg.make_problem("reach-avoid-v0")
SMALL: dict[str, Any] = {"worlds": 8, "n_steps": 16, "batch_size": 128}


@pytest.fixture(scope="module")
def certificate() -> Any:
    return cg.synthesize(RA2, 60, relation="exact").certificate


def rows_of(view: Any, seed: int = 0) -> np.ndarray:
    """Rows of 30 worlds at starts of the problem."""
    dynamics = Dynamics.of(RA2)
    worlds = initial(dynamics, np.random.default_rng(seed), 30)
    states = joint(dynamics, worlds) + np.random.default_rng(seed).normal(size=(30, RA2.n_states))
    return np.asarray(view.observations(states, worlds.q, np.full(30, 2)))


def test_only_the_critic_sees_the_other_agents() -> None:
    import torch

    view = TeamView(RA2)
    model: Any = new_learner("mappo", view, settings_for("mappo", view, steps=100, **SMALL), 0)
    rows = rows_of(view)
    changed = rows.copy()
    changed[:, view.seen :] = np.random.default_rng(1).uniform(-1, 1, (60, 2))
    (before, _), (after, _) = (model.predict(r, deterministic=True) for r in (rows, changed))
    assert np.array_equal(before, after)
    with torch.no_grad():
        values = [model.policy.predict_values(torch.as_tensor(r)).numpy() for r in (rows, changed)]
    assert np.abs(values[0] - values[1]).min() > 0.0


def test_agents_share_no_parameters() -> None:
    import torch

    view = SharedView(RA2)
    model: Any = new_learner("ippo", view, settings_for("ippo", view, steps=100, **SMALL), 0)
    rows = torch.as_tensor(rows_of(view)[::2])  # rows of the first agent alone
    values, log_probability, _ = model.policy.evaluate_actions(rows, torch.zeros((30, 1)))
    (values.sum() + log_probability.sum()).backward()
    networks = model.policy.mlp_extractor
    for kind in (networks.actors, networks.critics):
        assert all(p.grad is not None and p.grad.abs().sum() > 0 for p in kind[0].parameters())
        assert all(p.grad is None or not p.grad.any() for p in kind[1].parameters())
    held = {id(p) for group in model.policy.optimizer.param_groups for p in group["params"]}
    assert {id(p) for p in networks.parameters()} <= held, "the optimizer moves the networks that are used"


@pytest.mark.parametrize("algorithm", ["ippo", "mappo"])
def test_helped_teams_are_good_at_once_and_travel(
    algorithm: str, certificate: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """2,000 episodes at a success of .97 or more fall below .9 with a probability of less than 1e-6."""
    monkeypatch.setattr(imitation, "ROUNDS", 400)
    training = cg.train(RA2, algorithm, 256, 1, warm_start=certificate, **SMALL)
    assert cg.rollout(RA2, training.actor, 2000, seed=9).successes > 1800
    view: Any = TeamView(RA2) if algorithm == "mappo" else SharedView(RA2)
    rows = rows_of(view)
    expected, _ = training.model.predict(rows, deterministic=True)
    again = load_actor(training.save(tmp_path / algorithm), RA2)
    assert isinstance(again, TeamActor) == (algorithm == "ippo")
    for actor in (training.actor, again):
        networks = networks_of(actor)
        for agent in range(2):
            own = networks[agent % len(networks)].actions(rows[agent::2, : SharedView(RA2).size])
            assert own == pytest.approx(np.clip(expected[agent::2], -1, 1), abs=1e-5)
    assert ("for each agent" in repr(training)) == (algorithm == "ippo")
    resumed = cg.train(RA2, algorithm, 128, 2, resume=tmp_path / algorithm, **SMALL)
    assert cg.rollout(RA2, resumed.actor, 2000, seed=9).successes > 1800


def test_limits_of_a_mean_are_student_limits() -> None:
    """Over normal rates they cover as often as they say: 2,000 of 2,000 trials with p = .9 leave [.861, .935] with a
    probability below 1e-6."""
    rng = np.random.default_rng(5)
    limits = [mean_limits(rng.normal(0.5, 0.02, 4).tolist(), 0.9) for _ in range(2000)]
    assert 0.861 < np.mean([low <= 0.5 <= high for low, high in limits]) < 0.935
    assert mean_limits([1.0, 0.9], 0.99) == (0.0, 1.0)
    with pytest.raises(ValueError, match="at least two"):
        mean_limits([0.5], 0.9)
