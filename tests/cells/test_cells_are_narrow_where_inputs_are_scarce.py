"""As many cells in all, narrower along axes where regions take most of the input to stay in."""

from __future__ import annotations

import math

import numpy as np
import pytest

import certigym as cg
from certigym.synthesis.policy_search.portfolio.weak_inputs import (
    LEAST_SHARE,
    MOST_UNEVEN,
    cells_where_scarce,
    left_of_inputs,
)


def problem(middle: list[float], A: float = 0.9) -> cg.Problem:
    """One robot of the plane that comes to a region around a point and stays there for a step."""
    robot = cg.LinearAgent(
        name="robot",
        A=A * np.eye(2),
        B=np.eye(2),
        noise_covariance=0.09 * np.eye(2),
        state_low=[-20, -20],
        state_high=[20, 20],
        input_low=[-2, -2],
        input_high=[2, 2],
        initial_state=[0, 0],
    )
    low, high = (np.array(middle) + side for side in (-2.0, 2.0))
    return cg.Problem(
        name="stay",
        horizon=25,
        agents=[robot],
        propositions={"goal": cg.Proposition("robot", low, high)},
        specification=cg.Specification("F (goal & X goal)", "co-safe"),
    )


def test_what_staying_leaves_of_the_inputs_is_exact() -> None:
    np.testing.assert_allclose(left_of_inputs(problem([-14.0, 5.0]), 0), [2.0 - 1.4, 2.0 - 0.5], rtol=1e-12)
    # Nothing is left where a region cannot be held: a share counts all the same.
    np.testing.assert_allclose(left_of_inputs(problem([-17.9, 0.0], A=0.8), 0), [LEAST_SHARE * 2.0, 2.0], rtol=1e-12)


def test_cells_are_as_many_in_all() -> None:
    (cells,) = cells_where_scarce(problem([-14.0, 5.0])).values()
    assert cells[0] > 64 > cells[1] and cells[0] <= 64 * MOST_UNEVEN
    assert 0.95 * 64**2 <= math.prod(cells) <= 64**2


@pytest.mark.parametrize("one", [problem([-14.0, -14.0]), problem([-14.0, 5.0], A=1.0)], ids=["alike", "at rest"])
def test_cells_are_even_where_axes_are_alike(one: cg.Problem) -> None:
    assert cells_where_scarce(one) == {}
