"""Certificates of agents by expressions are below the truth, survive files and rollouts, and wrong ones are refused."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import norm

import certigym as cg
from certigym.envs.systems.agents import Agent
from certigym.synthesis.certificates.proofs import changed
from certigym.synthesis.relations.kinds import SymbolicMeans
from kinds import mostly_thorough
from written_problems import bent_team, oscillator, oscillator_reach

FALSE_ALARM = 1e-6
"""Probability that rollouts refute a true certificate."""


@cache
def of_oscillator() -> cg.Certificate:
    return cg.synthesize(oscillator_reach(), 30, relation="boxes").certificate


@cache
def of_team() -> cg.Certificate:
    return cg.synthesize(bent_team(4), 30, relation="boxes").certificate


@cache
def of_ring() -> cg.Certificate:
    """Propositions about the distance from the origin: cells may or may not be in their regions."""
    agent = oscillator(outputs=["x**2 + y**2"], initial_state=[-0.4, 0.4], noise_covariance=[[0.02, 0], [0, 0.02]])
    problem = cg.Problem(
        name="disk",
        horizon=4,
        agents=[agent],
        propositions={"near": cg.Proposition("vdp", [-1.0], [2.0])},
        specification=cg.Specification("G near", "finite-trace"),
    )
    return cg.synthesize(problem, 60, relation="boxes").certificate


CERTIFICATES = {"oscillator": of_oscillator, "team": of_team, "ring": of_ring}


@pytest.mark.thorough
@pytest.mark.parametrize("name", CERTIFICATES)
def test_files_checks_and_rollouts_agree(name: str, tmp_path: Path) -> None:
    """40,000 episodes notice a claim that is too large by about .01 at a false-alarm rate of 1e-6."""
    certificate = CERTIFICATES[name]()
    assert certificate.proof.agents[0].relation["kind"] == "boxes" and certificate.gap is None
    cg.save(certificate, tmp_path / "certificate.npz")
    loaded = cg.load(tmp_path / "certificate.npz")
    assert isinstance(loaded, cg.Certificate) and isinstance(loaded.problem.agents[0], cg.Agent)
    report = cg.check(loaded, certificate.problem)
    assert report, report
    assert loaded.lower_bound == certificate.lower_bound > {"oscillator": 0.3}.get(name, 0.4)
    validated = cg.validate(loaded, 40_000, seed=1, confidence=1 - FALSE_ALARM)
    assert validated.verdict != "refuted" and validated.details["inadmissible"] == 0
    assert not cg.audit(loaded, 2_000, seed=2, confidence=1 - FALSE_ALARM).refuted


def masses(edges: NDArray, mean: float, std: float) -> NDArray:
    return np.diff(norm.cdf((edges - mean) / std))


@pytest.mark.thorough
def test_values_stay_below_dense_programming_with_an_adversary() -> None:
    """The adversary chooses all states of the cells after it has seen the joint cell; no products, no lattice.

    Means at 41 states of each cell; between them a mean of this agent moves by less than is allowed for.
    """
    problem = bent_team(3)
    certificate = cg.synthesize(problem, 8, relation="boxes").certificate
    assert cg.check(certificate) and certificate.proof.rank >= 1
    edges = [part.grid.edges[0] for part in certificate.proof.agents]
    automaton, terms = problem.automaton, certificate.proof.tree
    centres = [0.5 * (axis[1:] + axis[:-1]) for axis in edges]
    n = [len(c) for c in centres]
    holds = [problem.labeling.class_at(i, c[None]) for i, c in enumerate(centres)]
    letters = np.concatenate([np.repeat(holds[0], n[1], axis=1), np.tile(holds[1], n[0])])
    value = np.repeat(automaton.accepting.astype(float)[:, None], n[0] * n[1], axis=1)
    for t in reversed(range(problem.horizon)):
        before = value.copy()
        for q in np.flatnonzero(~automaton.finished):
            following = automaton.next_state(np.full(n[0] * n[1], q), letters)
            arriving = value[following, np.arange(n[0] * n[1])].reshape(n)
            for s in np.ndindex(*n):
                tables = []
                for i, part in enumerate(certificate.proof.agents):
                    choice = part.policy[t, q, s[i]]
                    states = np.linspace(edges[i][s[i]], edges[i][s[i] + 1], 41)
                    u = part.relation["menu"][choice][0]
                    means = states - 0.2 * np.tanh(states) + u / (1 + 0.2 * states**2)
                    tables.append(np.array([masses(edges[i], m, 0.6) for m in means]))
                before[q, s[0] * n[1] + s[1]] = (tables[0] @ arriving @ tables[1].T).min()
        value = before
    for state in range(automaton.n_states):
        tree = sum(
            (np.multiply.outer(terms.factors[0][a], terms.factors[1][b]) for a, b in terms.index[state]),
            np.zeros(n),
        )
        assert np.all(tree.ravel() <= value[state] + 2e-4)
        if not automaton.dead[state]:
            assert tree.max() > 0.5 * value[state].max()


# --- sabotage: searches that are wrong about one thing --------------------------------------------------------


def shrunk(boxes: tuple[NDArray, NDArray]) -> tuple[NDArray, NDArray]:
    """Boxes that are too small by a hundredth."""
    middle, half = 0.5 * (boxes[0] + boxes[1]), 0.5 * (boxes[1] - boxes[0])
    return middle - 0.99 * half, middle + 0.99 * half


def without_wind(means: SymbolicMeans) -> SymbolicMeans:
    calm = Agent(**{**means.agent.to_dict(), "disturbances": {name: [0.0, 0.0] for name in means.agent.disturbances}})
    return replace(means, agent=calm)


def middle_only(boxes: tuple[NDArray, NDArray]) -> tuple[NDArray, NDArray]:
    centre = 0.5 * (boxes[0] + boxes[1])
    return centre, centre


def windy() -> cg.Problem:
    problem = oscillator_reach(8)
    dynamics = ["x + step*y + wind", "y + step*(-x + (1 - x**2)*y) + u"]
    agent = problem.agents[0].replace(dynamics=dynamics, disturbances={"wind": [-0.05, 0.05]})
    return cg.Problem(
        name="windy",
        horizon=8,
        agents=[agent],
        propositions=problem.declared,
        specification=problem.specification,
    )


SABOTAGE: dict[str, Callable[..., Any]] = {
    "boxes that are too small by 1 %": lambda around: lambda self, *a: shrunk(around(self, *a)),
    "means of the centres": lambda around: lambda self, *a: middle_only(around(self, *a)),
    "a disturbance left out": lambda around: lambda self, *a: around(without_wind(self), *a),
    "other dynamics": lambda around: lambda self, low, high, *a: around(self, low + 0.05, high + 0.05, *a),
}


@mostly_thorough("name", SABOTAGE)
def test_certificates_of_wrong_enclosures_are_refused(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    problem = windy()
    honest = cg.synthesize(problem, 20, relation="boxes")
    assert cg.check(honest)
    with monkeypatch.context() as patch:
        patch.setattr(SymbolicMeans, "around", SABOTAGE[name](SymbolicMeans.around))
        broken = cg.synthesize(problem, 20, relation="boxes").certificate
    assert broken.lower_bound > 0.0
    report = cg.check(broken)
    assert not report and "exceed" in str(report)


def test_a_variance_taken_for_a_deviation_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """The search believes in less noise than there is."""
    from certigym.synthesis.abstraction.models import box_model

    problem = oscillator_reach(8)
    truth = box_model.grid_laws
    with monkeypatch.context() as patch:
        patch.setattr(box_model, "grid_laws", lambda agent: [law.scaled(law.std) for law in truth(agent)])
        broken = cg.synthesize(problem, 20, relation="boxes").certificate
    report = cg.check(broken)
    assert not report and "exceed" in str(report)


def test_targets_that_inputs_do_not_reach_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """The search believes in inputs half as large again; the controller's saturate."""
    problem = oscillator_reach(8)
    around = SymbolicMeans.around

    def generous(self: SymbolicMeans, low: NDArray, high: NDArray, input_set: NDArray) -> Any:
        larger = self.agent.replace(input_low=[-1.5], input_high=[1.5])
        return around(replace(self, agent=larger), low, high, 1.5 * input_set)

    with monkeypatch.context() as patch:
        patch.setattr(SymbolicMeans, "around", generous)
        broken = cg.synthesize(problem, 20, relation="boxes").certificate
    assert (
        not cg.check(broken)
        and broken.lower_bound > cg.synthesize(problem, 20, relation="boxes").certificate.lower_bound
    )


def with_relation(certificate: cg.Certificate, **changes: Any) -> cg.Certificate:
    part = certificate.proof.agents[0]
    return changed(certificate, agents=(replace(part, relation=part.relation | changes), *certificate.proof.agents[1:]))


def test_forged_relations_are_refused(tmp_path: Path) -> None:
    certificate = of_oscillator()
    input_set = np.array(certificate.proof.agents[0].relation["menu"])
    for forged in (
        with_relation(certificate, menu=(1.01 * input_set).tolist()),
        with_relation(certificate, menu=input_set[::-1].tolist()),
        changed(certificate, lower_bound=certificate.lower_bound + 1e-6),
    ):
        assert not cg.check(forged)
    descriptions: tuple[dict[str, Any], ...] = (
        {"parts": 99},
        {"parts": 0},
        {"kind": "exact"},
        {"parts": "two"},
        {"steer": [True] * len(input_set)},
        {"gains": np.ones((len(input_set), 1, 2)).tolist()},
    )
    for description in descriptions:
        forged = with_relation(certificate, **description)
        cg.save(forged, tmp_path / "forged.npz")
        with pytest.raises(ValueError, match="expected a certigym certificate"):
            cg.load(tmp_path / "forged.npz")


@pytest.mark.thorough
def test_cells_where_a_mean_is_not_defined_are_given_up() -> None:
    """The agent has no mean left of 0, and keeps away from there: a bound, and a controller that never fails on it."""
    agent = oscillator(
        states=["x", "y"],
        dynamics=["x + 0.2*u", "y + 0.05*log(x)"],
        state_low=[-0.5, -3],
        initial_state=[1.5, 0.0],
        noise_covariance=[[0.01, 0], [0, 0.01]],
    )
    problem = cg.Problem(
        name="log",
        horizon=6,
        agents=[agent],
        propositions={"goal": cg.Proposition("vdp", [2.0, -3.0], [3.0, 3.0])},
        specification=cg.Specification("F goal", "co-safe"),
    )
    certificate = cg.synthesize(problem, 28).certificate
    assert cg.check(certificate) and certificate.lower_bound > 0.5
    assert cg.validate(certificate, 4_000, seed=1, confidence=1 - FALSE_ALARM).verdict != "refuted"
    part = certificate.proof.agents[0]
    left = part.grid.high[:, 0] <= 0.0
    assert left.any() and np.all(part.policy[:, 0, left] < 0)
