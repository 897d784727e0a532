"""Finding cells by buckets gives the very cells that bisection gives, on and beside every edge."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from certigym.synthesis.relations.grids.grid import Grid, aligned_edges
from certigym.synthesis.relations.grids.lookup import MOST_BUCKETS_PER_CELL, buckets, cell_finder

AXES = {
    "uniform": np.linspace(-20.0, 5.0, 1001),
    "aligned": aligned_edges(-20.0, 5.0, 1200, [-14.0, -8.0, 1 / 3, 0.1]),
    "one cell": np.array([-1.0, 1.0]),
    "uneven": np.array([-2.0, -1.9, 0.0, 5.0]),
    "far from 0": 1e6 + np.linspace(0.0, 1.0, 700),
}


def beside(edges: np.ndarray) -> np.ndarray:
    points = [edges, np.nextafter(edges, -np.inf), np.nextafter(edges, np.inf), 0.5 * (edges[1:] + edges[:-1])]
    return np.clip(np.concatenate(points), edges[0], edges[-1])


@pytest.mark.parametrize("edges", AXES.values(), ids=AXES.keys())
def test_cells_are_those_of_bisection(edges: np.ndarray) -> None:
    grid = Grid((edges,))
    random = np.random.default_rng(0).uniform(edges[0], edges[-1], 20_000)
    points = np.concatenate([beside(edges), random])[None]
    found = cell_finder(grid)(points)
    assert found.dtype == np.int64
    np.testing.assert_array_equal(found, grid.cell_of(points))


def test_axes_with_very_unequal_cells_are_bisected() -> None:
    edges = np.array([0.0, 1e-9, 2e-9, 1.0])
    assert buckets(edges) is None and MOST_BUCKETS_PER_CELL * 3 < 1e9
    grid = Grid((edges,))
    np.testing.assert_array_equal(cell_finder(grid)(beside(edges)[None]), grid.cell_of(beside(edges)[None]))


BEYOND = [np.array([0.0, 5e-324]), np.array([0.0, 1e-310, 3e-310]), np.array([-1e308, 0.0, 1e308])]


@pytest.mark.parametrize("edges", BEYOND)
def test_axes_beyond_numbers_are_bisected(edges: np.ndarray) -> None:
    grid = Grid((edges,))
    assert buckets(edges) is None
    np.testing.assert_array_equal(cell_finder(grid)(edges[None]), grid.cell_of(edges[None]))


def test_two_axes_are_numbered_in_c_order() -> None:
    grid = Grid((AXES["uneven"], AXES["aligned"]))
    rng = np.random.default_rng(1)
    points = np.stack([rng.uniform(axis[0], axis[-1], (3, 500)) for axis in grid.edges])
    np.testing.assert_array_equal(cell_finder(grid)(points), grid.cell_of(points))


@given(st.lists(st.floats(-1e3, 1e3), min_size=2, max_size=12, unique=True))
def test_any_axis_is_searched_exactly(corners: list[float]) -> None:
    edges = np.sort(np.array(corners)) + 0.0
    if not np.all(np.diff(edges) > 0):
        return
    grid = Grid((edges,))
    np.testing.assert_array_equal(cell_finder(grid)(beside(edges)[None]), grid.cell_of(beside(edges)[None]))
