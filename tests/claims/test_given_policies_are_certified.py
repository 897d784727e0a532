"""A policy from anywhere gets a certificate that belongs to it as wrapped on the cells; improving never lowers it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import certigym as cg
from certigym.synthesis.abstraction.models.target_windows import TargetWindows
from certigym.synthesis.certificates.controllers import InputTable, vectorized
from certigym.synthesis.certificates.controllers.given_policies import decentralised
from certigym.synthesis.certificates.proofs import is_exact
from certigym.synthesis.relations.grids import Grid
from certigym.synthesis.relations.grids.grid import aligned_edges
from certigym.synthesis.verbs.abstract import abstract
from certigym.synthesis.verbs.certify import wrap
from problems import scalar_agent, two_agents

LOUD: dict[str, Any] = {"noise_covariance": [[0.8]]}
PROBLEM = two_agents(horizon=4, **LOUD)


def towards_goal(x: Any, q: int, time: int) -> Any:
    """Head for the middle of region a, a little harder at the end."""
    return np.clip((2.0 - 0.9 * x) / 0.5, -1.5, 1.5 + 0.1 * time)


def stay(x: Any, q: int, time: int) -> Any:
    return 0.0 * x + 0.2 * q


POLICY = {"one": towards_goal, "two": stay}


def test_the_bound_is_that_of_the_wrapped_policy() -> None:
    """The certificate is exact: 200,000 episodes notice an error of about .006 at a false-alarm rate of 1e-6."""
    result = cg.certify(PROBLEM, POLICY, 80)
    assert is_exact(result.certificate)
    assert 0.05 < result.certificate.lower_bound < 0.95
    assert cg.check(result.certificate, PROBLEM)
    report = cg.validate(result, 200_000, seed=3, confidence=1 - 1e-6)
    assert report.verdict == "consistent", str(report)
    assert report.details["inadmissible"] == 0


def test_all_forms_of_one_policy_get_one_certificate() -> None:
    plain = cg.certify(PROBLEM, POLICY, 40).certificate
    edges = (aligned_edges(-4.0, 4.0, 40, [-3.0, -2.0, -1.0, 0.0, 1.0, 3.0]),)
    grid = Grid(edges)
    tables = {}
    for name, function in POLICY.items():
        values = [[[function(c, q, t) for c in grid.centres] for q in range(3)] for t in range(4)]
        tables[name] = InputTable(grid, np.array(values))
    forms: list[Any] = [{name: vectorized(f) for name, f in POLICY.items()}, tables]
    n_q = PROBLEM.automaton.n_states
    assert n_q == 3
    for form in forms:
        found = cg.certify(PROBLEM, form, 40).certificate
        assert found.lower_bound == plain.lower_bound
        for mine, theirs in zip(found.proof.agents, plain.proof.agents):
            assert np.array_equal(mine.policy, theirs.policy)


def test_certified_controllers_are_certified_again_to_the_last_bit() -> None:
    result = cg.synthesize(PROBLEM, 40, search=cg.SearchOptions(max_sweeps=1))
    again = cg.certify(PROBLEM, result.controller, 40)
    assert again.certificate.lower_bound == pytest.approx(result.certificate.lower_bound, rel=1e-12)
    finer = cg.certify(PROBLEM, result.controller, 80)
    assert 0.0 < finer.certificate.lower_bound < 1.0


def test_improving_never_lowers_the_bound() -> None:
    given = cg.certify(PROBLEM, POLICY, 40).certificate.lower_bound
    same = cg.improve(PROBLEM, POLICY, 40, search=cg.SearchOptions(max_sweeps=0)).certificate
    better = cg.improve(PROBLEM, POLICY, 40)
    assert same.lower_bound == given
    assert better.certificate.lower_bound > given + 0.01
    assert cg.check(better.certificate, PROBLEM)
    assert better.stats["sweeps"][0] == pytest.approx(given, rel=1e-9)  # type: ignore[index]


@pytest.mark.parametrize("form", ["diagonal", "oblique"])
def test_the_nearest_admissible_target_is_taken(form: str) -> None:
    """Against a comparison with every admissible target, for windows that are boxes and such that are not."""
    inputs = [[0.5, 0.0], [0.0, 0.6]] if form == "diagonal" else [[0.5, 0.3], [-0.2, 0.6]]
    agent = cg.LinearAgent(
        name="plane",
        A=[[0.9, 0.1], [0.0, 0.8]],
        B=inputs,
        noise_covariance=[[0.1, 0.0], [0.0, 0.1]],
        state_low=[-3, -3],
        state_high=[3, 3],
        input_low=[-2, -1],
        input_high=[2, 2],
        initial_state=[0, 0],
    )
    problem = cg.Problem(
        name="plane",
        horizon=2,
        agents=[agent],
        propositions={"goal": cg.Proposition("plane", [1, 1], [3, 3])},
        specification=cg.Specification("F goal", "co-safe"),
    )
    (model,) = abstract(problem, 9, relation="exact").models
    windows = model.choices
    assert isinstance(windows, TargetWindows)
    wanted = np.random.default_rng(0).uniform(-4.0, 4.0, (2, model.n_cells))
    policy = model.choices.nearest(lambda points: wanted)
    points = np.stack(np.meshgrid(*model.lattice, indexing="ij"), axis=-1).reshape(-1, 2)
    searched = 0
    for s in range(model.n_cells):
        allowed = windows.admissible(np.full(len(points), s), np.arange(len(points)))
        gaps = np.where(allowed, ((points - wanted[:, s]) ** 2).sum(axis=1), np.inf)
        assert allowed[policy[s]]
        assert gaps[policy[s]] == pytest.approx(gaps.min())
        searched += int(np.isfinite(gaps.min()))
    assert searched == model.n_cells


def test_a_cell_without_admissible_target_gets_none() -> None:
    weak: dict[str, Any] = {"A": [[2.0]], "input_low": [-0.1], "input_high": [0.1]}
    problem = two_agents(horizon=2, **weak)
    abstraction = abstract(problem, 8, relation="exact")
    for policy in wrap(problem, abstraction, decentralised(problem, stay)):
        assert np.all(policy == -1)
    assert cg.certify(problem, stay, 8, relation="exact").certificate.lower_bound == 0.0


@pytest.mark.thorough
def test_agents_with_fewer_inputs_than_states_are_wrapped_on_linear_cells() -> None:
    """A double integrator: the bound holds (1e-6)."""
    cart = cg.LinearAgent(
        name="cart",
        A=[[1.0, 0.5], [0.0, 1.0]],
        B=[[0.125], [0.5]],
        noise_covariance=[[0.1, 0.0], [0.0, 0.1]],
        state_low=[-6, -4],
        state_high=[6, 4],
        input_low=[-6],
        input_high=[6],
        initial_state=[-3.0, 0.0],
    )
    problem = cg.Problem(
        name="cart",
        horizon=8,
        agents=[cart],
        propositions={"goal": cg.Proposition("cart", [0.0, -4.0], [4.0, 4.0])},
        specification=cg.Specification("F goal", "co-safe"),
    )

    def pull(x: Any, q: int, time: int) -> Any:
        return [0.6 * (1.0 - x[0]) - x[1]]

    result = cg.certify(problem, pull, 40)
    assert result.certificate.settings["relation"] == "linear"
    assert 0.2 < result.certificate.lower_bound < 0.99
    assert cg.check(result.certificate, problem)
    assert cg.validate(result, 20_000, confidence=1 - 1e-6).verdict != "refuted"
    better = cg.improve(problem, pull, 40, search=cg.SearchOptions(max_sweeps=2)).certificate
    assert better.lower_bound >= result.certificate.lower_bound


def test_wrong_policies_are_refused() -> None:
    cases: list[tuple[Any, str]] = [
        ({"one": stay}, "one policy per agent"),
        (3.0, "function or a table"),
        ({"one": stay, "two": None}, "function or a table for agent `two`"),
        (lambda x, q, t: [1.0, 2.0], "1 finite inputs"),
        (lambda x, q, t: x * np.nan, "finite inputs"),
        (vectorized(lambda x, q, t: x[:, :1]), "finite inputs"),
        (InputTable(Grid((np.array([-4.0, 4.0]),)), np.zeros((1, 1, 1, 1))), "automaton states"),
        (
            cg.synthesize(PROBLEM, 80, relation="paper", search=cg.SearchOptions(epsilon=0.3, max_sweeps=0)).controller,
            "without memory",
        ),
        (cg.certify(_renamed(), stay, 10).controller, "of this problem's agents"),
    ]
    for policy, message in cases:
        with pytest.raises(ValueError, match=message):
            cg.certify(PROBLEM, policy, 40)
    with pytest.raises(ValueError, match="finite numbers of shape"):
        InputTable(Grid((np.array([-4.0, 4.0]),)), np.zeros((1, 1, 2, 1)))
    with pytest.raises(ValueError, match="`max_sweeps`"):
        cg.improve(PROBLEM, stay, 40, search=cg.SearchOptions(max_sweeps=-1))


def _renamed() -> cg.Problem:
    return cg.Problem(
        name="one",
        horizon=2,
        agents=[scalar_agent("other")],
        propositions={"a": cg.Proposition("other", [1.0], [3.0])},
        specification=cg.Specification("F a", "co-safe"),
    )
