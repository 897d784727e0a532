"""Networks as they are, for agents whose dynamics are expressions: met by rollouts, and refused where changed."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from scipy.stats import binom

import certigym as cg
from certigym.synthesis.abstraction.models import network_model
from certigym.synthesis.certificates.proofs import changed
from certigym.synthesis.extended_check.steps.map_enclosures import networked_maps
from certigym.synthesis.relations.kinds import Network, network_maps
from certigym.validation.policies.actors import SharedActor
from certigym.validation.policies.views import SharedView
from kinds import mostly_thorough
from network_problems import with_network

FALSE_ALARM = 1e-6
"""Probability with which a statistical test here fails although all is right."""

NORMAL = {"law": "gaussian", "std": 0.25}


def rover(**changes: Any) -> cg.Agent:
    """One state that drifts away from the middle, and an input that counts less far from it."""
    arguments: dict[str, Any] = {
        "states": ["x"], "inputs": ["u"], "dynamics": ["x + 0.2*sin(x) + (1 - 0.1*x**2)*u"], "noise": [NORMAL],
        "state_low": [-2.0], "state_high": [2.0], "input_low": [-0.8], "input_high": [0.8], "initial_state": [1.3],
    }  # fmt: skip
    return cg.Agent(name="rover", **{**arguments, **changes})


def middle(agent: cg.Agent, horizon: int = 3) -> cg.Problem:
    return cg.Problem(
        name="middle", horizon=horizon, agents=[agent], propositions={"home": cg.Proposition("rover", [-0.3], [0.3])},
        specification=cg.Specification("F home", "co-safe"),
    )  # fmt: skip


def balancing(problem: cg.Problem, gain: float = 0.9) -> SharedActor:
    """Two hidden tanh units that push towards the middle."""
    view = SharedView(problem)
    first = np.zeros((2, view.size), dtype=np.float32)
    first[:, 0] = 0.8, 1.5
    first[0, 1:] = 0.1 * np.arange(1, view.size)  # it looks at the automaton state and the time as well
    last = np.full((view.n_actions, 2), -gain, dtype=np.float32)
    layers = Network((first, last), (np.zeros(2, np.float32), np.zeros(view.n_actions, np.float32)), "tanh", False)
    return SharedActor(problem, layers)


PROBLEMS = {
    "plain": lambda: middle(rover()),
    "disturbed": lambda: middle(
        rover(
            dynamics=["x + 0.2*sin(x) + (1 - 0.1*x**2)*u + push"],
            disturbances={"push": [-0.05, 0.05]},
        )
    ),
}


@cache
def certified(kind: str) -> tuple[cg.Problem, Any, Any]:
    problem = PROBLEMS[kind]()
    actor = balancing(problem)
    return problem, actor, cg.certify(problem, actor, 60, above=True).certificate


@mostly_thorough("kind", PROBLEMS)
def test_rollouts_lie_between_both_ends(kind: str) -> None:
    problem, actor, certificate = certified(kind)
    report = cg.check(certificate)
    assert report, report
    assert 0.05 < certificate.lower_bound <= certificate.upper_bound
    runs = cg.rollout(problem, cg.as_controller(problem, actor), episodes=20_000, seed=3)
    assert binom.cdf(runs.successes, 20_000, certificate.lower_bound) > FALSE_ALARM
    assert binom.sf(runs.successes - 1, 20_000, certificate.upper_bound) > FALSE_ALARM
    assert runs.successes / 20_000 - certificate.lower_bound < 0.2


def bent(**changes: Any) -> cg.Problem:
    """Two states, of which one bends, and noise that is not along them."""
    agent = cg.Agent(
        name="rover", states=["x", "y"], inputs=["u", "w"], dynamics=["x + 0.3*sin(y) + 0.5*u*cos(x)", "0.9*y + 0.4*w"],
        noise_covariance=[[0.05, 0.02], [0.02, 0.04]], state_low=[-2.0, -1.5], state_high=[2.0, 1.5],
        input_low=[-1.0, -0.5], input_high=[0.8, 0.9], initial_state=[0.9, 0.2],
    )  # fmt: skip
    home = cg.Proposition("rover", [-0.5, -1.5], [0.5, 1.5])
    return cg.Problem(
        name="bent", horizon=2, agents=[agent], propositions={"home": home},
        specification=cg.Specification("F home", "co-safe"),
    )  # fmt: skip


@mostly_thorough("make", [PROBLEMS["plain"], bent])
def test_maps_hold_what_the_deployed_network_does(make: Any) -> None:
    """5,000 states: means lie in the maps of the check, which leave no more than those of the search."""
    problem = make()
    (agent,), actor = problem.agents, balancing(problem)
    assert isinstance(agent, cg.Agent)
    certificate = cg.certify(problem, actor, 12).certificate
    assert cg.check(certificate)
    (part,), rng = certificate.proof.agents, np.random.default_rng(5)
    cells = rng.integers(part.grid.n_cells, size=5_000)
    low, high = part.grid.low[cells], part.grid.high[cells]
    points, q = low + rng.random(low.shape) * (high - low), int(problem.initial_q or 0)
    mode = problem.automaton.n_states + q  # of the second step
    z, gain, rho = networked_maps(agent, part, (low, high), mode)
    inputs = actor.inputs(0, points.T, np.full(len(cells), q), 1)
    means = agent.mean(points.T, inputs).T
    off = means - z - np.einsum("nkj,nj->nk", gain, points - 0.5 * (low + high))
    assert np.all(np.abs(off) <= rho + 1e-12)
    relation = certificate.controller.agents[0].relation
    searched = relation.means.around(part.grid.low[:50], part.grid.high[:50], relation.input_set)
    again = networked_maps(agent, part, (part.grid.low[:50], part.grid.high[:50]), mode)
    assert np.all(again[2] <= searched.rest[:, mode])


def test_maps_that_forget_what_networks_leave_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """Sabotage of the search: inputs that are their affine maps, with nothing left."""
    honest = network_maps.mean_form

    def careless(*arguments: Any) -> Any:
        form = honest(*arguments)
        return replace(form, radius=0.0 * form.radius)

    problem = PROBLEMS["plain"]()
    monkeypatch.setattr(network_maps, "mean_form", careless)
    forged = cg.certify(problem, balancing(problem), 12).certificate
    monkeypatch.undo()
    assert not cg.check(forged)


def test_angles_that_wrap_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """Linear cells would count who turns past the seam as gone: refused, and refused by the check where it is not."""
    agent = rover(dynamics=["x + u"], angles=["x"], state_low=[-np.pi], state_high=[np.pi], initial_state=[1.0])
    problem = middle(agent)
    with pytest.raises(ValueError, match="which wraps"):
        cg.certify(problem, balancing(problem), 24)
    monkeypatch.setattr(network_model, "refuse_angles", lambda *arguments: None)
    forged = cg.certify(problem, balancing(problem), 24)
    assert "takes its angles for numbers" in cg.check(forged).failures[0]


def test_other_networks_and_larger_claims_are_refused() -> None:
    problem, _, certificate = certified("plain")
    larger = certificate.lower_bound + 0.02
    claim = changed(certificate, lower_bound=larger, bounds={certificate.proof.bound: larger}, gap=None,
                                complement=None)  # fmt: skip
    assert "exceeds" in cg.check(claim).failures[0]
    weak = balancing(problem, 0.1).network
    others = with_network(certificate, weights=[w.tolist() for w in weak.weights])
    assert not cg.check(others)
    assert not cg.check(with_network(certificate, activation="relu"))
