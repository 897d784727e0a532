"""How far above its bound a probability may be: right against dense programming, and verified by ``check``."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.stats import binom

import certigym as cg
from certigym.synthesis.abstraction.models.joint import JointModel, join, start_of
from certigym.synthesis.certificates.cell_probabilities.checked_kernel import lost_to_rounding
from certigym.synthesis.certificates.proofs import OnGrid, changed, start_of_claim
from certigym.synthesis.certificates.value_functions.terms import Occupancy, Terms
from certigym.synthesis.certificates.value_functions.train_values import Rounding, Trains, start_above, start_value
from certigym.synthesis.extended_check.claims.forward_occupancy import TooManyProducts, masses
from certigym.synthesis.extended_check.claims.upper_bound import MOST, attained, inexact
from certigym.synthesis.policy_search.ascent.relaxation import upper_bound
from certigym.synthesis.policy_search.ascent.train_backward import evaluate
from certigym.synthesis.policy_search.bounds.above import evaluate_above
from certigym.synthesis.policy_search.bounds.certified import deadlocked_mass, nominal_bound, train_bound
from certigym.synthesis.policy_search.bounds.dense import dense_value
from certigym.synthesis.verbs.abstract import abstract
from kinds import mostly_thorough
from problems import two_agents

WEAK: dict[str, Any] = {"input_low": [-0.2], "input_high": [0.2]}
"""Inputs too weak for some cells: no target is admissible there."""

PROBLEMS = [
    two_agents(horizon=5),
    two_agents("F (a & F c) & G[0,2] !b", horizon=5),
    two_agents("G (b -> X d)", "finite-trace", horizon=3),
    two_agents(horizon=3, initial_state=None, initial_low=[-3.0], initial_high=[-1.0]),
    cg.make_problem("reach-avoid-n-v0", n_agents=3),
    cg.make_problem("invariance-4-v0"),
]


def truth(certificate: OnGrid, cells: int) -> float:
    """What the certificate's policies attain from a point, by dense programming."""
    problem = certificate.problem
    models = abstract(problem, cells, relation="exact").models
    dense = dense_value(problem, models, tuple(part.policy for part in certificate.proof.agents))
    where = [int(m.grid.cell_of(a.initial.low[:, None])[0]) for m, a in zip(models, problem.agents, strict=True)]
    return float(dense[(problem.initial_q, *where)])


@mostly_thorough("problem", PROBLEMS, ids=lambda problem: problem.name + problem.specification.semantics)
@mostly_thorough("value", ["tree", "train"])
def test_the_upper_end_of_exact_claims_is_verified(problem: cg.Problem, value: str) -> None:
    certificate = cg.synthesize(problem, 24, search=cg.SearchOptions(value=value), relation="exact").certificate
    assert certificate.gap is not None
    report = cg.check(certificate)
    assert report and report.above is not None
    assert report.recomputed - 1e-12 <= report.above <= certificate.lower_bound + certificate.gap
    if problem.n_agents == 2 and start_of_claim(certificate) == "point":
        exactly = truth(certificate, 24)
        assert certificate.lower_bound <= exactly <= report.above


def test_mass_goes_where_dense_programming_says() -> None:
    certificate = cg.synthesize(two_agents("F (a & F c) & G[0,2] !b", horizon=5), 24, relation="exact").certificate
    *_, last = masses(certificate, 0.0, 10_000)
    exactly = truth(certificate, 24)
    assert last.dropped == last.deadlocked == 0.0
    accepted = last.accepted + last.totals[certificate.problem.automaton.accepting[last.states]].sum()
    assert accepted == pytest.approx(exactly, rel=1e-11)
    with pytest.raises(TooManyProducts):
        list(masses(certificate, 0.0, 1))


@pytest.mark.parametrize("value", ["tree", "train"])
def test_runs_into_cells_without_a_choice_may_succeed(value: str) -> None:
    """Controllers go on where policies have no choice; 40,000 rollouts, seed 2: refuted with probability 1e-6."""
    problem = two_agents("F (a & d)", horizon=6, B=[[0.35]], input_low=[-0.32], input_high=[0.32])
    certificate = cg.synthesize(problem, 16, search=cg.SearchOptions(value=value), relation="exact").certificate
    assert any(np.any(part.policy < 0) for part in certificate.proof.agents)
    assert certificate.gap is not None and certificate.gap > 1e-3
    report = cg.check(certificate)
    assert report and report.above is not None and report.above > report.recomputed + 1e-3
    runs = cg.rollout(problem, certificate.controller, 40_000, seed=2)
    assert binom.sf(runs.successes - 1, 40_000, certificate.lower_bound + certificate.gap) > 1e-6
    assert runs.successes / 40_000 > certificate.lower_bound


def a_team() -> tuple[cg.Problem, JointModel, Any]:
    problem = two_agents("F (a & F c)", horizon=4, **WEAK)
    joint = join(problem, abstract(problem, 16, relation="exact"))
    policies = tuple(np.tile(model.choices.resting_choice, (4, joint.n_states, 1)) for model in joint.models)
    return problem, joint, policies


@pytest.mark.parametrize("seed", range(3))
def test_cells_left_out_are_counted_from_above(seed: int) -> None:
    """Whatever cells trains leave out, the closed loop lies between both sides; choices are random, some missing."""
    problem, joint, policies = a_team()
    rng = np.random.default_rng(seed)
    policies = tuple(
        rng.integers(0, len(m.lattice[0]), size=policy.shape).astype(np.int32)
        for m, policy in zip(joint.models, policies, strict=True)
    )
    dense = dense_value(problem, joint.models, policies)
    visited = [tuple(np.flatnonzero(rng.random(n) < 0.7) for n in joint.n_cells) for _ in range(5)]
    above = evaluate_above(joint, policies, Rounding(1e-9, tuple(visited)))
    below = evaluate(joint, policies, 1e-9, visited=visited)
    cells = np.stack(np.meshgrid(*visited[0], indexing="ij"), axis=-1).reshape(-1, 2)
    differences = []
    for q, train in enumerate(above.states):
        exactly = dense[q][tuple(cells.T)]
        if train is None:
            continue
        assert np.all(train.at(cells) + train.error >= exactly)
        assert np.all(below.at(q, cells) <= exactly)
        if not (problem.automaton.accepting[q] or problem.automaton.dead[q]):
            differences.append(np.max(train.at(cells) - exactly))
    assert max(differences) > 1e-3
    everything = evaluate_above(joint, policies, Rounding(1e-9, (None,) * 5))
    start = start_of(problem, joint)
    exact = sum(
        float(own[0] @ dense[q] @ other[0])
        for q, rows in enumerate(start.terms.index)
        if len(rows)
        for own, other in [start.terms.factors]
    )
    assert exact <= start_above(start, everything) <= exact + 1e-8


def test_what_rounding_may_have_taken_is_counted() -> None:
    problem, joint, policies = a_team()
    start, value = start_of(problem, joint), evaluate_above(joint, policies, Rounding(1e-9, (None,) * 5))
    coarse = Trains(tuple(None if train is None else replace(train, error=0.01) for train in value.states))
    assert start_above(start, coarse) == pytest.approx(start_value(start, value) + 0.01, abs=1e-8)


@pytest.mark.parametrize("value", ["tree", "train"])
def test_tasks_that_are_done_before_the_first_letter_have_an_upper_end(value: str) -> None:
    """Half of the start box lies outside the workspace of each agent."""
    box: dict[str, Any] = {"initial_state": None, "initial_low": [-5.0], "initial_high": [-3.0]}
    certificate = cg.synthesize(
        two_agents("true", horizon=2, **box), 16, search=cg.SearchOptions(value=value), relation="exact"
    ).certificate
    report = cg.check(certificate)
    assert report, report
    assert report.above == pytest.approx(0.25, abs=1e-7)
    assert not cg.check(changed(certificate, lower_bound=0.2, bounds={"nominal": 0.2}))


def test_the_start_may_lie_outside_of_what_trains_cover() -> None:
    problem, joint, policies = a_team()
    away = tuple(np.arange(3) for _ in joint.models)
    above = evaluate_above(joint, policies, Rounding(1e-9, (away,) * 5))
    assert start_above(start_of(problem, joint), above) == pytest.approx(1.0)


def a_lossy_team(loss: float) -> Any:
    """What bounds take of two agents over 5 steps whose kernels may have lost ``loss`` per step."""
    model = SimpleNamespace(kernel=SimpleNamespace(loss=loss), delta=0.0)
    return SimpleNamespace(horizon=5, n_cells=[10, 10], models=[model, model], absorbing=[False])


def test_upper_ends_count_everything_that_was_left_out() -> None:
    tree: Any = SimpleNamespace(value=0.5, rank=3, dropped=0.02)
    bound = nominal_bound(a_lossy_team(1e-3), tree, 0.0, True, 0.05)
    assert bound.gap is not None and bound.lower <= 0.5 and bound.lower + bound.gap >= 0.5 + 0.02 + 0.01 + 0.05
    rounding = SimpleNamespace(tolerance=1e-6)
    trains: Any = SimpleNamespace(value=0.5, rank=3, terms=SimpleNamespace(error=1e-4), rounding=rounding)
    bound = train_bound(a_lossy_team(1e-3), trains, 0.0, 0.52)
    assert bound.gap is not None and bound.lower <= 0.5 - 1e-4 and bound.lower + bound.gap >= 0.52 + 0.01
    none = Terms((np.zeros((0, 10)), np.zeros((0, 10))), (np.zeros((0, 2), dtype=np.int64),))
    assert deadlocked_mass(a_lossy_team(1e-3), (), [Occupancy(none, 0.01)] * 3) >= 0.03 + 2e-3 * (0 + 1 + 2)
    one = Terms((np.ones((1, 1)), np.ones((1, 1))), (np.zeros((1, 2), dtype=np.int64),))
    half: Any = SimpleNamespace(values=np.full((1, 1), 0.5))
    assert upper_bound(a_lossy_team(1e-3), Occupancy(one, 0.0), (half, half)) >= 0.25 + 0.01


@pytest.fixture(scope="module", params=["tree", "train"])
def certificate(request: pytest.FixtureRequest) -> OnGrid:
    return cg.synthesize(
        two_agents("F (a & F c)", horizon=5), 40, search=cg.SearchOptions(value=request.param), relation="exact"
    ).certificate


def claim_nothing_above(c: OnGrid) -> OnGrid:
    return changed(c, gap=0.0)


def promise_less(c: OnGrid) -> OnGrid:
    return changed(c, lower_bound=c.lower_bound - 0.01)


def forget_a_guard(c: OnGrid) -> OnGrid:
    kept = (
        np.arange(len(c.proof.guard_source)) != np.flatnonzero(c.proof.guard_source == c.problem.automaton.initial)[-1]
    )
    guards = {
        "guard_source": c.proof.guard_source,
        "guard_target": c.proof.guard_target,
        "guard_mask": c.proof.guard_mask,
    }
    return changed(c, **{name: own[kept] for name, own in guards.items()})


@pytest.mark.parametrize("tamper", [claim_nothing_above, promise_less])
def test_upper_ends_that_are_too_low_are_refused(certificate: OnGrid, tamper: Callable[[OnGrid], OnGrid]) -> None:
    assert cg.check(certificate)
    assert not cg.check(tamper(certificate))


def test_guards_that_leave_something_out_have_no_upper_end(certificate: OnGrid) -> None:
    assert inexact(certificate) == []
    assert "leave out" in inexact(forget_a_guard(certificate))[0]


def test_what_the_check_loses_to_rounding_is_counted(certificate: OnGrid, monkeypatch: pytest.MonkeyPatch) -> None:
    usual, problem = attained(certificate), certificate.problem
    assert usual is not None
    pairs = zip(problem.agents, certificate.proof.agents, strict=True)
    assert all(1e-15 < lost_to_rounding(agent, part) < 1e-11 for agent, part in pairs)
    if certificate.proof.rounding is None:
        *_, last = masses(certificate, 0.0, MOST)
        accepted = last.accepted + last.totals[problem.automaton.accepting[last.states]].sum()
        assert usual >= accepted * (1.0 + 1e-11)
    monkeypatch.setattr("certigym.synthesis.extended_check.claims.upper_bound.lost_to_rounding", lambda *_: 1e-4)
    assert attained(certificate) == pytest.approx(usual + 1e-4 * problem.horizon * problem.n_agents, abs=1e-9)


def test_start_guards_that_leave_something_out_have_no_upper_end() -> None:
    box: dict[str, Any] = {"initial_state": None, "initial_low": [-3.5], "initial_high": [-1.5]}
    whole = cg.synthesize(two_agents(horizon=3, **box), 16, relation="exact").certificate
    assert inexact(whole) == [] and len(whole.proof.start_target) > 0
    for kept in np.delete(
        ~np.eye(len(whole.proof.start_target), dtype=bool), whole.problem.automaton.dead[whole.proof.start_target], 0
    ):
        less = changed(whole, start_target=whole.proof.start_target[kept], start_mask=whole.proof.start_mask[kept])
        assert "leave out" in inexact(less)[0]


def test_a_pruned_tree_is_found_out() -> None:
    """A tree without its largest term proves less, and says nothing about the probability from above."""
    c = cg.synthesize(
        two_agents("F (a & F c)", horizon=5), 40, search=cg.SearchOptions(value="tree"), relation="exact"
    ).certificate
    q = c.problem.initial_q
    assert q is not None and c.proof.terms is not None
    first, terms = c.proof.merge_log[0], c.proof.terms
    size = np.prod([own.max(axis=1)[terms.index[q][:, i]] for i, own in enumerate(terms.factors)], axis=0)
    left = np.delete(np.arange(len(size)), size.argmax())
    kept = tuple(own[left] if p == q else own for p, own in enumerate(first.kept))
    index = tuple(own[left] if p == q else own for p, own in enumerate(terms.index))
    pruned = changed(
        c, merge_log=(replace(first, kept=kept), *c.proof.merge_log[1:]), terms=replace(terms, index=index)
    )
    pruned.__dict__.pop("value", None)
    state = np.concatenate([agent.initial.low for agent in c.problem.agents])
    lower = float(pruned.at(state)[0])
    assert lower < c.lower_bound - 1e-3
    below = changed(pruned, lower_bound=lower, bounds={"nominal": lower})
    assert cg.check(changed(below, gap=None))
    report = cg.check(below)
    assert not report and "at most" in report.failures[0]
    above = attained(below)
    assert above is not None and above >= c.lower_bound


def test_only_exact_relations_have_an_upper_end() -> None:
    options = cg.SearchOptions(epsilon=0.3, feedback=-0.5)
    certificate = cg.synthesize(two_agents(horizon=4), 40, relation="paper", search=options).certificate
    assert certificate.gap is None and cg.check(certificate).above is None
    claimed = cg.check(changed(certificate, gap=0.5))
    assert not claimed and "does not follow" in claimed.failures[0]


def test_uncertain_cells_have_no_upper_end() -> None:
    """The goal is a strip across the cells, of the sum of both coordinates."""
    agent = cg.LinearAgent(
        name="a",
        A=np.eye(2),
        B=np.eye(2),
        output_matrix=[[1.0, 1.0]],
        noise_covariance=0.2 * np.eye(2),
        state_low=[-3.0, -3.0],
        state_high=[3.0, 3.0],
        input_low=[-1.0, -1.0],
        input_high=[1.0, 1.0],
        initial_state=[0.0, 0.0],
    )
    goal = cg.Proposition("a", [1.0], [3.0])
    problem = cg.Problem(
        name="strip",
        horizon=3,
        agents=[agent],
        propositions={"goal": goal},
        specification=cg.Specification("F goal", "co-safe"),
    )
    certificate = cg.synthesize(problem, 20, relation="exact").certificate
    assert certificate.lower_bound > 0.1 and certificate.gap is None and cg.check(certificate)
    assert "certain class" in cg.check(changed(certificate, gap=0.5)).failures[0]


def test_dropped_mass_is_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    certificate = cg.synthesize(
        two_agents("F (a & F c)", horizon=5), 40, search=cg.SearchOptions(value="tree"), relation="exact"
    ).certificate
    exactly = attained(certificate)
    monkeypatch.setattr("certigym.synthesis.extended_check.claims.upper_bound.SPARED", 1e9)
    coarse = attained(certificate)
    assert exactly is not None and coarse is not None and coarse > exactly + 1e-4


def test_large_masses_are_left_unverified(certificate: OnGrid, monkeypatch: pytest.MonkeyPatch) -> None:
    if certificate.proof.rounding is not None:
        return
    monkeypatch.setattr("certigym.synthesis.extended_check.claims.upper_bound.MOST", 1)
    report = cg.check(certificate)
    assert report and report.above is None and "at most" not in str(report)
