"""Each part of the check of paths decides a problem of its own, in one row and one step, whose failure is known.

Chance problems rarely rest on one row alone: a check that forgets about drifts, about noise that agents share or about
jumps over regions claims too much where little is left, and no simulation sees it. Here it would claim hardly any
failure of runs most of which fail.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt
from typing import Any

import numpy as np
import pytest
from scipy.stats import norm

import certigym as cg
from certigym.synthesis.certificates.proofs import (
    SOMETIME,
    AgentPath,
    AlongPath,
    Certificate,
    PathProof,
    canonical,
    changed,
)
from certigym.synthesis.checker import problem as checked_problem
from certigym.synthesis.checker import trajectories
from certigym.synthesis.checker.constraints import Constraints
from certigym.synthesis.checker.error_system import ErrorSystem

EPISODES, DEVIATIONS = 4000, 5.3
"""Rates are farther than so many deviations from the truth with a probability of 1.2e-7, seven times below 1e-6."""

FAINT = 1e-3
"""Deviation of noise that decides nothing."""


@dataclass(frozen=True)
class Case:
    """A certificate by hand, how often its runs fail, what the check makes of it at most, and a sabotage that errs.

    ``loose`` is the same run with limits that ask for next to nothing: what the sabotage leaves out is all there is.
    """

    certificate: AlongPath
    loose: AlongPath
    truth: float
    most: float
    sabotage: tuple[Any, str, Any]


def agent(name: str, dynamics: list[str], std: list[float], reach: float = 2.0) -> cg.Agent:
    """Return an agent with states x, y, .. and an input u, far from the ends of its workspace."""
    d = len(dynamics)
    return cg.Agent(
        name=name, states=["x", "y", "z"][:d], inputs=["u"], dynamics=dynamics,
        noise_covariance=np.diag(np.square(std)), state_low=[-9.0] * d, state_high=[999.0] * d,
        input_low=[-reach], input_high=[reach], initial_state=[0.0] * d,
    )  # fmt: skip


def along(
    agents: list[cg.Agent],
    regions: dict[str, Any],
    formula: str,
    strips: list[list[float]],
    *,
    letter: int = 1,
    states: list[list[float]] | None = None,
    inputs: list[float] | None = None,
    gain: float = 0.0,
    **more: Any,
) -> AlongPath:
    """Return a certificate along 0, or other states: strips of the states at each time, a letter at the last one."""
    steps, semantics = len(strips) - 1, "finite-trace"
    problem = cg.Problem(
        name="one row", horizon=steps, agents=agents, propositions=regions,
        specification=cg.Specification(formula, semantics), **more,
    )  # fmt: skip
    d, letters = agents[0].n_states, np.zeros((steps + 1, 1), dtype=np.int8)
    faces = np.full((steps + 1, 1), -1)
    letters[-1] = letter
    if letter == SOMETIME:
        letters[1:], faces[1:] = letter, 0
    path = AgentPath(
        np.zeros((steps, 1)) if inputs is None else np.array(inputs)[:, None],
        np.zeros((steps, 1, d)),
        np.zeros((steps + 1, d)) if states is None else np.array(states),
        np.concatenate([np.array(strips), np.full((steps + 1, 1), np.inf)], axis=1),
    )
    path.gains[1:, :, 0] = gain
    normals = np.zeros((steps + 1, 1)) if problem.labeling.pairs else None
    proof = PathProof((path,) * len(agents), letters, faces, 1.0, normals)
    return Certificate(problem, proof, {"relation": "path"})


def of_drift(strip: float) -> AlongPath:
    """A state that is the square of noise."""
    low = cg.Proposition("a", [-9.0, -9.0], [999.0, 0.25])
    strips = [[0.0, 0.0], [strip, np.inf], [np.inf, np.inf]]
    return along([agent("a", ["u", "x^2"], [1.0, FAINT])], {"low": low}, "X X low", strips)


def of_product(strip: float) -> AlongPath:
    """A state that is the product of two noises: it is off by as much on both sides."""
    near = cg.Proposition("a", [-9.0, -9.0, -0.25], [999.0, 999.0, 0.25])
    strips = [[0.0] * 3, [strip, strip, np.inf], [np.inf] * 3]
    return along([agent("a", ["u", "0*u", "x*y"], [1.0, 1.0, FAINT])], {"near": near}, "X X near", strips)


def of_tube(strip: float) -> AlongPath:
    """A state that is the square of the square of noise: what the first one is off makes the tube of the second."""
    low = cg.Proposition("a", [-9.0, -9.0, -9.0], [999.0, 999.0, 0.0625])
    strips = [[0.0] * 3, [strip, 0.01, np.inf], [6.0, 0.01, np.inf], [np.inf] * 3]
    return along([agent("a", ["u", "x^2", "y^2"], [1.0, FAINT, FAINT])], {"low": low}, "X X X low", strips)


def of_middle() -> AlongPath:
    """Nominal states that the dynamics miss by 1."""
    low = cg.Proposition("a", [-9.0], [0.5])
    return along([agent("a", ["u + 1"], [FAINT])], {"low": low}, "X low", [[0.0], [np.inf]])


def of_inputs() -> AlongPath:
    """A feedback that asks for more than there is."""
    near = cg.Proposition("a", [-9.0, -0.01], [999.0, 0.01])
    strips = [[0.0, 0.0], [np.inf, np.inf], [np.inf, np.inf]]
    agents = [agent("a", ["0*x", "x + u"], [1.0, FAINT], 0.5)]
    return along(agents, {"near": near}, "X X near", strips, gain=-1.0)


def of_wind() -> AlongPath:
    """Two agents that the same wind blows apart."""
    agents = [agent(name, ["x + u"], [FAINT]) for name in ("a", "b")]
    near = {"near": cg.Pair(["a", "b"], [-0.1], [0.1])}
    wind = {"wind": {"a": [0.1], "b": [-0.1]}}
    return along(agents, near, "X near", [[0.0], [np.inf]], joint_noise=wind)


def of_jump() -> AlongPath:
    """A region that is narrower than a step."""
    goal = cg.Proposition("a", [1.0], [1.2])
    agents, strips = [agent("a", ["x + u"], [0.2])], [[0.0], [np.inf], [np.inf]]
    states, inputs = [[0.0], [0.0], [2.0]], [0.0, 2.0]
    return along(agents, {"goal": goal}, "F goal", strips, letter=SOMETIME, states=states, inputs=inputs)


def far_product() -> float:
    """Probability that the product of two standard normal numbers is beyond 1/4."""
    x = (np.arange(400_000) + 0.5) * 1e-5 * 2.0
    return float(np.sum(2.0 * norm.pdf(x) * 2.0 * norm.sf(0.25 / x)) * 2e-5)


def missed_by_a_jump() -> float:
    """Probability that a number is in [1, 1.2) neither after a step of noise nor after one of 2 and noise."""
    x = np.linspace(-3.0, 3.0, 200_001)
    stays = (x < 1.0) | (x >= 1.2)
    after = 1.0 - (norm.cdf(1.2 - x - 2.0, scale=0.2) - norm.cdf(1.0 - x - 2.0, scale=0.2))
    return float(np.trapezoid(np.where(stays, norm.pdf(x, scale=0.2) * after, 0.0), x))


def nowhere(self: ErrorSystem, c: Any, earlier: Any = None) -> Any:
    """Say that errors are forms of the noise."""
    ends, forms = ROWS(self, c, earlier)
    return 0.0 * ends, forms


def within_shifts(self: ErrorSystem, c: Any, earlier: Any = None) -> Any:
    """Say that errors are forms of the noise, shifted."""
    ends, forms = ROWS(self, c, earlier)
    return np.tile(ends.mean(axis=0), (2, 1)), forms


def without_inputs(self: Constraints, low: Any, high: Any, width: Any, forms: Any, labels: Any) -> None:
    """Ask for nothing of inputs."""
    if not labels[0].startswith("input"):
        ADD(self, low, high, width, forms, labels)


ROWS, ADD = ErrorSystem.rows, Constraints.add
NOISE: Any = checked_problem.Problem.noise
CANCELLING = property(lambda self: np.abs(NOISE.func(self)))
HALF = 2.0 * float(norm.sf(0.5))
CASES = {
    "drift": Case(of_drift(0.49), of_drift(6.0), HALF, 1.02 * HALF, (ErrorSystem, "rows", nowhere)),
    "product": Case(of_product(0.49), of_product(6.0), far_product(), 0.87, (ErrorSystem, "rows", within_shifts)),
    "tube": Case(of_tube(0.48), of_tube(6.0), HALF, 1.03 * HALF, (ErrorSystem, "rows", nowhere)),
    "middle": Case(of_middle(), of_middle(), 1.0, 1.0, (ErrorSystem, "rows", nowhere)),
    "inputs": Case(
        of_inputs(), of_inputs(), 2.0 * float(norm.sf(0.51)), 1.01 * HALF,
        (Constraints, "add", without_inputs),
    ),
    "wind": Case(of_wind(), of_wind(), HALF, 1.001 * HALF, (checked_problem.Problem, "noise", CANCELLING)),
    "jump": Case(of_jump(), of_jump(), missed_by_a_jump(), 1.0, (trajectories, "_ask_jumps", lambda *_: None)),
}  # fmt: skip


@pytest.mark.parametrize("name", CASES)
def test_runs_fail_as_often_as_is_said(name: str) -> None:
    case = CASES[name]
    found = cg.rollout(case.certificate.problem, case.certificate.controller, EPISODES, seed=0)
    rate = 1.0 - found.successes / found.episodes
    assert abs(rate - case.truth) <= DEVIATIONS * sqrt(case.truth * (1.0 - case.truth) / EPISODES) + 2.0 * FAINT


@pytest.mark.parametrize("name", CASES)
def test_the_check_makes_of_it_no_less_and_hardly_more(name: str) -> None:
    case = CASES[name]
    report = cg.check(case.certificate)
    assert report
    assert (1.0 - 1e-3) * case.truth <= 1.0 - report.recomputed <= case.most
    for certificate in (case.certificate, case.loose):
        for share in (0.5, 0.9, 0.99):
            assert not cg.check(changed(certificate, failure=share * case.truth))


@pytest.mark.parametrize("name", CASES)
def test_a_check_that_leaves_it_out_accepts_what_most_runs_contradict(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What makes these problems: that sabotage is seen."""
    case = CASES[name]
    forged = changed(case.loose, failure=0.5 * case.truth)
    assert not cg.check(forged)
    monkeypatch.setattr(*case.sabotage)
    monkeypatch.setattr(canonical, "_verdicts", {})
    assert cg.check(forged)
