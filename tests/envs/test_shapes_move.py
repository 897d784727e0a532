"""Shapes whose centres, corners, normals or tips name the time are, at each time, the shapes that these numbers say."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import certigym as cg
from certigym.envs.simulation import Dynamics
from certigym.envs.simulation.batch_simulator import letters
from certigym.envs.tasks.regions import pieces

HORIZON = 6
TRIANGLE = {"corners": [["0.5*t - 2", 0], ["0.5*t", "0.1*t"], ["0.5*t - 1", 2]]}
SPINNING = {"normal": ["cos(0.5*t)", "sin(0.5*t)"], "offset": "0.5 - 0.2*t"}
CENTRE = ["0.6*t - 2", "2*sin(0.4*t)"]


def robot(linear: bool) -> Any:
    start, noise = [-4.0, 0.0], 0.0025 * np.eye(2)
    boxes = {"state_low": [-5, -5], "state_high": [5, 5], "input_low": [-1.6, -1.6], "input_high": [1.6, 1.6]}
    if linear:
        return cg.LinearAgent(
            name="robot", A=np.eye(2), B=np.eye(2), noise_covariance=noise, initial_state=start, **boxes
        )
    return cg.Agent(
        name="robot", states=["x", "y"], inputs=["u", "v"], dynamics=["x + u", "y + v"], noise_covariance=noise,
        initial_state=start, **boxes,
    )  # fmt: skip


def problem_of(horizon: int = HORIZON, linear: bool = False, **shape: Any) -> cg.Problem:
    propositions = {"moving": cg.Proposition("robot", **shape), "goal": cg.Proposition("robot", [3, -1], [5, 1])}
    return cg.Problem(
        name="moves", horizon=horizon, agents=[robot(linear)], propositions=propositions,
        specification=cg.Specification("!moving U goal", "co-safe"),
    )  # fmt: skip


def held(problem: cg.Problem, time: int, points: np.ndarray) -> np.ndarray:
    """Whether the region holds at states (n, 2), as batches of worlds are judged."""
    found = letters(Dynamics.of(problem), [np.ascontiguousarray(points.T)[:, None]], time)
    names = problem.labeling.names
    return np.array(
        ["moving" in problem.told(n for n, row in zip(names, found, strict=True) if row[k]) for k in range(len(points))]
    )


def disc(time: int, x: np.ndarray) -> np.ndarray:
    return 1.0 - np.hypot(x[:, 0] - (0.6 * time - 2.0), x[:, 1] - 2.0 * np.sin(0.4 * time))


def triangle(time: int, x: np.ndarray) -> np.ndarray:
    corners = np.array([[0.5 * time - 2, 0], [0.5 * time, 0.1 * time], [0.5 * time - 1, 2]])
    edges = zip(corners, np.roll(corners, -1, axis=0), strict=True)
    sides = [(b[0] - a[0]) * (x[:, 1] - a[1]) - (b[1] - a[1]) * (x[:, 0] - a[0]) for a, b in edges]
    return np.min(sides, axis=0)


def spinning(time: int, x: np.ndarray) -> np.ndarray:
    return 0.5 - 0.2 * time - np.cos(0.5 * time) * x[:, 0] - np.sin(0.5 * time) * x[:, 1]


@pytest.mark.parametrize("linear", [False, True])
@pytest.mark.parametrize(
    ("shape", "inside"),
    [
        ({"disc": {"centre": CENTRE, "radius": 1.0}}, disc),
        ({"polygon": TRIANGLE}, triangle),
        ({"halfspace": SPINNING}, spinning),
    ],
)
def test_letters_are_those_of_geometry_at_each_time(shape: dict[str, Any], inside: Any, linear: bool) -> None:
    problem, rng = problem_of(linear=linear, **shape), np.random.default_rng(1)
    for time in range(HORIZON + 1):
        points = rng.uniform(-5.0, 5.0, (300, 2))
        depth = inside(time, points)
        sure = np.abs(depth) > 1e-9
        assert np.array_equal(held(problem, time, points)[sure], (depth > 0.0)[sure])


@pytest.fixture(scope="module")
def certified() -> Any:
    return cg.synthesize(problem_of(disc={"centre": CENTRE, "radius": 1.0}), relation="path")


def test_paths_pass_what_moves(certified: Any) -> None:
    assert certified.certificate.lower_bound > 0.99 and cg.check(certified.certificate)
    report = cg.validate(certified, 10_000, seed=2, confidence=1.0 - 1e-6)
    assert report.ci_high >= certified.certificate.lower_bound


@pytest.mark.parametrize("centre", [["0.6*(t + 1) - 2", "2*sin(0.4*(t + 1))"], ["0.6*t - 2", 0.0], [0.0, 0.4]])
def test_a_path_past_one_shape_is_refused_for_another(certified: Any, centre: Any) -> None:
    """That of the step after, one that moves otherwise, and one that stands still, each in the way of the path."""
    other = problem_of(disc={"centre": centre, "radius": 3.0})
    assert not cg.check(certified.certificate, other)
    assert not cg.check(replace(certified.certificate, problem=other), other)


def test_a_table_that_is_late_by_a_step_is_noticed(certified: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Letters of a compiler that reads the numbers of the step before are not those of geometry."""
    table = pieces._table
    monkeypatch.setattr(pieces, "_table", lambda ends, far, n: table({k + 1: end for k, end in ends.items()}, far, n))
    problem = problem_of(disc={"centre": CENTRE, "radius": 1.0})
    points = np.random.default_rng(3).uniform(-5.0, 5.0, (300, 2))
    assert not np.array_equal(held(problem, 3, points), disc(3, points) > 0.0)


def test_another_horizon_has_outputs_of_its_own() -> None:
    problem = problem_of(disc={"centre": CENTRE, "radius": 1.0})
    longer = problem.replace(horizon=9, initial_state={"robot": [-3.0, 0.0]})
    assert longer.fingerprint == problem_of(9, disc={"centre": CENTRE, "radius": 1.0}).replace(
        initial_state={"robot": [-3.0, 0.0]}
    ).fingerprint  # fmt: skip
    assert longer.agents[0].n_outputs == problem.agents[0].n_outputs + 3


def test_headings_move_through_pi_and_in_every_turn() -> None:
    start, end = "pi - 0.8 + 0.3*t", "-pi + 0.4 + 0.3*t"
    problem = problem_of(heading={"of": "y", "from": start, "to": end})
    points = np.random.default_rng(2).uniform(-5, 5, (2000, 2))
    for time in range(HORIZON + 1):
        inside = (points[:, 1] - (np.pi - 0.8 + 0.3 * time)) % (2 * np.pi) < 1.2
        assert np.array_equal(held(problem, time, points), inside)


def test_a_heading_that_moves_is_met_and_no_other_one(certified: Any) -> None:
    agent = cg.Agent(
        name="robot", states=["x", "y"], inputs=["u", "v"], dynamics=["x + u", "y + v"],
        noise_covariance=0.0025 * np.eye(2), state_low=[-5, -7], state_high=[5, 7],
        input_low=[-1, -1], input_high=[1, 1], initial_state=[0, 0],
    )  # fmt: skip

    def turning(rate: float) -> cg.Problem:
        ends = {"of": "y", "from": f"2.5 + {rate}*t", "to": f"{3.5 - 2 * np.pi} + {rate}*t"}
        return cg.Problem(
            name="turns", horizon=8, agents=[agent], propositions={"p": cg.Proposition("robot", heading=ends)},
            specification=cg.Specification("F[7,8] p", "co-safe"),
        )  # fmt: skip

    problem, other = turning(0.2), turning(-0.2)
    result = cg.synthesize(problem)
    assert cg.check(result.certificate, problem)
    assert result.certificate.lower_bound > 0.99
    assert cg.rollout(problem, result.controller, 300).success.mean() > 0.97
    assert not cg.check(replace(result.certificate, problem=other), other)
