"""Grids of vertices that are others at each time: values below the truth, forgeries, vehicles."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.special import ndtr

import certigym as cg
from certigym.synthesis.certificates.controllers import interpolated
from certigym.synthesis.certificates.proofs import canonical_problem
from certigym.synthesis.checker import CheckedProblem, Refused, read_problem
from certigym.synthesis.extended_check.vertex_grids import Backups, turns
from certigym.synthesis.policy_search.vertex_values import sampled_runs, value_iteration
from certigym.synthesis.trajectories.planning import CountedWork
from rollout_limits import most_by_rollouts

HORIZON = 6
STD = {2: [0.1, 0.15], 3: [0.12, 0.12, 0.2]}


def vehicle(**more: Any) -> cg.Problem:
    """A vehicle of place and heading that passes a rock."""
    options = {
        "states": ["x", "y", "h"], "dynamics": ["x + 0.5*cos(h)", "y + 0.5*sin(h)", "h + 0.6*u"], "noise_std": STD[3],
        "state_low": [-1, -3, -3], "state_high": [5, 3, 3], "inputs": ["u"], "input_low": [-1], "input_high": [1],
        "initial_state": [0, 0, 0],
    }  # fmt: skip
    agent = cg.Agent(name="car", **{**options, **more})
    places = {"goal": ([1.6, -0.9, -3], [3.4, 0.9, 3]), "rock": ([0.6, -1.5, -3], [1.4, -0.35, 3])}
    regions = {name: cg.Proposition("car", *ends) for name, ends in places.items()}
    return cg.Problem(name="p", agents=[agent], propositions=regions, specification="!rock U goal", horizon=7)


def with_grid(proof: Any, **changed: Any) -> Any:
    return replace(proof, grid=replace(proof.grid, **changed))


def cart() -> cg.Problem:
    agent = cg.Agent(
        name="cart", states=["x", "v"], inputs=["u"], dynamics=["x + 0.3*v", "0.9*v + 0.4*u - 0.1*x*x"],
        noise_std=STD[2], state_low=[-3, -2], state_high=[3, 2], input_low=[-1], input_high=[1], initial_state=[0, 0],
    )  # fmt: skip
    goal = cg.Proposition("cart", [0.5, -1], [1.5, 1])
    return cg.Problem(name="p", agents=[agent], propositions={"goal": goal}, specification="F goal", horizon=HORIZON)


def checked(problem: cg.Problem) -> CheckedProblem:
    return read_problem({"problem": canonical_problem(problem)})


def moving(problem: CheckedProblem, cells: int) -> tuple[np.ndarray, ...]:
    """Windows that move and become wider, unevenly cut; along the last axis at rest."""
    rng, (low, high), edges = np.random.default_rng(4), problem.agents[0].state_box, []
    for k, (a, b) in enumerate(zip(low, high, strict=True)):
        shares = (rng.uniform(0.0, 0.4, (problem.horizon + 1, cells + 1)) + np.arange(cells + 1)) / (cells + 1)
        begin = a + (b - a) * np.linspace(0.05, 0.3, problem.horizon + 1)[:, None]
        edges.append(begin + (b - a) * np.linspace(0.5, 0.65, problem.horizon + 1)[:, None] * shares)
        if k == len(low) - 1:
            edges[-1] = np.linspace(a, b, cells + 1)
    return tuple(edges)


MOVES: dict[int, Callable[[np.ndarray, np.ndarray], list[np.ndarray]]] = {
    2: lambda x, u: [x[0] + 0.3 * x[1], 0.9 * x[1] + 0.4 * u - 0.1 * x[0] ** 2],
    3: lambda x, u: [x[0] + 0.5 * np.cos(x[2]), x[1] + 0.5 * np.sin(x[2]), x[2] + 0.6 * u],
}


def mean_of(W: np.ndarray, edges: tuple[np.ndarray, ...], y: list[np.ndarray], std: list[float]) -> np.ndarray:
    """Return E W(y + noise) (M,), along one axis after the other."""
    total: Any = np.broadcast_to(W, (len(y[0]), *W.shape))
    for axis, own, size in zip(edges, y, std, strict=True):
        z = (axis - own[:, None]) / size
        mass, phi = np.diff(ndtr(z), axis=1), np.exp(-0.5 * z * z) / np.sqrt(2.0 * np.pi)
        rising = (phi[:, :-1] - phi[:, 1:] - z[:, :-1] * mass) / np.diff(z, axis=1)
        hats = np.stack([mass - rising, rising], axis=-1).reshape(len(mass), -1)
        total = np.einsum("na,na...->n...", hats, total)
    return np.asarray(total)


def below_and_true(problem: CheckedProblem, cells: int, on_lattice: bool, t: int = 2) -> tuple[np.ndarray, np.ndarray]:
    """Return what is proved to be below a mean, and that mean, at states of the grid of a time."""
    d, rng = len(problem.agents[0].states), np.random.default_rng(5)
    edges = moving(problem, cells)
    steps = Backups(problem, edges, (True,) * d, 7.0)
    if on_lattice:
        times = range(problem.horizon + 1)
        each = [[(own[0] - 1.0, own[-1] + 1.0) for own in steps.edges_at(t)] for t in times]
        steps.window = np.array(each).transpose(0, 2, 1)
    there = np.meshgrid(*(0.5 * (axis[1:] + axis[:-1]) for axis in steps.edges_at(t + 1)), indexing="ij")
    W = np.sin(there[0] + 0.5) * np.cos(0.7 * there[1])
    for k in range(d):
        W = np.repeat(W, 2, axis=k)
    W = 0.7 + 0.2 * W + rng.uniform(0.0, 0.02, W.shape)
    inputs = 0.4 * np.sin(np.stack(np.meshgrid(*steps.edges_at(t), indexing="ij")).sum(axis=0)).reshape(-1, 1)
    found, nothing = steps.below(W, steps.images_of(inputs, t))
    here = steps.edges_at(t)
    x = np.stack([rng.uniform(axis[0], axis[-1], 4000) for axis in here])
    u = interpolated(here, inputs[None], x, np.zeros(x.shape[1], dtype=int))[0]
    true = mean_of(W, steps.edges_at(t + 1), MOVES[d](x, u), STD[d])
    own = interpolated(here, found.reshape(1, -1, 1), x, np.zeros(x.shape[1], dtype=int))[0]
    at = tuple(np.searchsorted(axis, own, side="right") - 1 for axis, own in zip(here, x, strict=True))
    return np.where(nothing[at], 0.0, own), true


@pytest.mark.parametrize("on_lattice", [False, True])
@pytest.mark.parametrize(("make", "cells"), [(cart, 24), (vehicle, 16)])
def test_backups_from_one_grid_to_the_next_are_below_the_truth(
    make: Callable[[], cg.Problem], cells: int, on_lattice: bool
) -> None:
    found, true = below_and_true(checked(make()), cells, on_lattice)
    assert np.all(found <= true + 1e-12) and np.mean(found > 0.1) > 0.1


def test_a_grid_of_the_wrong_time_is_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    edges_at = Backups.edges_at
    monkeypatch.setattr(Backups, "edges_at", lambda self, t: edges_at(self, min(t, 2)))
    with pytest.raises(AssertionError):
        problem = checked(cart())
        steps = Backups(problem, moving(problem, 24), (True, True), 7.0)
        W = np.random.default_rng(5).uniform(0.6, 1.0, tuple(2 * n for n in steps.shape))
        found, _ = steps.below(W, steps.images_of(np.zeros((25**2, 1)), 2))
        here = edges_at(steps, 2)
        x = np.stack(np.meshgrid(*here, indexing="ij")).reshape(2, -1)
        true = mean_of(W, edges_at(steps, 3), MOVES[2](x, 0.0 * x[0]), STD[2])
        assert np.all(found.ravel() <= true + 1e-12)


@pytest.fixture(scope="module")
def certificate() -> cg.Certificate:
    path = cg.synthesize(vehicle(), relation="path", effort=4.0)
    return value_iteration.vertex_grid_certificate(vehicle(), CountedWork(8.0), path.controller).certificate


@pytest.mark.thorough
def test_a_vehicle_in_noise_is_certified_by_default() -> None:
    found = cg.synthesize(vehicle(), effort=30.0)
    path = cg.synthesize(vehicle(), relation="path")
    assert "move with runs" in found.certificate.proof.method
    assert found.lower_bound > 0.5 + 0.5 * path.lower_bound


def test_certificates_stand_rollouts_and_travel(certificate: cg.Certificate, tmp_path: Path) -> None:
    proof: Any = certificate.proof
    assert proof.grid.moves and "move with runs" in proof.method and certificate.lower_bound > 0.5
    assert certificate.lower_bound <= most_by_rollouts(certificate, 3)
    cg.save(certificate, tmp_path / "c.npz")
    again: Any = cg.load(tmp_path / "c.npz")
    assert cg.check(again) and all(map(np.array_equal, again.proof.grid.edges, proof.grid.edges))


@pytest.mark.parametrize("forge", ["window", "number"])
def test_lattices_and_axes_of_other_shapes_are_refused(certificate: cg.Certificate, forge: str, tmp_path: Path) -> None:
    proof: Any = certificate.proof
    if forge == "window":
        report = cg.check(replace(certificate, proof=with_grid(proof, window=proof.grid.window[0])))
        assert not report and "each time" in str(report.failures)
    else:
        wrong = with_grid(proof, edges=(np.array(1.0), *proof.grid.edges[1:]))
        cg.save(replace(certificate, proof=wrong), tmp_path / "c.npz")
        with pytest.raises(ValueError, match="fit its grid"):
            cg.load(tmp_path / "c.npz")


@pytest.mark.parametrize("forge", ["one time", "later", "beyond", "turned", "fewer"])
def test_forged_grids_are_refused(certificate: cg.Certificate, forge: str) -> None:
    proof: Any = certificate.proof
    first, *others = proof.grid.edges
    beyond, turned = first.copy(), first.copy()
    beyond[3, -1], turned[3] = 5.5, turned[3, ::-1]
    wrong = {"one time": first[1], "later": np.roll(first, 1, axis=0), "beyond": beyond, "turned": turned}
    forged = with_grid(proof, edges=(wrong.get(forge, first[1:]), *others))
    report = cg.check(replace(certificate, proof=forged))
    assert not report and report.failures


def test_windows_of_all_runs_stay_narrower_than_a_turn() -> None:
    problem = checked(turning())
    windows = np.tile(np.array([[-1.0, -1.0, -4.0], [1.0, 1.0, 3.5]]), (problem.horizon + 1, 1, 1))
    found = sampled_runs.within_a_turn(problem, windows)
    assert np.array_equal(found[..., :2], windows[..., :2])
    edges = tuple(found[:, :1, k] + (found[:, 1:, k] - found[:, :1, k]) * np.linspace(0.0, 1.0, 9) for k in range(3))
    assert Backups(problem, edges, (True,) * 3).moves and np.ptp(found[0, :, 2]) > 6.28


def test_runs_that_spread_wide_are_refused_in_words() -> None:
    with pytest.raises(Refused, match="each time"):
        problem = checked(cart())
        Backups(problem, tuple(axis[None] if axis.ndim == 1 else axis[:3] for axis in moving(problem, 5)), (True, True))
    assert value_iteration.MOVING.keys() == {2, 3}


def turning(**more: Any) -> cg.Problem:
    """The vehicle with a heading that wraps, which begins near the end of a turn."""
    ends = {"state_low": [-4, -3, -np.pi], "state_high": [2, 3, np.pi], "initial_state": [0, 0, 2.9]}
    problem = vehicle(angles=["h"], **{**ends, **more})
    places = {"goal": {"low": [-3.6, -1.5], "high": [-1.8, 0.7]}, "rock": {"low": [-1.5, 0.35], "high": [-0.7, 1.8]}}
    regions = {name: cg.Proposition("car", of=["x", "y"], **ends) for name, ends in places.items()}
    regions["back"] = cg.Proposition("car", heading={"of": "h", "from": "pi - 1", "to": "-pi + 1.2"})
    task = "!rock U (goal & back)"
    return cg.Problem(name="p", agents=problem.agents, propositions=regions, specification=task, horizon=7)


def holds(problem: CheckedProblem, p: int, numbers: np.ndarray) -> np.ndarray:
    """Return whether a region holds at numbers (M,) along the angle, wherever else."""
    region, low, high = problem.regions[p], -np.pi, np.pi
    state = numbers - 2.0 * np.pi * np.floor((numbers - low) / (high - low))
    return (region.low[0, 2] <= state) & (state < region.high[0, 2])


@pytest.mark.parametrize("first", [-9.0, -3.0, 0.4, 3.3])
@pytest.mark.parametrize("sabotaged", [False, True])
def test_regions_along_angles_have_a_copy_for_every_turn(
    first: float, sabotaged: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    if sabotaged:  # copies a tenth of a radian away
        monkeypatch.setattr(turns, "TURN", 6.183)
    problem, rng = checked(turning()), np.random.default_rng(6)
    (p,) = [k for k, own in enumerate(problem.regions) if np.any(np.isfinite(own.low[0, 2]) & (own.low[0, 2] > -4))]
    edges = np.array([0.0, 1.0]), np.array([0.0, 1.0]), np.array(first + 0.05 * np.arange(110), dtype=np.float64)
    labels = turns.labels_of_copies(problem, edges)[:, p]
    numbers = rng.uniform(edges[2][:-1, None], edges[2][1:, None], (109, 200))
    inside = holds(problem, p, numbers)
    is_right = np.all(inside[labels == 1]) and not np.any(inside[labels == -1])
    assert is_right != (sabotaged and first != -3.0) and 0 < np.sum(labels == 0) <= 6


@pytest.mark.thorough
def test_a_vehicle_that_turns_through_pi_is_certified() -> None:
    problem = turning()
    path = cg.synthesize(problem, relation="path", effort=4.0)
    found = value_iteration.vertex_grid_certificate(problem, CountedWork(10.0), path.controller)
    proof: Any = found.certificate.proof
    assert found.lower_bound > 0.3 and proof.grid.edges[2].max() > np.pi
    assert cg.check(found.certificate)
    assert found.lower_bound <= most_by_rollouts(found.certificate, 4)
    # the same point of the circle, the same input
    controller: Any = found.controller
    x = np.array([[-1.0, -1.0], [0.0, 0.0], [3.1, 3.1 - 2.0 * np.pi]])
    same = controller.inputs(0, x, np.array([problem.automaton.initial] * 2), 3)
    assert np.allclose(same[:, 0], same[:, 1], atol=1e-9)
    # a window of a turn is refused: which number would a state be?
    wide = proof.grid.edges[2][:, :1] + (2.0 * np.pi) * np.linspace(0.0, 1.0, proof.grid.edges[2].shape[1])
    report = cg.check(replace(found.certificate, proof=with_grid(proof, edges=(*proof.grid.edges[:2], wide))))
    assert not report and "narrower than a turn" in str(report.failures)
