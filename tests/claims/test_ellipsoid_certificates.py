"""Certificates under the ellipsoid relation hold, with and without delta: checked, rolled out, saved and loaded."""

from __future__ import annotations

import sys
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import certigym as cg
from certigym.envs.simulation import batch_simulator as core
from certigym.envs.simulation.batch_simulator import Dynamics
from certigym.synthesis.abstraction.models import finite_models as abstraction
from certigym.synthesis.certificates.controllers.controller import BatchMemory
from certigym.synthesis.certificates.proofs import changed, delta_of, is_exact
from certigym.synthesis.relations.grids.labels import cell_labels
from certigym.synthesis.relations.kinds.coupled import CoupledRelation
from certigym.synthesis.verbs.abstract import abstract
from certigym.validation.statistical_tests.binomial import REFUTED
from kinds import mostly_thorough
from problems import cart, cart_reach

pytest.importorskip("cvxpy", reason="the extra lmi is not installed")

FALSE_ALARM = 1e-6


CASES = {
    "diagonal": cart_reach(cart()),
    "correlated": cart_reach(cart(noise_covariance=[[0.04, 0.02], [0.02, 0.05]])),
    "wide": cart_reach(cart(B=[[0.1, 0.0], [0.5, 0.2]], input_low=[-2.0, -1.0], input_high=[2.0, 1.0])),
}


@cache
def synthesis(name: str, delta: float | None) -> cg.Synthesis:
    return cg.synthesize(
        CASES[name], [48, 48], relation="ellipsoid", search=cg.SearchOptions(delta=delta, max_sweeps=1)
    )


@mostly_thorough("delta", [None, 0.001, 0.01])
@mostly_thorough("name", CASES)
def test_ellipsoid_bounds_hold_and_check(name: str, delta: float | None) -> None:
    """One-sided at 1e-6 / 9, 20,000 rollouts."""
    result = synthesis(name, delta)
    certificate = result.certificate
    assert set(certificate.proof.bounds) == ({"nominal"} if delta is None else {"a-posteriori", "robust tree"})
    assert not is_exact(certificate) and certificate.proof.agents[0].relation["kind"] == "ellipsoid"
    assert cg.check(certificate), str(cg.check(certificate))
    report = cg.validate(result, 20_000, seed=3, confidence=1 - FALSE_ALARM / 9)
    assert report.verdict != REFUTED, str(report)
    assert report.lower_bound > 0.3


@pytest.mark.thorough
def test_two_agents_couple_with_independent_coins() -> None:
    """RA4 on 40 x 40 cells from near its goal: the bound is positive, checked, and not refuted at 1e-6."""
    near = cg.make_problem("reach-avoid-kinematic-v0").replace(horizon=8, initial_state=[-6.0, 0.0, -4.0, 0.0])
    result = cg.synthesize(near, 40, relation="ellipsoid", search=cg.SearchOptions(delta=0.001, max_sweeps=1))
    deltas = [part.relation["delta"] for part in result.certificate.proof.agents]
    assert delta_of(result.certificate) == pytest.approx(1 - (1 - deltas[0]) * (1 - deltas[1]), rel=1e-9)
    assert cg.check(result.certificate) and result.certificate.lower_bound > 0.1
    assert cg.validate(result, 20_000, seed=1, confidence=1 - FALSE_ALARM).verdict != REFUTED


@pytest.mark.parametrize("delta", [None, 0.01])
def test_relations_are_kept_and_inputs_are_admissible(delta: float | None) -> None:
    """Without delta never lost; with it, rarely, and inputs stay admissible all the same."""
    task, controller = CASES["diagonal"], synthesis("diagonal", delta).controller
    dynamics = Dynamics.of(task)
    policy, rng = controller.batch(dynamics), np.random.default_rng(2)
    worlds = core.initial(dynamics, rng, 20_000)
    memory = policy.begin(worlds, np.random.default_rng(1))
    relation = controller.agents[0].relation
    assert isinstance(relation, CoupledRelation)
    for _ in range(task.horizon):
        inputs, memory = policy.act(worlds, memory)
        assert isinstance(memory, BatchMemory)
        undecided = ~worlds.failed & ~worlds.accepted
        assert np.all(np.abs(inputs[0][:, :, undecided]) <= 2.0)
        (own,) = memory.groups[0]
        assert own is not None
        error = worlds.states[0] - np.moveaxis(controller.agents[0].grid.centres[own.cells], -1, 0)
        assert np.all(relation.related(error)[:, undecided & ~own.lost[0]])
        worlds = core.transition(dynamics, worlds, inputs, core.noise(dynamics, rng, 20_000))
    assert memory.lost is not None
    lost = np.mean(memory.lost & ~worlds.failed & ~worlds.accepted)
    assert lost == 0 if delta is None else lost <= task.horizon * relation.delta
    assert delta is None or np.any(memory.lost)


def test_certificates_travel_and_are_checked_without_the_solver(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    certificate = synthesis("diagonal", 0.01).certificate
    cg.save(certificate, tmp_path / "c.npz")
    monkeypatch.setitem(sys.modules, "cvxpy", None)
    loaded = cg.load(tmp_path / "c.npz")
    assert loaded.proof.agents[0].relation == certificate.proof.agents[0].relation
    assert loaded.lower_bound == certificate.lower_bound
    assert cg.check(loaded, CASES["diagonal"])
    first, again = (cg.rollout(c.problem, c.controller, 2000, seed=5).successes for c in (certificate, loaded))
    assert first == again


def test_tampered_certificates_are_refused() -> None:
    certificate = synthesis("diagonal", 0.01).certificate
    part = certificate.proof.agents[0]
    for entries in (
        {"delta": 0.5 * part.relation["delta"]},
        {"epsilon": 0.99 * part.relation["epsilon"]},
        {"feedback": [[0.0, 0.0]]},
        {"coupling": [[0.0, 0.0], [0.0, 0.0]]},
    ):
        other = replace(part, relation={**part.relation, **entries})
        assert not cg.check(changed(certificate, agents=(other,))), entries
    assert not cg.check(changed(certificate, bound="nominal"))


def test_labels_that_are_not_shrunk_are_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(abstraction, "error_labels", lambda p, i, g, c, reach: cell_labels(p, i, g, c))
    certificate = cg.synthesize(
        cart_reach(cart()), [40, 40], relation="ellipsoid", search=cg.SearchOptions(max_sweeps=0)
    ).certificate
    assert not cg.check(certificate)


@pytest.mark.thorough
def test_delta_belongs_to_relations_that_have_one() -> None:
    for relation in ("auto", "exact", "tube"):
        with pytest.raises(ValueError, match=rf"`delta`: expected none with relation `{relation}`, got 0.01"):
            abstract(cart_reach(cart()), 40, relation=relation, search=cg.SearchOptions(delta=0.01))
    with pytest.raises(ValueError, match=r"`delta`: expected a number of at least 0 and below 1, got 1.0"):
        abstract(cart_reach(cart()), 40, relation="ellipsoid", search=cg.SearchOptions(delta=1.0))
    with pytest.raises(ValueError, match=r"`share`: expected none with relation `tube`, got 0.3"):
        abstract(cart_reach(cart()), 40, relation="tube", search=cg.SearchOptions(share=0.3))
    spent = (
        abstract(cart_reach(cart()), 40, relation="ellipsoid", search=cg.SearchOptions(share=0.3)).models[0].relation
    )
    assert isinstance(spent, CoupledRelation) and np.max(spent.inputs) >= 2.0 * (1 - 0.3) - 0.15 - 1e-6  # half a cell
    settings = abstract(cart_reach(cart()), 40, relation="ellipsoid", search=cg.SearchOptions(delta=0.01)).settings
    assert settings["relation"] == "ellipsoid" and settings["delta"] == 0.01
