"""A tensor train is within its stated error of the function it stands for, and certificates on trains hold."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import binom

import certigym as cg
from certigym.synthesis.abstraction.models.action_tables import Policies
from certigym.synthesis.abstraction.models.joint import JointModel, join, start_of
from certigym.synthesis.certificates.proofs import changed
from certigym.synthesis.certificates.value_functions.tensor_train import Diagram, Train, added, diagram, rounded
from certigym.synthesis.certificates.value_functions.train_values import Rounding
from certigym.synthesis.policy_search.ascent import multistart as policy_search
from certigym.synthesis.policy_search.ascent.relaxation import relax, relaxed_policies
from certigym.synthesis.policy_search.ascent.train_ascent import TrainLimits, sweep_trains
from certigym.synthesis.policy_search.ascent.train_backward import evaluate
from certigym.synthesis.policy_search.bounds.dense import dense_value
from certigym.synthesis.verbs.abstract import abstract
from test_tree_equals_dense_programming import FORMULAS, problem_of

SHAPE = (5, 4, 6, 3)


def dense(train: Train) -> np.ndarray:
    whole = np.ones((1, 1))
    for core in train.cores:
        whole = np.tensordot(whole, core, axes=1)
    return whole.reshape(tuple(core.shape[1] for core in train.cores))


def random_parts(seed: int) -> tuple[list[tuple[Train, Diagram]], np.ndarray]:
    """Two trains on the two halves of a partition into a cube and its complement, and their sum written out."""
    draw = np.random.default_rng(seed)
    masks = []
    for n in SHAPE:
        inside = draw.random(n) < 0.6
        masks.append(np.stack([inside, ~inside, np.ones(n, dtype=bool)]))
    complement = np.array([[1, 2, 2, 2], [0, 1, 2, 2], [0, 0, 1, 2], [0, 0, 0, 1]])
    cube = np.zeros((1, 4), dtype=int)
    indicator = np.einsum("a,b,c,d->abcd", *(m[0] for m in masks)).astype(float)
    trains = []
    for rank in (4, 3):
        ranks = (1, rank, rank, rank, 1)
        sizes = zip(ranks, SHAPE, ranks[1:], strict=False)
        cores = tuple(draw.standard_normal(size) * 0.5 ** np.arange(size[2]) for size in sizes)
        trains.append(Train(cores, error=0.01 * rank))
    total = dense(trains[0]) * (1 - indicator) + dense(trains[1]) * indicator
    return [(trains[0], diagram(masks, complement)), (trains[1], diagram(masks, cube))], total


@pytest.mark.parametrize("seed", range(20))
@pytest.mark.parametrize("tolerance", [1e-13, 1e-3, 0.1, 1.0])
def test_rounding_a_masked_sum_changes_it_by_no_more_than_it_says(seed: int, tolerance: float) -> None:
    parts, total = random_parts(seed)
    found = rounded(parts, tolerance)
    made = found.error - 0.04  # the larger of the parts' own errors is carried along
    assert np.max(np.abs(dense(found) - total)) <= made
    assert made <= tolerance + 1e-9


@pytest.mark.parametrize("n_agents", [1, 2, 3])
def test_sums_of_trains_are_sums(n_agents: int) -> None:
    rng = np.random.default_rng(n_agents)

    def train(rank: int, error: float) -> Train:
        ranks = [1, *[rank] * (n_agents - 1), 1]
        return Train(tuple(rng.standard_normal((a, 4, b)) for a, b in zip(ranks, ranks[1:])), error)

    one, other = train(2, 0.25), train(3, 0.5)
    total = added(one, other)
    np.testing.assert_allclose(dense(total), dense(one) + dense(other), atol=1e-12)
    assert 0.75 <= total.error <= 0.75 + 1e-12
    assert added(one, None) is one


def test_a_complement_needs_two_nodes_however_many_cubes_it_has() -> None:
    parts, _ = random_parts(0)
    assert [len(table) for table in parts[0][1].following] == [1, 2, 2, 2]


def a_team(n_agents: int, formula: str, semantics: str) -> tuple[cg.Problem, JointModel, Policies]:
    problem = problem_of(n_agents, formula, semantics, 4)
    joint = join(problem, abstract(problem, 12))
    return problem, joint, relaxed_policies(relax(problem, joint))


@pytest.mark.parametrize(("formula", "semantics"), FORMULAS)
@pytest.mark.parametrize("tolerance", [1e-9, 1e-2, 0.2])
def test_values_are_within_their_error_of_dense_programming(formula: str, semantics: str, tolerance: float) -> None:
    problem, joint, policies = a_team(3, formula, semantics)
    exact = dense_value(problem, list(joint.models), policies)
    value = evaluate(joint, policies, tolerance)
    cells = np.stack(np.meshgrid(*(np.arange(n) for n in joint.n_cells), indexing="ij"), axis=-1).reshape(-1, 3)
    for q, train in enumerate(value.states):
        if problem.automaton.dead[q]:
            continue
        true = exact[q].astype(float).ravel()
        here = np.zeros(len(cells)) if train is None else train.at(cells)
        assert np.max(np.abs(here - true)) <= (0.0 if train is None else train.error)
        assert np.all(value.at(q, cells) <= true)
    assert value.error <= tolerance + 1e-9


def test_leaving_cells_out_only_takes_away() -> None:
    problem, joint, policies = a_team(2, *FORMULAS[0])
    exact = dense_value(problem, list(joint.models), policies)
    visited = [tuple(np.arange(2, 9) for _ in joint.models)] * 5
    value = evaluate(joint, policies, 1e-9, visited=visited)
    cells = np.stack(np.meshgrid(*(np.arange(n) for n in joint.n_cells), indexing="ij"), axis=-1).reshape(-1, 2)
    for q in range(joint.n_states):
        assert np.all(value.at(q, cells) <= exact[q].astype(float).ravel())
    assert value.at(problem.automaton.initial, np.array([[0, 5]]))[0] == 0.0


def test_the_ascent_on_trains_finds_what_the_ascent_on_trees_finds() -> None:
    problem = cg.make_problem("reach-avoid-v0", horizon=6)
    tree, train = (cg.synthesize(problem, 200, search=cg.SearchOptions(value=value)) for value in ("tree", "train"))
    assert train.certificate.proof.rounding is not None and train.certificate.proof.rank < tree.certificate.proof.rank
    assert train.certificate.lower_bound == pytest.approx(tree.certificate.lower_bound, rel=1e-4)


def cyclic(n_robots: int = 3) -> cg.Problem:
    """Robots on a line that pick up together and deliver together; a robot that strays sends all back."""
    names = ("pickup", "loss", "delivery")
    members = {name: tuple(f"{name}_{robot}" for robot in range(n_robots)) for name in names}
    rows = [
        ("empty", "all(pickup)", "carrying"),
        ("empty", "!all(pickup)", "empty"),
        ("carrying", "any(loss)", "empty"),
        ("carrying", "all(delivery) & !any(loss)", "done"),
        ("carrying", "!all(delivery) & !any(loss)", "carrying"),
    ]
    by_hand = {"states": ["empty", "carrying", "done"], "initial": "empty", "accepting": ["done"], "transitions": rows}
    automaton = cg.translate(by_hand, [name for family in members.values() for name in family], families=members)
    robot = cg.LinearAgent(
        name="robot",
        A=[[0.9]],
        B=[[1.0]],
        noise_covariance=[[0.25]],
        state_low=[-8.0],
        state_high=[4.0],
        input_low=[-2.0],
        input_high=[2.0],
        initial_state=[0.0],
    )
    return cg.Problem(
        name="cyclic",
        horizon=9,
        agents=robot.copies(n_robots),
        propositions={
            "pickup": cg.Proposition("robot_*", [-2.0], [2.0]),
            "loss": cg.Proposition("robot_*", [-8.0], [-7.0]),
            "delivery": cg.Proposition("robot_*", [-6.0], [-4.0]),
        },
        specification=cg.Specification(automaton=automaton),
    )


@pytest.fixture(scope="module")
def certified() -> cg.Synthesis:
    return cg.synthesize(cyclic(), 48, search=cg.SearchOptions(value="train", max_sweeps=3))


def test_a_cyclic_task_is_certified_close_to_what_rollouts_show(certified: cg.Synthesis) -> None:
    """20,000 rollouts, seed 3: refuted with probability at most 1e-6; at least 95 % of the estimate is certified."""
    certificate, n = certified.certificate, 20_000
    runs = cg.rollout(certificate.problem, certified.controller, n, seed=3)
    assert binom.cdf(runs.successes, n, certificate.lower_bound) > 1e-6
    assert certificate.lower_bound >= 0.95 * runs.successes / n
    assert certificate.lower_bound > 0.3
    upper = certified.stats["abstract_upper_bound"]
    assert isinstance(upper, float) and certificate.lower_bound <= upper


@pytest.mark.parametrize("wrong", ["bound", "tolerance", "cells", "twice", "horizon"])
def test_tampered_certificates_on_trains_are_refused(certified: cg.Synthesis, wrong: str) -> None:
    certificate = certified.certificate
    rounding = certificate.proof.rounding
    assert rounding is not None
    visited = list(rounding.visited)
    if wrong == "bound":
        bad = changed(certificate, lower_bound=certificate.lower_bound + 2 * rounding.tolerance)
    elif wrong == "tolerance":
        bad = changed(certificate, rounding=Rounding(0.5, rounding.visited))
    elif wrong == "cells":
        visited[4] = tuple(np.arange(3) for _ in certificate.proof.agents)
        bad = changed(certificate, rounding=Rounding(rounding.tolerance, tuple(visited)))
    elif wrong == "twice":
        cells = visited[4]
        assert cells is not None
        visited[4] = tuple(np.sort(np.append(own, own[-1])) for own in cells)
        bad = changed(certificate, rounding=Rounding(rounding.tolerance, tuple(visited)))
    else:
        bad = changed(certificate, rounding=Rounding(rounding.tolerance, rounding.visited[1:]))
    assert not cg.check(bad)


def test_frozen_policies_keep_their_value_under_a_finer_rounding() -> None:
    problem = cyclic()
    joint = join(problem, abstract(problem, 48))
    start, policies = start_of(problem, joint), relaxed_policies(relax(problem, joint))
    coarse = sweep_trains(joint, policies, start, TrainLimits(0.05, share=0.0), improve=False)
    fine = sweep_trains(joint, policies, start, TrainLimits(1e-6, share=0.0), improve=False)
    assert abs(coarse.value - fine.value) <= coarse.terms.error + fine.terms.error
    assert coarse.rank <= fine.rank


def test_trees_too_large_for_memory_become_trains(monkeypatch: pytest.MonkeyPatch) -> None:
    problem = cg.make_problem("reach-avoid-v0", horizon=6)
    tree = cg.synthesize(problem, 60).certificate
    monkeypatch.setattr(policy_search, "TREE_BYTES", 8 * policy_search.FINAL_TERMS * 1000)
    train = cg.synthesize(problem, 60).certificate
    assert tree.proof.terms is not None and train.proof.terms is None and cg.check(train)
    assert tree.lower_bound * (1 - 1e-4) <= train.lower_bound <= tree.lower_bound * (1 + 1e-4)
