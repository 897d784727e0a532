"""The difference of two agents may be in a shape with flat faces: judged as it is, certified below the truth."""

from __future__ import annotations

import json
import pickle
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

import certigym as cg
from certigym.envs.tasks.problem import problem_from_dict
from kinds import mostly_thorough
from pair_problems import judged_by_hand

TRIANGLE = [[-1.5, -1.0], [1.5, -1.0], [0.0, 1.5]]

SHAPES: dict[str, tuple[dict[str, Any], Any]] = {
    "polygon": ({"polygon": {"corners": TRIANGLE}}, lambda d, t: in_polygon(TRIANGLE, d)),
    "polygon of states": (
        {"polygon": {"corners": TRIANGLE}, "of": ["y", "x"]}, lambda d, t: in_polygon(TRIANGLE, d[::-1])
    ),
    "polygon in t": (
        {"polygon": {"corners": [[f"{x} + 0.1*t", y] for x, y in TRIANGLE]}},
        lambda d, t: in_polygon([[x + 0.1 * t, y] for x, y in TRIANGLE], d),
    ),
    "halfspace": (
        {"halfspace": {"normal": [-1, -2], "offset": "-4 - 0.1*t"}}, lambda d, t: d[0] + 2 * d[1] >= 4 + 0.1 * t
    ),
    "polytope": (
        {"polytope": {"normals": [[1, 1], [-1, 0], [0, -1]], "offsets": [1, 1, 1]}},
        lambda d, t: (d[0] + d[1] <= 1) & (d[0] >= -1) & (d[1] >= -1),
    ),
    "cone": (
        {"cone": {"tip": [-1, 0], "axis": [1, 0], "angle": 1.2}}, lambda d, t: np.abs(np.arctan2(d[1], d[0] + 1)) < 0.6
    ),
}  # fmt: skip


def in_polygon(corners: list[list[float]], p: np.ndarray) -> Any:
    """Return whether points (2, n) lie on one side of all edges, by cross products."""
    sides = [(b[0] - a[0]) * (p[1] - a[1]) - (b[1] - a[1]) * (p[0] - a[0]) for a, b in pairwise([*corners, corners[0]])]
    return np.min(sides, axis=0) > 0


def written(name: str, start: list[float]) -> cg.Agent:
    return cg.Agent(
        name=name, states=["x", "y"], inputs=["u", "v"], dynamics=["x + u", "y + v"],
        noise=[{"law": "gaussian", "std": 0.08}] * 2, state_low=[-6, -6], state_high=[6, 6], input_low=[-1, -1],
        input_high=[1, 1], initial_state=start,
    )  # fmt: skip


def linear(name: str, start: list[float]) -> cg.LinearAgent:
    return cg.LinearAgent(
        name=name, A=np.eye(2), B=np.eye(2), noise_covariance=0.0064 * np.eye(2), state_low=[-6, -6],
        state_high=[6, 6], input_low=[-1, -1], input_high=[1, 1], initial_state=start,
    )  # fmt: skip


def problem_of(formula: str, near: dict[str, Any], kind: Any = written, horizon: int = 12) -> cg.Problem:
    return cg.Problem(
        name="polygons", horizon=horizon, agents=[kind("one", [-4, 0]), kind("two", [4, -0.2])],
        propositions={"there": cg.Proposition("one", [3, -1], [5, 1]), "near": cg.Pair(["one", "two"], **near)},
        specification=cg.Specification(formula, "co-safe"),
    )  # fmt: skip


@mostly_thorough("name", SHAPES)
@mostly_thorough("kind", [written, linear])
def test_a_difference_is_in_a_shape_where_geometry_says(name: str, kind: Any) -> None:
    near, wanted = SHAPES[name]
    if kind is linear and "of" in near:
        near = {**near, "of": [1, 0]}
    problem = problem_of("F (near & there)", near, kind)
    assert all(type(agent) is type(own) for agent, own in zip(problem.agents, problem.written_agents, strict=True))
    states = np.random.default_rng(5).uniform(-3, 3, (4, 600))
    for time in (0, 5, 12):
        labeling = problem.labeling.at(time)
        found = np.array([labeling.letter([x[:2], x[2:]])[1] for x in states.T])
        assert np.array_equal(found, wanted(states[:2] - states[2:], time))
        assert 0.02 < found.mean() < 0.98
    again = problem_from_dict(json.loads(json.dumps(problem.to_dict())))
    assert again.fingerprint == problem.fingerprint == pickle.loads(pickle.dumps(problem)).fingerprint


@mostly_thorough(
    ("name", "formula"), [*((name, "!near U there") for name in SHAPES), (next(iter(SHAPES)), "F (near & there)")]
)
def test_what_is_certified_is_checked_and_met(name: str, formula: str) -> None:
    from certigym.validation.statistical_tests import Loop, paths

    near, wanted = SHAPES[name]
    problem = problem_of(formula, near)
    result = cg.synthesize(problem)
    assert cg.check(result.certificate, problem)
    assert result.certificate.lower_bound > 0.99
    states, success = paths(Loop(problem, result.controller, 5, 150), 150)
    assert np.array_equal(success, judged_by_hand(states, wanted, formula))
    assert success.mean() > 0.97


@pytest.mark.parametrize(
    "wrong",
    [
        {"polygon": {"corners": [[-y, x] for x, y in TRIANGLE]}},
        {"polygon": {"corners": [[0.1 * x, 0.1 * y] for x, y in TRIANGLE]}},
        {"polygon": {"corners": [[x + 2, y] for x, y in TRIANGLE]}},
        {"halfspace": {"normal": [0, -1], "offset": 1}},
    ],
)
def test_certificates_of_other_shapes_are_refused(wrong: dict[str, Any]) -> None:
    """As they are, and with the problem that is meant put in."""
    made, meant = (problem_of("F (near & there)", near) for near in (SHAPES["polygon"][0], wrong))
    certificate = cg.synthesize(made, relation="path").certificate
    assert cg.check(certificate, made)
    assert not cg.check(certificate, meant)
    assert not cg.check(replace(certificate, problem=meant), meant)


@pytest.mark.parametrize(
    ("near", "said"),
    [
        ({"disc": {"centre": [0, 0], "radius": 1}}, "`disc`: expected a box, a distance, or one of polygon"),
        ({"polygon": {"corners": TRIANGLE}, "of": ["x", "z"]}, "the states are x, y"),
        ({"polygon": {"corners": [[x + 30, y] for x, y in TRIANGLE]}}, "that differences of one and two can meet"),
    ],
)
def test_what_cannot_be_is_refused_in_words(near: dict[str, Any], said: str) -> None:
    with pytest.raises(ValueError, match=r"[`:]") as caught:
        problem_of("F near", near)
    assert said in str(caught.value)
