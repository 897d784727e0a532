"""A start box on cells that are turned against it, as by correlated noise: polygons, sections and rationals agree."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import certigym as cg
from balls import check_rigorous
from balls.ball_memory import Memory
from balls.turned_shares import turned
from certigym.synthesis.cells import RelationRefused, start_share
from certigym.synthesis.cells import turned_starts as search_side
from certigym.synthesis.certificates import OnGrid
from certigym.synthesis.step_checking import turned_boxes as check_side
from composing import PLANAR, matrices, problem_of, task

CORRELATED = [[0.05, 0.02], [0.02, 0.04]]


def planar(low: list[float], high: list[float]) -> cg.Problem:
    """A planar agent with correlated noise whose start is drawn from a box."""
    box = {"initial_state": None, "initial_low": low, "initial_high": high}
    return task(matrices(**{**PLANAR, "noise_covariance": CORRELATED, **box}))


def certificate_of(problem: cg.Problem) -> OnGrid:
    found: Any = cg.synthesize(problem, 14, relation="exact").certificate
    return found


@pytest.mark.parametrize(
    ("low", "high"),
    [([-1.0, 0.0], [-0.8, 0.2]), ([-2.0, -1.0], [1.0, 1.5]), ([-1.0, 0.1], [-0.2, 0.1]), ([-1.0, -0.4], [-1.0, 0.9])],
)
def test_shares_of_both_sides_are_those_of_rational_polygons(low: list[float], high: list[float]) -> None:
    certificate = certificate_of(planar(low, high))
    (part,) = certificate.proof.agents
    ends = np.array(low), np.array(high)
    found = start_share(part.grid, part.coordinates, *ends)
    again = check_side.turned_shares(part, *ends)
    np.testing.assert_allclose(found, again, atol=1e-12)
    assert found.sum() == pytest.approx(1.0, abs=1e-10)
    table = again.reshape(part.grid.shape)
    assert turned(Memory(), part, *ends, table)[1] == []
    assert turned(Memory(), part, *ends, table * (1.0 + 1e-9))[1] != []
    report = check_rigorous(certificate)
    assert report and cg.check(certificate)
    assert not cg.validate(certificate, 20_000, confidence=1.0 - 1e-6).refuted


def test_other_agents_keep_their_axes() -> None:
    """Three states, of which two are correlated, and axes in another order: shares multiply block by block."""
    rng = np.random.default_rng(3)
    coordinates = np.zeros((3, 3))
    coordinates[np.ix_([0, 2], [1, 2])], coordinates[1, 0] = [[0.9, -0.4], [0.3, 1.1]], 1.5
    edges = tuple(np.linspace(-9.0, 9.0, n) for n in (7, 9, 12))
    grid = search_side.Grid(edges)
    low, high = np.array([-0.5, -1.0, 0.2]), np.array([0.7, 0.5, 0.9])
    shares = start_share(grid, coordinates, low, high)
    points = low[:, None] + (high - low)[:, None] * rng.random((3, 200_000))
    counted = np.bincount(grid.cell_of(np.linalg.solve(coordinates, points)), minlength=grid.n_cells) / 200_000
    # Five deviations and more of a count: by chance less often than once in a million.
    assert np.all(np.abs(counted - shares) <= 6.0 * np.sqrt(0.25 / 200_000)) and shares.sum() == pytest.approx(1.0)


def test_three_states_that_are_mixed_are_refused_in_words() -> None:
    grid = search_side.Grid(tuple(np.linspace(-9.0, 9.0, 5) for _ in range(3)))
    with pytest.raises(RelationRefused, match="at most 2 states that are drawn"):
        start_share(grid, np.ones((3, 3)) + np.eye(3), np.zeros(3), np.ones(3))


@pytest.mark.parametrize("broken", ["the whole box in one cell", "another box"])
def test_the_check_refuses_shares_that_are_too_large(broken: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The best cell for all, and a smaller box that is nearer to the goal."""
    problem = planar([-2.0, -1.0], [1.0, 1.5])

    def share(grid: Any, coordinates: Any, low: Any, high: Any) -> Any:
        if broken == "another box":
            return true(grid, coordinates, 0.5 * (low + high), high)
        shares = true(grid, coordinates, low, high)
        return np.where(np.arange(len(shares)) == np.flatnonzero(shares)[-1], 1.0, 0.0)

    true = search_side.turned_share
    monkeypatch.setattr(search_side, "turned_share", share)
    certificate = certificate_of(problem)
    monkeypatch.undo()
    assert not cg.check(certificate)


def test_least_values_miss_no_cell_that_a_box_meets() -> None:
    claim = certificate_of(problem_of("exact correlated")).claim
    low, high = np.array([-1.3, -0.4]), np.array([-0.3, 0.8])
    points = low + (high - low) * np.random.default_rng(0).random((5_000, 2))
    assert claim.min(low, high) <= claim.at(points).min() + 1e-12
    assert claim.min(low, high) <= claim.mean(low, high)
