"""Networks as they are, for agents whose dynamics are expressions: met by rollouts, and refused where changed."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from scipy.stats import binom

import certigym as cg
from certigym.synthesis.certificates import changed
from certigym.synthesis.checking.network_spans import _inputs_between, driven_spans
from certigym.synthesis.raw_networks import repair_network
from certigym.synthesis.relations import Network
from certigym.validation.policies.actors import SharedActor
from certigym.validation.policies.views import SharedView
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
    "scaled noise": lambda: middle(rover(noise_scale=["0.8 + 0.2*cos(x) + 0.1*u**2"])),
}


@cache
def certified(kind: str) -> tuple[cg.Problem, Any, Any]:
    problem = PROBLEMS[kind]()
    actor = balancing(problem)
    return problem, actor, cg.certify(problem, actor, 150, as_is=True, above=True).certificate


@pytest.mark.parametrize("kind", PROBLEMS)
def test_rollouts_lie_between_both_ends(kind: str) -> None:
    problem, actor, certificate = certified(kind)
    report = cg.check(certificate)
    assert report, report
    assert 0.05 < certificate.lower_bound <= certificate.upper_bound
    runs = cg.rollout(problem, cg.as_controller(problem, actor), episodes=20_000, seed=3)
    assert binom.cdf(runs.successes, 20_000, certificate.lower_bound) > FALSE_ALARM
    assert binom.sf(runs.successes - 1, 20_000, certificate.upper_bound) > FALSE_ALARM
    assert runs.successes / 20_000 - certificate.lower_bound < 0.2


def test_boxes_hold_what_the_deployed_network_does() -> None:
    """10,000 states: inputs and means lie in the enclosures of the check."""
    problem, actor, certificate = certified("plain")
    (agent,), (part,) = problem.agents, certificate.proof.agents
    assert isinstance(agent, cg.Agent)
    rng = np.random.default_rng(5)
    cells = rng.integers(part.grid.n_cells, size=10_000)
    low, high = part.grid.low[cells], part.grid.high[cells]
    states = (low + rng.random(low.shape) * (high - low)).T
    q = int(problem.initial_q or 0)
    for t in (0, 2):
        mode = t * problem.automaton.n_states + q
        inputs = actor.inputs(0, states, np.full(states.shape[1], q), t)
        first, last = driven_spans(agent, part, cells, mode)
        means = agent.mean(states, inputs).T
        assert np.all((first <= means) & (means <= last))
        least, most = _inputs_between(agent, part, low, high, mode)
        assert np.all((least <= inputs.T) & (inputs.T <= most))


def test_other_networks_and_larger_claims_are_refused() -> None:
    problem, _, certificate = certified("plain")
    larger = certificate.lower_bound + 0.02
    claim = changed(certificate, lower_bound=larger, bounds={certificate.proof.bound: larger}, gap=None,
                                opposite=None)  # fmt: skip
    assert "exceeds" in cg.check(claim).failures[0]
    weak = balancing(problem, 0.1).network
    others = with_network(certificate, weights=[w.tolist() for w in weak.weights])
    assert not cg.check(others)
    assert not cg.check(with_network(certificate, activation="relu"))


def test_a_check_that_forgets_what_inputs_may_be_is_caught(monkeypatch: pytest.MonkeyPatch) -> None:
    """Sabotage of the search: inputs at the middle of what the network may answer. The check refuses the claim."""
    from certigym.synthesis.relations import driven_means

    honest = driven_means.mean_bounds

    def careless(*arguments: Any) -> tuple[Any, Any]:
        least, most = honest(*arguments)
        return 0.5 * (least + most), 0.5 * (least + most)

    monkeypatch.setattr(driven_means, "mean_bounds", careless)
    problem = PROBLEMS["plain"]()
    forged = cg.certify(problem, balancing(problem), 30, as_is=True).certificate
    monkeypatch.undo()
    assert not cg.check(forged)


def test_repairs_and_refusals() -> None:
    problem = PROBLEMS["plain"]()
    poor = balancing(problem, 0.1)
    as_is = cg.certify(problem, poor, 40, as_is=True).certificate
    repaired, _ = repair_network(problem, poor, 40)
    assert cg.check(repaired) and repaired.certificate.lower_bound > as_is.lower_bound + 0.05
    with pytest.raises(ValueError, match="linear dynamics"):
        cg.certify(problem, poor, 40, as_is=True, relation="linear")
