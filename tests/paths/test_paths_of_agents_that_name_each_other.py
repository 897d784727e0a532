"""Agents that name states of each other have paths between each other's tubes: below the truth, and checked."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.stats import beta, norm

import certigym as cg
from certigym.synthesis.certificates.proofs import changed

OWN = Path(__file__).parents[2] / "examples" / "own"

FALSE_ALARM = 1e-6
"""Probability that a test of rollouts fails although the claim is true."""


@cache
def own_path(file: str) -> Any:
    """The path of an example, found once."""
    return path_of(cg.load(OWN / file))


def path_of(problem: cg.Problem) -> Any:
    return cg.synthesize(problem, relation="path").certificate


@pytest.mark.thorough
@pytest.mark.parametrize(("file", "least"), [("springs.toml", 0.999), ("tanks_side_by_side.toml", 0.99)])
def test_coupled_agents_are_certified_and_the_claim_holds_in_rollouts(file: str, least: float) -> None:
    certificate = own_path(file)
    assert certificate.lower_bound > least
    assert cg.check(certificate)
    episodes = 20_000
    wins = cg.validate(certificate, episodes, seed=5).successes
    # The claim is refuted if so few successes are unlikely under it.
    assert beta.ppf(1.0 - FALSE_ALARM, wins + 1, max(episodes - wins, 1e-9)) >= certificate.lower_bound


@pytest.mark.thorough
def test_narrower_tubes_than_are_kept_are_refused() -> None:
    """Whoever says that neighbours stay nearer to their paths pays for it with inequalities that fail more often."""
    certificate = own_path("springs.toml")
    for share in (0.3, 0.6):
        paths = list(certificate.proof.paths)
        paths[1] = replace(paths[1], strips=paths[1].strips * share)
        assert not cg.check(changed(certificate, paths=tuple(paths)))
    paths[1] = replace(certificate.proof.paths[1], strips=np.zeros_like(certificate.proof.paths[1].strips))
    assert not cg.check(changed(certificate, paths=tuple(paths)))


def pushed(noise: float) -> cg.Problem:
    """A slow agent that is carried along by a noisy one: nearly all that it is off by comes from there."""
    common: dict[str, Any] = {"states": ["x"], "state_low": [-9.0], "state_high": [9.0], "initial_state": [0.0]}
    slow = cg.Agent(
        name="slow", inputs=["u"], dynamics=["x + 0.2*fast.x"], noise_covariance=[[1e-6]],
        input_low=[-1.0], input_high=[1.0], **common,
    )  # fmt: skip
    fast = cg.Agent(name="fast", dynamics=["0.5*x"], noise_covariance=[[noise**2]], **common)
    return cg.Problem(
        name="pushed", horizon=6, agents=[slow, fast], propositions={"near": cg.Proposition("slow", [-0.5], [0.5])},
        specification=cg.Specification("G near", "finite-trace"),
    )  # fmt: skip


@pytest.mark.thorough
def test_what_comes_from_a_neighbour_is_in_the_bound() -> None:
    """The exact law of the slow agent at the end, from the joint system, is an upper bound on the truth."""
    problem = pushed(0.3)
    A, noise = np.array([[1.0, 0.2], [0.0, 0.5]]), np.diag([1e-6, 0.09])
    covariance = np.zeros((2, 2))
    for _ in range(problem.horizon):
        covariance = A @ covariance @ A.T + noise
    truth = 1.0 - 2.0 * norm.sf(0.5 / np.sqrt(covariance[0, 0]))
    assert 0.9 < truth < 0.999
    certificate = path_of(problem)
    assert certificate.lower_bound <= truth
    # A claim of a path that takes its neighbour for standing still would be above it, and is refused.
    assert not cg.check(changed(certificate, failure=0.5 * (1.0 - truth)))
    # With less noise there is something left.
    calm = path_of(pushed(0.03))
    assert 0.99 < calm.lower_bound <= 1.0 and cg.check(calm)


@pytest.mark.thorough
def test_a_boiler_burns_for_the_rooms_that_name_it() -> None:
    """Planned in turn the boiler stays in the middle of its range, too cool for valves that are open: .98."""
    common: dict[str, Any] = {"input_low": [0.0], "input_high": [1.0]}
    boiler = cg.Agent(
        name="boiler", states=["w"], inputs=["burn"], dynamics=["0.8*w + 12*burn + 4"], noise_covariance=[[0.25]],
        state_low=[0.0], state_high=[90.0], initial_state=[40.0], **common,
    )  # fmt: skip
    rooms = [
        cg.Agent(
            name=name, states=["T"], inputs=["valve"], noise_covariance=[[0.01]],
            dynamics=[f"T + 0.05*({other}.T - T) + {loss}*(5 - T) + 0.02*valve*(boiler.w - T)"],
            state_low=[10.0], state_high=[30.0], initial_state=[20.0], **common,
        )
        for name, other, loss in (("a", "b", 0.03), ("b", "a", 0.04))
    ]  # fmt: skip
    regions = {name: cg.Proposition(name, [18.5], [22.0]) for name in ("a", "b")}
    regions["well"] = cg.Proposition("boiler", [20.0], [75.0])
    task = cg.Specification("G (a & b & well)", "finite-trace")
    problem = cg.Problem(name="heat", horizon=10, agents=[boiler, *rooms], propositions=regions, specification=task)
    certificate = path_of(problem)
    assert certificate.lower_bound > 0.99999 and cg.check(certificate)
