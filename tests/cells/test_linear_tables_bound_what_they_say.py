"""Masses of hats are below the true ones, and bends are at least what values lack between lattice points."""

from __future__ import annotations

import math
import tracemalloc
from itertools import product

import mpmath
import numpy as np
import pytest
from numpy.typing import NDArray

import certigym as cg
from certigym.synthesis.abstraction.kernels import second_derivative_bounds
from certigym.synthesis.abstraction.kernels.kernel import Kernel
from certigym.synthesis.abstraction.kernels.linear_kernel import hat_masses, hat_table
from certigym.synthesis.abstraction.models.corner_model import MOST_MASSES
from certigym.synthesis.certificates.cell_probabilities import normal_hats
from certigym.synthesis.relations.grids import Grid
from kinds import mostly_thorough
from problems import linear

mpmath.mp.dps = 50


def true_hats(mean: float, low: float, high: float, std: float) -> tuple[mpmath.mpf, mpmath.mpf]:
    """Exact masses of the falling and of the rising hat of one cell, to 50 digits."""
    m, a, b, s = (mpmath.mpf(float(number)) for number in (mean, low, high, std))
    x, y = (a - m) / s, (b - m) / s
    mass = mpmath.ncdf(y) - mpmath.ncdf(x) if y < 0 else mpmath.ncdf(-x) - mpmath.ncdf(-y)
    rising = (mpmath.npdf(x) - mpmath.npdf(y) - x * mass) * s / (b - a)
    return mass - rising, rising


def uniform_axis(low: float, high: float, cells: int, per_cell: int, first: float, last: float) -> NDArray:
    """Middles of intervals of equal size from about ``first`` to ``last``, ``per_cell`` to a mean cell."""
    lattice_spacing = (high - low) / (cells * per_cell)
    return np.asarray(
        low
        + (np.arange(np.floor((first - low) / lattice_spacing), np.ceil((last - low) / lattice_spacing)) + 0.5)
        * lattice_spacing
    )


def backed_up(
    kernel: Kernel, bends_of: second_derivative_bounds.SecondDerivativeBounds, factors: NDArray
) -> tuple[NDArray, NDArray]:
    """Values of factors on the lattice, and their bends."""
    values = kernel.backup(factors)
    bent = np.empty_like(values)
    bends_of.add_to(bent, values, factors)
    return values, bent


def hats_of(code: str, means: NDArray, edges: NDArray, std: float) -> NDArray:
    """Masses by the code of the search, or by that of the check."""
    return hat_masses(means, edges, std)[0] if code == "search" else normal_hats(means, edges, std)[0]


@pytest.mark.parametrize("code", ["search", "check"])
@pytest.mark.parametrize("width", [1e-5, 0.01, 0.3, 2.0, 40.0])
@pytest.mark.parametrize("offset", [0.0, 1e4])
def test_hats_are_below_50_digits(code: str, width: float, offset: float) -> None:
    std = 0.7
    edges = offset + width * std * np.arange(-3, 4)
    means = offset + std * np.array([-35.0, -8.5, -2.2, -0.3, 0.0, 1e-3, 0.9, 4.1, 9.0, 26.0])
    masses = hats_of(code, means, edges, std)
    for z, row in zip(means, masses, strict=True):
        for s in range(len(edges) - 1):
            for entry, truth in zip(row[2 * s : 2 * s + 2], true_hats(z, edges[s], edges[s + 1], std), strict=True):
                assert 0.0 <= entry
                assert mpmath.mpf(float(entry)) <= truth or entry == 0.0
                # Narrow cells lose digits to cancellation: that is what is taken off.
                assert truth - mpmath.mpf(float(entry)) <= 1e-12 + 1e-12 / width


def test_what_rows_miss_is_bounded() -> None:
    edges, means = np.linspace(-4.0, 4.0, 33), np.linspace(-5.0, 5.0, 9)
    masses, loss = hat_masses(means, edges, 0.4)
    for z, row in zip(means, masses, strict=True):
        truth = sum(sum(true_hats(z, a, b, 0.4)) for a, b in zip(edges[:-1], edges[1:], strict=True))
        assert truth - mpmath.fsum(map(float, row)) <= loss < 1e-10


def test_the_norms_are_those_of_the_normal_density() -> None:
    """Half the L1 norms of derivatives of the density in up to three dimensions, by quadrature on [-12, 12]."""
    x = np.linspace(-12.0, 12.0, 2_400_001)
    phi, step = np.exp(-0.5 * x * x) / np.sqrt(2 * np.pi), x[1] - x[0]
    hermite = {n: np.polynomial.hermite_e.hermeval(x, [0] * n + [1]) for n in range(1, 7)}
    norm = {n: float(np.abs(values * phi).sum()) * step for n, values in hermite.items()}
    beyond = {
        n: float(np.abs(values * phi)[np.abs(x) > second_derivative_bounds.WINDOW].sum()) * step
        for n, values in hermite.items()
    }
    largest = (0.5 * norm[4], 0.5 * norm[3] * norm[1], 0.5 * norm[2] ** 2)
    sixth = (0.5 * norm[6], 0.5 * norm[4] * norm[2], 0.5 * norm[2] ** 3)
    for given, true in zip(
        (second_derivative_bounds.FOURTH, second_derivative_bounds.MIXED, second_derivative_bounds.SQUARED),
        largest,
        strict=True,
    ):
        assert true <= given <= true * (1 + 5e-5)
    for given, true in zip(second_derivative_bounds.SIXTH.values(), sixth, strict=True):
        assert true <= given <= true * (1 + 5e-5)
    assert 0.5 * norm[2] <= second_derivative_bounds.SECOND <= 0.5 * norm[2] * (1 + 5e-5)
    # Beyond the window the straight derivatives have the largest norms of all that sum to the order.
    assert beyond[4] <= second_derivative_bounds.FOURTH_BEYOND <= 1.01 * beyond[4]
    assert beyond[6] <= second_derivative_bounds.SIXTH_BEYOND <= 1.01 * beyond[6]
    for order in (4, 6):
        assert all(norm.get(order - n, 1.0) * beyond[n] <= beyond[order] for n in range(1, order))


@mostly_thorough("d", [1, 2])
@mostly_thorough("width", [0.2, 0.7, 2.0])
@mostly_thorough("skew", [False, True])
def test_bends_are_at_least_the_gaps_of_random_factors(d: int, width: float, skew: bool) -> None:
    """Steps of two lattice points along the first axis and, in two dimensions, a straight or a skew one."""
    rng, deviations, n, per_cell = np.random.default_rng(int(10 * width) + d), np.array([1.0, 0.5])[:d], 7, 4
    edges = tuple(np.linspace(0.0, n * width * s, n + 1) for s in deviations)
    lattice = tuple(uniform_axis(0.0, e[-1], n, per_cell, -2.0 * s, e[-1] + 2.0 * s) for e, s in zip(edges, deviations))
    lattice_spacing = np.array([axis[1] - axis[0] for axis in lattice])
    moves = np.array([[2, 0], [int(skew), 2]])[:, :d] if d == 2 else np.array([[2]])
    tables, losses = zip(*(hat_table(a, e, float(s)) for a, e, s in zip(lattice, edges, deviations)), strict=True)
    bends_of = second_derivative_bounds.SecondDerivativeBounds(
        moves * lattice_spacing, lattice, edges, deviations, sum(losses)
    )
    assert bends_of.is_aligned == (d == 1 or not skew)
    kernel = Kernel(tables, sum(losses))
    # Some factors are 0 in most places: these bend most.
    factors = rng.random((6, (2 * n) ** d)) * (rng.random((6, (2 * n) ** d)) < [[0.1], [0.2], [0.5], [1], [1], [0.05]])
    values, bent = backed_up(kernel, bends_of, factors)
    shape, worst = np.array(kernel.lattice_shape), 0.0
    for _ in range(300):
        base = rng.integers(0, shape - moves.sum(axis=0), size=d)
        share = rng.random(len(moves))
        point = np.array([axis[k] for axis, k in zip(lattice, base)]) + share @ (moves * lattice_spacing)
        corners = list(product((0, 1), repeat=len(moves)))
        flat = [int(np.ravel_multi_index(tuple(base + np.array(c) @ moves), tuple(shape))) for c in corners]
        weights = [np.prod(np.where(c, share, 1 - share)) for c in corners]
        truth = factors.reshape(6, *(2 * n,) * d)
        for axis in reversed(range(d)):
            row = hat_masses(point[axis : axis + 1], edges[axis], float(deviations[axis]))[0][0]
            truth = truth @ row
        gap = np.asarray(weights) @ values[:, flat].T - truth
        allowed = bent[:, flat].max(axis=1)
        assert np.all(gap <= allowed + 1e-12)
        worst = max(worst, float(np.max(gap[1:5] / allowed[1:5])))
    # The bound is not idle.
    assert worst > 0.1


def true_second_derivatives(axis: NDArray, edges: NDArray, std: float) -> NDArray:
    """Second derivatives (Z, 2 S) of hat masses by the mean."""
    t = (edges - axis[:, None]) / std
    phi, width = np.exp(-0.5 * t**2) / np.sqrt(2 * np.pi), np.diff(edges) / std
    a, b, rise = t[:, :-1] * phi[:, :-1], t[:, 1:] * phi[:, 1:], np.diff(phi, axis=1) / width
    return np.stack([a + rise, -b - rise], axis=-1).reshape(len(axis), -1) / std**2


@pytest.mark.parametrize("seed", range(6))
def test_bends_cover_directions_that_bend_most_at_different_points(seed: int) -> None:
    """The loss is a sum of suprema; the largest sum at a single point, as it was once, is less."""
    rng = np.random.default_rng(seed)
    problem = cg.make_problem("car-park-planar-v0")
    agent = problem.agents[0]
    grid = Grid(tuple(np.linspace(a, b, 13) for a, b in zip(agent.state_low, agent.state_high, strict=True)))
    deviations = np.sqrt(np.diag(agent.noise_covariance))
    lattice = tuple(uniform_axis(e[0], e[-1], 12, 4, e[0] - s, e[-1] + s) for e, s in zip(grid.edges, deviations))
    axes = zip(lattice, grid.edges, deviations.tolist(), strict=True)
    tables, losses = zip(*(hat_table(*axis) for axis in axes), strict=True)
    widths = np.array([edges[1] - edges[0] for edges in grid.edges])
    steps = np.concatenate([(linear(agent).A * widths).T / 4, np.diag([axis[1] - axis[0] for axis in lattice])])
    bends_of, kernel = (
        second_derivative_bounds.SecondDerivativeBounds(steps, lattice, grid.edges, deviations, sum(losses)),
        Kernel(tables, sum(losses)),
    )
    factors = rng.random((4, grid.n_cells * 4)) * (rng.random((4, grid.n_cells * 4)) < 0.3)
    _, bent = backed_up(kernel, bends_of, factors)
    # The second derivatives themselves, in closed form.
    masses = [table.toarray() for table in kernel.tables]
    each = []
    for axis in range(2):
        deviation = float(deviations[axis])
        hats = true_second_derivatives(lattice[axis], grid.edges[axis], deviation)
        chosen = [hats if k == axis else masses[k] for k in range(2)]
        square = float(np.sum(steps[:, axis] ** 2))
        second = np.einsum("nab,ya,zb->nyz", factors.reshape(4, *(len(e) * 2 - 2 for e in grid.edges)), *chosen)
        each.append(0.125 * square * np.maximum(second, 0.0).reshape(4, -1))
    for factor in range(4):
        # Any window of lattice points may be the image of a cell.
        for _ in range(200):
            window = tuple(slice(k, k + 5) for k in rng.integers(0, np.array(kernel.lattice_shape) - 5))
            seen = bent[factor].reshape(kernel.lattice_shape)[window].max()
            suprema = sum(s[factor].reshape(kernel.lattice_shape)[window].max() for s in each)
            assert seen >= suprema


@mostly_thorough("lattice_spacing", [0.4, 0.7, 1.1])
@mostly_thorough("step", [1, 2])
def test_bends_hold_for_factors_that_bend_most_between_lattice_points(lattice_spacing: float, step: int) -> None:
    """Factors of 0 and 1 by the sign of a derivative of the density are the worst ones for that derivative."""
    edges = np.linspace(-16.0, 16.0, 641)
    centres = np.repeat(0.5 * (edges[1:] + edges[:-1]), 2)
    shares, ratios = np.linspace(0.0, 1.0, 21)[1:-1], []
    for offset in np.linspace(0.0, 1.0, 9) * lattice_spacing:
        lattice = offset + lattice_spacing * np.arange(-24, 25)
        lattice = lattice[np.abs(lattice) <= 12.0]
        table, loss = hat_table(lattice, edges, 1.0)
        bends_of = second_derivative_bounds.SecondDerivativeBounds(
            np.array([[step * lattice_spacing]]), (lattice,), (edges,), np.ones(1), loss
        )
        kernel = Kernel((table,), loss)
        signs = [np.polynomial.hermite_e.hermeval(centres, [0] * n + [1]) > 0 for n in (2, 4, 6)]
        factors = np.array([*signs, *(~sign for sign in signs)], dtype=float)
        values, bent = backed_up(kernel, bends_of, factors)
        for first in range(3, len(lattice) - step - 3):
            last = first + step
            points = lattice[first] + shares * step * lattice_spacing
            truth = factors @ hat_masses(points, edges, 1.0)[0].T
            between = values[:, first, None] * (1.0 - shares) + values[:, last, None] * shares
            allowed = np.maximum(bent[:, first], bent[:, last])
            gap = (between - truth).max(axis=1)
            assert np.all(gap <= allowed + 1e-12)
            ratios.append(gap / allowed)
    # The bound is not idle, also where second differences alone would say too little.
    assert np.max(ratios) > 0.15


def test_what_a_check_holds_at_once_does_not_grow_with_the_square_of_the_cells() -> None:
    """A line of 2,000 cells had 16 lattice points to a cell, and its check took 18 GB."""
    agent = cg.LinearAgent(
        name="a", A=[[1.0]], B=[[1.0]], noise_std=[0.1], state_low=[-10.0], state_high=[10.0], input_low=[-1.0],
        input_high=[1.0], initial_state=[0.0],
    )  # fmt: skip
    problem = cg.Problem(
        name="line", horizon=1, agents=[agent], propositions={"p": cg.Proposition("a", [1.0], [2.0])},
        specification=cg.Specification("F p", "finite-trace"),
    )  # fmt: skip
    points = math.prod(cg.abstract(problem, 2000, relation="linear").models[0].kernel.lattice_shape)
    assert points > 2 * 2000  # there is something to interpolate
    assert points * 2 * 2000 <= 1.05 * MOST_MASSES
    axis, edges = np.linspace(-1.0, 1.0, 3000), np.linspace(-1.0, 1.0, 2001)
    tracemalloc.start()
    normal_hats(axis, edges, 0.1)
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert most < 3.0 * 8 * 3000 * 4000
