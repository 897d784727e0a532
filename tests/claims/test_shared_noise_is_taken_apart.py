"""Grids of vertices where noise moves both states: runs of the coordinates are those of the states."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import certigym as cg
from certigym.envs.systems.distributions import Gaussian
from certigym.synthesis.certificates.proofs import canonical_problem
from certigym.synthesis.checker import CheckedProblem, Refused, read_problem, value_on
from certigym.synthesis.extended_check.vertex_grids import (
    Backups,
    Independent,
    Normal,
    coordinates,
    images_at,
    independent,
)
from certigym.synthesis.extended_check.vertex_grids.coordinates import FINEST
from rollout_limits import most_by_rollouts

LAPLACE = {"law": "laplace", "scale": 0.1}
NOISE: dict[str, dict[str, Any]] = {
    "correlated": {"noise_covariance": [[0.01, 0.008], [0.008, 0.02]]},
    "against each other": {"noise_covariance": [[0.03, -0.01], [-0.01, 0.005]]},
    "one source": {"noise_covariance": [[0.0001, 0.002], [0.002, 0.04]]},
    "other laws": {"noise": [LAPLACE, {"law": "uniform", "low": -0.1, "high": 0.1}], "noise_axes": [[1, 0], [-0.5, 1]]},
}  # fmt: skip


def problem_of(name: str, **more: Any) -> cg.Problem:
    options = {"states": ["x", "v"], "dynamics": ["x + 0.2*v", "0.9*v - 0.1*sin(x) + 0.3*u"], "initial_state": [0, 0]}
    options |= {"state_low": [-1, -2], "state_high": [3, 2], "inputs": ["u"], "input_low": [-1], "input_high": [1]}
    agent = cg.Agent(name="ship", outputs=["x", "v + 0.1*x"], **{**options, **NOISE[name], **more})
    goal = cg.Proposition("ship", [1.0, -0.8], [2.0, 0.8])
    return cg.Problem(name="p", agents=[agent], propositions={"goal": goal}, specification="F goal", horizon=12)


def checked(problem: cg.Problem) -> CheckedProblem:
    return read_problem({"problem": canonical_problem(problem)})


@pytest.mark.parametrize("name", NOISE)
def test_runs_of_coordinates_are_those_of_states(name: str) -> None:
    own, rng = checked(problem_of(name)), np.random.default_rng(2)
    other = independent(own)
    assert isinstance(other, Independent) and not isinstance(own, Independent)
    agent, there = own.agents[0], other.agents[0]
    low, high = agent.state_box
    x, u = rng.uniform(low[:, None], high[:, None], (2, 500)), rng.uniform(-1.0, 1.0, (500, 1))
    w = rng.standard_normal((agent.noise.shape[1], 500))
    z = other.matrix @ x
    later = images_at(agent, x, u, 0)[0][:2] + agent.noise @ w
    scales = np.stack([value_on(tree, {"x": np.zeros((2, 500))})[0] for tree in there.scale])
    assert np.allclose(images_at(there, z, u, 0)[0][:2] + scales * (there.noise @ w), other.matrix @ later, atol=1e-12)
    # each axis has one source at most, each source one axis; what sources the check knows are those
    assert np.all(np.count_nonzero(there.noise, axis=0) <= 1) and np.all(np.count_nonzero(there.noise, axis=1) <= 1)
    deviations = np.array([[own.deviation] for own in agent.envelopes])
    assert np.allclose(images_at(there, z, u, 0)[0][2:], scales * (np.abs(there.noise) @ deviations))
    # states and outputs are read from z, and z lies in its box
    names = {name: np.stack([row, row]) for name, row in zip(there.states, z, strict=True)}
    before = {name: np.stack([row, row]) for name, row in zip(agent.states, x, strict=True)}
    assert np.allclose([value_on(tree, names)[0] for tree in other.inverse], x, atol=1e-12)
    for a, b in zip(agent.outputs, there.outputs, strict=True):
        assert np.allclose(value_on(a, before), value_on(b, names), atol=1e-12)
    assert np.all((there.state_box[0][:, None] <= z) & (z <= there.state_box[1][:, None]))


@pytest.mark.parametrize("name", NOISE)
def test_cells_inside_hold_no_state_outside(name: str) -> None:
    problem, rng = independent(checked(problem_of(name))), np.random.default_rng(3)
    assert isinstance(problem, Independent)
    edges = tuple(np.linspace(a, b, 23) for a, b in problem.agents[0].state_box.T)
    steps = Backups(problem, edges, (True, True), noise_laws=problem_of(name).agents[0].laws)
    z = np.stack([rng.uniform(axis[0], axis[-1], 20_000) for axis in edges])
    x = np.linalg.solve(problem.matrix, z)
    low, high = problem.workspace
    out = np.any((x < low[:, None]) | (x > high[:, None]), axis=0)
    cells = tuple(2 * (np.searchsorted(axis, own) - 1) for axis, own in zip(edges, z, strict=True))
    assert out.any() and not np.any(steps.inside(0)[cells][out]) and steps.inside(0).mean() > 0.3
    # nothing is worth anything there, whatever comes later
    values, nothing = steps.at_end()
    W = steps.after_letter(np.ones_like(values), nothing, 0, 1)
    assert np.all(W[cells][out] == 0.0) and W.max() == 1.0


@pytest.fixture(scope="module")
def certificate() -> cg.Certificate:
    return cg.synthesize(problem_of("correlated"), relation="vertices", effort=8.0).certificate


def test_certificates_stand_rollouts_and_travel(certificate: cg.Certificate, tmp_path: Path) -> None:
    proof: Any = certificate.proof
    assert proof.kind == "vertex-grid" and proof.grid.matrix is not None and certificate.lower_bound > 0.9
    assert certificate.lower_bound <= most_by_rollouts(certificate, 3)
    cg.save(certificate, tmp_path / "c.npz")
    again: Any = cg.load(tmp_path / "c.npz")
    assert cg.check(again) and np.array_equal(again.proof.grid.matrix, proof.grid.matrix)


@pytest.mark.parametrize("forge", ["none", "turned", "finer"])
def test_other_coordinates_are_refused(certificate: cg.Certificate, forge: str) -> None:
    proof: Any = certificate.proof
    matrix = {"none": None, "turned": proof.grid.matrix.T, "finer": np.nextafter(proof.grid.matrix, 2.0)}[forge]
    report = cg.check(replace(certificate, proof=replace(proof, grid=replace(proof.grid, matrix=matrix))))
    assert not report and "other coordinates" in str(report.failures)


def test_starts_on_edges_and_cells_that_are_too_fine_are_refused() -> None:
    problem = independent(checked(problem_of("correlated", initial_state=[0.3, 0.7])))
    low, high = problem.agents[0].start
    edges = [np.linspace(a, b, 9) for a, b in problem.agents[0].state_box.T]
    axis = int(np.argmax(high - low))
    assert low[axis] < high[axis]  # known up to rounding
    edges[axis][3] = high[axis]
    steps = Backups(problem, tuple(np.sort(own) for own in edges), (True, True))
    with pytest.raises(Refused, match="either side of an edge"):
        steps.failure(*steps.at_end())
    edges[0] = np.sort(np.append(edges[0], edges[0][4] + 0.5 * 4.0 / FINEST))
    assert isinstance(problem, Independent)
    with pytest.raises(Refused, match="too narrow"):
        problem.refuse_fine(tuple(edges))
    with pytest.raises(Refused, match="in a box"):
        independent(checked(problem_of("correlated", initial_state=None, initial_low=[0, 0], initial_high=[0.1, 0])))


COVARIANCE = [[0.041, 0.023, -0.011], [0.023, 0.053, 0.017], [-0.011, 0.017, 0.031]]


def of_three(**more: Any) -> cg.Problem:
    options = {"states": ["x", "y", "h"], "inputs": ["u"], "input_low": [-1], "input_high": [1]}
    options |= {"dynamics": ["x + 0.3*cos(h)", "y + 0.3*sin(h)", "h + 0.2*u"], "initial_state": [0, 0, 0]}
    options |= {"state_low": [-2, -2, -2], "state_high": [3, 2, 2], "noise_covariance": COVARIANCE}
    agent = cg.Agent(name="car", **{**options, **more})
    goal = cg.Proposition("car", [1, -1, -2], [2, 1, 2])
    return cg.Problem(name="p", agents=[agent], propositions={"goal": goal}, specification="F goal", horizon=12)


def test_normal_noise_of_three_states_is_taken_apart() -> None:
    own, rng = checked(of_three()), np.random.default_rng(7)
    other = independent(own)
    assert isinstance(other, Independent) and 0.0 < other.lost < 1e-13
    agent, there = own.agents[0], other.agents[0]
    low, high = agent.state_box
    x, u = rng.uniform(low[:, None], high[:, None], (3, 500)), rng.uniform(-1.0, 1.0, (500, 1))
    assert np.allclose(images_at(there, other.matrix @ x, u, 0)[0][:3], other.matrix @ images_at(agent, x, u, 0)[0][:3])
    sizes = np.diag(there.noise)
    assert np.allclose(other.matrix @ COVARIANCE @ other.matrix.T, np.diag(sizes**2), atol=1e-15)
    assert np.array_equal(images_at(there, other.matrix @ x, u, 0)[0][3:, 0], sizes)
    names = {name: np.stack([row, row]) for name, row in zip(there.states, other.matrix @ x, strict=True)}
    assert np.allclose([value_on(tree, names)[0] for tree in other.inverse], x, atol=1e-12)
    edges = tuple(np.linspace(a, b, 17) for a, b in there.state_box.T)
    steps = Backups(other, edges, (True,) * 3)
    z = np.stack([rng.uniform(axis[0], axis[-1], 20_000) for axis in edges])
    places = np.linalg.solve(other.matrix, z)
    out = np.any((places < low[:, None]) | (places > high[:, None]), axis=0)
    cells = tuple(2 * (np.searchsorted(axis, row) - 1) for axis, row in zip(edges, z, strict=True))
    assert out.any() and not np.any(steps.inside(0)[cells][out]) and steps.inside(0).mean() > 0.1
    # what is off by rounding is added to the failure
    certain = np.ones_like(steps.at_end()[0]), steps.at_end()[1]
    assert steps.failure(*certain) >= other.lost


@pytest.mark.parametrize("factor", [1.0, 1.0 + 1e-9])
def test_what_coordinates_leave_is_counted(factor: float, monkeypatch: pytest.MonkeyPatch) -> None:
    # deviations a little off: what noise differs by is charged, and coordinates that give up more are none
    root = coordinates.math.sqrt
    monkeypatch.setattr(coordinates.math, "sqrt", lambda x: root(x) * (factor if 1e-3 < x < 1.0 else 1.0))
    other = independent(checked(of_three()))
    assert isinstance(other, Independent) == (factor == 1.0)


def test_normal_noise_with_two_sources_for_each_state_is_taken_apart() -> None:
    noise = [{"law": "gaussian", "std": 0.1}, {"law": "gaussian", "std": 0.2}]
    other = independent(checked(problem_of("other laws", noise=noise, noise_axes=[[1, 0.5], [-0.5, 1]])))
    assert isinstance(other, Independent) and other.lost < 1e-13
    # laws by their place say nothing of the sources of other coordinates
    edges = tuple(np.linspace(a, b, 9) for a, b in other.agents[0].state_box.T)
    steps = Backups(other, edges, (True, True), noise_laws=[Gaussian(0.1), Gaussian(0.2)])
    assert all(isinstance(own, Normal) for own in steps.noises)
    noise[0] = {"law": "laplace", "scale": 0.1}
    assert not isinstance(
        independent(checked(problem_of("other laws", noise=noise, noise_axes=[[1, 0.5], [-0.5, 1]]))), Independent
    )
