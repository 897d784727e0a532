"""Levels of finer cells begin with what coarser ones found, and what they certify is valid."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import certigym as cg
from certigym.synthesis import task_ways
from certigym.synthesis.cells import RelationRefused
from certigym.synthesis.choosing import Effort
from certigym.synthesis.choosing import levels as levels_of_cells
from certigym.synthesis.choosing.carrying import carried_over
from certigym.synthesis.choosing.cell_budget import axis_weights
from certigym.synthesis.models import BoxChoices, Settings, abstraction_of
from certigym.synthesis.on_cells import Plan
from certigym.synthesis.relations import BoxRelation, CoupledRelation
from certigym.synthesis.search import Search


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


@pytest.mark.parametrize("kind", ["tube", "boxes"])
def test_inputs_stay_the_same_on_finer_cells(kind: str) -> None:
    """The input of a fine cell is that of the coarse cell around it, or the nearest one of a smaller menu."""
    problem = crossing(1)
    coarse, fine = (abstraction_of(problem, cells, [kind], Settings()) for cells in ((40, 16), (80, 32)))
    before, after = coarse.models[0], fine.models[0]
    choices = np.random.default_rng(0).integers(0, 3, (2, 2, before.n_cells)).astype(np.int32)
    (carried,) = carried_over(coarse, fine, (choices,))
    cell = before.grid.cell_of(after.grid.centres.T)
    assert carried.shape == (2, 2, after.n_cells)
    if kind == "boxes":
        np.testing.assert_array_equal(carried, choices[..., cell])
    else:
        assert isinstance(before.relation, CoupledRelation) and isinstance(after.relation, CoupledRelation)
        old, new = before.relation.inputs, after.relation.inputs
        apart = np.abs(old[choices[..., cell]] - new[carried])
        nearest = np.abs(old[choices[..., cell]][..., None, :] - new).min(axis=-2)
        np.testing.assert_array_equal(apart, nearest)


def test_a_menu_that_finer_cells_shorten_or_lengthen_carries_over() -> None:
    """Feedback inside cells is offered where they leave enough of the inputs for it: menus differ from grid to grid."""
    problem = crossing(1)
    plain, fed = (abstraction_of(problem, cells, ["boxes"], Settings()) for cells in ((40, 2), (80, 32)))
    for coarse, fine in ((plain, fed), (fed, plain)):
        before, after = coarse.models[0], fine.models[0]
        assert isinstance(before.relation, BoxRelation) and isinstance(after.relation, BoxRelation)
        assert isinstance(after.choices, BoxChoices)
        assert len(before.relation.menu) != len(after.relation.menu)
        choices = np.full((1, 2, before.n_cells), before.relation.n_choices - 1, dtype=np.int32)
        (carried,) = carried_over(coarse, fine, (choices,))
        wanted, got = before.relation.menu[-1], after.relation.menu[carried[0, 0]]
        np.testing.assert_allclose(got, np.full_like(got, wanted[0]), atol=0.2)
        read = after.choices.read(np.ones((1, math.prod(after.choices.shape))), carried[0, 0])
        assert read.shape == (1, after.n_cells)


def test_policies_without_a_choice_rest_on_finer_cells() -> None:
    """Where coarse cells had no choice, fine ones take that which stays nearest to them."""
    problem = crossing(1)
    coarse, fine = (abstraction_of(problem, cells, ["tube"], Settings()) for cells in ((40, 16), (80, 32)))
    nothing = np.full((1, 2, coarse.models[0].n_cells), -1, dtype=np.int32)
    (carried,) = carried_over(coarse, fine, (nothing,))
    np.testing.assert_array_equal(carried[0, 0], fine.models[0].choices.resting_choice)


@pytest.mark.thorough
def test_defaults_of_agents_with_velocities_are_refined(monkeypatch: pytest.MonkeyPatch) -> None:
    """Default cells become finer where the first ones certify little; the bound rises and the certificate is valid."""

    def refused(problem: cg.Problem, *others: object) -> cg.Synthesis:
        raise RelationRefused("no path for this test")

    monkeypatch.setattr(task_ways, "along_path", refused)
    monkeypatch.setattr(task_ways, "may_be_linear", lambda problem, plan: False)
    problem = crossing(2, horizon=4)
    synthesis = cg.synthesize(problem, effort=task_ways.COMPARED + 0.5)
    levels = synthesis.certificate.settings["levels"]
    bounds = [level["lower_bound"] for level in levels]
    assert len(levels) > 1 and max(bounds) == synthesis.certificate.lower_bound > bounds[0] + 0.01
    assert cg.check(synthesis.certificate, problem).valid


def test_axes_that_matter_little_get_wide_cells() -> None:
    """Along an axis with targets only what it moves elsewhere counts; first cells and levels keep to that."""
    drift = cg.Agent(
        name="drift",
        states=["x", "v"],
        inputs=["u"],
        dynamics=["x + 0.5*v", "v - 0.1*x**2 + u"],
        noise_covariance=[[0.04, 0.0], [0.0, 0.01]],
        state_low=[-4.0, -2.0],
        state_high=[4.0, 2.0],
        input_low=[-1.0],
        input_high=[1.0],
        initial_state=[0.0, 0.0],
    )
    # A deviation of x moves the mean of x by one deviation, one of v by 0.5 * 0.1 / 0.2 deviations.
    np.testing.assert_allclose(axis_weights(drift), [1.0, 0.25], rtol=1e-6)
    # An input that is not seen to command v leaves both axes as they are: v then widens its own boxes, too.
    np.testing.assert_allclose(
        axis_weights(drift.replace(dynamics=["x + 0.5*v", "v + tanh(u)"])), [0.8, 1.0], rtol=1e-6
    )
    np.testing.assert_array_equal(axis_weights(coordinate("robot")), [1.0, 1.0])
    goal = {"goal": cg.Proposition("drift", [1.0, -2.0], [2.0, 2.0])}
    problem = cg.Problem(
        name="drift", agents=[drift], propositions=goal, specification=cg.Specification("F goal", "co-safe"), horizon=5
    )
    assert levels_of_cells.first_cells(problem) == {"drift": (24, 5)}


def test_a_path_that_is_better_than_coarse_cells_leaves_finer_ones_to_try() -> None:
    """Unless it is better by far; and the best of other relations is still the one that is made finer."""

    def result(bound: float) -> Any:
        return SimpleNamespace(
            certificate=SimpleNamespace(lower_bound=bound, proof=SimpleNamespace(rounding=None, has_cells=True))
        )

    plan = Plan(Settings(), Search(), None, Effort())
    finer = task_ways._finer(cg.make_problem("reach-avoid-v0", horizon=3), plan)

    def reason(**bounds: float) -> str | None:
        return finer.why_not({name: result(bound) for name, bound in bounds.items()})

    assert reason(others=0.66, path=0.88) is None
    assert reason(others=0.01, path=0.88) == ""
    assert reason(others=0.66, linear=0.9) == ""


def test_what_a_level_gains_is_foreseen() -> None:
    """Losses go with the square of the width: after half of it three quarters of the last gain are left, by a third."""
    lost = {width: 0.08 * width**2 for width in (1.0, 0.5, 0.2, 0.16)}
    for first, second, third in ((1.0, 0.5, 0.2), (0.5, 0.2, 0.16)):
        gain = levels_of_cells.expected_gain(lost[first] - lost[second], first / second, second / third)
        assert gain == pytest.approx(lost[second] - lost[third])
