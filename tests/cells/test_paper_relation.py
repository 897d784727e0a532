"""The paper's relation holds: its coupling has both marginals, it is kept as often as it says, and its bounds are lower
bounds for the coupled closed loop."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.stats import binomtest, kstest, norm

import certigym as cg
from certigym.envs.simulation import batch_simulator as core
from certigym.envs.simulation.batch_simulator import Dynamics
from certigym.synthesis.abstraction.models import Policies, finite_models
from certigym.synthesis.abstraction.models.input_sets import InputSet
from certigym.synthesis.abstraction.models.joint import join, start_of
from certigym.synthesis.certificates.controllers.abstract_state import Memory, Tracker
from certigym.synthesis.certificates.controllers.controller import BatchMemory
from certigym.synthesis.certificates.proofs import changed
from certigym.synthesis.policy_search.ascent.coordinate_ascent import resting_policies, start_value, sweep
from certigym.synthesis.policy_search.ascent.limits import Limits
from certigym.synthesis.policy_search.ascent.occupancy import forward
from certigym.synthesis.policy_search.bounds.certified import plain_loss, robust_loss, undecided_steps
from certigym.synthesis.relations.grids.labels import cell_labels
from certigym.synthesis.relations.kinds.coupled import CoupledRelation, couple, coupling_failure, joint_delta
from certigym.synthesis.relations.kinds.scalar import paper_relation
from certigym.synthesis.verbs.abstract import abstract
from certigym.validation.presentation.paper.heuristics import HeuristicStep, paper_steps
from certigym.validation.statistical_tests.binomial import CONFIRMED, REFUTED, clopper_pearson
from problems import scalar_agent, two_agents

FALSE_ALARM = 1e-6


def test_delta_is_the_closed_form() -> None:
    """RA2 .0019947, IV .0717, PD8 .000332."""
    ra = paper_relation(scalar_agent("a"), np.linspace(-20, 5, 1001), 0.1)
    assert ra.delta == pytest.approx(0.0019947, abs=5e-8)
    iv = paper_relation(scalar_agent("a"), np.linspace(-10, 10, 101), 0.1)
    assert iv.delta == pytest.approx(0.0717, abs=5e-5) and iv.is_cell
    pd = paper_relation(scalar_agent("a"), np.linspace(-20, 5, 1201), 0.1)
    assert pd.delta == pytest.approx(0.000332, abs=1e-6)
    still = paper_relation(scalar_agent("a"), np.linspace(-20, 5, 1001), 0.2)
    assert still.delta == 0.0 and not np.any(still.coupling)


@pytest.mark.parametrize("feedback", [0.0, -1.0, 0.7])
@pytest.mark.parametrize("a", [0.9, -1.05, 1.2])
def test_the_relation_is_invariant(a: float, feedback: float) -> None:
    relation = paper_relation(scalar_agent("x", A=[[a]]), np.linspace(-4, 4, 161), 0.1, feedback)
    moved, epsilon = a + 0.5 * feedback - float(relation.coupling[0, 0]), float(relation.reach[0])
    assert abs(moved) * epsilon + 0.025 <= epsilon * (1 + 1e-12)
    assert np.all(np.abs(relation.inputs) + abs(feedback) * epsilon <= 2.0)


def test_the_coupling_has_both_marginals_and_fails_as_rarely_as_can_be() -> None:
    """Kolmogorov-Smirnov and exact binomial tests at 1e-6 / 3 each; 200,000 draws notice errors of .007."""
    rng = np.random.default_rng(7)
    n, deviation, shift = 200_000, 0.5, np.full(200_000, 0.3)
    noise = deviation * rng.standard_normal(n)
    abstract_noise = deviation * couple(noise[None] / deviation, shift[None] / deviation, rng.random(n))[0]
    level = FALSE_ALARM / 3
    assert kstest(abstract_noise, norm(scale=deviation).cdf).pvalue > level
    together = np.isclose(abstract_noise, noise + shift)
    failure = coupling_failure(0.3 / deviation)
    assert binomtest(int((~together).sum()), n, failure).pvalue > level
    assert kstest(noise, norm(scale=deviation).cdf).pvalue > level


def test_the_abstract_state_moves_as_the_kernel_says_and_stays_related() -> None:
    """Cell frequencies against kernel masses (Holm-free union over cells) and losses against delta, each at 1e-6."""
    problem = two_agents(horizon=3)
    model = abstract(problem, 64, relation="paper", search=cg.SearchOptions(epsilon=0.1)).models[0]
    relation, grid = model.relation, model.grid
    assert isinstance(relation, CoupledRelation) and isinstance(model.choices, InputSet)
    rng = np.random.default_rng(3)
    n, cell, choice = 400_000, 40, 7
    centre = grid.centres[cell, 0]
    states = np.full((1, 1, n), centre + 0.09)
    inputs = np.full((1, 1, n), relation.inputs[choice, 0])
    mean = relation.means(grid.centres)[cell, choice, 0]
    cells, lost_before = np.full((1, n), cell), np.zeros((1, n), dtype=bool)
    memory = Memory(cells, states - centre, lost_before, states, inputs, np.full((1, 1, n), mean))
    following = 0.9 * states + 0.5 * inputs + 0.5 * rng.standard_normal((1, 1, n))
    moved = Tracker(relation, grid).follow(memory, following, rng.random((1, n)))
    row = model.kernel.tables[0].toarray()[model.choices.leads_to[cell, choice]]
    kept = ~moved.lost[0]
    lost = int((~kept).sum())
    low, _ = clopper_pearson(lost, n, 1 - FALSE_ALARM)
    outside = 1 - row.sum()
    assert low <= relation.delta + outside
    assert lost > 0.2 * relation.delta * n  # the start is near the edge of the relation: it is lost now and then
    assert np.all(np.abs(following[0, 0] - grid.centres[moved.cells[0], 0])[kept] <= relation.reach[0] * (1 + 1e-9))
    for s in range(grid.n_cells):
        count = int((moved.cells[0][kept] == s).sum())
        assert count <= n and clopper_pearson(count, n, 1 - FALSE_ALARM / 64)[0] <= row[s] + 1e-12


@pytest.mark.parametrize("settings", [{"epsilon": 0.1}, {"epsilon": 0.15, "feedback": -0.8}, {"epsilon": 0.0625}])
def test_bounds_hold_for_the_coupled_closed_loop(settings: dict[str, Any]) -> None:
    """One-sided at 1e-6 / 3; the bound, and the bound elsewhere, survive 50,000 rollouts and the check."""
    problem = two_agents(horizon=4, noise_covariance=[[0.6]]).replace(initial_state=[3.6, 0.4])
    result = cg.synthesize(problem, 64, relation="paper", search=cg.SearchOptions(**settings))
    certificate = result.certificate
    assert set(certificate.proof.bounds) in ({"nominal"}, {"a-posteriori", "robust tree"})
    assert certificate.lower_bound == max(certificate.proof.bounds.values()) > 0.1
    assert cg.check(certificate), str(cg.check(certificate))
    report = cg.validate(result, 50_000, seed=1, confidence=1 - FALSE_ALARM / 3)
    assert report.verdict == CONFIRMED, str(report)
    elsewhere = cg.validate(result, 20_000, seed=1, confidence=1 - FALSE_ALARM / 3, initial_state=[1.5, -2.0])
    assert elsewhere.verdict != REFUTED


def test_claiming_the_nominal_value_in_spite_of_delta_is_refused() -> None:
    problem = two_agents(horizon=4)
    certificate = cg.synthesize(problem, 64, relation="paper", search=cg.SearchOptions(epsilon=0.1)).certificate
    assert cg.check(certificate)
    assert not cg.check(changed(certificate, bound="nominal"))
    part = replace(certificate.proof.agents[0], relation={**certificate.proof.agents[0].relation, "delta": 1e-5})
    assert not cg.check(changed(certificate, agents=(part, certificate.proof.agents[1])))
    part = replace(certificate.proof.agents[0], relation={**certificate.proof.agents[0].relation, "epsilon": 0.2})
    assert not cg.check(changed(certificate, agents=(part, certificate.proof.agents[1])))


def test_a_relation_that_takes_more_inputs_than_there_are_is_refused() -> None:
    """Of the second of two equal agents, too."""
    agents = [scalar_agent(name) for name in ("one", "two")]
    regions = {name: cg.Proposition(name, [-3.5], [3.5]) for name in ("one", "two")}
    task = cg.Specification("G (one & two)", "finite-trace")
    problem = cg.Problem(name="alike", horizon=3, agents=agents, propositions=regions, specification=task)
    certificate = cg.synthesize(problem, 64, relation="paper", search=cg.SearchOptions(epsilon=0.2)).certificate
    part = certificate.proof.agents[0]
    assert cg.check(changed(certificate, agents=(part, part)))
    for changes in ({"feedback": -1.0}, {"inputs": 12}):
        wrong = replace(part, relation={**part.relation, **changes})
        assert not cg.check(changed(certificate, agents=(part, wrong)))


def test_labels_that_are_not_shrunk_are_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(finite_models, "error_labels", lambda p, i, g, reach: cell_labels(p, i, g))
    options = cg.SearchOptions(epsilon=0.3, feedback=-0.5)
    certificate = cg.synthesize(two_agents(horizon=4), 64, relation="paper", search=options).certificate
    assert certificate.proof.bound == "nominal" and not cg.check(certificate)


def test_relations_without_delta_are_never_lost_and_inputs_are_admissible() -> None:
    problem = two_agents(horizon=4)
    options = cg.SearchOptions(epsilon=0.3, feedback=-0.5)
    controller = cg.synthesize(problem, 64, relation="paper", search=options).controller
    dynamics = Dynamics.of(problem)
    policy, rng = controller.batch(dynamics), np.random.default_rng(2)
    worlds = core.initial(dynamics, rng, 20_000)
    memory = policy.begin(worlds, np.random.default_rng(1))
    assert all(agent.relation.delta == 0.0 for agent in controller.agents)
    for _ in range(problem.horizon):
        inputs, memory = policy.act(worlds, memory)
        undecided = ~worlds.failed & ~worlds.accepted
        assert all(np.all(np.abs(own[:, :, undecided]) <= 2.0) for own in inputs)
        worlds = core.transition(dynamics, worlds, inputs, core.noise(dynamics, rng, 20_000))
    assert isinstance(memory, BatchMemory) and memory.lost is not None
    assert not np.any(memory.lost & ~worlds.failed & ~worlds.accepted)


def test_undecided_steps_are_what_rollouts_of_the_abstract_chain_count() -> None:
    """Theta against 20,000 simulated abstract chains, interval at 1e-6 by Hoeffding (counts in [0, T])."""
    problem = two_agents(horizon=5, noise_covariance=[[0.6]]).replace(initial_state=[3.6, 0.4])
    joint = join(problem, abstract(problem, 40, relation="paper", search=cg.SearchOptions(epsilon=0.2)))
    start = start_of(problem, joint)
    policies = resting_policies(joint)
    theta = undecided_steps(joint, forward(joint, policies, start, Limits(0, 0, 0, 10**6)))
    rng = np.random.default_rng(5)
    n = 20_000
    cells = [np.full(n, int(np.flatnonzero(f[0])[0])) for f in start.terms.factors]
    q, alive, count = np.full(n, problem.initial_q), np.ones(n, dtype=bool), np.zeros(n)
    for t in range(problem.horizon):
        count += alive
        for i, model in enumerate(joint.models):
            points = model.choices.points(policies[i][t, 0])
            table = model.kernel.tables[0].toarray()
            cumulative = np.cumsum(table, axis=1)
            cells[i] = (cumulative[points[np.minimum(cells[i], len(points) - 1)]] < rng.random(n)[:, None]).sum(axis=1)
        alive &= np.all([c < m.n_cells for c, m in zip(cells, joint.models)], axis=0)
        inside = [np.minimum(c, m.n_cells - 1) for c, m in zip(cells, joint.models)]
        following = np.full(n, -1)
        for g in range(len(joint.guards.source)):
            hit = (q == joint.guards.source[g]) & alive
            for i, own in enumerate(inside):
                hit &= joint.masks[i][joint.guards.mask[g, i], own]
            following[hit] = joint.guards.target[g]
        alive &= following >= 0
        q = np.where(alive, following, q)
        alive &= ~joint.absorbing[q]
    margin = problem.horizon * np.sqrt(np.log(2 / FALSE_ALARM) / (2 * n))
    assert abs(theta - count.mean()) <= margin + 1e-6


def test_plain_robust_operator_is_refused_above_one_where_it_would_be_unsound() -> None:
    problem = two_agents(horizon=2)
    model = abstract(problem, 40, relation="paper", search=cg.SearchOptions(epsilon=0.1)).models[0]
    big = np.full((1, model.n_cells), 3.0)
    with pytest.raises(ValueError, match="above 1"):
        plain_loss(model, big, model.kernel.backup(big))
    small, large = model.kernel.backup(big / 3), model.kernel.backup(big)
    np.testing.assert_allclose(robust_loss(model, big, large), 3 * robust_loss(model, big / 3, small), rtol=1e-9)


def of_steps(steps: Iterable[HeuristicStep]) -> Policies:
    """Policies (T, Q, S_i) of the paper's heuristic for the whole horizon."""
    tables = [step.policies for step in steps][::-1]
    return tuple(np.stack(own).astype(np.int32) for own in zip(*tables, strict=True))


def test_heuristic_steps_are_evaluations_of_their_policies() -> None:
    """The value reported with t steps to go is what a frozen evaluation of the same policies gives."""
    problem = two_agents(horizon=4, noise_covariance=[[0.6]]).replace(initial_state=[3.6, 0.4])
    joint = join(problem, abstract(problem, 40, relation="paper", search=cg.SearchOptions(epsilon=0.15)))
    start = start_of(problem, joint)
    steps = [*paper_steps(joint)]
    again = sweep(joint, of_steps(steps), start, Limits(0, 0, 0, 10**6), improve=False, loss=plain_loss)
    assert start_value(start, steps[-1].terms) == pytest.approx(again.value, rel=1e-9, abs=1e-13)


def test_joint_delta_rounds_up() -> None:
    assert joint_delta([0.0, 0.0]) == 0.0
    assert joint_delta([1.0, 0.5]) == 1.0
    assert joint_delta([0.1] * 20) >= 1 - 0.9**20
