"""Networks are certified as they are where the task names the time, and changed ones are refused."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from scipy.stats import binom

import certigym as cg
from certigym.synthesis.certificates.proofs import Certificate, TimedProof, changed
from certigym.synthesis.relations.kinds import Network
from certigym.synthesis.relations.kinds.network_maps import DrivenMaps
from certigym.synthesis.verbs.raw_networks import _policies, _written, certify_network, differences
from certigym.validation.policies.actors import SharedActor
from certigym.validation.policies.views import SharedView
from composing import expressions, matrices, timed
from kinds import mostly_thorough
from network_problems import with_network

FALSE_ALARM = 1e-6
"""Probability with which a statistical test here fails although all is right."""

EPISODES = 20_000


def looking(problem: cg.Problem, seed: int = 0) -> SharedActor:
    """A network to whom everything that it sees makes a difference, the time and the automaton state above all."""
    view, rng = SharedView(problem), np.random.default_rng(seed)
    first = rng.normal(size=(6, view.size)).astype(np.float32)
    last = (0.4 * rng.normal(size=(view.n_actions, 6)) + 0.2).astype(np.float32)
    layers = Network((first, last), (np.zeros(6, np.float32), np.zeros(view.n_actions, np.float32)), "tanh", False)
    return SharedActor(problem, layers)


def drifting() -> cg.Problem:
    """Dynamics and regions name the time."""
    return timed(expressions(dynamics=["0.9*x + 0.8*u + 0.6*sin(2*t)"]))


PROBLEMS: dict[str, Any] = {
    "regions move": lambda: timed(matrices()),
    "dynamics name the time": drifting,
}


@cache
def certified(kind: str) -> tuple[cg.Problem, SharedActor, Any]:
    problem = PROBLEMS[kind]()
    actor = looking(problem, 5)
    return problem, actor, cg.certify(problem, actor, 60, above=True).certificate


@mostly_thorough("kind", PROBLEMS)
def test_rollouts_of_the_network_lie_between_both_ends(kind: str) -> None:
    problem, actor, certificate = certified(kind)
    report = cg.check(certificate)
    assert report, report
    assert differences(certificate, actor) == []
    assert 0.03 < certificate.lower_bound <= certificate.upper_bound < 0.999
    runs = cg.rollout(problem, cg.as_controller(problem, actor), EPISODES, seed=3)
    assert binom.cdf(runs.successes, EPISODES, certificate.lower_bound) > FALSE_ALARM
    assert binom.sf(runs.successes - 1, EPISODES, certificate.upper_bound) > FALSE_ALARM
    same = cg.rollout(problem, certificate.controller, EPISODES, seed=3)
    assert same.successes == runs.successes


@pytest.mark.parametrize("kind", PROBLEMS)
def test_a_network_answers_alike_however_the_problem_is_written(kind: str) -> None:
    """At all times, in all automaton states that go with one another, at 200 states."""
    problem, actor, certificate = certified(kind)
    base, policies = _written(problem, _policies(problem, actor))
    rng, n_q = np.random.default_rng(1), problem.automaton.n_states
    states = [rng.uniform(a.state_low, a.state_high, size=(200, a.n_states)).T for a in problem.agents]
    table = np.tile(np.arange(n_q), (problem.horizon + 1, 1))
    if isinstance(certificate.proof, TimedProof):
        table = certificate.proof.states_in_time(problem)
    for t in range(problem.horizon):
        for q in np.flatnonzero((table[t] >= 0) & ~base.automaton.absorbing[table[t]]).tolist():
            wanted = np.concatenate([actor.inputs(i, x, np.full(200, q), t) for i, x in enumerate(states)])
            asked = np.full(200, table[t, q])
            found = np.concatenate([own.inputs(x, asked, t) for own, x in zip(policies, states, strict=True)])
            assert np.allclose(found[: len(wanted)], wanted, rtol=0.0, atol=1e-6)
            assert np.all(found[len(wanted) :] == t)  # a clock


def forged(certificate: Any, **facts: Any) -> Certificate:
    """The same claim, with other facts about the network of its base."""
    return replace(certificate, proof=replace(certificate.proof, base=with_network(certificate.proof.base, **facts)))


@pytest.mark.parametrize("kind", PROBLEMS)
def test_other_weights_and_larger_claims_are_refused(kind: str) -> None:
    _, _, certificate = certified(kind)
    base = certificate.proof.base
    network = base.proof.agents[0].relation["network"]
    weights = [*network["weights"][:-1], (np.array(network["weights"][-1]) - 0.25).tolist()]
    assert not cg.check(forged(certificate, weights=weights))
    larger = base.lower_bound + 1e-3
    claim = changed(base, lower_bound=larger, bounds={base.proof.bound: larger}, gap=None, complement=None)
    assert "exceeds" in cg.check(replace(certificate, proof=replace(certificate.proof, base=claim))).failures[0]


def test_networks_that_are_told_of_other_states_are_refused() -> None:
    """Where regions move, the automaton counts: what a network is told of is the state of the task, not another one."""
    problem, actor, certificate = certified("regions move")
    told = certificate.proof.base.proof.agents[0].relation["network"]["told"]
    others = [q if q < 0 else (q + 1) % problem.automaton.n_states for q in told]
    assert "another automaton state than that of its problem" in cg.check(forged(certificate, told=others)).failures[0]
    assert "told" in differences(forged(certificate, told=others), actor)[0]
    assert not cg.check(forged(certificate, told=told[:-1]))


def test_enclosures_at_another_step_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """Sabotage of the search: boxes of the step before, under a network that is asked at the step itself."""
    problem = drifting()
    actor, honest = looking(problem, 5), DrivenMaps._names
    monkeypatch.setattr(DrivenMaps, "_names", lambda self, inputs: honest(self, np.maximum(inputs - 1.0, 0.0)))
    other = certify_network(problem, actor, 60).certificate
    monkeypatch.undo()
    right = certify_network(problem, actor, 60).certificate
    assert other.lower_bound > right.lower_bound + 0.01  # it would claim more than is true
    assert not cg.check(other)


def test_a_clock_that_is_not_the_time_is_refused() -> None:
    _, _, certificate = certified("dynamics name the time")
    base = certificate.proof.base
    (part,) = base.proof.agents
    input_set = np.array(part.relation["menu"])
    input_set[:, -1] = np.maximum(input_set[:, -1] - 1.0, 0.0)
    other = changed(base, agents=(replace(part, relation={**part.relation, "menu": input_set.tolist()}),))
    report = cg.check(replace(certificate, proof=replace(certificate.proof, base=other)))
    assert "its clock is not the time" in report.failures[0]
