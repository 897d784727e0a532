"""Polar inputs over any range of angles reach sectors: what is claimed of them is exact, and wider ones are refused."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import certigym as cg
from certigym.envs.systems.agents import Agent
from certigym.synthesis.extended_check.steps.target_enclosures import turned_there
from certigym.synthesis.relations.kinds import SymbolicTargets, Turn, input_cones, inverse_means, symbolic_targets
from kinds import mostly_thorough
from test_expressions_have_exact_targets import avoiding, robot

FALSE_ALARM = 1e-6
"""Probability that rollouts refute a true certificate."""

POLAR = ["x + 0.1*sin(y) + r*cos(a)", "y + r*sin(a)"]

SECTORS = {
    "narrow": ([0.0, -0.4], [3.0, 2.0]),
    "wide": ([0.0, -1.5], [2.0, 4.0]),
    "part of a ring": ([0.4, -1.6], [2.5, 3.4]),
    "both signs": ([-2.0, -0.9], [2.0, 1.2]),
    "both signs, all directions": ([-1.6, -1.2], [2.0, 2.4]),
    "negative sizes": ([-2.5, 2.2], [-0.1, 5.6]),
    "nearly all the way round": ([0.0, -3.1415926], [2.0, 3.1415926]),
    "backwards, with a gap": ([-2.0, -2.4], [0.1, 2.4]),
    "angles far from 0": ([0.0, 1000.0], [2.0, 1004.0]),
}


def polar(low: list[float], high: list[float], **changes: Any) -> Agent:
    return robot(POLAR, ["r", "a"], low, high, **changes)


def in_space() -> cg.Problem:
    """Polar inputs in the plane, and an ordinary one for the height."""
    agent = Agent(
        name="robot",
        states=["x", "y", "z"],
        inputs=["lift", "r", "a"],
        dynamics=["x + r*sin(a)", "y + r*cos(a)", "0.9*z + 0.1*x + lift"],
        noise=[{"law": "gaussian", "std": 0.6}] * 3,
        state_low=[-3, -3, -2],
        state_high=[3, 3, 2],
        input_low=[-1.5, -2.0, -2.0],
        input_high=[1.5, 2.0, 1.0],
        initial_state=[-2.0, -1.0, 0.0],
    )
    return cg.Problem(
        name="rise",
        horizon=4,
        agents=[agent],
        propositions={"goal": cg.Proposition("robot", [0.0, 0.0, 0.0], [3.0, 3.0, 2.0])},
        specification=cg.Specification("F goal", "co-safe"),
    )


@cache
def certificate_of(name: str) -> cg.Certificate:
    problem, cells = (in_space(), 10) if name == "in space" else (avoiding(polar(*SECTORS[name])), 20)
    certificate = cg.synthesize(problem, cells, relation="exact").certificate
    assert isinstance(certificate, cg.Certificate)
    return certificate


def reachable(agent: Agent, east: NDArray, north: NDArray) -> NDArray:
    """Whether some size and angle give a vector: both signs and all turns are tried, which is not the package's way."""
    (least, first), (most, last) = agent.input_low.tolist(), agent.input_high.tolist()
    size, angle = np.hypot(east, north), np.arctan2(north, east)
    found = np.zeros(east.shape, dtype=bool)
    for sign, opposite in ((1.0, 0.0), (-1.0, np.pi)):
        for turn in range(int(first // 6.2) - 2, int(last // 6.2) + 3):
            there = angle + opposite + 2.0 * np.pi * turn
            found |= (least <= sign * size) & (sign * size <= most) & (first <= there) & (there <= last)
    return found


def test_boxes_that_are_let_through_hold_nothing_that_inputs_do_not_give() -> None:
    """Random ranges and boxes, 81 points of each: search and check agree, and the controller gives them all."""
    rng, turn, found, most = np.random.default_rng(0), Turn(0, 1), 0, 0
    for _ in range(120):
        least, middle = float(rng.choice([-1.3, -0.5, 0.0, 0.4])), rng.uniform(-8.0, 8.0)
        size = max(least + 0.1, float(rng.choice([-0.2, 0.3, 1.0, 2.0])))
        half = float(rng.choice([rng.uniform(0.05, 3.3), 0.5 * np.pi, 3.1415926, np.pi, 1.0]))
        agent = polar([least, middle - half], [size, middle + half])
        centre, width = rng.uniform(-2.0, 2.0, (2, 300)), rng.choice([1e-9, 0.01, 0.1, 0.5], 300) * rng.random((2, 300))
        east, north = (np.stack([c - w, c + w]) for c, w in zip(centre, width, strict=True))
        pair = (tuple(east), tuple(north))
        searched = np.any([part.holds(*pair, 1e-13) for part in input_cones.input_cones_of(agent, turn)], axis=0)
        checked = turned_there(agent, turn, east, north)
        steps = np.stack([mesh.ravel() for mesh in np.meshgrid(*[np.linspace(0.0, 1.0, 9)] * 2)])[..., None]
        x, y = (side[0] + (side[1] - side[0]) * step for side, step in zip((east, north), steps, strict=True))
        inside = np.all(reachable(agent, x, y), axis=0)
        assert np.all(inside[searched | checked])
        assert np.all(checked[searched])
        found, most = found + int(searched.sum()), most + int(inside.sum())
        sizes, angles = input_cones.polar_inputs(agent, turn, x, y)
        sizes, angles = np.clip(sizes, least, size), np.clip(angles, middle - half, middle + half)
        off = np.hypot(sizes * np.cos(angles) - x, sizes * np.sin(angles) - y)
        assert off[:, searched].max(initial=0.0) < 1e-13
    assert found > 5000 and found > 0.99 * most  # nothing much is lost, either


def test_a_million_boxes_that_the_check_lets_through_are_reached() -> None:
    """Sizes of either sign, boxes small and large, beside 0, around it and on the axes: what is passed is reached."""
    rng, turn, passed, around_zero = np.random.default_rng(1), Turn(0, 1), 0, 0
    for number in range(50):
        ends = np.sort(rng.uniform(-2.0, 2.0, 2)) if number % 3 else np.sort(rng.uniform([-2.0, -1.0], [-1.0, 0.3]))
        middle, half = rng.uniform(-7.0, 7.0), float(rng.choice([rng.uniform(0.05, 3.1), rng.uniform(2.3, 3.1), np.pi]))
        agent = polar([ends[0], middle - half], [ends[1], middle + half])
        size = rng.choice([0.01, 0.2, 1.0], 20_000)
        centre, width = size * rng.uniform(-1.5, 1.5, (2, 20_000)), size * rng.random((2, 20_000))
        east, north = (np.stack([c - w, c + w]) for c, w in zip(centre, width, strict=True))
        checked = turned_there(agent, turn, east, north)
        # Corners, the middle, and on all sides and inside what is nearest to 0: where wrong sectors are wrong.
        near = [np.clip(0.0, *east), np.clip(0.0, *north)]
        xs = np.stack([*east, *east, centre[0], *east, *[near[0]] * 3])[:, checked]
        ys = np.stack([*north, *north[::-1], centre[1], *[near[1]] * 3, *north])[:, checked]
        assert np.all(reachable(agent, xs, ys))
        passed += int(checked.sum())
        around_zero += int(np.sum((centre**2 < width**2).all(axis=0) & (ends[0] < 0.0)))
    assert passed > 30_000 and around_zero > 50_000


@mostly_thorough("name", [*SECTORS, "in space"], first=3)
def test_claims_are_exact_checked_and_met_by_rollouts(name: str) -> None:
    """Both ends hold in simulations: false alarm 1e-6; a gap of .04 would be seen."""
    certificate = certificate_of(name)
    assert certificate.lower_bound > 0.1 and certificate.gap is not None and certificate.gap < 1e-5
    assert cg.check(certificate)
    outcome = cg.validate(certificate, 3000, seed=3, confidence=1.0 - FALSE_ALARM)
    assert outcome.ci_low <= certificate.lower_bound + certificate.gap and certificate.lower_bound <= outcome.ci_high


@mostly_thorough("name", [*SECTORS, "in space"], first=2)
def test_inputs_put_means_on_targets_from_everywhere_in_a_cell(name: str) -> None:
    """Every choice, at random points of its cell: inputs in their box, the mean on the lattice point."""
    certificate, rng = certificate_of(name), np.random.default_rng(1)
    agent, part = certificate.problem.agents[0], certificate.proof.agents[0]
    relation = certificate.controller.agents[0].relation
    assert isinstance(relation, SymbolicTargets) and isinstance(agent, Agent)
    cells = np.flatnonzero(part.policy[0, 0] >= 0)
    index = np.unravel_index(part.policy[0, 0, cells], part.lattice_shape)
    targets, signs = np.stack([axis[k] for axis, k in zip(part.lattice, index, strict=True)]), set()
    assert len(cells) > 30
    for _ in range(10):
        share = rng.random(targets.shape)
        points = part.grid.centres[cells].T + (2.0 * share - 1.0) * part.grid.half_widths[cells].T
        inputs = relation.inputs(relation.mean_targets(targets), points)
        assert np.all((agent.input_low[:, None] <= inputs) & (inputs <= agent.input_high[:, None]))
        # Angles near 1000 are rounded to 1e-13.
        atol = 2e-12 if name == "angles far from 0" else 2e-14
        assert np.allclose(agent.mean(points, inputs), targets, rtol=0.0, atol=atol)
        signs |= {*np.sign(inputs[agent.inputs.index("r")]).tolist()}
    assert ({-1.0, 1.0} <= signs) == name.startswith(("both signs", "in space"))


def test_no_step_is_taken_with_an_angle_of_the_interval() -> None:
    """A vector of length 0 has no direction: any angle will do, if it is in the box."""
    for low, high in ([0.0, 2.0], [1.0, 3.0]), ([-1.0, -9.0], [0.0, -8.5]), ([-1.0, 40.0], [1.0, 50.0]):
        agent = robot(["x + r*cos(a)", "y + r*sin(a)"], ["r", "a"], low, high)
        inputs = symbolic_targets(agent).inputs(np.zeros((2, 1)), np.zeros((2, 1)))
        assert inputs[0] == 0.0 and low[1] <= inputs[1] <= high[1]


def test_a_component_alone_has_no_sector() -> None:
    agent = robot(["x + r*cos(a)", "y + u"], ["r", "a", "u"], [0.0, 0.0, -1.0], [1.0, 1.0, 1.0])
    with pytest.raises(ValueError, match="both components of polar inputs"):
        symbolic_targets(agent)


# --- sabotage: searches and controllers that are wrong about one thing ----------------------------------------


def wider(agent: Agent, turn: Turn) -> tuple[input_cones.InputCone, ...]:
    """Sectors that are too wide by a hundredth."""
    true = _SECTORS_OF(agent, turn)
    return tuple(input_cones.InputCone(part.least, part.most, part.middle, 1.01 * part.half) for part in true)


def longer(agent: Agent, turn: Turn) -> tuple[input_cones.InputCone, ...]:
    true = _SECTORS_OF(agent, turn)
    return tuple(input_cones.InputCone(part.least, 1.01 * part.most, part.middle, part.half) for part in true)


def gapless(agent: Agent, turn: Turn) -> tuple[input_cones.InputCone, ...]:
    """Negative sizes that go anywhere, although some directions are missing."""
    low, _, middle, _ = input_cones._ranges(agent, turn)
    return (input_cones.InputCone(0.0, -low, middle, np.inf),)


def opposite(agent: Agent, turn: Turn) -> tuple[input_cones.InputCone, ...]:
    """Negative sizes that go where positive ones do."""
    low, high, middle, half = input_cones._ranges(agent, turn)
    return input_cones.InputCone(0.0, max(high, -low), middle, half), input_cones.InputCone(0.0, -low, middle, half)


_SECTORS_OF, _POLAR_INPUTS, _TURNED = input_cones.input_cones_of, input_cones.polar_inputs, input_cones._turned


@mostly_thorough(
    "name, wrong",
    [
        ("narrow", wider),
        ("both signs", longer),
        ("negative sizes", opposite),
        ("backwards, with a gap", gapless),
    ],
)
def test_the_check_refuses_sectors_that_are_too_large(name: str, wrong: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """The search is fooled, the check is not."""
    assert cg.check(certificate_of(name))
    with monkeypatch.context() as patch:
        patch.setattr(inverse_means, "input_cones_of", wrong)
        forged = cg.synthesize(avoiding(polar(*SECTORS[name])), 40, relation="exact").certificate
    assert any("beyond its input box" in text for text in cg.check(forged).failures)


def test_the_check_refuses_controllers_that_turn_elsewhere(monkeypatch: pytest.MonkeyPatch) -> None:
    """Sizes of the wrong sign, and angles modulo half a turn."""
    certificate = certificate_of("both signs")
    for name, wrong in (
        ("polar_inputs", lambda *given: (-_POLAR_INPUTS(*given)[0], _POLAR_INPUTS(*given)[1])),
        ("_turned", lambda angle: 0.5 * _TURNED(2.0 * np.asarray(angle))),
    ):
        with monkeypatch.context() as patch:
            patch.setattr(inverse_means if name == "polar_inputs" else input_cones, name, wrong)
            assert any("steer elsewhere" in text for text in cg.check(certificate).failures)
    assert cg.check(certificate)
