"""A box or a shape is about the states, or outputs, that `of` names, and about nothing else."""

from __future__ import annotations

import json
import math
import pickle
from typing import Any

import numpy as np
import pytest

import certigym as cg
from certigym.envs.tasks.problem import problem_from_dict

NAMES = ["x", "y", "vx", "vy", "heading", "fuel"]
LOW, HIGH = [-9.0, -9.0, -3.0, -3.0, -4.0, 0.0], [9.0, 9.0, 3.0, 3.0, 4.0, 1.0]


def craft(**changes: Any) -> cg.Agent:
    """Six states, two of which are places."""
    data: dict[str, Any] = {
        "states": NAMES, "inputs": ["ax", "ay", "turn"], "noise_covariance": np.diag([1e-3] * 4 + [1e-4, 0.0]),
        "dynamics": ["x + 0.5*vx", "y + 0.5*vy", "vx + 0.5*ax", "vy + 0.5*ay", "heading + 0.2*turn", "fuel"],
        "state_low": LOW, "state_high": HIGH, "input_low": [-1, -1, -1], "input_high": [1, 1, 1],
        "initial_state": [0, 0, 0, 0, 0, 0.5],
    }  # fmt: skip
    return cg.Agent(name="craft", **{**data, **changes})


def cart(**changes: Any) -> cg.LinearAgent:
    """A double integrator of the plane, whose states have numbers alone."""
    data: dict[str, Any] = {
        "A": np.eye(4) + 0.5 * np.eye(4, k=2), "B": np.vstack([np.zeros((2, 2)), 0.5 * np.eye(2)]),
        "noise_covariance": 1e-3 * np.eye(4), "state_low": LOW[:4], "state_high": HIGH[:4], "input_low": [-1, -1],
        "input_high": [1, 1], "initial_state": [0, 0, 0, 0],
    }  # fmt: skip
    return cg.LinearAgent(name="craft", **{**data, **changes})


def problem_of(agent: Any, formula: str = "F p", horizon: int = 8, **regions: dict[str, Any]) -> cg.Problem:
    kind = "finite-trace" if formula.startswith("G") else "co-safe"
    made = {name: cg.Proposition("craft", **region) for name, region in regions.items()}
    return cg.Problem(name="about", horizon=horizon, agents=[agent], propositions=made,
                      specification=cg.Specification(formula, kind))  # fmt: skip


def held(problem: cg.Problem, points: np.ndarray, time: int = 0) -> np.ndarray:
    """Return where the proposition `p`, as it is written, holds."""
    labeling = problem.labeling.at(time)
    classes = labeling.class_at(0, points)
    return np.array(
        ["p" in problem.told(n for n, yes in zip(labeling.names, c, strict=True) if yes) for c in classes.T]
    )


POINTS = np.random.default_rng(4).uniform(LOW, HIGH, (3000, 6)).T
X, Y, VX, VY, H, FUEL = POINTS

ABOUT: dict[str, tuple[dict[str, Any], Any]] = {
    "box": ({"low": [-2, 0], "high": [6, 2], "of": ["vx", "y"]}, (-2 <= VX) & (VX < 6) & (0 <= Y) & (Y < 2)),
    "box in t": ({"low": ["0.5*t"], "high": ["0.5*t + 1"], "of": "vy"}, (1.5 <= VY) & (VY < 2.5)),
    "disc": ({"disc": {"centre": [3, 0.5], "radius": 1.8}, "of": ["vx", "vy"]}, np.hypot(VX - 3, VY - 0.5) < 1.8),
    "disc in t": (
        {"disc": {"centre": ["t", 0.5], "radius": 1.8}, "of": ["vx", "vy"]}, np.hypot(VX - 3, VY - 0.5) < 1.8
    ),
    "ball": (
        {"ball": {"centre": [0, 0, 1], "radius": 3}, "of": ["y", "x", "vy"]}, np.sqrt(Y**2 + X**2 + (VY - 1) ** 2) < 3
    ),
    "polygon": (
        {"polygon": {"corners": [[0, 0], [3, 0], [0, 6]]}, "of": ["vx", "x"]}, (VX >= 0) & (X >= 0) & (2 * VX + X < 6)
    ),
    "halfspace": ({"halfspace": {"normal": [1, 1], "offset": "1 + t"}, "of": ["y", "vy"]}, Y + VY <= 4),
    "polytope": (
        {"polytope": {"normals": [[1, 1], [-1, 0]], "offsets": [2, 1]}, "of": [0, "vy"]}, (X + VY <= 2) & (-X <= 1)
    ),
    "cone": (
        {"cone": {"tip": [-1, 0], "axis": [1, 0], "angle": 1.2}, "of": ["y", "vx"]}, np.abs(np.arctan2(VX, Y + 1)) < 0.6
    ),
    "heading": (
        {"heading": {"from": "pi - 0.5", "to": "-pi + 0.5"}, "of": "heading"},
        np.abs(np.abs(H) - math.pi) < 0.5,
    ),
    "union": (
        {"union": [{"disc": {"centre": [2, 0], "radius": 2}}, {"box": {"low": [0.5], "high": [1], "of": "fuel"}}],
         "of": ["vx", "vy"]},
        (np.hypot(VX - 2, VY) < 2) | (FUEL >= 0.5),
    ),
    "complement": (
        {"complement": {"disc": {"centre": [2, 0], "radius": 2}}, "of": ["vx", "vy"]}, np.hypot(VX - 2, VY) >= 2
    ),
}  # fmt: skip


def numbered(value: Any) -> Any:
    """Return what is written of a region with the numbers of states in the place of their names."""
    if isinstance(value, list):
        return [numbered(item) for item in value]
    if isinstance(value, dict):
        return {key: numbered(item) for key, item in value.items()}
    return NAMES.index(value) if isinstance(value, str) and value in NAMES else value


@pytest.mark.parametrize("name", ABOUT)
@pytest.mark.parametrize("is_linear", [False, True])
def test_a_region_holds_where_the_states_say_that_it_names(name: str, is_linear: bool) -> None:
    region, wanted = ABOUT[name]
    if is_linear:
        region = numbered(region)
        agent: Any = cart(
            A=np.eye(6), B=np.eye(6)[:, :2], noise_covariance=1e-3 * np.eye(6), state_low=LOW, state_high=HIGH,
            initial_state=[0] * 6, output_matrix=np.eye(6)[:2],
        )  # fmt: skip
    else:
        agent = craft()
    problem = problem_of(agent, p=region)
    found = held(problem, POINTS, time=3)
    assert np.array_equal(found, wanted)
    assert 0.005 < found.mean() < 0.995
    again = problem_from_dict(json.loads(json.dumps(problem.to_dict())))
    assert again.fingerprint == problem.fingerprint == pickle.loads(pickle.dumps(problem)).fingerprint
    written = problem.to_dict()["propositions"]["p"]
    assert set(written) == {"agent", *region}


def test_where_states_are_outputs_nothing_changes() -> None:
    """The agent stays as it is, and the region is the one that is written without `of`, to the last bit."""
    for agent, of in ((craft(outputs=["x", "vy"]), ["x", "vy"]), (cart(output_matrix=np.eye(4)[[0, 3]]), [0, 3])):
        plain, named = (problem_of(agent, p={"low": [1, 0], "high": [2, 1], **more}) for more in ({}, {"of": of}))
        assert named.agents[0] is agent
        assert named.fingerprint == plain.fingerprint
        swapped = problem_of(agent, p={"low": [0, 1], "high": [1, 2], "of": of[::-1]})
        assert swapped.fingerprint == plain.fingerprint
    for agent in (craft(), cart()):
        assert problem_of(agent, p={"low": [1], "high": [2], "of": 1}).agents[0] is agent


def test_certificates_of_other_states_are_refused() -> None:
    """What was certified of places says nothing of velocities, in whichever way the claim is dressed."""
    meant, made = (
        problem_of(cart(), "F p", 10, p={"low": [1, -0.5], "high": [2.5, 0.5], "of": of}) for of in ([2, 1], [0, 1])
    )
    assert meant.fingerprint != made.fingerprint
    false = cg.synthesize(made).certificate
    assert false.lower_bound > 0.99
    assert cg.check(false, made)
    assert not cg.check(false, meant)


def test_a_grid_knows_boxes_of_some_states() -> None:
    """On cells, too: a certificate of the plane with a box along one axis, and the same with both axes written out."""
    agent = cg.LinearAgent(
        name="craft", A=np.eye(2), B=np.eye(2), noise_covariance=0.02 * np.eye(2), state_low=[-3, -3],
        state_high=[3, 3], input_low=[-1, -1], input_high=[1, 1], initial_state=[-2, 0],
    )  # fmt: skip
    whole = {"low": [1, -3], "high": [2.5, 3]}
    one, two = problem_of(agent, p=whole), problem_of(agent, p={"low": [1], "high": [2.5], "of": [0]})
    bounds = []
    for problem in (one, two):
        result = cg.synthesize(problem, 12, relation="exact")
        assert cg.check(result.certificate, problem)
        bounds.append(result.certificate.lower_bound)
    assert bounds[0] == bounds[1] > 0.9


@pytest.mark.parametrize(
    ("region", "said"),
    [
        ({"low": [5, 1], "high": [7, 3]}, 'say which states they are about, such as `of = ["x", "y"]`'),
        ({"low": [5, 1], "high": [7, 3], "of": ["x"]}, "`of`: expected 2 states, as `low` has entries"),
        ({"low": [5, 1], "high": [7, 3], "of": ["x", "x"]}, "expected different names"),
        ({"disc": {"centre": [0, 0], "radius": 1, "of": ["x", "y"]}, "of": ["x", "y"]}, "got one that does"),
        ({"union": ["q", "r"], "of": ["x", "y"]}, "one that consists of names"),
        ({"heading": {"from": 0, "to": 1}}, "expected the state that is the angle, got none"),
    ],
)
def test_what_cannot_be_is_refused_in_words(region: dict[str, Any], said: str) -> None:
    with pytest.raises(ValueError, match=r"[`:]") as caught:
        problem_of(craft(), p=region)
    assert said in str(caught.value)
