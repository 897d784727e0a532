"""Networks of teams that keep apart are certified by subtraction: what pairs may spoil is bounded from above."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from scipy.stats import binom, norm

import certigym as cg
from certigym.envs.systems.agents import LinearAgent
from certigym.synthesis.abstraction.models import network_model
from certigym.synthesis.certificates.proofs import UnionBoundProof
from certigym.synthesis.composition.lattice_moves import NearPoints
from certigym.synthesis.extended_check.claims.pairs_check import wrong_pairs
from certigym.synthesis.relations.kinds import Network
from certigym.synthesis.verbs.raw_networks import _less_nearness, _policies, differences
from certigym.validation.policies.actors import TeamActor
from certigym.validation.policies.views import SharedView
from composing import expressions, matrices
from kinds import mostly_thorough

FALSE_ALARM = 1e-6
"""Probability with which a statistical test here fails although all is right."""

EPISODES = 20_000


def pair(formula: str = "G !near", horizon: int = 3, near: Any = (-0.3, 0.3), **kinds: Any) -> cg.Problem:
    """Two scalar agents that may come near each other."""
    make = kinds.get("make", matrices)
    agents = make("one", initial_state=[-1.0]), make("two", initial_state=[kinds.get("other", 1.2)])
    regions: dict[str, Any] = {
        "near": cg.Pair(["one", "two"], [near[0]], [near[1]]),
        "there": cg.Proposition("one", [-0.6], [3.0]),
    }
    return cg.Problem(
        name="pair", horizon=horizon, agents=agents, propositions=regions,
        specification=cg.Specification(formula, "finite-trace" if formula.startswith("G") else "co-safe"),
    )  # fmt: skip


def towards(problem: cg.Problem, *goals: Any) -> TeamActor:
    """Networks that lead every agent to a goal of its own, on each axis; they look at the automaton state, too."""
    view, networks = SharedView(problem), []
    for agent, goal in zip(problem.agents, goals, strict=True):
        d = agent.n_states
        first = np.zeros((d, view.size), dtype=np.float32)
        first[:, :d], first[:, view.width] = 1.5 * np.eye(d), 0.1
        shift = (-1.5 * np.array(goal) / agent.state_high).astype(np.float32)
        last = np.zeros((view.n_actions, d), dtype=np.float32)
        last[:d] = -1.2 * np.eye(d)
        networks.append(Network((first, last), (shift, np.zeros(view.n_actions, np.float32)), "tanh", False))
    return TeamActor(problem, tuple(networks))


PROBLEMS: dict[str, Any] = {
    "matrices": lambda: pair(),
    "expressions": lambda: pair("(!near) U there", make=expressions),
    "near at all times": lambda: pair("G near", 2, (-1.5, 2.5), other=-1.3),
}


@cache
def certified(kind: str) -> tuple[cg.Problem, TeamActor, Any]:
    problem = PROBLEMS[kind]()
    actor = towards(problem, [-0.9], [1.3 if problem.agents[1].initial.low[0] > 0.0 else -1.2])
    found = _less_nearness(problem, _policies(problem, actor), 60, None).certificate
    return problem, actor, found


@mostly_thorough("kind", PROBLEMS)
def test_rollouts_are_above_the_bound_and_not_far(kind: str) -> None:
    problem, actor, certificate = certified(kind)
    report = cg.check(certificate)
    assert report, report
    assert isinstance(certificate.proof, UnionBoundProof) and differences(certificate, actor) == []
    assert certificate.proof.near > 1e-3 and certificate.lower_bound > 0.1
    runs = cg.rollout(problem, cg.as_controller(problem, actor), EPISODES, seed=3)
    assert binom.cdf(runs.successes, EPISODES, certificate.lower_bound) > FALSE_ALARM
    assert runs.successes / EPISODES - certificate.lower_bound < 0.15


@pytest.mark.thorough
@pytest.mark.parametrize("wanted", [False, True])
def test_one_step_is_charged_as_it_is(wanted: bool) -> None:
    """From known starts the means are known, and so is how likely the pair is as it should not be after a step."""
    problem = pair("G near", 1, (-1.0, 2.5), other=-1.3) if wanted else pair("G !near", 1)
    actor = towards(problem, [-0.9], [-1.2] if wanted else [1.3])
    q = np.array([problem.initial_q])
    states = [agent.initial.low[:, None] for agent in problem.agents]
    means = [float(agent.mean(x, actor.inputs(i, x, q, 0))[0, 0])
             for i, (agent, x) in enumerate(zip(problem.agents, states, strict=True))]  # fmt: skip
    gap, std = means[0] - means[1], np.sqrt(0.4)
    low, high = problem.labeling.pairs[0].low[0], problem.labeling.pairs[0].high[0]
    inside = norm.cdf((high - gap) / std) - norm.cdf((low - gap) / std)
    truth = 1.0 - inside if wanted else inside
    for cells, slack in ((30, 0.05), (240, 0.006)):
        certificate: Any = _less_nearness(problem, _policies(problem, actor), cells, None).certificate
        failures, again = wrong_pairs(certificate, problem)
        assert not failures and truth <= again <= certificate.proof.near <= truth + slack


@mostly_thorough("kind", PROBLEMS)
def test_smaller_charges_and_other_networks_are_refused(kind: str) -> None:
    _, _, certificate = certified(kind)
    less = replace(certificate, proof=replace(certificate.proof, near=0.97 * certificate.proof.near))
    assert "pairs spoil" in cg.check(less).failures[0]
    (first, *others), base = certificate.proof.base.proof.agents, certificate.proof.base
    network = first.relation["network"]
    moved = [*network["biases"][:-1], (np.array(network["biases"][-1]) + np.float32(0.25)).tolist()]
    part = replace(first, relation={**first.relation, "network": {**network, "biases": moved}})
    other = replace(base, proof=replace(base.proof, agents=(part, *others)))
    assert not cg.check(replace(certificate, proof=replace(certificate.proof, base=other)))


@pytest.mark.parametrize("what", ["reach", "masses"])
def test_a_search_that_forgets_what_is_not_known_is_refused(what: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Sabotage: means that are lattice points, or cells that get the mass of one mean alone."""
    honest = NearPoints.step, NearPoints._tables
    if what == "reach":
        monkeypatch.setattr(NearPoints, "step", lambda self, policy: (honest[0](self, policy)[0], np.zeros(1)))
    else:
        monkeypatch.setattr(NearPoints, "_tables", lambda self, reach: honest[1](self, np.zeros_like(reach)))
    problem = pair("G !near")
    forged = _less_nearness(problem, _policies(problem, towards(problem, [-0.9], [1.3])), 60, None).certificate
    monkeypatch.undo()
    assert "pairs spoil" in cg.check(forged).failures[0]


def robot(name: str, start: list[float]) -> LinearAgent:
    return LinearAgent(
        name=name, A=np.eye(2), B=np.eye(2), noise_covariance=0.04 * np.eye(2), state_low=[-3.0, -3.0],
        state_high=[3.0, 3.0], input_low=[-0.9, -0.9], input_high=[0.9, 0.9], initial_state=start,
    )  # fmt: skip


@cache
def robots() -> tuple[cg.Problem, TeamActor, Any]:
    """Two planar robots: four states together."""
    agents = robot("one", [-1.0, -0.5]), robot("two", [1.0, 0.5])
    regions: dict[str, Any] = {
        "home_one": cg.Proposition("one", [-1.8, -1.8], [0.0, 0.0]),
        "home_two": cg.Proposition("two", [0.0, 0.0], [1.8, 1.8]),
        "near": cg.Pair(["one", "two"], distance=0.9),
    }
    problem = cg.Problem(
        name="robots", horizon=2, agents=agents, propositions=regions,
        specification=cg.Specification("G !near & F G (home_one & home_two)", "finite-trace"),
    )  # fmt: skip
    actor = towards(problem, [-0.9, -0.9], [0.9, 0.9])
    return problem, actor, cg.certify(problem, actor, 16).certificate


@mostly_thorough("what", ["angles", "time"])
def test_what_is_not_known_of_pairs_is_refused(what: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """An angle turns, so that masses come from copies of cells; and the time is for paths alone beside pairs."""

    def cart(name: str, start: float) -> cg.Agent:
        return cg.Agent(
            name=name, states=["x", "a"], inputs=["u", "w"], noise=[{"law": "gaussian", "std": 0.3}] * 2,
            dynamics=["x + u", "a + w" if what == "angles" else "0.5*a + w + 0.1*t"], state_low=[-3.0, -np.pi],
            state_high=[3.0, np.pi], input_low=[-0.5, -0.5], input_high=[0.5, 0.5], initial_state=[start, 0.0],
            angles=["a"] if what == "angles" else [],
        )  # fmt: skip

    near = cg.Pair(["one", "two"], [-0.4], [0.4], of=["x"])
    problem = cg.Problem(
        name="carts", horizon=2, agents=[cart("one", -1.0), cart("two", 1.0)], propositions={"near": near},
        specification=cg.Specification("G !near", "finite-trace"),
    )  # fmt: skip
    actor = towards(problem, [-1.0, 0.0], [1.0, 0.0])
    with pytest.raises(ValueError, match="which wraps" if what == "angles" else "not name the time `t`"):
        cg.certify(problem, actor, 12)
    if what == "angles":
        monkeypatch.setattr(NearPoints, "__post_init__", lambda self: None)
        monkeypatch.setattr(network_model, "refuse_angles", lambda *arguments: None)
        forged = cg.certify(problem, actor, 12)
        assert "angle" in cg.check(forged).failures[0]


def test_starts_may_be_drawn_from_boxes() -> None:
    """The mean over starts is claimed: separate code finds it, rollouts agree, and charging less is refused."""
    problem = pair(horizon=2)
    low, high = ({a.name: a.initial.low + reach for a in problem.agents} for reach in (-0.2, 0.2))
    drawn = problem.replace(initial_low=low, initial_high=high)
    found = _less_nearness(drawn, _policies(drawn, towards(drawn, [0.5], [-0.5])), 24, None).certificate
    assert isinstance(found.proof, UnionBoundProof) and found.lower_bound > 0.1 and cg.check(found)
    runs = cg.rollout(drawn, found.controller, EPISODES, seed=3)
    assert binom.cdf(runs.successes, EPISODES, found.lower_bound) > FALSE_ALARM
    # Sabotage: hardly less is charged.
    smaller = replace(found, proof=replace(found.proof, near=0.9 * found.proof.near))
    assert not cg.check(smaller)
