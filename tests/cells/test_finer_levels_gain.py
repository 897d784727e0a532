"""Levels of finer cells begin with what coarser ones found, and what they certify is valid."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np

import certigym as cg
from certigym.synthesis.abstraction.models import BoxChoices, Settings, abstraction_of
from certigym.synthesis.policy_search.ascent import Search
from certigym.synthesis.policy_search.cell_certificates.on_cells import Plan
from certigym.synthesis.policy_search.portfolio import Effort
from certigym.synthesis.policy_search.portfolio.carrying import carried_over
from certigym.synthesis.relations.kinds import BoxRelation, CoupledRelation
from certigym.synthesis.verbs import task_strategies
from problems import two_agents


def coordinate(name: str) -> cg.LinearAgent:
    """Return an agent with position and velocity that starts two units from the goal."""
    return cg.LinearAgent(
        name=name,
        A=[[1.0, 0.5], [0.0, 1.0]],
        B=[[0.0], [0.5]],
        noise_covariance=[[0.01, 0.0], [0.0, 0.01]],
        state_low=[-3.0, -2.0],
        state_high=[2.0, 2.0],
        input_low=[-2.0],
        input_high=[2.0],
        initial_state=[-2.0, 0.0],
    )


def crossing(n_agents: int, horizon: int = 6) -> cg.Problem:
    """Return the task that all agents are at the goal at once."""
    agents = [coordinate(f"robot_{i}") for i in range(n_agents)]
    goals = {f"goal_{i}": cg.Proposition(agents[i].name, low=[-0.5, -2.0], high=[1.0, 2.0]) for i in range(n_agents)}
    task = cg.Specification("F (" + " & ".join(goals) + ")", "co-safe")
    return cg.Problem(name="crossing", agents=agents, propositions=goals, specification=task, horizon=horizon)


def test_inputs_stay_the_same_on_finer_cells() -> None:
    """The input of a fine cell is that of the coarse cell around it."""
    problem = crossing(1)
    coarse, fine = (abstraction_of(problem, cells, ["boxes"], Settings()) for cells in ((40, 16), (80, 32)))
    before, after = coarse.models[0], fine.models[0]
    choices = np.random.default_rng(0).integers(0, 3, (2, 2, before.n_cells)).astype(np.int32)
    (carried,) = carried_over(coarse, fine, (choices,))
    cell = before.grid.cell_of(after.grid.centres.T)
    assert carried.shape == (2, 2, after.n_cells)
    np.testing.assert_array_equal(carried, choices[..., cell])


def test_inputs_are_the_nearest_ones_of_a_smaller_menu() -> None:
    """Finer cells leave the feedback of the paper's relation more of the inputs, which are other ones then."""
    problem = two_agents(horizon=2)
    coarse, fine = (
        abstraction_of(problem, 40, ["paper"] * 2, Settings(epsilon=epsilon, feedback=-0.5)) for epsilon in (0.4, 0.2)
    )
    before, after = coarse.models[0].relation, fine.models[0].relation
    assert isinstance(before, CoupledRelation) and isinstance(after, CoupledRelation)
    choices = np.random.default_rng(0).integers(0, 10, (2, 2, 40)).astype(np.int32)
    carried, _ = carried_over(coarse, fine, (choices, choices))
    apart = np.abs(before.inputs[choices] - after.inputs[carried])
    nearest = np.abs(before.inputs[choices][..., None, :] - after.inputs).min(axis=-2)
    np.testing.assert_array_equal(apart, nearest)


def test_a_menu_that_finer_cells_shorten_or_lengthen_carries_over() -> None:
    """Feedback inside cells is offered where they leave enough of the inputs for it: menus differ from grid to grid."""
    problem = crossing(1)
    plain, fed = (abstraction_of(problem, cells, ["boxes"], Settings()) for cells in ((40, 2), (80, 32)))
    for coarse, fine in ((plain, fed), (fed, plain)):
        before, after = coarse.models[0], fine.models[0]
        assert isinstance(before.relation, BoxRelation) and isinstance(after.relation, BoxRelation)
        assert isinstance(after.choices, BoxChoices)
        assert len(before.relation.input_set) != len(after.relation.input_set)
        choices = np.full((1, 2, before.n_cells), before.relation.n_choices - 1, dtype=np.int32)
        (carried,) = carried_over(coarse, fine, (choices,))
        wanted, got = before.relation.input_set[-1], after.relation.input_set[carried[0, 0]]
        np.testing.assert_allclose(got, np.full_like(got, wanted[0]), atol=0.2)
        read = after.choices.read(np.ones((1, math.prod(after.choices.shape))), carried[0, 0])
        assert read.shape == (1, after.n_cells)


def test_policies_without_a_choice_rest_on_finer_cells() -> None:
    """Where coarse cells had no choice, fine ones take that which stays nearest to them."""
    problem = crossing(1)
    coarse, fine = (abstraction_of(problem, cells, ["boxes"], Settings()) for cells in ((40, 16), (80, 32)))
    nothing = np.full((1, 2, coarse.models[0].n_cells), -1, dtype=np.int32)
    (carried,) = carried_over(coarse, fine, (nothing,))
    np.testing.assert_array_equal(carried[0, 0], fine.models[0].choices.resting_choice)


def test_a_path_that_is_better_than_coarse_cells_leaves_finer_ones_to_try() -> None:
    """Unless it is better by far; and the best of other relations is still the one that is made finer."""

    def result(bound: float) -> Any:
        return SimpleNamespace(
            certificate=SimpleNamespace(lower_bound=bound, proof=SimpleNamespace(rounding=None, has_cells=True))
        )

    plan = Plan(Settings(), Search(), Effort())
    finer = task_strategies._finer(cg.make_problem("reach-avoid-v0", horizon=3), plan)

    def reason(**bounds: float) -> str | None:
        return finer.why_not({name: result(bound) for name, bound in bounds.items()})

    assert reason(others=0.66, path=0.88) is None
    assert reason(others=0.01, path=0.88) == ""
    assert reason(others=0.66, linear=0.9) == ""
