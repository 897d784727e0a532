"""Agents by expressions whose inputs reach every mean have exact claims, and claims that go too far are refused."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

import certigym as cg
from certigym.envs.systems.agents import Agent
from certigym.envs.systems.expressions import Number, Operation
from certigym.synthesis.extended_check.steps.carrying_out import wrong_actions
from certigym.synthesis.extended_check.steps.execution import execution_of
from certigym.synthesis.relations.kinds import SymbolicTargets, symbolic_targets
from kinds import mostly_thorough

FALSE_ALARM = 1e-6
"""Probability that rollouts refute a true certificate."""

FULL_CIRCLE = [-3.1416, 3.1416]


def robot(dynamics: list[str], inputs: list[str], low: list[float], high: list[float], **changes: Any) -> Agent:
    """A robot in the plane."""
    values: dict[str, Any] = {
        "name": "robot",
        "states": ["x", "y"],
        "inputs": inputs,
        "dynamics": dynamics,
        "noise": [{"law": "gaussian", "std": 0.6}] * 2,
        "state_low": [-4, -4],
        "state_high": [4, 4],
        "input_low": low,
        "input_high": high,
        "initial_state": [-2.1, -2.2],
    }
    return Agent(**{**values, **changes})


AGENTS = {
    "turn": robot(["x + 0.1*sin(y) + r*cos(a)", "y + r*sin(a)"], ["r", "a"], [0, FULL_CIRCLE[0]], [2, FULL_CIRCLE[1]]),
    "ring": robot(["x + 2*r*cos(a)", "y + r*sin(a)"], ["r", "a"], [0.4, 0.0], [2, 6.2832]),
    "tied": robot(["x + cos(y)*u - sin(y)*v", "y + sin(y)*u + cos(y)*v"], ["u", "v"], [-2, -2], [2, 2]),
    "alone": robot(
        ["x + 0.1*sin(y) + u/(1 + 0.1*x**2)", "y - 0.02*x*y + (1 + 0.1*cos(x))*v"], ["u", "v"], [-2, -2], [2, 2]
    ),
    "spare input": robot(["x + u + 0.1*w", "y + v + 0.2*w"], ["u", "v", "w"], [-2, -2, 0], [2, 2, 1]),
    "laws": robot(
        ["x + u", "y + 0.1*cos(x) + v"],
        ["u", "v"],
        [-2, -2],
        [2, 2],
        noise=[{"law": "uniform", "low": -0.6, "high": 0.6}, {"law": "laplace", "scale": 0.2}],
    ),
}


def avoiding(agent: Agent, horizon: int = 6) -> cg.Problem:
    """Come to a corner, and keep off the middle until then."""
    return cg.Problem(
        name="corner",
        horizon=horizon,
        agents=[agent],
        propositions={
            "goal": cg.Proposition("robot", [1.0, 1.0], [3.0, 3.0]),
            "bad": cg.Proposition("robot", [-0.8, -0.8], [0.2, 0.2]),
        },
        specification=cg.Specification("!bad U goal", "co-safe"),
    )


@cache
def certificate_of(name: str) -> cg.Certificate:
    result = cg.synthesize(avoiding(AGENTS[name]), 20, relation="exact")
    assert isinstance(result.certificate, cg.Certificate)
    return result.certificate


@mostly_thorough("name", AGENTS)
def test_claims_are_exact_checked_and_met_by_rollouts(name: str) -> None:
    """Both ends of the claim hold in simulations of their own: false alarm 1e-6; a gap of .03 would be seen."""
    certificate = certificate_of(name)
    assert certificate.gap is not None and certificate.gap < 1e-6
    report = cg.check(certificate)
    assert report and report.above is not None
    outcome = cg.validate(certificate, 4000, seed=3, confidence=1.0 - FALSE_ALARM)
    assert outcome.ci_low <= certificate.lower_bound + certificate.gap and certificate.lower_bound <= outcome.ci_high


@mostly_thorough("name", AGENTS)
def test_inputs_put_means_on_targets_from_everywhere_in_a_cell(name: str) -> None:
    """Every choice, at random points of its cell: inputs in their box, the mean on the lattice point."""
    certificate, rng = certificate_of(name), np.random.default_rng(1)
    agent, part = certificate.problem.agents[0], certificate.proof.agents[0]
    relation = certificate.controller.agents[0].relation
    assert isinstance(relation, SymbolicTargets)
    cells = np.flatnonzero(part.policy[0, 0] >= 0)[:: max(1, len(part.policy[0, 0]) // 100)]
    index = np.unravel_index(part.policy[0, 0, cells], part.lattice_shape)
    targets = np.stack([axis[k] for axis, k in zip(part.lattice, index, strict=True)])
    for _ in range(20):
        share = rng.random((2, len(cells)))
        points = part.grid.centres[cells].T + (2.0 * share - 1.0) * part.grid.half_widths[cells].T
        inputs = relation.inputs(relation.mean_targets(targets), points)
        assert np.all((agent.input_low[:, None] <= inputs) & (inputs <= agent.input_high[:, None]))
        assert np.allclose(agent.mean(points, inputs), targets, rtol=0.0, atol=1e-12)


def test_turns_fill_a_disk_and_no_more() -> None:
    """Targets at .97 of the radius fit a small cell in every direction, those beyond it or in a hole in none."""
    low, high = np.array([[0.5, 0.5]]) - 1e-3, np.array([[0.5, 0.5]]) + 1e-3
    angles = np.linspace(0.0, 2.0 * np.pi, 73)
    for least, radii in ((0.0, {0.0: True, 0.97: True, 1.001: False}), (0.4, {0.39: False, 0.42: True, 1.001: False})):
        agent = robot(["x + r*cos(a)", "y + r*sin(a)"], ["r", "a"], [least, 0.0], [1.0, 6.2832])
        relation = symbolic_targets(agent)
        asked = relation.asked(low, high)
        for radius, fits in radii.items():
            targets = 0.5 + radius * np.stack([np.cos(angles), np.sin(angles)], axis=1)
            assert np.all(relation.fits(asked.of(np.zeros(len(angles), dtype=int), targets)) == fits)


def test_what_is_not_exact_is_refused_in_words() -> None:
    plain: tuple[Any, ...] = (["u", "v"], [-1, -1], [1, 1])
    cases = {
        "got disturbances": robot(["x + u + wind", "y + v"], *plain, disturbances={"wind": [-0.1, 0.1]}),
        "means `a": robot(["x + sin(u)", "y + v"], *plain),
        "as many independent inputs": robot(["x + u + v", "y + u + v"], *plain),
        "independent along the states": robot(
            ["x + u", "y + v"], *plain, noise=None, noise_covariance=[[0.1, 0.05], [0.05, 0.1]]
        ),
    }
    for words, agent in cases.items():
        with pytest.raises(ValueError, match=words):
            cg.synthesize(avoiding(agent), 8, relation="exact")
    rooms = [agent.replace(communicated=None) for agent in cg.make_problem("room-network-v0", n_agents=3).agents]
    problem = cg.make_problem("room-network-v0", n_agents=3)
    deaf = cg.Problem(
        name="deaf", horizon=3, agents=rooms, propositions=problem.declared, specification=problem.specification
    )
    with pytest.raises(ValueError, match="not `communicated`"):
        cg.synthesize(deaf, 20, relation="exact")


def test_the_check_refuses_ranges_that_are_too_wide(monkeypatch: pytest.MonkeyPatch) -> None:
    """Inputs are not enough for targets by 1 %, or for half of the cell: the search is fooled, the check is not."""
    agent = robot(["x + 0.3*sin(2*y) + u", "y + v"], ["u", "v"], [-0.6, -0.6], [0.6, 0.6])
    problem = avoiding(agent)
    assert cg.check(cg.synthesize(problem, 12, relation="exact").certificate)
    fits, asked = SymbolicTargets.fits, SymbolicTargets.asked
    with monkeypatch.context() as patch:
        patch.setattr(SymbolicTargets, "fits", lambda self, ends, which=None: fits(self, ends / 1.01, which))
        forged = cg.synthesize(problem, 12, relation="exact").certificate
    assert any("beyond its input box" in text for text in cg.check(forged).failures)
    with monkeypatch.context() as patch:
        middle = lambda low, high: 0.5 * (low + high)  # noqa: E731
        patch.setattr(
            SymbolicTargets,
            "asked",
            lambda self, low, high, around=True: asked(
                self, 0.5 * (low + middle(low, high)), 0.5 * (high + middle(low, high)), around
            ),
        )
        forged = cg.synthesize(problem, 12, relation="exact").certificate
    assert any("beyond its input box" in text for text in cg.check(forged).failures)


def test_the_check_refuses_a_wrong_sign_of_b() -> None:
    """The controller takes B for its negative: seen where it acts."""
    certificate = certificate_of("alone")
    agent, part, controller = (
        certificate.problem.agents[0],
        certificate.proof.agents[0],
        certificate.controller.agents[0],
    )
    relation = controller.relation
    assert isinstance(relation, SymbolicTargets)
    execution = execution_of(agent, part, relation)
    assert not wrong_actions(agent, part, controller, execution)
    negative = [[Operation("*", (Number(-1.0), entry)) if entry != Number(0.0) else entry for entry in row]
                for row in relation.form.factors]  # fmt: skip
    wrong = replace(relation, form=replace(relation.form, factors=tuple(map(tuple, negative))))
    assert wrong_actions(agent, part, replace(controller, relation=wrong), execution)


def test_neighbours_that_are_told_are_cancelled() -> None:
    """Rooms on a ring: 10 of them, more than boxes certify, checked, and met by rollouts."""
    problem = cg.make_problem("room-network-v0", n_agents=10)
    result = cg.synthesize(problem, 48, relation="exact")
    assert result.certificate.lower_bound > 0.99999 and cg.check(result.certificate)
    assert {part.relation["kind"] for part in result.certificate.proof.agents} == {"exact"}
    assert len({id(controller.relation) for controller in result.certificate.controller.agents}) == 1
    assert cg.validate(result, 500, seed=0).estimate == 1.0
