"""Certificates along paths of linear agents: below the truth, checked by other code, carried out.

Forgeries and files are those of all paths: `test_nonlinear_paths_are_certified.py`.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.stats import norm

import certigym as cg
from certigym.synthesis.certificates.proofs import AlongPath, PathProof, changed
from certigym.synthesis.trajectories.chance_constraints.affine_forms import AffineForms
from certigym.synthesis.trajectories.chance_constraints.nonlinear_model import NonlinearModel

FALSE_ALARM = 1e-6
"""Probability that a test of rollouts fails although the claim is true."""


def chain(n: int, horizon: int, safe: float = 10.0, start: list[float] | None = None) -> cg.Problem:
    """Return the chain of n integrators that is to stay in a box."""
    tau = 0.1
    rows = [[tau ** (j - i) / math.factorial(j - i) if j >= i else 0.0 for j in range(n)] for i in range(n)]
    agent = cg.LinearAgent(
        name="chain", A=rows, B=[[tau ** (n - i) / math.factorial(n - i)] for i in range(n)],
        noise_covariance=0.01 * np.eye(n), state_low=[-safe] * n, state_high=[safe] * n, input_low=[-1.0],
        input_high=[1.0], initial_state=[0.0] * n if start is None else start,
    )  # fmt: skip
    return problem_of([agent], {"safe": cg.Proposition("chain", [-safe] * n, [safe] * n)}, "G safe", horizon)


def problem_of(agents: list[Any], regions: dict[str, cg.Proposition], formula: str, horizon: int) -> cg.Problem:
    """Return a problem; formulas with G are judged at the end."""
    task = cg.Specification(formula, "finite-trace" if "G" in formula else "co-safe")
    return cg.Problem(name="along", agents=agents, propositions=regions, specification=task, horizon=horizon)


def boat(name: str, start: list[float], noise: Any = None) -> cg.LinearAgent:
    """Return an agent in the plane with two velocities: four states."""
    A = [[1.0, 0.0, 0.5, 0.0], [0.0, 1.0, 0.0, 0.5], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
    return cg.LinearAgent(
        name=name, A=A, B=[[0.0, 0.0], [0.0, 0.0], [0.5, 0.0], [0.0, 0.5]],
        noise_covariance=0.002 * np.eye(4) if noise is None else noise, state_low=[-5, -5, -3, -3],
        state_high=[5, 5, 3, 3], input_low=[-2, -2], input_high=[2, 2], initial_state=start,
        output_matrix=[[1, 0, 0, 0], [0, 1, 0, 0]],
    )  # fmt: skip


def harbour(horizon: int = 14) -> cg.Problem:
    """Two boats: one passes a rock, then both are at the pier."""
    regions = {
        "rock": cg.Proposition("left", [-1, -1.5], [1, 1]),
        "pier": cg.Proposition("left", [2, -1], [4, 1]),
        "buoy": cg.Proposition("right", [2, 2], [4, 4]),
    }
    agents = [boat("left", [-3, 0, 0, 0]), boat("right", [0, 0, 0, 0])]
    return problem_of(agents, regions, "(!rock) U (pier & buoy)", horizon)


def singular() -> cg.Problem:
    """Noise reaches the velocities alone."""
    agents = [boat("left", [-3, 0, 0, 0], np.diag([0.0, 0.0, 0.004, 0.004]))]
    return problem_of(agents, {"pier": cg.Proposition("left", [2, -1], [4, 1])}, "F pier", 12)


PROBLEMS = {"chain": chain(3, 30), "harbour": harbour(), "singular": singular(), "short": chain(2, 5, 1.0)}


def path_of(problem: cg.Problem) -> AlongPath:
    """Return the certificate along a path of a problem."""
    found: Any = cg.synthesize(problem, relation="path").certificate
    assert isinstance(found.proof, PathProof)
    return found


@pytest.fixture(scope="module", params=sorted(PROBLEMS))
def certificate(request: pytest.FixtureRequest) -> AlongPath:
    return path_of(PROBLEMS[request.param])


def test_certificates_are_checked_and_not_refuted(certificate: AlongPath) -> None:
    report = cg.check(certificate, certificate.problem)
    assert report.valid, report.failures
    assert certificate.lower_bound > 0.3
    verdict = cg.validate(certificate, 20_000, seed=1, confidence=1.0 - FALSE_ALARM / 4)
    assert verdict.verdict != "refuted"


def test_one_step_is_exact_and_several_are_below_the_truth() -> None:
    """A scalar that is to stay in an interval, against quadrature on a fine grid."""
    agent = cg.LinearAgent(
        name="chain", A=[[1.0]], B=[[1.0]], noise_covariance=[[0.16]], state_low=[-1], state_high=[1],
        input_low=[0.0], input_high=[0.0], initial_state=[0.2],
    )  # fmt: skip
    for horizon in (1, 3):
        problem = problem_of([agent], {"safe": cg.Proposition("chain", [-1], [1])}, "G safe", horizon)
        certificate = path_of(problem)
        x = np.linspace(-1.0, 1.0, 801)
        value, inner = np.ones_like(x), np.resize([4.0, 2.0], len(x) - 2)  # Simpson's rule: off by less than 1e-9
        weight = np.concatenate([[1.0], inner, [1.0]]) * (x[1] - x[0]) / 3.0
        for _ in range(horizon - 1):
            value = norm.pdf(x[None] - x[:, None], scale=0.4) @ (weight * value)
        truth = float(norm.pdf(x - 0.2, scale=0.4) @ (weight * value))
        assert certificate.lower_bound <= truth + 1e-7
        assert certificate.lower_bound > truth - (1e-6 if horizon == 1 else 0.2)
        assert cg.check(certificate).valid


@pytest.mark.thorough
def test_small_failures_are_not_rounded_to_none() -> None:
    certificate = path_of(chain(20, 5))
    assert 0.0 < certificate.proof.failure < 1e-200 and certificate.lower_bound < 1.0
    assert cg.check(certificate).valid


SABOTAGES = {
    "smaller noise": (NonlinearModel, "covariance", property(lambda model: 0.9 * model.agent.noise_covariance)),
    "calmer steps": (
        AffineForms, "of_motion", lambda agent, mean: AffineForms(np.hstack([0.8 * agent.A, agent.B]), mean),
    ),
}  # fmt: skip


@pytest.mark.usefixtures("search_alone")
@pytest.mark.parametrize("name", sorted(SABOTAGES))
def test_sabotage_of_the_search_is_refused_by_the_check(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """On a path whose probability of failing is not negligible."""
    problem = chain(2, 5, 1.0)
    monkeypatch.setattr(*SABOTAGES[name])
    certificate = path_of(problem)
    monkeypatch.undo()
    assert cg.check(path_of(problem))
    assert not cg.check(certificate)


def test_controllers_act_alike_in_environments_and_in_batches() -> None:
    """One episode in the PettingZoo environment, with the inputs that rollouts would use."""
    certificate = path_of(PROBLEMS["harbour"])
    environment = cg.parallel_env(certificate.problem)
    observations, infos = environment.reset(seed=3)
    certificate.controller.reset(observations, infos)
    for t in range(3):
        actions = certificate.controller.act(observations, infos)
        for i, name in enumerate(certificate.problem.agent_names):
            path, state = certificate.proof.paths[i], np.asarray(infos[name]["state"])
            wanted = path.inputs[t] + path.gains[t] @ (state - certificate.controller.nominal[i][t])
            np.testing.assert_allclose(actions[name], np.clip(wanted, -2.0, 2.0), atol=1e-12)
        observations, _, _, _, infos = environment.step(actions)
        assert "error" not in infos


def test_what_paths_do_not_do_is_said() -> None:
    problem = chain(2, 3)
    with pytest.raises(ValueError, match="which needs none"):
        cg.synthesize(problem, 40, relation="path")
    far = problem_of(list(problem.agents), {"goal": cg.Proposition("chain", [8, -10], [9, 10])}, "F goal", 3)
    with pytest.raises(ValueError, match="no nominal path"):
        cg.synthesize(far, relation="path")


def idle(**changes: Any) -> cg.LinearAgent:
    """Two states and three inputs, of which the last one moves nothing."""
    arguments: dict[str, Any] = {
        "A": [[1.0, 0.1], [0.0, 0.9]], "B": [[0.3, 0.0, 0.0], [0.0, 0.5, 0.0]], "noise_covariance": 0.01 * np.eye(2),
        "state_low": [-3.0] * 2, "state_high": [3.0] * 2, "input_low": [-1.0] * 3, "input_high": [1.0, 1.0, 2.0],
        "initial_state": [-1.0, 0.0],
    }  # fmt: skip
    return cg.LinearAgent(name="idle", **{**arguments, **changes})


def docks(agent: cg.LinearAgent) -> cg.Problem:
    return problem_of([agent], {"dock": cg.Proposition("idle", [0.5, -1.0], [2.5, 1.0])}, "F dock", 8)


def test_inputs_that_move_nothing_are_near_the_middle_and_may_be_at_a_face() -> None:
    certificate = cg.synthesize(docks(idle()), relation="path").certificate
    assert isinstance(certificate.proof, PathProof) and certificate.lower_bound > 0.9
    (path,) = certificate.proof.paths
    assert np.any(path.gains) and np.all(np.abs(path.inputs[:, 2] - 0.5) < 0.1)
    assert cg.check(certificate)
    at_face = path.inputs.copy()
    at_face[:, 2] = 2.0
    faced = changed(certificate, paths=(replace(path, inputs=at_face),))
    assert cg.check(faced)
    at_face[3, 2] = np.nextafter(2.0, 3.0)
    assert not cg.check(faced)


def test_inputs_that_noise_reaches_have_no_room_at_a_face() -> None:
    """The idle input follows the first state, which is noisy, or nothing."""
    agent = idle(noise_covariance=[[0.01, 0.0], [0.0, 0.0]], A=[[1.0, 0.1], [0.0, 0.9]])
    certificate = cg.synthesize(docks(agent), relation="path").certificate
    assert isinstance(certificate.proof, PathProof)
    (path,) = certificate.proof.paths
    for followed, admissible in (([1e-6, 0.0], False), ([0.0, 0.0], True)):
        inputs, gains = path.inputs.copy(), path.gains.copy()
        inputs[:, 2], gains[:, 1], gains[:, 2] = 2.0, 0.0, followed
        report = cg.check(changed(certificate, paths=(replace(path, inputs=inputs, gains=gains),), failure=0.5))
        assert bool(report) == admissible, report
