"""A probe clones the certified controllers, improves the clone, and judges it on episodes of their own."""

from __future__ import annotations

import json
from collections.abc import Iterator
from itertools import product
from math import comb
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import certigym as cg
from certigym.cli.main import main
from certigym.validation.policies import Probe, imitation
from certigym.validation.policies.imitation import Demonstrations, demonstrate
from certigym.validation.policies.views import CentralView, SharedView
from certigym.validation.statistical_tests import clopper_pearson, paired_difference

RA2 = cg.make_problem("reach-avoid-v0")


@pytest.fixture(scope="module", autouse=True)
def short_cloning() -> Iterator[None]:
    """A tenth of the regression is enough for a problem of two scalar agents."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(imitation, "ROUNDS", 400)
        yield


@pytest.fixture(scope="module")
def certificate() -> Any:
    return cg.synthesize(RA2, 60, relation="exact").certificate


@pytest.mark.parametrize("view", [SharedView(RA2), CentralView(RA2)])
def test_demonstrations_hold_what_the_controllers_do(view: Any, certificate: Any) -> None:
    """Written-down actions, sent back through the view, are the controllers' inputs at the states that were seen."""
    shown = demonstrate(view, certificate.controller, 40, seed=3, disturbance=0.3)
    joint_actions = view.joint_actions(shown.actions)
    half = np.concatenate([agent.input_high for agent in RA2.agents])
    n, q = len(shown.rows) // view.rows, RA2.automaton.n_states
    assert 40 < n <= 40 * RA2.horizon
    for world in range(0, n, 7):
        rows = shown.rows[world * view.rows : (world + 1) * view.rows]
        # Own states, automaton state and time left, read from the observation.
        states = rows[:, 0] if view.rows == 2 else rows[0, :2]
        low, high = -20.0, 5.0
        tail = rows[0, 1:] if view.rows == 2 else rows[0, 2:]
        time = round((1.0 - float(tail[q])) * RA2.horizon)
        infos = {
            name: {
                "state": np.array([low + (states[k] + 1.0) / 2.0 * (high - low)]),
                "automaton_state": int(np.argmax(tail[:q])),
                "time": time,
            }
            for k, name in enumerate(RA2.agent_names)
        }
        inputs = certificate.controller.act({name: np.zeros(1) for name in infos}, infos)
        # A cell edge may lie between a state and its float32 image; targets of neighbouring cells differ by a cell.
        wanted = np.concatenate([inputs[name] for name in RA2.agent_names]) / half
        assert np.abs(joint_actions[world] - wanted).max() < 25.0 / 60.0 / 5.0 + 1e-3
    assert set(np.unique(shown.outcomes)) <= {0.0, 1.0} and shown.outcomes.mean() > 0.5


def test_demonstrations_repeat_with_a_seed(certificate: Any) -> None:
    runs: list[Demonstrations] = [demonstrate(SharedView(RA2), certificate.controller, 30, seed) for seed in (1, 1, 2)]
    assert np.array_equal(runs[0].rows, runs[1].rows) and np.array_equal(runs[0].actions, runs[1].actions)
    assert not np.array_equal(runs[0].rows[:200], runs[2].rows[:200])
    assert len(repr(runs[0]).splitlines()) <= 4


def test_limits_of_a_paired_difference_cover_exactly() -> None:
    """Against the multinomial distribution, summed in full: no pair of probabilities is missed more often than said."""
    n, confidence = 12, 0.9
    limits = {(a, b): paired_difference(a, b, n, confidence) for a, b in product(range(n + 1), repeat=2) if a + b <= n}
    for p, q in product((0.0, 0.05, 0.2, 0.45), (0.0, 0.1, 0.3, 0.5)):
        covered = sum(
            comb(n, a) * comb(n - a, b) * p**a * q**b * (1.0 - p - q) ** (n - a - b)
            for (a, b), (low, high) in limits.items()
            if low <= p - q <= high
        )
        assert covered >= confidence - 1e-12
    assert limits[5, 2][0] == -limits[2, 5][1]  # the roles may be exchanged
    low, high = clopper_pearson(0, 100, 0.95)
    assert paired_difference(0, 0, 100, 0.9) == (low - high, high - low)
    with pytest.raises(ValueError, match="`episodes`: expected at least 7"):
        paired_difference(3, 4, 6, 0.9)


@pytest.fixture(scope="module")
def found(certificate: Any) -> Probe:
    pytest.importorskip("stable_baselines3", reason="needs the extra `rl`")
    return cg.probe(RA2, certificate, 3000, steps=300, seed=5, confidence=1 - 1e-6)


@pytest.mark.thorough
def test_a_probe_is_judged_on_common_episodes(found: Probe, certificate: Any) -> None:
    """Clone and controllers of a nearly certain task both succeed nearly always; the limits fail once in 1e6 seeds."""
    assert found.only_learned - found.only_certified == found.learned - found.certified
    assert found.gain == pytest.approx((found.learned - found.certified) / 3000)
    assert found.gain_low < found.gain < found.gain_high and found.gain_high - found.gain_low < 0.2
    _, high = clopper_pearson(found.certified, 3000, 1 - 1e-6)
    assert high >= found.lower_bound == certificate.lower_bound > 0.9
    assert found.cloned > 0.9, "an untrained network succeeds in fewer than half of the episodes"
    assert [attempt.deviation for attempt in found.attempts] == [0.2, 0.1, 0.05]
    assert all(300 <= attempt.steps <= 600 for attempt in found.attempts)


@pytest.mark.thorough
def test_the_command_prints_and_writes(certificate: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("stable_baselines3", reason="needs the extra `rl`")
    cg.save(certificate, tmp_path / "c.npz")
    words = ["probe", "reach-avoid-v0", "--certificate", str(tmp_path / "c.npz"), "--steps", "300", "--episodes", "500"]
    assert main([*words, "--json", str(tmp_path / "probe.json")]) == 0
    assert "gain" in capsys.readouterr().out
    assert json.loads((tmp_path / "probe.json").read_text())["episodes"] == 500
