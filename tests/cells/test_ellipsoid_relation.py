"""Ellipsoids hold: errors stay in them unless the coupling fails, which it does as rarely as delta says, and the
verifier needs no solver to see it and nobody's word for it."""

from __future__ import annotations

import itertools
import sys
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from scipy.stats import binomtest, kstest, norm

import certigym as cg
import problems
from certigym.synthesis.abstraction.models.agent_models import ellipsoid_model
from certigym.synthesis.abstraction.models.ellipsoid_search import find_ellipsoid
from certigym.synthesis.abstraction.models.input_sets import InputSet
from certigym.synthesis.certificates.cell_probabilities.agent_record import AgentRecord
from certigym.synthesis.certificates.controllers.abstract_state import Memory, Tracker
from certigym.synthesis.extended_check.steps.execution import execution_of
from certigym.synthesis.extended_check.steps.relation_check import verify_relation
from certigym.synthesis.relations.grids.grid import Grid
from certigym.synthesis.relations.kinds import ellipsoid as relation_ellipsoid
from certigym.synthesis.relations.kinds.coupled import CoupledRelation, couple
from certigym.synthesis.relations.kinds.description import check_description, describe_relation, relation_from
from certigym.synthesis.relations.kinds.ellipsoid import Ellipsoid, ellipsoid_relation
from certigym.synthesis.relations.kinds.ellipsoid_facts import ellipsoid_failure, ellipsoid_is_invariant
from certigym.synthesis.relations.kinds.tube import disturbance_of
from certigym.validation.statistical_tests.binomial import clopper_pearson
from kinds import mostly_thorough
from problems import scalar_agent

pytest.importorskip("cvxpy", reason="the extra lmi is not installed")

FALSE_ALARM = 1e-6
ROOM = np.array([2.5, 5.0])


def cart(**changes: Any) -> cg.LinearAgent:
    """The position-velocity agent of RA4 on a smaller track."""
    wide: dict[str, Any] = {"state_low": [-6.0, -5.0], "state_high": [6.0, 5.0]}
    return problems.cart(**{**wide, "noise_covariance": [[0.25, 0.0], [0.0, 0.25]], **changes})


def cells(agent: cg.LinearAgent, n: int = 48) -> Grid:
    pairs = zip(agent.workspace.low, agent.workspace.high)
    return Grid(tuple(np.linspace(low, high, n + 1) for low, high in pairs))


def case(name: str, delta: float) -> tuple[cg.LinearAgent, AgentRecord]:
    """Agent of a case, and what a certificate would store of it; the policy does not matter here."""
    return CASES[name][0], _part(name, delta)


@cache
def _part(name: str, delta: float) -> AgentRecord:
    agent, coordinates = CASES[name]
    grid, axes = cells(agent), np.eye(agent.n_states) if coordinates is None else coordinates
    relation, lattice, _, input_set = ellipsoid_model(agent, grid, axes, np.full(agent.n_states, 3.0), delta)
    assert isinstance(input_set, InputSet)
    masks, policy = np.zeros((1, grid.n_cells), dtype=bool), np.zeros((1, 1, grid.n_cells), dtype=np.int32)
    return AgentRecord(grid, axes, describe_relation(relation), lattice, masks, masks, policy, input_set.leads_to)


def relation_of(agent: cg.LinearAgent, part: AgentRecord) -> CoupledRelation:
    relation = part.relation_of(agent)
    assert isinstance(relation, CoupledRelation)
    return relation


def boundary(relation: CoupledRelation, n: int, seed: int = 0) -> np.ndarray:
    """Errors (d, n) on the boundary of the ellipsoid."""
    assert relation.shape is not None
    directions = np.random.default_rng(seed).standard_normal((len(relation.shape), n))
    size = np.sqrt(np.sum(directions * (relation.shape @ directions), axis=0))
    return relation.epsilon * directions / size


@cache
def _model(delta: float) -> Any:
    """Relation, lattice, kernel and menu of the cart."""
    return ellipsoid_model(cart(), cells(cart()), np.eye(2), ROOM, delta)


CORRELATED = [[0.25, 0.1], [0.1, 0.3]]
AXES = np.array([[1.0, 0.0], [0.4, 1.0]])  # Sigma = L diag(.25, .26) L'
CASES: dict[str, tuple[cg.LinearAgent, Any]] = {
    "cart": (cart(), None),
    "two inputs": (cart(B=[[0.1, 0.0], [0.5, 0.2]], input_low=[-2.0, -1.0], input_high=[2.0, 1.0]), None),
    "snapped": (cart(A=[[1.0, 0.37], [-0.05, 0.9]], offset=[0.05, -0.02]), None),
    "correlated": (cart(noise_covariance=CORRELATED), AXES),
    "output": (cart(output_matrix=[[1.0, 0.0]]), None),
}


def failures(agent: Any, part: Any) -> list[str]:
    """Return what the check finds wrong with the relation of an agent; a relation that is refused is wrong."""
    try:
        relation = part.relation_of(agent)
    except ValueError as error:
        return [str(error)]
    return verify_relation(agent, part, relation, execution_of(agent, part, relation))


@mostly_thorough("delta", [0.0, 0.02])
@mostly_thorough("name", CASES)
def test_ellipsoids_are_found_and_verified_without_the_solver(
    name: str, delta: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    agent, part = case(name, delta)
    monkeypatch.setitem(sys.modules, "cvxpy", None)
    assert failures(agent, part) == []
    relation = relation_of(agent, part)
    assert 0.9 * delta <= relation.delta <= delta
    assert np.any(relation.coupling) == (delta > 0)
    assert name != "snapped" or np.any(relation.snap > 0)
    if name == "output":
        assert relation.epsilon == pytest.approx(relation.state_reach[0], rel=1e-6)


@mostly_thorough("delta", [0.0, 0.02])
@mostly_thorough("name", CASES)
def test_errors_on_the_boundary_and_vertices_of_the_cells_stay_inside(name: str, delta: float) -> None:
    """20,000 errors, every vertex, the largest image within 0.1 % of the boundary: nothing is given away."""
    agent, part = case(name, delta)
    relation = relation_of(agent, part)
    half = disturbance_of(part.grid, relation.snap)
    closed = relation.A + relation.B @ relation.feedback - relation.coupling
    moved, form = closed @ boundary(relation, 20_000), relation.shape
    assert form is not None
    largest = 0.0
    for signs in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
        image = moved + (half * signs)[:, None]
        largest = max(largest, float(np.max(np.sum(image * (form @ image), axis=0))) / relation.epsilon**2)
    assert 0.999 < largest <= 1.0
    reaches = np.max(np.abs(part.coordinates @ boundary(relation, 20_000)), axis=1)
    assert np.all((0.999 * relation.state_reach < reaches) & (reaches <= relation.state_reach))
    reserve = np.max(np.abs(relation.feedback @ boundary(relation, 20_000)), axis=1)
    assert np.all(np.abs(relation.inputs) + reserve <= agent.input_box.high)


TAMPERED: dict[str, Any] = {
    "shape": lambda r: {"shape": (0.9 * np.array(r["shape"])).tolist()},
    "other shape": lambda r: {"shape": np.diag(np.diag(r["shape"])).tolist()},
    "indefinite": lambda r: {"shape": [[1.0, 2.0], [2.0, 1.0]]},
    "unsymmetric": lambda r: {"shape": (np.array(r["shape"]) + [[0.0, 1e-6], [0.0, 0.0]]).tolist()},
    "feedback": lambda r: {"feedback": (0.9 * np.array(r["feedback"])).tolist()},
    "no coupling": lambda r: {"coupling": [[0.0, 0.0], [0.0, 0.0]]},
    "coupling": lambda r: {"coupling": (1.01 * np.array(r["coupling"])).tolist()},
    "delta": lambda r: {"delta": 0.999 * r["delta"]},
    "epsilon": lambda r: {"epsilon": 0.94 * r["epsilon"]},
    "negative": lambda r: {"epsilon": -r["epsilon"]},
    "inputs": lambda r: {"inputs": (1.01 * np.array(r["inputs"])).tolist()},
}


@pytest.mark.parametrize("name", TAMPERED)
def test_every_tampered_piece_is_refused(name: str) -> None:
    part = _part("cart", 0.02)
    assert failures(cart(), part) == []
    changed = replace(part, relation={**part.relation, **TAMPERED[name](part.relation)})
    assert failures(cart(), changed) != []


def test_means_that_are_not_those_of_the_dynamics_are_refused() -> None:
    part = _part("cart", 0.0)
    assert failures(cart(), part) == []
    moved = replace(part, lattice=(part.lattice[0] + 0.02, part.lattice[1]))
    assert any("invariant" in text for text in failures(cart(), moved))


def test_what_means_are_snapped_by_is_computed_and_not_believed() -> None:
    """The stored distance decides nothing: the check measures from every mean to its lattice point."""
    part = _part("cart", 0.0)
    moved = replace(part, lattice=(part.lattice[0] + 0.02, part.lattice[1]))
    for snap in ([0.0, 0.0], [-0.01, -0.01], [1.0, 1.0]):
        assert failures(cart(), replace(part, relation={**part.relation, "snap": snap})) == []
        assert failures(cart(), replace(moved, relation={**part.relation, "snap": snap})) != []


@mostly_thorough("seed", range(8), first=5)
def test_the_proof_of_invariance_is_sound_and_loses_nothing(seed: int) -> None:
    """Against the largest image over 200,000 boundary points and all vertices, up to 1e-5 on both sides."""
    rng = np.random.default_rng(seed)
    closed, half = 0.5 * rng.normal(size=(2, 2)), rng.uniform(0.05, 0.2, size=2)
    root = rng.normal(size=(2, 2)) + 2 * np.eye(2)
    shape = root @ root.T
    angle = np.linspace(0, 2 * np.pi, 200_000)
    circle = np.linalg.solve(np.linalg.cholesky(shape).T, np.stack([np.cos(angle), np.sin(angle)]))

    def largest(epsilon: float) -> float:
        images = [epsilon * closed @ circle + (half * signs)[:, None] for signs in ((1, 1), (1, -1))]
        return max(float(np.max(np.sum(v * (shape @ v), axis=0))) for v in images) / epsilon**2

    for epsilon in np.linspace(0.05, 3.0, 60):
        size = largest(float(epsilon))
        if abs(size - 1) > 1e-5:
            assert ellipsoid_is_invariant(shape, float(epsilon), closed, half) == (size < 1), (epsilon, size)


def test_the_box_around_an_ellipsoid_is_not_invariant_and_serves_margins_only() -> None:
    relation = relation_of(cart(), _part("cart", 0.0))
    closed = relation.A + relation.B @ relation.feedback
    assert np.any(np.abs(closed) @ relation.reach + disturbance_of(cells(cart()), None) > relation.reach * 1.01)
    assert np.all(relation.related(boundary(relation, 1000) * (1 - 1e-12)))
    assert not np.any(relation.related(boundary(relation, 1000) * (1 + 1e-9)))
    assert not relation.related(relation.reach[:, None] * np.array([[1.0], [1.0]])).any()


@pytest.mark.parametrize("delta", [0.0, 0.005, 0.02])
def test_scalar_ellipsoids_are_the_closed_form(delta: float) -> None:
    """K = 0: ``(a - F) epsilon + h/2 = epsilon``, ``F epsilon = r sigma``: ``epsilon = (h/2 - r sigma) / (1 - a)``."""
    agent = scalar_agent("x")
    grid = Grid((np.linspace(-4, 4, 81),))
    found = find_ellipsoid(agent, grid, np.eye(1), np.ones(1), delta, share=0.0)
    least = (0.05 - 2 * float(norm.ppf(0.5 + delta / 2)) * 0.5) / 0.1
    assert least <= found.epsilon <= least * 1.001
    assert found.shape[0, 0] == pytest.approx(1.0) and not np.any(found.feedback)


@pytest.mark.thorough
def test_three_states_and_their_four_pairs_of_vertices() -> None:
    """Every vertex of W, 20,000 errors: a chain of three integrators."""
    low, high = [-6.0] * 3, [6.0] * 3
    A, B, noise = np.eye(3) + 0.5 * np.eye(3, k=1), [[0.0], [0.0], [0.5]], 0.1 * np.eye(3)
    agent = cg.LinearAgent(
        name="x",
        A=A,
        B=B,
        noise_covariance=noise,
        state_low=low,
        state_high=high,
        input_low=[-8.0],
        input_high=[8.0],
        initial_state=[0.0] * 3,
    )
    grid = cells(agent)
    found = find_ellipsoid(agent, grid, np.eye(3), np.full(3, 3.0), 0.01, share=0.4)
    relation = ellipsoid_relation(agent, grid, np.eye(3), found)
    assert 0 < relation.delta <= 0.01 and np.max(found.support(found.feedback)) <= 0.4 * 8.0 * (1 + 1e-6)
    moved = (A + np.array(B) @ found.feedback - found.coupling) @ boundary(relation, 20_000)
    for signs in itertools.product((1, -1), repeat=3):
        image = moved + (0.125 * np.array(signs))[:, None]
        assert np.all(relation.related(image))


def test_agents_without_usable_inputs_need_no_feedback() -> None:
    agent = scalar_agent("x", A=[[0.8]], input_low=[0.0], input_high=[0.0])
    found = find_ellipsoid(agent, Grid((np.linspace(-4, 4, 81),)), np.eye(1), np.ones(1))
    assert not np.any(found.feedback) and found.epsilon == pytest.approx(0.25, rel=1e-6)


@pytest.mark.thorough
def test_the_coupling_has_both_marginals_and_fails_as_rarely_as_can_be() -> None:
    """Kolmogorov-Smirnov per axis and one exact binomial test, each at 1e-6 / 4; 200,000 draws see errors of .007."""
    relation = relation_of(cart(), _part("cart", 0.05))
    assert relation.shape is not None
    deviation, n, level = np.sqrt(relation.covariance)[:, None], 200_000, FALSE_ALARM / 4
    errors = boundary(relation, 5000)
    shifts = relation.coupling @ errors / deviation
    worst = shifts[:, np.argmax(np.sum(shifts**2, axis=0))]  # whitened, of the error whose coupling fails most
    rng = np.random.default_rng(3)
    noise = rng.standard_normal((2, n))
    other = couple(noise, np.repeat(worst[:, None], n, axis=1), rng.random(n))
    for k in range(2):
        assert kstest(other[k], norm.cdf).pvalue > level
    along = worst / np.linalg.norm(worst)
    assert kstest(along @ other, norm.cdf).pvalue > level
    apart = int((~np.all(np.isclose(other, noise + worst[:, None]), axis=0)).sum())
    assert binomtest(apart, n, relation.delta).pvalue > level
    assert relation.delta <= 0.05


def followed(relation: CoupledRelation, model: Any, agent: cg.LinearAgent, grid: Grid, n: int) -> tuple[Any, Any, int]:
    """Memory after one coupled step of n worlds from the worst error of one cell; the states; the lattice point."""
    cell, choice = grid.n_cells // 2 + 20, 3
    errors = boundary(relation, 5000)
    error = errors[:, np.argmax(np.sum((relation.coupling @ errors) ** 2, axis=0))]
    states = np.repeat((grid.centres[cell] + error)[:, None, None], n, axis=2)
    inputs = np.repeat((relation.inputs[choice] + relation.feedback @ error)[:, None, None], n, axis=2)
    point = int(model[3].leads_to[cell, choice])
    index = np.unravel_index(point, tuple(len(axis) for axis in model[1]))
    means = np.repeat(np.array([axis[k] for axis, k in zip(model[1], index)])[:, None, None], n, axis=2)
    errors = np.repeat(error[:, None, None], n, axis=2)
    memory = Memory(np.full((1, n), cell), errors, np.zeros((1, n), dtype=bool), states, inputs, means)
    rng = np.random.default_rng(5)
    noise = np.linalg.cholesky(agent.noise_covariance) @ rng.standard_normal((2, n))
    following = agent.A @ states[:, 0] + agent.B @ inputs[:, 0] + noise
    return Tracker(relation, grid).follow(memory, following[:, None], rng.random((1, n))), following, point


@pytest.mark.thorough
def test_relations_are_lost_no_more_often_than_delta_says_and_cells_move_as_the_kernel_says() -> None:
    """Losses one-sided at 1e-6, cell frequencies at 1e-6 over all cells; 300,000 steps from the worst error."""
    agent, grid, n = cart(), cells(cart()), 300_000
    model = _model(0.05)
    relation = model[0]
    assert isinstance(relation, CoupledRelation)
    moved, following, point = followed(relation, model, agent, grid, n)
    tables = [table.toarray() for table in model[2].tables]
    index = np.unravel_index(point, tuple(len(axis) for axis in model[1]))
    masses = np.outer(tables[0][index[0]], tables[1][index[1]]).ravel()
    lost = int(moved.lost.sum())
    assert clopper_pearson(lost, n, 1 - FALSE_ALARM)[0] <= relation.delta + 1 - masses.sum()
    assert lost > 0.2 * relation.delta * n  # rejected proposals do leave the ellipsoid now and then
    kept = ~moved.lost[0]
    error = following - grid.centres[moved.cells[0]].T
    assert np.all(relation.related(error[:, kept]))
    counts = np.bincount(moved.cells[0][kept], minlength=grid.n_cells)
    for s in np.flatnonzero(counts):
        low = clopper_pearson(int(counts[s]), n, 1 - FALSE_ALARM / grid.n_cells)[0]
        assert low <= masses[s] + 1e-12


def test_a_coupling_of_the_wrong_sign_is_noticed() -> None:
    agent, grid, n = cart(), cells(cart()), 100_000
    model = _model(0.05)
    assert isinstance(model[0], CoupledRelation)
    moved, _, _ = followed(replace(model[0], coupling=-model[0].coupling), model, agent, grid, n)
    assert clopper_pearson(int(moved.lost.sum()), n, 1 - FALSE_ALARM)[0] > model[0].delta


def test_a_delta_without_the_half_is_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    part = _part("cart", 0.02)
    monkeypatch.setattr(relation_ellipsoid, "coupling_failure", lambda distance: 0.1 * distance)
    wrong = replace(part, relation={**part.relation, "delta": 0.01})
    assert any("delta" in text for text in failures(cart(), wrong))


def test_delta_by_hand() -> None:
    """D = I, epsilon = 0.1, F = diag(2, 1), deviations 0.5 and 1: r = 0.1 * 2 / 0.5, delta = 2 Phi(0.2) - 1."""
    found = ellipsoid_failure(np.eye(2), 0.1, np.diag([2.0, 1.0]), np.array([0.25, 1.0]))
    assert found == pytest.approx(2 * norm.cdf(0.2) - 1, rel=1e-8) and found >= 2 * norm.cdf(0.2) - 1
    assert ellipsoid_failure(np.eye(2), 0.1, np.diag([2.0, 0.0]), np.array([0.0, 1.0])) == 1.0
    assert ellipsoid_failure(np.eye(2), 0.1, np.zeros((2, 2)), np.array([0.0, 1.0])) == 0.0


def test_descriptions_give_the_same_relation_again() -> None:
    part = _part("cart", 0.02)
    check_description(part.relation, cart())
    first = relation_of(cart(), part)
    again = relation_from(describe_relation(first), cart(), part.grid, part.coordinates)
    assert again.kind == "ellipsoid"
    assert all(np.array_equal(a, b) for a, b in zip(first.arrays, again.arrays))
    for wrong in ({"shape": [[1.0]]}, {"coupling": [1.0, 2.0]}, {"delta": True}, {"epsilon": "1"}, {"kind": "ball"}):
        with pytest.raises(ValueError, match="relation"):
            check_description({**part.relation, **wrong}, cart())


@pytest.mark.parametrize("delta", [-0.1, 1.0, float("nan"), True, "much"])
def test_wrong_deltas_are_refused(delta: Any) -> None:
    with pytest.raises(ValueError, match=r"`delta`: expected a number of at least 0 and below 1, got"):
        find_ellipsoid(cart(), cells(cart()), np.eye(2), ROOM, delta)


def test_requests_that_cannot_be_met_say_what_to_try(monkeypatch: pytest.MonkeyPatch) -> None:
    grid = cells(cart())
    apart = cart(A=[[1.3, 0.0], [0.0, 1.0]])
    with pytest.raises(ValueError, match=r"expected a pair `A`, `B` .*`cells`, a larger `delta`"):
        find_ellipsoid(apart, grid, np.eye(2), ROOM)
    with pytest.raises(ValueError, match=r"expected a pair `A`, `B`"):
        find_ellipsoid(cart(), cells(cart(), 4), np.eye(2), ROOM)
    still = cart(noise_covariance=[[0.25, 0.0], [0.0, 0.0]])
    with pytest.raises(ValueError, match=r"`delta` > 0 needs a positive definite `noise_covariance`"):
        find_ellipsoid(still, grid, np.eye(2), ROOM, 0.01)
    given = Ellipsoid(np.eye(2), 0.1, np.zeros((1, 2)), np.eye(2))
    with pytest.raises(ValueError, match="positive definite `noise_covariance`"):
        ellipsoid_relation(still, grid, np.eye(2), given)
    with pytest.raises(ValueError, match=r"`input_low`, `input_high`"):
        ellipsoid_relation(cart(), grid, np.eye(2), replace(given, feedback=np.array([[50.0, 0.0]])))
    with pytest.raises(ValueError, match="what F costs"):
        ellipsoid_relation(cart(), grid, np.eye(2), given, delta=1e-3)
    monkeypatch.setitem(sys.modules, "cvxpy", None)
    with pytest.raises(
        ValueError, match=r'`relation`: expected .* got none; install it with `pip install "certigym\[lmi\]'
    ):
        find_ellipsoid(cart(), grid, np.eye(2), ROOM)
