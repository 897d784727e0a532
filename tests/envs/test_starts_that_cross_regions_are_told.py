"""Starts that a task tells apart are told at once, with boxes that are the starts together and cross no region."""

from __future__ import annotations

import numpy as np
import pytest

from certigym.envs.tasks.problem import crossed_starts, problem_from_toml
from certigym.envs.tasks.problem.start_boxes import _pieces, _share

CROSSED = """
name = "crossed"
horizon = 4
specification = "F goal"
[[agents]]
name = "a"
states = ["x", "v"]
inputs = ["u"]
dynamics = ["x + 0.1*v", "v + 0.1*sin(x) + u"]
noise_std = [0.01, 0.01]
state_low = [-3, -3]
state_high = [3, 3]
input_low = [-1]
input_high = [1]
initial_low = [-0.3, -0.3]
initial_high = [0.3, 0.3]
[propositions]
goal = { agent = "a", low = [-0.2, -0.2], high = [0.2, 0.2] }
"""


def test_the_boxes_are_the_starts_and_cross_nothing() -> None:
    problem = problem_from_toml(CROSSED)
    pieces = _pieces(problem)
    assert len(pieces) == 5 and all(piece.initial_q is not None for piece in pieces)
    assert sum(_share(problem, piece) for piece in pieces) == pytest.approx(1.0, abs=1e-12)
    # Each start is in one box.
    starts = np.random.default_rng(0).uniform(-0.3, 0.3, (1000, 2))
    boxes = [piece.agents[0].initial for piece in pieces]
    assert np.all(sum(np.all((box.low <= starts) & (starts < box.high), axis=1).astype(int) for box in boxes) == 1)
    assert "`goal`" in crossed_starts(problem) and "[(-0.2, -0.2), (0.2, 0.2)) with 0.4444" in crossed_starts(problem)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (("high = [0.2, 0.2] }", "high = [0.4, 0.4] }"), "with 0.6944 of them"),
        (
            ("low = [-0.2, -0.2], high = [0.2, 0.2]", "disc = { centre = [0, 0], radius = 0.2 }"),
            "within regions, or bey",
        ),
        (("F goal", "true U goal"), "0.4444"),
        (("initial_low = [-0.3, -0.3]", "initial_low = [-0.3, 0.1]"), "with 0.3333"),
        (("low = [-0.2, -0.2], high = [0.2, 0.2]", "low = [-0.4, -0.4], high = [0.4, 0.4]"), ""),
        (("low = [-0.2, -0.2], high = [0.2, 0.2]", "low = [0.3, -0.2], high = [0.4, 0.2]"), ""),
        (("initial_low = [-0.3, -0.3]\ninitial_high = [0.3, 0.3]", "initial_state = [0.2, 0.0]"), ""),
    ],
)
def test_what_is_said_fits_the_starts(change: tuple[str, str], says: str) -> None:
    said = crossed_starts(problem_from_toml(CROSSED.replace(*change)))
    assert says in said if says else not said


def test_regions_that_the_task_does_not_ask_about_cut_nothing() -> None:
    away = 'away = { agent = "a", low = [0.0, -3], high = [1, 3] }'
    problem = problem_from_toml(CROSSED.replace("F goal", "F goal & F away") + away)
    assert len(_pieces(problem)) > 5
    assert len(_pieces(problem_from_toml(CROSSED + away))) == 5
