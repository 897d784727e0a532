"""Learners start from a clone and say so, go on where they stopped, and keep their best actor."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import certigym as cg
from certigym.validation.policies import imitation
from certigym.validation.policies.actors import networks_of
from certigym.validation.policies.views import SharedView

pytestmark = pytest.mark.thorough

pytest.importorskip("stable_baselines3", reason="needs the extra `rl`")

RA2 = cg.make_problem("reach-avoid-v0")
SMALL: dict[str, Any] = {"worlds": 8, "n_steps": 16, "batch_size": 128}


@pytest.fixture(scope="module", autouse=True)
def short_cloning() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(imitation, "ROUNDS", 400)
        yield


@pytest.fixture(scope="module")
def certificate() -> Any:
    return cg.synthesize(RA2, 60, relation="exact").certificate


@pytest.fixture(scope="module")
def helped(certificate: Any) -> Any:
    return cg.train(RA2, "ppo", 256, 1, warm_start=certificate, **SMALL)


def test_a_warm_start_is_good_at_once_and_says_that_it_was_helped(helped: Any, certificate: Any) -> None:
    """2,000 episodes at a success of .97 or more fall below .9 with a probability of less than 1e-6."""
    assert cg.rollout(RA2, helped.actor, 2000, seed=9).successes > 1800
    assert helped.help and helped.help in helped.information and helped.to_dict()["help"] == helped.help
    entry = cg.compare(RA2, {"helped": helped}, 100).entries[0]
    assert helped.help in entry.information
    assert [phase["reward"] for phase in helped.settings["phases"]] == ["sparse"]
    cold = cg.train(RA2, "ppo", 256, 1, **SMALL)
    assert cold.help == "" and cg.rollout(RA2, cold.actor, 2000, seed=9).successes < 1800


def test_a_learner_goes_on_where_it_stopped(helped: Any, tmp_path: Path) -> None:
    helped.save(tmp_path / "first")
    again = cg.train(RA2, "ppo", 128, 2, resume=tmp_path / "first", **SMALL)
    assert again.help == helped.help and again.settings["hidden"] == helped.settings["hidden"]
    assert cg.rollout(RA2, again.actor, 2000, seed=9).successes > 1800
    header, *lines = (tmp_path / "first" / "curve.csv").read_text().splitlines()
    assert header == "steps,seconds,episodes,success,return" and len(lines) == len(helped.curve) > 0
    for name, message in (("nowhere", "training.json and model.zip"), ("first", "'ppo' on 'reach-avoid-v0'")):
        with pytest.raises(ValueError, match=message):
            cg.train("reach-avoid-v0", "central-ppo", 64, resume=tmp_path / name)


def test_the_learner_ends_with_the_numbers_of_its_best_actor(helped: Any) -> None:
    rows = np.random.default_rng(0).uniform(-1.0, 1.0, (20, SharedView(RA2).size)).astype(np.float32)
    expected, _ = helped.model.predict(rows, deterministic=True)
    assert networks_of(helped.actor)[0].actions(rows) == pytest.approx(np.clip(expected, -1, 1), abs=1e-5)
