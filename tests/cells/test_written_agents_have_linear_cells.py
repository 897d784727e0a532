"""Linear cells of agents with expressions hold what they promise: below the truth, checked anew, sabotage refused."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.stats import norm

import certigym as cg
from certigym import Agent, Problem, Proposition, Specification
from certigym.synthesis.abstraction.kernels import MultilinearKernel
from certigym.synthesis.abstraction.kernels.lattice_kernel import bend_of
from certigym.synthesis.abstraction.models.corner_model import corner_model
from certigym.synthesis.certificates.proofs import changed
from certigym.synthesis.extended_check.steps.map_enclosures import map_enclosures
from certigym.synthesis.relations.grids import Grid, hats
from certigym.synthesis.relations.kinds import AffineBoxes, AffineMeans
from kinds import mostly_thorough
from written_problems import oscillator, oscillator_reach

FALSE_ALARM = 1e-6
"""Probability that rollouts refute a true certificate."""

STEPS: dict[str, list[str]] = {
    "pendulum": ["x + 0.1*y", "y + 0.1*(sin(x) - 0.2*y + 2*u) + 0.05*wind"],
    "oscillator": ["x + 0.1*y", "y + 0.1*(-x + (1 - x**2)*y) + u"],
    "input inside": ["x + 0.3*cos(y + u)", "y + 0.2*tanh(x)*u + 0.1*wind*x"],
    "kinks": ["x + 0.2*abs(y) - 0.1*max(x, y)", "y + 0.5*u/(1 + x**2)"],
}
NORMAL = {"law": "gaussian", "std": 0.3}


def mover(dynamics: str, **changes: Any) -> Agent:
    """An agent of two states, with a disturbance where its dynamics name one."""
    values: dict[str, Any] = {
        "name": "mover",
        "states": ["x", "y"],
        "inputs": ["u"],
        "dynamics": STEPS[dynamics],
        "noise": [NORMAL, {"law": "gaussian", "std": 0.25}],
        "state_low": [-1.5, -2.0],
        "state_high": [1.5, 2.0],
        "input_low": [-1.0],
        "input_high": [1.0],
        "initial_state": [0.8, 0.0],
    }
    if any("wind" in text for text in STEPS[dynamics]):
        values["disturbances"] = {"wind": [-0.4, 0.6]}
    return Agent(**{**values, **changes})


def reach(agent: Agent, horizon: int = 6) -> Problem:
    """The agent is to come to the middle."""
    return Problem(
        name="reach",
        horizon=horizon,
        agents=[agent],
        propositions={"middle": Proposition("mover", [-0.3, -2.0], [0.3, 2.0])},
        specification=Specification("F middle", "co-safe"),
    )


@pytest.mark.parametrize("name", STEPS)
def test_maps_hold_all_means(name: str) -> None:
    """500 random points of each of 40 cells, under random disturbances; the check's boxes are no larger."""
    agent, rng = mover(name), np.random.default_rng(1)
    low = rng.uniform([-1.5, -2.0], [1.2, 1.6], size=(40, 2))
    high, input_set = low + rng.uniform(0.02, 0.3, size=(40, 2)), np.array([[-1.0], [0.3], [1.0]])
    for cuts in (1, 2):
        maps = AffineMeans(agent, cuts).around(low, high, input_set)
        for a, inputs in enumerate(input_set):
            own = map_enclosures(agent, low, high, np.repeat(inputs[None], 40, axis=0), cuts)
            gain, rest = (array[:, a if array.shape[1] > 1 else 0] for array in (maps.gain, maps.rest))
            np.testing.assert_allclose(own[0], maps.centre[:, a], atol=1e-9)
            assert np.all(own[2] <= rest * (1.0 + 1e-12) + 1e-300) and np.all(rest <= own[2] + 1e-9)
            share = rng.random((40, 500, 2))
            x = low[:, None] + share * (high - low)[:, None]
            wind = rng.uniform(-0.4, 0.6, size=(1, 40, 500)) if agent.disturbances else np.zeros((0, 40, 500))
            means = agent.mean(np.moveaxis(x, 2, 0), np.broadcast_to(inputs[0], (1, 40, 500)), wind)
            mapped = np.einsum("sij,skj->ski", gain, x - 0.5 * (low + high)[:, None]) + maps.centre[:, a, None]
            assert np.all(np.abs(np.moveaxis(means, 0, 2) - mapped) <= rest[:, None] * (1.0 + 1e-12))


def test_what_is_left_is_of_second_order() -> None:
    """Half the cell leaves a quarter."""
    means = AffineMeans(oscillator(), 2)
    low = np.array([[0.5, 1.0]])
    wide, narrow = (means.around(low, low + width, np.zeros((1, 1))).rest[0, 0, 1] for width in (0.2, 0.1))
    assert wide == pytest.approx(4.0 * narrow, rel=0.2) and wide < 0.005


def test_inputs_that_are_added_have_one_map() -> None:
    assert AffineMeans(mover("pendulum"), 1).pushes is not None
    assert AffineMeans(mover("input inside"), 1).pushes is None


def expected(agent: Agent, grid: Grid, factor: np.ndarray, means: np.ndarray) -> np.ndarray:
    """``E l(m + w)`` of a multilinear factor at means (2, M), from moments of normal noise in closed form."""
    table = np.ones((means.shape[1], 1))
    for k, edges in enumerate(grid.edges):
        a, b = edges[:-1] - means[k][:, None], edges[1:] - means[k][:, None]
        std = float(np.sqrt(agent.noise_covariance[k, k]))
        mass = norm.cdf(b / std) - norm.cdf(a / std)
        moment = std * (norm.pdf(a / std) - norm.pdf(b / std)) - a * mass
        up = moment / (b - a)
        axis = np.stack([mass - up, up], axis=2).reshape(len(a), -1)
        table = (table[:, :, None] * axis[:, None, :]).reshape(len(a), -1)
    return np.asarray(table @ factor)


@pytest.mark.parametrize("name", STEPS)
def test_a_step_is_below_the_truth(name: str) -> None:
    """Random factors, random choices, random points of cells, random disturbances: a step is never above."""
    agent, rng = mover(name), np.random.default_rng(2)
    grid = Grid((np.linspace(-1.5, 1.5, 13), np.linspace(-2.0, 2.0, 17)))
    _, _, kernel, choices = corner_model(agent, grid)
    x, y = (np.repeat(edges, 2)[1:-1] for edges in grid.edges)
    ramp = np.exp(-2.0 * ((x[:, None] - 0.3) ** 2 + (y[None] + 0.5) ** 2)).ravel()
    near = 1.0
    for factor in (ramp, (ramp > 0.3) * 1.0, rng.random(len(ramp)) * ramp):
        policy = rng.integers(len(choices.relation.input_set), size=grid.n_cells).astype(np.int32)
        lower = choices.read(kernel.backup(factor[None]), policy)[0]
        points = rng.uniform([[-1.5], [-2.0]], [[1.5], [2.0]], size=(2, 4000))
        places, weights = hats(grid, points)
        inputs = choices.relation.input_set[policy[grid.cell_of(points)]].T
        wind = rng.choice([-0.4, 0.1, 0.6], size=(1, 4000)) if agent.disturbances else np.zeros((0, 4000))
        truth = expected(agent, grid, factor, agent.mean(points, inputs, wind))
        claimed = np.sum(lower[places] * weights, axis=1)
        assert np.all(claimed <= truth + 1e-13)
        near = min(near, float(np.mean(truth - claimed)))
    assert near < 0.1, "the bound is worth something"


def test_bends_of_lines_are_those_of_the_worst_line() -> None:
    """Chords of piecewise linear functions with one second difference of 1 at all points, at 2,000 random lines."""
    rng = np.random.default_rng(3)
    for steps in (0.2, 0.7, 1.0, 1.6, 2.0, 3.3, 5.0):
        most = 0.0
        for begin in rng.random(2000):
            t = np.linspace(0.0, 1.0, 401)
            place = begin + steps * t
            value = sum((np.maximum(place - k, 0.0) for k in range(1, int(begin + steps) + 2)), start=0.0 * t)
            most = max(most, float(np.max(value[0] + (value[-1] - value[0]) * t - value)))
        bound = float(bend_of(np.array([steps]))[0])
        assert most <= bound + 1e-12 and most >= 0.89 * bound


@cache
def certificate_of(name: str) -> cg.Certificate:
    """Small certificates of each kind."""
    problems = {
        "oscillator": (oscillator_reach(8), [20, 20]),
        "pendulum": (reach(mover("pendulum")), [20, 24]),
        "input inside": (reach(mover("input inside")), [14, 16]),
    }
    problem, cells = problems[name]
    return cg.synthesize(problem, cells, relation="linear").certificate


@mostly_thorough("name", ["oscillator", "pendulum", "input inside"])
def test_certificates_travel_and_hold(name: str, tmp_path: Path) -> None:
    """20,000 episodes notice a claim that is too large by about .02 at a false-alarm rate of 1e-6."""
    certificate = certificate_of(name)
    cg.save(certificate, tmp_path / "certificate.npz")
    loaded = cg.load(tmp_path / "certificate.npz")
    assert isinstance(loaded, cg.Certificate) and loaded.proof.agents[0].relation["kind"] == "linear"
    assert cg.check(loaded, certificate.problem) and loaded.lower_bound == certificate.lower_bound > 0.01
    report = cg.validate(loaded, 20_000, seed=1, confidence=1 - FALSE_ALARM)
    assert report.verdict != "refuted" and report.details["inadmissible"] == 0
    assert not cg.audit(loaded, 2_000, seed=2, confidence=1 - FALSE_ALARM).refuted
    later = cg.value_in_time(loaded).at(certificate.problem.agents[0].initial.low, loaded.problem.automaton.initial, 3)
    assert 0.0 <= later[0] <= 1.0


@mostly_thorough("cells", [50, 200, 400], first=2)
def test_noise_that_is_narrow_in_a_wide_workspace_is_proved(cells: int) -> None:
    """Hats of narrow cells are rounded far from 0, which the search has to count in full."""
    agent = Agent(
        name="drifter",
        states=["x"],
        inputs=["u"],
        dynamics=["0.95*x + u"],
        noise=[{"law": "gaussian", "std": 0.29}],
        state_low=[-5],
        state_high=[5],
        input_low=[-0.3],
        input_high=[0.3],
        initial_state=[-2],
    )
    regions = {"safe": Proposition("drifter", [-3], [3]), "goal": Proposition("drifter", [0.5], [1.5])}
    task = Specification("G safe & F[5,7] goal", "finite-trace")
    problem = Problem(name="drift", horizon=7, agents=[agent], propositions=regions, specification=task)
    certificate = cg.synthesize(problem, cells, relation="linear").certificate
    assert cg.check(certificate) and certificate.lower_bound > 0.44


def test_other_laws_are_refused_in_words() -> None:
    agent = mover("pendulum").to_dict() | {"noise": [{"law": "laplace", "scale": 0.2}] * 2}
    agent.pop("noise_covariance", None)
    with pytest.raises(ValueError, match="is for Gaussian noise"):
        cg.synthesize(reach(Agent(**agent)), 10, relation="linear")


def sabotaged(monkeypatch: pytest.MonkeyPatch, how: str) -> None:
    """Break the search in one of several ways; the check has code of its own."""
    around, lacking = AffineMeans.around, MultilinearKernel._lacking

    def smaller(self: AffineMeans, *args: Any) -> AffineBoxes:
        maps = around(self, *args)
        return replace(maps, rest=0.99 * maps.rest)

    def calm(self: AffineMeans, *args: Any) -> AffineBoxes:
        still = replace_disturbances(self.agent)
        return around(replace(self, agent=still), *args)

    def of_another_cell(self: AffineMeans, *args: Any) -> AffineBoxes:
        maps = around(self, *args)
        return replace(maps, gain=np.roll(maps.gain, 7, axis=0))

    def without_slopes(self: MultilinearKernel, table: Any, middle: Any, steps: Any, rest: Any) -> Any:
        return lacking(self, table, middle, steps, np.zeros_like(rest))

    def without_bends(self: MultilinearKernel, table: Any, middle: Any, steps: Any, rest: Any) -> Any:
        return lacking(self, table, middle, np.zeros_like(steps), rest)

    if how == "slopes left out":
        monkeypatch.setattr(MultilinearKernel, "_lacking", without_slopes)
    elif how == "bends left out":
        monkeypatch.setattr(MultilinearKernel, "_lacking", without_bends)
    else:
        changed = {"what is left 1 % too small": smaller, "a disturbance left out": calm}
        monkeypatch.setattr(AffineMeans, "around", changed.get(how, of_another_cell))


def replace_disturbances(agent: Agent) -> Agent:
    """The same agent in calm air."""
    return Agent(**{**agent.to_dict(), "disturbances": {"wind": [0.0, 0.0]}})


SABOTAGE = (
    "what is left 1 % too small",
    "a disturbance left out",
    "the Jacobian of another cell",
    "slopes left out",
    "bends left out",
)


@pytest.mark.parametrize("how", SABOTAGE)
def test_sabotage_is_refused(how: str, monkeypatch: pytest.MonkeyPatch) -> None:
    sabotaged(monkeypatch, how)
    certificate = cg.synthesize(reach(mover("pendulum")), [20, 24], relation="linear").certificate
    assert not cg.check(certificate)


FORGERIES: dict[str, dict[str, Any]] = {
    "differences that reach less far": {"reach": [1, 1]},
    "fewer parts": {"parts": 1},
    "no parts": {"parts": 0},
    "cells in no parts": {"cuts": 0},
    "cells in many parts": {"cuts": 1000},
    "a reach that is no list": {"reach": 3},
    "a reach beyond all bounds": {"reach": [10**9, 1]},
    "no block": {"blocks": [0, 1]},
    "a block beyond all bounds": {"blocks": [10**9, 1]},
    "inputs beyond their box": {"menu": [[1.5]] * 7},
    "one input in place of all": {"menu": [[0.0]] * 7},
}


@pytest.mark.parametrize("forgery", FORGERIES)
def test_forgeries_are_refused(forgery: str, tmp_path: Path) -> None:
    certificate = certificate_of("pendulum")
    part = certificate.proof.agents[0]
    forged = replace(part, relation=part.relation | FORGERIES[forgery])
    try:
        cg.save(changed(certificate, agents=(forged,)), tmp_path / "forged.npz")
        assert not cg.check(cg.load(tmp_path / "forged.npz"))
    except ValueError as refusal:
        assert str(refusal)
