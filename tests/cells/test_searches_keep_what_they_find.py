"""Person-by-person gains, further starts, horizons one after the other, and policies that do not look at the time."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import certigym as cg
from certigym.synthesis.abstraction.models.action_tables import Policies
from certigym.synthesis.abstraction.models.joint import JointModel, join, start_of
from certigym.synthesis.certificates.proofs import lasting_bound
from certigym.synthesis.certificates.value_functions import UNIT
from certigym.synthesis.policy_search.ascent.coordinate_ascent import sweep
from certigym.synthesis.policy_search.ascent.multistart import FINAL, find_policies
from certigym.synthesis.policy_search.ascent.search_settings import Search
from certigym.synthesis.policy_search.bounds.dense import dense_optimum, dense_value
from certigym.synthesis.policy_search.portfolio.given_start import policies_from
from certigym.synthesis.verbs.abstract import abstract
from certigym.validation.statistical_tests.binomial import REFUTED
from kinds import mostly_thorough
from problems import two_agents

FALSE_ALARM = 1e-6


def measured_gain(joint: JointModel, policies: Policies, problem: cg.Problem) -> float:
    gains = [0.0]
    sweep(
        joint, policies, start_of(problem, joint), FINAL, improve=False, watch=lambda stage: gains.append(stage.gain())
    )
    return max(gains)


def at_start(problem: cg.Problem, joint: JointModel, dense: np.ndarray) -> float:
    cells = [m.grid.cell_of(a.initial.low[:, None])[0] for a, m in zip(problem.agents, joint.models, strict=True)]
    return float(dense[(problem.initial_q, *cells)])


def brute_gain(problem: cg.Problem, joint: JointModel, policies: Policies) -> float:
    """The largest gain of one agent at one time and state: every cell tries every target, one at a time.

    Cells of one agent at one time and state exclude one another, so the gains of its cells add up.
    """
    models = list(joint.models)
    value = at_start(problem, joint, dense_value(problem, models, policies))
    most = 0.0
    for i, model in enumerate(models):
        for t in range(joint.horizon):
            for q in range(joint.n_states):
                total = 0.0
                for s in range(model.n_cells):
                    best = 0.0
                    for z in range(int(model.choices.low[s, 0]), int(model.choices.high[s, 0])):  # type: ignore[attr-defined]
                        changed = [policy.copy() for policy in policies]
                        changed[i][t, q, s] = z
                        best = max(best, at_start(problem, joint, dense_value(problem, models, tuple(changed))) - value)
                    total += best
                most = max(most, total)
    return most


@pytest.mark.thorough
@pytest.mark.parametrize("formula", ["(!b | !c) U a", "(!b U a) & F c"])
def test_the_gain_of_one_agent_is_that_of_trying_everything(formula: str) -> None:
    problem = two_agents(formula, horizon=2)
    joint = join(problem, abstract(problem, 8))
    found = find_policies(problem, joint, Search())
    best = found.best.policies
    assert found.unilateral_gain is not None and found.unilateral_gain < 1e-9
    assert brute_gain(problem, joint, best) < found.unilateral_gain + 1e-9
    spoiled = [policy.copy() for policy in best]
    for policy, model in zip(spoiled, joint.models, strict=True):  # all go down as far as they can
        policy[:] = np.where(policy >= 0, model.choices.low[:, 0], policy)  # type: ignore[attr-defined]
    expected = brute_gain(problem, joint, tuple(spoiled))
    assert expected > 1e-4
    assert measured_gain(joint, tuple(spoiled), problem) == pytest.approx(expected, rel=1e-6)


@mostly_thorough("problem_id", ["reach-avoid-v0", "patrol-recharge-v0"])
def test_further_starts_never_lower_the_bound(problem_id: str) -> None:
    problem = cg.make_problem(problem_id)
    problem = problem.replace(horizon=min(problem.horizon, 4))
    plain, more, again = (
        cg.synthesize(problem, 20, search=cg.SearchOptions(restarts=r), relation="exact") for r in (0, 2, 2)
    )
    assert more.certificate.lower_bound >= plain.certificate.lower_bound * (1 - 1e-6)
    assert more.certificate.lower_bound == again.certificate.lower_bound
    starts = more.stats["starts"]
    assert isinstance(starts, dict)
    solved = max(starts.values()) >= float(more.stats["abstract_upper_bound"]) * (1 - 1e-9)  # type: ignore[arg-type]
    assert solved or "perturbed start 2" in starts


@mostly_thorough("problem_id", ["reach-avoid-v0", "reach-avoid-n-v0"])
def test_bounds_rise_with_the_horizon(problem_id: str) -> None:
    problem = cg.make_problem(problem_id)
    asked = [4, 2, 3, 6, 2]
    found = cg.synthesize(problem, 30, horizon=asked)
    assert [one.certificate.problem.horizon for one in found] == asked
    by_horizon = {one.certificate.problem.horizon: one.certificate.lower_bound for one in found}
    ordered = [by_horizon[horizon] for horizon in sorted(by_horizon)]
    assert all(later >= earlier - 1e-9 for earlier, later in zip(ordered, ordered[1:], strict=False))
    assert ordered[-1] > ordered[0] > 0.0
    for one in found:
        assert cg.check(one.certificate)
        assert cg.validate(one, 20_000, confidence=1 - FALSE_ALARM).verdict != REFUTED


def test_policies_are_read_by_the_time_left_and_by_the_time_gone() -> None:
    problem = cg.make_problem("reach-avoid-v0").replace(horizon=5)
    certificate = cg.synthesize(problem, 20, relation="exact").certificate
    policies = [part.policy for part in certificate.proof.agents]
    longer, shorter = problem.replace(horizon=7), problem.replace(horizon=3)
    kept = policies_from(certificate, longer, abstract(longer, 20))
    left, gone = kept["given start by time left"], kept["given start by time gone"]
    for policy, a, b in zip(policies, left, gone, strict=True):
        np.testing.assert_array_equal(a, policy[[0, 0, 0, 1, 2, 3, 4]])
        np.testing.assert_array_equal(b, policy[[0, 1, 2, 3, 4, 4, 4]])
    kept = policies_from(certificate, shorter, abstract(shorter, 20))
    for policy, a, b in zip(policies, *kept.values(), strict=True):
        np.testing.assert_array_equal(a, policy[2:])
        np.testing.assert_array_equal(b, policy[:3])
    with pytest.raises(ValueError, match="`start`: expected a certificate of the same agents"):
        cg.synthesize(longer, 30, start=certificate)
    with pytest.raises(ValueError, match="`start`: expected a certificate of the same agents"):
        cg.synthesize(cg.make_problem("meeting-v0"), 20, start=certificate)
    with pytest.raises(ValueError, match="`start`: expected none for several relations"):
        cg.synthesize(longer, 20, relation="best", start=certificate)
    unchanged = cg.synthesize(problem, 20, start=certificate, search=cg.SearchOptions(max_sweeps=0)).certificate
    assert unchanged.lower_bound == pytest.approx(certificate.lower_bound, rel=1e-9)


@mostly_thorough("problem_id", ["reach-avoid-v0", "car-park-v0", "invariance-v0"], first=2)
def test_stationary_policies_are_certified_checked_and_simulated(problem_id: str, tmp_path: Path) -> None:
    problem = cg.make_problem(problem_id)
    result = cg.synthesize(problem, 40, search=cg.SearchOptions(stationary=True))
    certificate = result.certificate
    assert certificate.proof.stationary and all(len(part.policy) == 1 for part in certificate.proof.agents)
    assert certificate.lower_bound <= float(result.stats["abstract_upper_bound"])  # type: ignore[arg-type]
    cg.save(certificate, tmp_path / "stationary.npz")
    loaded = cg.load(tmp_path / "stationary.npz")
    assert loaded.proof.stationary and cg.check(loaded, problem)
    assert cg.validate(loaded, 20_000, confidence=1 - FALSE_ALARM).verdict != REFUTED
    expected = certificate.lower_bound if problem.automaton.semantics == "co-safe" else None
    assert lasting_bound(certificate) == expected


def test_the_value_of_a_stationary_policy_is_that_of_dense_programming() -> None:
    problem = two_agents(horizon=6)
    joint = join(problem, abstract(problem, 12))
    certificate = cg.synthesize(problem, 12, search=cg.SearchOptions(stationary=True)).certificate
    policies = tuple(np.repeat(part.policy, 6, axis=0) for part in certificate.proof.agents)
    value = at_start(problem, joint, dense_value(problem, list(joint.models), policies))
    assert certificate.lower_bound == pytest.approx(value, rel=1e-8)
    assert value <= at_start(problem, joint, dense_optimum(problem, list(joint.models))) * (1 + 64 * UNIT)


def one_agent() -> cg.Problem:
    """A weak agent that may take as long as it likes to reach [2, 4), but not to enter [-4, -2)."""
    agent = cg.LinearAgent(
        name="slow",
        A=[[1.0]],
        B=[[0.3]],
        noise_covariance=[[0.36]],
        state_low=[-4.0],
        state_high=[4.0],
        input_low=[-1.0],
        input_high=[1.0],
        initial_state=[0.0],
    )
    regions = {"goal": cg.Proposition("slow", [2.0], [4.0]), "pit": cg.Proposition("slow", [-4.0], [-2.0])}
    return cg.Problem(
        name="slow",
        horizon=8,
        agents=[agent],
        propositions=regions,
        specification=cg.Specification("!pit U goal", "co-safe"),
    )


@pytest.mark.thorough
def test_without_a_deadline_one_agent_comes_to_the_optimum_from_below() -> None:
    """Value iteration over 1500 steps, far beyond its convergence, bounds what any policy attains at any time."""
    problem = one_agent()
    found = cg.synthesize(problem, 40, horizon=None)
    certificate = found.certificate
    far = problem.replace(horizon=1500)
    joint = join(far, abstract(far, 40))
    optimum = at_start(far, joint, dense_optimum(far, list(joint.models)))
    assert certificate.problem.horizon > 8 and certificate.proof.stationary
    assert optimum - 5e-6 < certificate.lower_bound <= optimum
    assert lasting_bound(certificate) == certificate.lower_bound
    patient = cg.rollout(problem.replace(horizon=400), certificate.controller, 20_000, seed=4)
    assert abs(patient.successes / 20_000 - optimum) < 5.0 * np.sqrt(0.25 / 20_000)  # 1e-6


def test_bounds_for_continuous_policies_say_nothing_where_relations_can_be_lost(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Abstract policies may then attain more than any policy of the continuous system."""
    monkeypatch.setattr(
        "certigym.synthesis.policy_search.cell_certificates.certification.continuous_upper_bound", lambda *_: 1e-3
    )
    problem = two_agents(horizon=3)
    exact, paper = (cg.synthesize(problem, 40, relation=relation).stats for relation in ("exact", "paper"))
    assert exact["abstract_upper_bound"] == exact["continuous_upper_bound"] == 1e-3
    assert isinstance(paper["abstract_upper_bound"], float) and paper["abstract_upper_bound"] > 0.1


@pytest.mark.parametrize("formula", ["F (a & c)", "(!b U a) & F c", "F (a & F c)"])
def test_the_bound_from_above_is_the_joint_optimum_where_that_is_small(formula: str) -> None:
    problem = two_agents(formula, horizon=4)
    result = cg.synthesize(problem, 12, relation="exact")
    joint = join(problem, abstract(problem, 12))
    optimum = at_start(problem, joint, dense_optimum(problem, list(joint.models)))
    most = float(result.stats["abstract_upper_bound"])  # type: ignore[arg-type]
    assert result.certificate.lower_bound <= optimum <= most <= optimum * (1 + 1e-6) + 1e-12


def test_the_bound_from_above_counts_every_letter_of_a_start() -> None:
    """Starts in a box have several letters that lead to one automaton state."""
    problem = two_agents(horizon=3, initial_state=None, initial_low=[-3.5], initial_high=[3.0])
    result = cg.synthesize(problem, 24, relation="exact")
    joint = join(problem, abstract(problem, 24))
    assert max(len(rows) for rows in start_of(problem, joint).terms.index) > 1
    assert float(result.stats["abstract_upper_bound"]) >= result.certificate.lower_bound > 0.1  # type: ignore[arg-type]
