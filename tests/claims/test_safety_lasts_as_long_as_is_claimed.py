"""Safety without a deadline: against eigenvalues, against certificates of every horizon, and against rollouts."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import norm

import certigym as cg
from certigym.synthesis.extended_check.claims import invariance_rate
from certigym.validation.statistical_tests import clopper_pearson
from kinds import mostly_thorough
from problems import scalar_agent

FALSE_ALARM = 1e-6
"""Probability that rollouts contradict a true bound."""


def team(agents: int, horizon: int = 30, formula: str = "") -> cg.Problem:
    """Agents that no input moves and that noise drives out, sooner or later."""
    members = [
        scalar_agent(f"a{k}", A=[[0.8]], input_low=[-1e-9], input_high=[1e-9], noise_covariance=[[0.5 + 0.2 * k]])
        for k in range(agents)
    ]
    return cg.Problem(
        name="drift",
        horizon=horizon,
        agents=members,
        propositions={f"safe_{k}": cg.Proposition(f"a{k}", [-2.0], [2.0]) for k in range(agents)},
        specification=cg.Specification(formula or " & ".join(f"G safe_{k}" for k in range(agents)), "finite-trace"),
    )


def test_the_rate_is_the_eigenvalue_of_the_finite_model() -> None:
    problem = team(1, 60)
    certificate = cg.synthesize(problem, 40, relation="boxes", search=cg.SearchOptions(stationary=True)).certificate
    lasting = cg.safety_rate(certificate)
    # the true decay: mass from a fine grid of the safe interval to itself under x' = .8 x + w
    edges = np.linspace(-2.0, 2.0, 801)
    middle = 0.5 * (edges[1:] + edges[:-1])
    kernel = np.diff(norm.cdf((edges[None] - 0.8 * middle[:, None]) / np.sqrt(0.5)), axis=1)
    truth = float(np.abs(np.linalg.eigvals(kernel)).max())
    assert 0.9 * truth < lasting.rate <= truth + 1e-4


@mostly_thorough("agents", [1, 2])
def test_the_bound_lies_below_the_certificate_of_every_horizon_and_below_rollouts(agents: int) -> None:
    problem = team(agents, 24)
    result = cg.synthesize(problem, 40, relation="boxes", search=cg.SearchOptions(stationary=True))
    lasting = cg.safety_rate(result)
    assert 0 < lasting.rate < 1
    claim = result.certificate
    steps = np.arange(0, 25)
    bounds = lasting.at(steps)
    assert np.all(np.diff(bounds) <= 0) and bounds[-1] > 0
    start = np.concatenate([agent.initial.low for agent in problem.agents])
    if isinstance(claim, cg.Certificate):
        values = cg.value_in_time(claim)
        q = claim.problem.initial_q
        for k in range(1, 25):
            assert bounds[k] <= values.at(start, q, k)[0] * (1 + 1e-12)
    for k in (1, 4, 12):
        runs = cg.rollout(problem.replace(horizon=k), claim.controller, episodes=20_000, seed=k)
        _, high = clopper_pearson(runs.successes, runs.episodes, 1 - FALSE_ALARM)
        assert lasting.at(k) <= high


@pytest.mark.thorough
def test_tasks_with_several_live_states_have_a_rate() -> None:
    """Who has been above 1 must stay above 0 from then on: two live automaton states."""
    agent = scalar_agent("a", A=[[0.8]], noise_covariance=[[0.3]])
    problem = cg.Problem(
        name="narrower",
        horizon=40,
        agents=[agent],
        propositions={
            "wide": cg.Proposition("a", [-3.0], [3.0]),
            "mark": cg.Proposition("a", [1.0], [3.0]),
            "upper": cg.Proposition("a", [0.0], [3.0]),
        },
        specification=cg.Specification("G wide & G (mark -> G upper)", "finite-trace"),
    )
    result = cg.synthesize(problem, 60, search=cg.SearchOptions(stationary=True))
    lasting = cg.safety_rate(result)
    values = cg.value_in_time(result.certificate)
    start, q = agent.initial.low, result.certificate.problem.initial_q
    for k in range(1, 41):
        assert lasting.at(k) <= values.at(start, q, k)[0] * (1 + 1e-12)
    assert lasting.rate > 0.9


@pytest.mark.thorough
def test_a_larger_rate_would_be_false(monkeypatch: pytest.MonkeyPatch) -> None:
    """The mistakes that are easy to make give bounds that certificates of longer horizons contradict."""
    problem = team(2, 4, formula="G (safe_0 & safe_1)")
    # v of a short horizon is far from the function that a step merely shrinks, so quotients differ between cells
    certificate = cg.synthesize(problem, 24, relation="boxes", search=cg.SearchOptions(stationary=True)).certificate
    longer = cg.synthesize(
        problem.replace(horizon=100), 24, relation="boxes", search=cg.SearchOptions(stationary=True)
    ).certificate
    start = np.concatenate([agent.initial.low for agent in problem.agents])
    truth = 1.05 * float(cg.value_in_time(longer).at(start, longer.problem.initial_q, 100)[0])

    def contradicted() -> bool:
        return bool(invariance_rate.safety_rate(certificate).at(100) > truth)

    assert not contradicted()
    least = invariance_rate._least
    # the quotient in the best cell in place of the worst one
    monkeypatch.setattr(invariance_rate, "_least", lambda a, b: float(np.max(a[b > 0] / b[b > 0], initial=0.0)))
    assert contradicted()
    monkeypatch.setattr(invariance_rate, "_least", least)
    # one agent alone
    first = "_quotient", lambda now, later, q: least(now.factors[0][0], later.factors[0][0])
    monkeypatch.setattr(invariance_rate, *first)
    assert contradicted()


def test_other_certificates_are_refused() -> None:
    problem = team(1, 10)
    with pytest.raises(ValueError, match="stationary"):
        cg.safety_rate(cg.synthesize(problem, 40, relation="boxes"))
    with pytest.raises(ValueError, match="safety task"):
        cg.safety_rate(cg.synthesize("reach-avoid-v0", 40, search=cg.SearchOptions(stationary=True)))
    with pytest.raises(ValueError, match="at least 4"):
        cg.safety_rate(
            cg.synthesize(problem.replace(horizon=3), 40, relation="boxes", search=cg.SearchOptions(stationary=True))
        )
    with pytest.raises(ValueError, match="whole numbers"):
        cg.safety_rate(cg.synthesize(problem, 40, relation="boxes", search=cg.SearchOptions(stationary=True))).at(-1)
    with pytest.raises(ValueError, match="co-safe task"):  # neither: what is false may become true again
        cg.synthesize(team(1, formula="F G safe_0"), horizon=None)
