"""Tubes hold with certainty: errors never leave their set, inputs stay admissible, and the bounds survive rollouts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import certigym as cg
from certigym.envs.simulation import batch_simulator as core
from certigym.envs.simulation.batch_simulator import Dynamics
from certigym.synthesis.certificates.controllers.controller import BatchMemory
from certigym.synthesis.certificates.proofs import changed, is_exact
from certigym.synthesis.relations.kinds.coupled import CoupledRelation
from certigym.synthesis.relations.kinds.tube import tube_generators, tube_relation
from certigym.synthesis.verbs.abstract import abstract
from certigym.validation.statistical_tests.binomial import REFUTED
from kinds import mostly_thorough
from problems import cart, cart_reach

FALSE_ALARM = 1e-6


def test_the_zonotope_of_a_nilpotent_loop_is_the_finite_sum() -> None:
    """Deadbeat by hand: A + B K = [[1, .5], [-2, -1]] has square 0, so E = W + (A + B K) W."""
    closed = np.array([[1.0, 0.5], [-2.0, -1.0]])
    half = np.array([0.1, 0.2])
    found = tube_generators(closed, half)
    assert found is not None
    np.testing.assert_allclose(np.abs(found).sum(axis=0), [0.1 + 0.1 + 0.1, 0.2 + 0.2 + 0.2], rtol=1e-6)


def test_unstable_loops_have_no_tube() -> None:
    assert tube_generators(np.array([[1.1]]), np.array([0.1])) is None
    model = abstract(cart_reach(cart()), [40, 40], relation="tube").models[0]
    with pytest.raises(ValueError, match="stabilises"):
        tube_relation(cart(), model.grid, np.eye(2), np.zeros((1, 2)))


@pytest.mark.parametrize("seed", range(5))
def test_the_zonotope_is_invariant_along_every_direction(seed: int) -> None:
    """Support functions: h(M' p) + h_W(p) <= h(p) for random directions p."""
    rng = np.random.default_rng(seed)
    closed = rng.normal(size=(3, 3))
    closed *= 0.9 / np.max(np.abs(np.linalg.eigvals(closed)))
    half = rng.uniform(0.01, 0.2, size=3)
    generators = tube_generators(closed, half)
    assert generators is not None
    directions = rng.normal(size=(2000, 3))
    support = np.abs(directions @ generators.T).sum(axis=1)
    moved = np.abs(directions @ closed @ generators.T).sum(axis=1) + np.abs(directions) @ half
    assert np.all(moved <= support * (1 + 1e-9))


def test_relations_are_never_lost_and_inputs_are_admissible() -> None:
    problem = cart_reach(cart())
    controller = cg.synthesize(problem, [60, 60], relation="tube", search=cg.SearchOptions(max_sweeps=1)).controller
    dynamics = Dynamics.of(problem)
    policy, rng = controller.batch(dynamics), np.random.default_rng(2)
    worlds = core.initial(dynamics, rng, 20_000)
    memory = policy.begin(worlds, np.random.default_rng(1))
    relation = controller.agents[0].relation
    assert isinstance(relation, CoupledRelation) and relation.delta == 0.0
    for _ in range(problem.horizon):
        inputs, memory = policy.act(worlds, memory)
        assert isinstance(memory, BatchMemory)
        undecided = ~worlds.failed & ~worlds.accepted
        assert np.all(np.abs(inputs[0][:, :, undecided]) <= 2.0)
        (own,) = memory.groups[0]
        assert own is not None
        error = worlds.states[0] - np.moveaxis(controller.agents[0].grid.centres[own.cells], -1, 0)
        assert np.all(relation.related(error)[:, undecided & ~own.lost[0]])
        worlds = core.transition(dynamics, worlds, inputs, core.noise(dynamics, rng, 20_000))
    still_in = ~worlds.failed & ~worlds.accepted
    assert memory.lost is not None and not np.any(memory.lost & still_in)


CASES = {
    "diagonal": cart(),
    "correlated": cart(noise_covariance=[[0.04, 0.02], [0.02, 0.05]]),
    "affine": cart(offset=[0.05, -0.02], A=[[1.0, 0.37], [-0.05, 0.9]]),
    "rounding": cart(
        B=[[0.125], [0.5]],
        noise_covariance=[[0.02, 0.0], [0.0, 0.02]],
        state_low=[-6.0, -4.0],
        state_high=[6.0, 4.0],
        input_low=[-6.0],
        input_high=[6.0],
    ),
    "wide": cart(B=[[0.1, 0.0], [0.5, 0.2]], input_low=[-2.0, -1.0], input_high=[2.0, 1.0]),
}


@mostly_thorough("name", CASES, first=2)
def test_tube_bounds_hold_and_check(name: str) -> None:
    """One-sided at 1e-6 / 5, 30,000 rollouts."""
    result = cg.synthesize(cart_reach(CASES[name]), [60, 60], relation="tube", search=cg.SearchOptions(max_sweeps=1))
    certificate = result.certificate
    assert certificate.proof.bound == "nominal" and not is_exact(certificate)
    assert cg.check(certificate), str(cg.check(certificate))
    report = cg.validate(result, 30_000, seed=3, confidence=1 - FALSE_ALARM / 5)
    assert report.verdict != REFUTED, str(report)
    assert report.lower_bound > 0.3


def test_a_tube_that_is_too_thin_is_refused() -> None:
    certificate = cg.synthesize(
        cart_reach(cart()), [40, 40], relation="tube", search=cg.SearchOptions(max_sweeps=1)
    ).certificate
    part = certificate.proof.agents[0]
    assert cg.check(certificate)
    other = replace(part, relation={**part.relation, "feedback": [[0.0, 0.0]]})
    assert not cg.check(changed(certificate, agents=(other,)))
    moved = replace(part, relation={**part.relation, "inputs": (np.array(part.relation["inputs"]) * 1.5).tolist()})
    assert not cg.check(changed(certificate, agents=(moved,)))


def test_the_relation_of_every_agent_is_verified_even_if_agents_are_alike() -> None:
    low, high = [-5.0, -3.0], [5.0, 3.0]
    problem = cg.Problem(
        name="carts",
        horizon=2,
        agents=list(cart(initial_state=[0.0, 0.0]).copies(2)),
        propositions={f"s{i}": cg.Proposition(f"cart_{i}", low, high) for i in range(2)},
        specification=cg.Specification("G (s0 & s1)", "finite-trace"),
    )
    certificate = cg.synthesize(problem, [40, 40], relation="tube", search=cg.SearchOptions(max_sweeps=0)).certificate
    part = certificate.proof.agents[0]
    both = changed(certificate, agents=(part, part))
    assert cg.check(both), str(cg.check(both))
    wrong = replace(part, relation={**part.relation, "inputs": (np.array(part.relation["inputs"]) * 1.5).tolist()})
    assert not cg.check(changed(certificate, agents=(part, wrong)))


def test_labels_that_are_not_shrunk_are_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    from certigym.synthesis.abstraction.models import finite_models as abstraction
    from certigym.synthesis.relations.grids.labels import cell_labels

    monkeypatch.setattr(abstraction, "error_labels", lambda p, i, g, c, reach: cell_labels(p, i, g, c))
    certificate = cg.synthesize(
        cart_reach(cart()), [40, 40], relation="tube", search=cg.SearchOptions(max_sweeps=1)
    ).certificate
    assert not cg.check(certificate)


def test_means_that_differ_by_rounding_share_a_lattice_point() -> None:
    """Cells of a third have no exact edges; the tube allows for the difference, and the certificate checks."""
    problem = cart_reach(cart(), horizon=4)
    model = abstract(problem, [36, 18], relation="tube").models[0]
    assert isinstance(model.relation, CoupledRelation) and 0 < np.max(model.relation.snap) < 1e-6
    means = model.relation.means(model.grid.centres)
    assert len(np.unique(means[..., 0])) > 2 * len(model.lattice[0])
    for lattice, n in zip(model.lattice, model.grid.shape, strict=True):
        assert len(lattice) <= 3 * n
    points = np.stack(np.unravel_index(np.asarray(model.choices.input_set), [len(a) for a in model.lattice]), axis=-1)
    reached = np.stack([axis[points[..., k]] for k, axis in enumerate(model.lattice)], axis=-1)
    assert np.all(np.abs(reached - means) <= model.relation.snap * (1 + 1e-9) + 1e-10)
    result = cg.synthesize(problem, [36, 18], relation="tube", search=cg.SearchOptions(max_sweeps=1))
    assert cg.check(result.certificate, problem)


def test_equal_agents_have_feedbacks_for_their_own_regions() -> None:
    """A narrow region asks for a narrow tube; agents with like regions go on sharing their model."""
    carts = cart().copies(3)
    sides = {"a": ("cart_0", 0.4), "b": ("cart_1", 0.4), "c": ("cart_2", 5.0)}
    regions = {name: cg.Proposition(agent, [-half, -3.0], [half, 3.0]) for name, (agent, half) in sides.items()}
    task = cg.Specification("F (a & b & c)", "co-safe")
    problem = cg.Problem(name="carts", horizon=3, agents=carts, propositions=regions, specification=task)
    models = abstract(problem, [60, 60], relation="tube").models
    reaches = [model.relation.state_reach[0] for model in models]  # type: ignore[union-attr]
    assert reaches[0] < 0.9 * reaches[2]
    assert models[0].kernel is models[1].kernel and models[0].relation is models[1].relation


def test_inputs_move_means_by_half_cells() -> None:
    """By hand: B = .5, cells of .1, so steps of .2 and extremes on multiples of .1."""
    model = abstract(cart_reach(cart()), [120, 60], relation="tube").models[0]
    assert isinstance(model.relation, CoupledRelation)
    inputs = model.relation.inputs[:, 0]
    np.testing.assert_allclose(inputs / 0.1, np.round(inputs / 0.1), atol=1e-9)
    np.testing.assert_array_equal(inputs, -inputs[::-1])
    assert 1.0 < np.max(inputs) < 2.0
