"""Two agents may be asked about their Euclidean distance: judged as it is, certified below the truth, checked."""

from __future__ import annotations

import math
import pickle
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.stats import binom

import certigym as cg
from certigym.envs.tasks.problem.problem_file import problem_from_toml
from certigym.envs.tasks.regions.pair import PairRegion, pair_region
from certigym.synthesis.certificates.proofs import AlongPath, changed
from fleet_problems import path_of, unicycle
from kinds import mostly_thorough
from pair_problems import mover

FALSE_ALARM = 1e-6
"""Probability that a test of rollouts fails although the claim is true."""

FILE = """
horizon = 3
specification = "F near_0_1"
agents.drone = { copies = 3, states = ["x", "y", "theta"], inputs = ["v"], noise_std = [0.1, 0.1, 0.1],
  dynamics = ["x + v*cos(theta)", "y + v*sin(theta)", "theta"], state_low = [-3, -3, -4], state_high = [3, 3, 4],
  input_low = [-1], input_high = [1], initial_state = [0, 0, 0] }

[propositions]
near = { agents = "drone_*", distance = 0.7, of = ["x", "y"] }
""".replace(",\n", ",")


def meeting(task: str, distance: float = 0.9, std: float = 0.05, horizon: int = 8, planar: bool = True) -> cg.Problem:
    """Two unicycles that come towards each other, or pass."""
    cars: list[Any] = [unicycle("car_0", [-3.0, -0.3, 0.0], std), unicycle("car_1", [3.0, 0.3, math.pi], std)]
    if not planar:
        cars = [mover("car_0", [-3.0, 0.0, 0.3]), mover("car_1", [3.0, 0.0, -0.3])]
    regions: dict[str, Any] = {
        "near": cg.Pair("car_*", distance=distance, outputs=[range(len(planar * [0, 1]) or 3)] * 2)
    }
    if planar:
        regions |= {
            "right": cg.Proposition("car_0", [2.0, -1.5], [4.0, 1.5]),
            "left": cg.Proposition("car_1", [-4.0, -1.5], [-2.0, 1.5]),
        }
    semantics = "finite-trace" if "G" in task else "co-safe"
    return cg.Problem(
        name="meeting",
        horizon=horizon,
        agents=cars,
        propositions=regions,
        specification=cg.Specification(task, semantics),
    )


@pytest.fixture(scope="module")
def apart() -> AlongPath:
    return path_of(meeting("G !near_0_1 & F (right & left)", horizon=12))


@pytest.fixture(scope="module")
def together() -> AlongPath:
    return path_of(meeting("F near_0_1"))


def test_files_and_python_say_the_same() -> None:
    problem = _from_toml(FILE)
    pair = problem.propositions["near_0_1"]
    assert pair.to_dict() == {"agents": ["drone_0", "drone_1"], "distance": 0.7, "of": ["x", "y"]}
    assert repr(problem.declared["near"]) == "Pair('drone_*', distance < 0.7 of (x, y))"
    again = cg.Problem(
        name="again", horizon=3, agents=problem.agents,
        propositions={"near": cg.Pair("drone_*", distance=0.7, of=[0, 1])},
        specification=cg.Specification("F near_0_1", "co-safe"),
    )  # fmt: skip
    assert [(p.outputs, p.radius) for p in again.labeling.pairs] == [(((0, 1), (0, 1)), 0.7)] * 3
    assert pickle.loads(pickle.dumps(problem)).fingerprint == problem.fingerprint
    assert problem.fingerprint != _from_toml(FILE.replace("0.7", "0.8")).fingerprint


def _from_toml(text: str) -> cg.Problem:
    return problem_from_toml(text)


def test_distances_are_judged_as_they_are() -> None:
    """Letters of states at once, of one state, and of worlds in batches agree with hypot."""
    rng = np.random.default_rng(5)
    for problem, size in ((meeting("F near_0_1"), 2), (meeting("F near_0_1", planar=False), 3)):
        region = problem.labeling.pairs[0]
        first, second = (rng.uniform(-0.8, 0.8, (size, 4000)) for _ in range(2))
        there = [math.dist(a, b) < 0.9 for a, b in zip(first.T, second.T, strict=True)]
        assert 500 < sum(there) < 3500
        for k in range(200):
            states = [np.append(own[:, k], [0.0] * (3 - size)) for own in (first, second)]
            assert problem.labeling.letter(states)[-1] == there[k]
        assert region.is_round


def test_in_one_dimension_it_is_an_open_interval() -> None:
    agents = [mover("a", [0.0]), mover("b", [0.0])]
    region = pair_region("near", cg.Pair(["a", "b"], distance=0.5), agents)
    assert not region.is_round
    problem = cg.Problem(
        name="line", horizon=2, agents=agents, propositions={"near": cg.Pair(["a", "b"], distance=0.5)},
        specification=cg.Specification("F near", "co-safe"),
    )  # fmt: skip
    for gap, near in ((0.5, False), (-0.5, False), (0.4999, True), (-0.4999, True)):
        assert problem.labeling.letter([np.array([gap]), np.array([0.0])])[-1] == near


@pytest.mark.parametrize("size", [1, 2, 3, 4])
def test_what_is_asked_inside_lies_inside(size: int) -> None:
    region = PairRegion(0, 1, ((0,), (0,)), np.full(size, -0.7), np.full(size, 0.7), 0.7)
    low, high = region.inner_box
    assert np.linalg.norm(low) < 0.7 and np.linalg.norm(high) < 0.7
    faces, least, most = region.inner_faces
    rng = np.random.default_rng(0)
    points = rng.normal(size=(20_000, size))
    # The furthest point of the polytope along each ray.
    reach = np.min(np.where(points @ faces.T > 0.0, most, -least) / np.abs(points @ faces.T), axis=1)
    lengths = reach * np.linalg.norm(points, axis=1)
    assert lengths.max() < 0.7
    assert lengths.max() > 0.69 if size <= 2 else lengths.max() > 0.6


@pytest.mark.thorough
@pytest.mark.parametrize("name", ["apart", "together"])
def test_bounds_hold_in_rollouts(name: str, request: pytest.FixtureRequest) -> None:
    certificate: AlongPath = request.getfixturevalue(name)
    assert certificate.lower_bound > 0.9
    assert cg.check(certificate)
    rollouts = cg.validate(certificate, 20_000, seed=3)
    assert binom.cdf(rollouts.successes, rollouts.episodes, certificate.lower_bound) > FALSE_ALARM


@pytest.mark.thorough
def test_a_shorter_distance_does_not_prove_a_longer_one(apart: AlongPath, together: AlongPath) -> None:
    longer = meeting("G !near_0_1 & F (right & left)", distance=1.6, horizon=12)
    assert not cg.check(replace(apart, problem=longer))
    shorter = meeting("F near_0_1", distance=0.25)
    assert not cg.check(replace(together, problem=shorter))


@pytest.mark.thorough
@mostly_thorough("size", [1e-9, 1e-170, 5e-324, 1e200], first=2)
def test_tiny_directions_ask_for_nothing_and_are_refused(apart: AlongPath, size: float) -> None:
    """Squares of 1e-170 are 0, as is the length of such a direction: any half-space would be as far as the origin."""
    assert apart.proof.normals is not None
    normals = np.where(np.abs(apart.proof.normals) > 0.3, size * np.sign(apart.proof.normals), 0.0)
    longer = meeting("G !near_0_1 & F (right & left)", distance=1.6, horizon=12)
    assert not cg.check(changed(apart, problem=longer, normals=normals))


def test_tiny_rows_have_a_variance() -> None:
    """Where squares of outputs underflow, a variance of 0 would say that nothing can happen."""

    def problem(size: float, written: bool) -> cg.Problem:
        agent: Any = mover("robot", [0.0], output_matrix=[[size]])
        if written:
            agent = cg.Agent(
                name="robot", states=["x"], inputs=["u"], dynamics=["x + u"], outputs=[f"{size!r}*x"],
                noise_covariance=[[0.04]], state_low=[-4], state_high=[4], input_low=[-1], input_high=[1],
                initial_state=[0.0],
            )  # fmt: skip
        goal = cg.Proposition("robot", [-0.1 * size], [0.1 * size])
        task = cg.Specification("X X X goal", "co-safe")
        return cg.Problem(name="tiny", horizon=3, agents=[agent], propositions={"goal": goal}, specification=task)

    for written in (False, True):
        certificate: Any = cg.synthesize(problem(1.0, written), relation="path").certificate
        assert 0.3 < cg.check(certificate).recomputed < 0.4  # P(|w| < 0.1) for a deviation of 0.2 is .383
        assert not cg.check(changed(certificate, failure=1e-6, problem=problem(1e-200, written)))


def test_subtraction_uses_a_box_around_and_a_box_within() -> None:
    def problem(task: str, distance: float) -> cg.Problem:
        agents = [mover("a", [-2.0, 0.0]), mover("b", [2.0, 0.5])]
        regions: dict[str, Any] = {
            "near": cg.Pair(["a", "b"], distance=distance),
            "left": cg.Proposition("a", [-3.0, -1.0], [-1.0, 1.0]),
            "right": cg.Proposition("b", [1.0, -0.5], [3.0, 1.5]),
        }
        specification = cg.Specification(f"G left & G right & {task}", "finite-trace")
        return cg.Problem(name="pair", horizon=4, agents=agents, propositions=regions, specification=specification)

    for task, distance in (("G !near", 1.0), ("G near", 7.0)):
        certificate = cg.synthesize(problem(task, distance), 16, relation="exact").certificate
        assert 0.9 < certificate.lower_bound
        assert cg.check(certificate)
        rollouts = cg.validate(certificate, 20_000, seed=4)
        assert binom.cdf(rollouts.successes, rollouts.episodes, certificate.lower_bound) > FALSE_ALARM
    # Steps are near in the box [-7, 7]^2 more often than within 7, which it holds.
    regions: dict[str, Any] = {**problem("G near", 7.0).written, "near": cg.Pair(["a", "b"], [-7.0, -7.0], [7.0, 7.0])}
    boxed = cg.Problem(
        name="pair", horizon=4, agents=certificate.problem.agents, propositions=regions,
        specification=certificate.problem.specification,
    )  # fmt: skip
    wider = cg.synthesize(boxed, 16, relation="exact").certificate
    assert wider.lower_bound > certificate.lower_bound
    assert not cg.check(replace(wider, problem=problem("G near", 7.0)))


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ({"distance": 1.0, "low": [0.0], "high": [1.0]}, "either a distance, or"),
        ({"distance": 0.0}, "a number above 0"),
        ({"distance": 1e-200}, "a number above 0"),
        ({"low": [0.0], "high": [1.0], "of": ["x", "y"]}, "1 states, as `low` has entries"),
        ({"distance": 1.0, "of": ["x", "x"]}, "different names"),
    ],
)
def test_mistakes_are_named(value: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        cg.Pair("car_*", **value)
