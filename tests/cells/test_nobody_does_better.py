"""Upper bounds for all continuous policies lie above certificates, rollouts, and the suprema they stand for."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import norm

import certigym as cg
from certigym.synthesis.abstraction.models.joint import join, start_of
from certigym.synthesis.policy_search.bounds import continuous as continuous_bound
from certigym.synthesis.policy_search.bounds.continuous import Optimist, continuous_upper_bound
from certigym.synthesis.verbs.abstract import abstract
from certigym.validation.statistical_tests.binomial import clopper_pearson
from kinds import mostly_thorough
from problems import scalar_agent, two_agents

FALSE_ALARM = 1e-6


def bound(problem: cg.Problem, cells: object) -> float:
    joint = join(problem, abstract(problem, cells))  # type: ignore[arg-type]
    most = continuous_upper_bound(problem, joint, start_of(problem, joint))
    assert most is not None
    return most


def expected_hats(means: NDArray, edges: NDArray, std: float) -> NDArray:
    """Expectations (Z, 2 S) of the falling and the rising hat of every cell around means."""
    t = (edges - means[:, None]) / std
    mass = np.diff(norm.cdf(t), axis=1)
    rising = (-np.diff(norm.pdf(t), axis=1) - t[:, :-1] * mass) * std / np.diff(edges)
    return np.stack([mass - rising, rising], axis=-1).reshape(len(means), -1)


@mostly_thorough("n_cells", [12, 40])
@mostly_thorough("dynamics", [([[0.9]], [[0.5]]), ([[1.3]], [[0.02]]), ([[-0.7]], [[1.0]])])
def test_one_step_lies_above_what_points_and_inputs_lead_to(n_cells: int, dynamics: tuple[object, object]) -> None:
    """Expectations by the normal distribution function, at many points of every cell and many inputs."""
    agent = scalar_agent("one", A=dynamics[0], B=dynamics[1], offset=[0.3], noise_covariance=[[0.16]])
    problem = cg.Problem(
        name="one",
        horizon=1,
        agents=[agent],
        propositions={"a": cg.Proposition("one", [1.0], [3.0])},
        specification=cg.Specification("F a", "co-safe"),
    )
    model = abstract(problem, n_cells, relation="auto").models[0]
    optimist = Optimist.of(agent, model)
    assert optimist is not None
    (edges,) = model.grid.edges
    rng = np.random.default_rng(n_cells)
    for sharp in range(6):
        # Numbers at both ends of every cell, linear in between; some of the values are plateaus.
        value = rng.random(2 * (len(edges) - 1)) ** (1 + 4 * sharp)
        value = np.repeat(value[::2], 2) if sharp % 2 else value
        most = optimist.back(value)
        for share, u in itertools.product(np.linspace(0.0, 1.0, 9), np.linspace(-2.0, 2.0, 41)):
            x = edges[:-1] + share * np.diff(edges)
            mean = agent.A[0, 0] * x + agent.B[0, 0] * u + 0.3
            between = (1.0 - share) * most[::2] + share * most[1::2]
            assert np.all(expected_hats(mean, edges, 0.4) @ value <= between + 1e-12)


def test_without_the_curvature_one_step_would_be_too_low(monkeypatch: pytest.MonkeyPatch) -> None:
    """Means between lattice points, and points between corners, can do better: the allowance for them is needed."""
    monkeypatch.setattr(
        continuous_bound.SecondDerivativeBounds,
        "add_to",
        lambda self, second_derivatives, values, factors: second_derivatives.fill(0.0),
    )
    with pytest.raises(AssertionError):
        test_one_step_lies_above_what_points_and_inputs_lead_to(12, ([[1.3]], [[0.02]]))


@mostly_thorough(
    ("problem_id", "horizon", "coarse", "fine"),
    [
        ("reach-avoid-v0", 3, (60, 250), 500),
        ("car-park-v0", 20, (60, 200), 600),
        ("invariance-4-v0", 7, (40, 100), 200),
        ("building-automation-v0", 3, ([40, 30],), [80, 60]),
    ],
)
def test_finer_certificates_stay_below(problem_id: str, horizon: int, coarse: tuple, fine: Any) -> None:
    """Abstract optima are exceeded by certificates on finer cells; this bound is not."""
    problem = cg.make_problem(problem_id).replace(horizon=horizon)
    certificate = cg.synthesize(problem, fine).certificate
    found = [bound(problem, cells) for cells in coarse]
    assert all(certificate.lower_bound <= most for most in found)
    runs = cg.rollout(problem, certificate.controller, 20_000, seed=0)
    assert clopper_pearson(runs.successes, runs.episodes, 1 - FALSE_ALARM)[0] <= min(found)


@mostly_thorough("seed", range(4))
def test_random_problems_stay_below(seed: int) -> None:
    rng = np.random.default_rng(seed)
    formula = ["(!b | !c) U a", "F (a & F c)", "!b U (a & d)", "G (!b | !c)"][seed % 4]
    semantics = "finite-trace" if formula.startswith("G") else "co-safe"
    problem = two_agents(
        formula,
        semantics,
        horizon=3,
        A=[[rng.uniform(0.5, 1.2)]],
        offset=[rng.uniform(-0.2, 0.2)],
        noise_covariance=[[rng.uniform(0.05, 0.5)]],
        initial_state=[rng.uniform(-1.5, 0.9)],
    )
    certificate = cg.synthesize(problem, 120).certificate
    for cells in (20, 40, 80):
        assert certificate.lower_bound <= bound(problem, cells)


@pytest.mark.thorough
def test_boxes_of_starts_are_averaged() -> None:
    problem = two_agents("(!b | !c) U a", horizon=2).replace(initial_low=[0.05, -0.4], initial_high=[0.77, 1.0])
    most = bound(problem, 60)
    assert cg.synthesize(problem, 120).certificate.lower_bound <= most < 1.0
    starts = np.random.default_rng(0).uniform([0.05, -0.4], [0.77, 1.0], size=(200, 2))
    at_points = [bound(problem.replace(initial_state=start), 60) for start in starts]
    assert most == pytest.approx(np.mean(at_points), abs=0.03)


def cut(formula: str, names: tuple[str, ...] = ("plane",), **start: object) -> cg.Problem:
    """Agents that start, by default, in boxes of which ``near`` cuts out ``NEAR``, aslant to all cells."""
    start = start or {"initial_low": [-0.2, -0.2], "initial_high": [0.2, 0.2]}
    agent = cg.LinearAgent(
        name=names[0],
        A=0.5 * np.eye(2),
        B=np.eye(2),
        noise_covariance=0.1 * np.eye(2),
        output_matrix=[[1.0, 1.0]],
        state_low=[-4.0, -4.0],
        state_high=[4.0, 4.0],
        input_low=[-0.01, -0.01],
        input_high=[0.01, 0.01],
        **start,
    )
    regions = {}
    for name in names:
        regions[f"near_{name}"] = cg.Proposition(name, [0.0], [0.05])
        regions[f"far_{name}"] = cg.Proposition(name, [1.5], [9.0])
    agents = [agent.replace(name=name) for name in names]
    return cg.Problem(
        name="cut",
        horizon=1,
        agents=agents,
        propositions=regions,
        specification=cg.Specification(formula, "co-safe"),
    )


NEAR = (0.4 * 0.05 - 0.5 * 0.05**2) / 0.4**2
"""Probability that two numbers that are uniform on [-.2, .2] have a sum in [0, .05]: their density is triangular."""


def far_from(total: np.ndarray) -> np.ndarray:
    """What the best inputs do for reaching ``far`` from states with this sum: the noise has variance .2."""
    return np.asarray(norm.sf((1.5 - 0.5 * total - 0.02) / np.sqrt(0.2)))


def test_starts_whose_letter_is_not_certain_count_in_full() -> None:
    """A ninth of the start box is in the region, which cuts through the cell that holds the box."""
    assert bound(cut("near_plane"), 5) > NEAR
    assert NEAR < bound(cut("near_plane"), 80) < 1.0


@pytest.mark.parametrize("cells", [5, 16, 40, 80])
def test_starts_that_may_have_succeeded_are_not_read_as_waiting(cells: int) -> None:
    """For a lower bound, a letter that may accept or not is read as one that does not; here it is the other way."""
    most = bound(cut("near_plane | X far_plane"), cells)
    total = np.linspace(-0.4, 0.4, 4001)
    density = (0.4 - np.abs(total)) / 0.4**2
    worth = np.where((total >= 0.0) & (total <= 0.05), 1.0, far_from(total))
    assert most >= np.sum(density * worth) / np.sum(density) - 1e-3 > NEAR - 1e-3
    assert cells < 80 or most < 0.7


@pytest.mark.parametrize("cells", [5, 60])
def test_some_letters_certain_and_others_not(cells: int) -> None:
    """One of two agents may have succeeded, or both; some cells are cut and some are not."""
    both = bound(cut("near_a & near_b | X (far_a & far_b)", ("a", "b")), cells)
    either = bound(cut("near_a | near_b | X (far_a & far_b)", ("a", "b")), cells)
    assert both >= NEAR**2 and either >= 1.0 - (1.0 - NEAR) ** 2
    assert cells < 60 or both < 0.6


@pytest.mark.thorough
def test_no_point_of_a_start_cell_is_worth_more_than_a_box_in_it() -> None:
    """Points on an edge of the region, next to it, and anywhere."""
    formula, rng = "near_plane | X far_plane", np.random.default_rng(0)
    edges = [[0.0, 0.0], [0.1, -0.1], [0.02, 0.03], [-1e-17, 0.0], [-1e-9, 0.0], [0.05, 1e-9]]
    in_box = bound(cut(formula), 5)
    for point in [*edges, *rng.uniform(-0.2, 0.2, size=(20, 2)).tolist()]:
        at_point = bound(cut(formula, initial_state=point), 5)
        truth = 1.0 if 0.0 <= point[0] + point[1] <= 0.05 else float(far_from(np.array(sum(point))))
        assert truth <= at_point <= in_box
