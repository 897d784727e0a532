"""Masses of hats are below the true ones, and bends are at least what values lack between lattice points."""

from __future__ import annotations

from itertools import product

import mpmath
import numpy as np
import pytest
from numpy.typing import NDArray

import certigym as cg
from certigym.synthesis.cells import Grid
from certigym.synthesis.checking import linear_check
from certigym.synthesis.models.kernel import Kernel
from certigym.synthesis.models.linear_kernel import (
    LinearKernel,
    _fourth,
    hat_masses,
    hat_tables,
    rounding_of_bends,
    uniform_axis,
)
from certigym.synthesis.models.linear_model import linear_model

mpmath.mp.dps = 50


def true_hats(mean: float, low: float, high: float, std: float) -> tuple[mpmath.mpf, mpmath.mpf]:
    """Exact masses of the falling and of the rising hat of one cell, to 50 digits."""
    m, a, b, s = (mpmath.mpf(float(number)) for number in (mean, low, high, std))
    x, y = (a - m) / s, (b - m) / s
    mass = mpmath.ncdf(y) - mpmath.ncdf(x) if y < 0 else mpmath.ncdf(-x) - mpmath.ncdf(-y)
    rising = (mpmath.npdf(x) - mpmath.npdf(y) - x * mass) * s / (b - a)
    return mass - rising, rising


def hats_of(code: str, means: NDArray, edges: NDArray, std: float) -> tuple[NDArray, NDArray, NDArray]:
    """Masses and derivatives by the code of the search, or by that of the check."""
    return hat_masses(means, edges, std)[:3] if code == "search" else linear_check._hats(means, edges, std)


@pytest.mark.parametrize("code", ["search", "check"])
@pytest.mark.parametrize("width", [1e-5, 0.01, 0.3, 2.0, 40.0])
@pytest.mark.parametrize("offset", [0.0, 1e4])
def test_hats_are_below_50_digits(code: str, width: float, offset: float) -> None:
    std = 0.7
    edges = offset + width * std * np.arange(-3, 4)
    means = offset + std * np.array([-35.0, -8.5, -2.2, -0.3, 0.0, 1e-3, 0.9, 4.1, 9.0, 26.0])
    masses, _, _ = hats_of(code, means, edges, std)
    for z, row in zip(means, masses, strict=True):
        for s in range(len(edges) - 1):
            for entry, truth in zip(row[2 * s : 2 * s + 2], true_hats(z, edges[s], edges[s + 1], std), strict=True):
                assert 0.0 <= entry
                assert mpmath.mpf(float(entry)) <= truth or entry == 0.0
                # Narrow cells lose digits to cancellation: that is what is taken off.
                assert truth - mpmath.mpf(float(entry)) <= 1e-12 + 1e-12 / width


def test_what_rows_miss_is_bounded() -> None:
    edges, means = np.linspace(-4.0, 4.0, 33), np.linspace(-5.0, 5.0, 9)
    masses, _, _, loss = hat_masses(means, edges, 0.4)
    for z, row in zip(means, masses, strict=True):
        truth = sum(sum(true_hats(z, a, b, 0.4)) for a, b in zip(edges[:-1], edges[1:], strict=True))
        assert truth - mpmath.fsum(map(float, row)) <= loss < 1e-10


@pytest.mark.parametrize("code", ["search", "check"])
def test_derivatives_are_those_of_the_masses(code: str) -> None:
    edges, means, h = np.linspace(-1.0, 1.0, 6), np.linspace(-2.0, 2.0, 7), mpmath.mpf("1e-12")
    _, slopes, bends = hats_of(code, means, edges, 0.6)
    for k, z in enumerate(means):
        for s in range(5):
            with mpmath.workdps(60):
                at = [hats_exact(mpmath.mpf(float(z)) + d * h, edges[s], edges[s + 1], 0.6) for d in (-1, 0, 1)]
            for side in (0, 1):
                slope = (at[2][side] - at[0][side]) / (2 * h)
                bend = (at[2][side] - 2 * at[1][side] + at[0][side]) / h**2
                assert abs(float(slope) - slopes[k, 2 * s + side]) < 1e-12
                assert abs(float(bend) - bends[k, 2 * s + side]) < 1e-12


def hats_exact(m: mpmath.mpf, low: float, high: float, std: float) -> tuple[mpmath.mpf, mpmath.mpf]:
    """The same as ``true_hats`` at a mean that has more digits than a double."""
    a, b, s = (mpmath.mpf(float(number)) for number in (low, high, std))
    x, y = (a - m) / s, (b - m) / s
    mass = mpmath.ncdf(y) - mpmath.ncdf(x)
    rising = (mpmath.npdf(x) - mpmath.npdf(y) - x * mass) * s / (b - a)
    return mass - rising, rising


def test_the_norms_are_those_of_the_normal_density() -> None:
    """Half the L1 norms of derivatives of the density in one and two dimensions, by quadrature on [-12, 12]."""
    x = np.linspace(-12.0, 12.0, 2_400_001)
    phi, step = np.exp(-0.5 * x * x) / np.sqrt(2 * np.pi), x[1] - x[0]
    norms = [float(np.abs(p).sum()) * step for p in (-x * phi, (x * x - 1) * phi, (3 * x - x**3) * phi)]
    fourth = float(np.abs((x**4 - 6 * x * x + 3) * phi).sum()) * step
    first, second, third = norms
    largest = (0.5 * fourth, 0.5 * third * first, 0.5 * second * second)
    for given, true in zip(linear_check.HALF_NORMS, largest, strict=True):
        assert true <= given <= true * (1 + 5e-5)


def test_both_codes_bound_fourth_derivatives_alike() -> None:
    rng = np.random.default_rng(0)
    for _ in range(200):
        d = int(rng.integers(1, 4))
        u, e = rng.normal(size=d), rng.normal(size=d)
        e = 2.5 * u if rng.random() < 0.3 else e
        assert _fourth(u, e) == pytest.approx(linear_check._fourth(u, e), rel=1e-13)


@pytest.mark.parametrize("d", [1, 2])
@pytest.mark.parametrize("width", [0.2, 0.7, 2.0])
def test_bends_are_at_least_the_gaps_of_random_factors(d: int, width: float) -> None:
    """Steps of two lattice points along each axis and, in two dimensions, a skew one."""
    rng, deviations, n, per_cell = np.random.default_rng(int(10 * width) + d), np.array([1.0, 0.5])[:d], 7, 4
    edges = [np.linspace(0.0, n * width * s, n + 1) for s in deviations]
    lattice = [uniform_axis(0.0, e[-1], n, per_cell, -2.0 * s, e[-1] + 2.0 * s) for e, s in zip(edges, deviations)]
    pitch = np.array([axis[1] - axis[0] for axis in lattice])
    moves = np.array([[2, 0], [1, 2]])[:, :d] if d == 2 else np.array([[2]])
    tables, losses = zip(*(hat_tables(a, e, float(s)) for a, e, s in zip(lattice, edges, deviations)), strict=True)
    masses, slopes, curvatures = zip(*tables, strict=True)
    steps, rounding = moves * pitch, rounding_of_bends(pitch / deviations)
    kernel = LinearKernel(masses, sum(losses), slopes, curvatures, deviations, steps, np.zeros((0, d)), rounding)
    # Some factors are 0 in most places: these bend most.
    factors = rng.random((6, (2 * n) ** d)) * (rng.random((6, (2 * n) ** d)) < [[0.1], [0.2], [0.5], [1], [1], [0.05]])
    values, bends = np.split(kernel.smooth(factors), 2, axis=1)
    shape, worst = np.array(kernel.lattice_shape), 0.0
    for _ in range(300):
        base = rng.integers(0, shape - moves.sum(axis=0), size=d)
        share = rng.random(len(moves))
        point = np.array([axis[k] for axis, k in zip(lattice, base)]) + share @ (moves * pitch)
        corners = list(product((0, 1), repeat=len(moves)))
        flat = [int(np.ravel_multi_index(tuple(base + np.array(c) @ moves), tuple(shape))) for c in corners]
        weights = [np.prod(np.where(c, share, 1 - share)) for c in corners]
        truth = factors.reshape(6, *(2 * n,) * d)
        for axis in reversed(range(d)):
            row = hat_masses(point[axis : axis + 1], edges[axis], float(deviations[axis]))[0][0]
            truth = truth @ row
        gap = np.asarray(weights) @ values[:, flat].T - truth
        allowed = bends[:, flat].max(axis=1)
        assert np.all(gap <= allowed + 1e-12)
        worst = max(worst, float(np.max(gap[1:5] / allowed[1:5])))
    # The bound is not idle.
    assert worst > 0.1


@pytest.mark.parametrize("seed", range(6))
def test_bends_cover_directions_that_bend_most_at_different_points(seed: int) -> None:
    """The loss is a sum of suprema; the largest sum at a single point, as it was once, is less."""
    rng = np.random.default_rng(seed)
    problem = cg.make_problem("car-park-planar-v0")
    agent = problem.agents[0]
    grid = Grid(tuple(np.linspace(a, b, 13) for a, b in zip(agent.state_low, agent.state_high, strict=True)))
    relation, lattice, kernel, _ = linear_model(agent, grid, np.eye(2), 4)
    factors = rng.random((4, grid.n_cells * 4)) * (rng.random((4, grid.n_cells * 4)) < 0.3)
    bends = kernel.smooth(factors)[:, kernel.n_points :]
    each = []
    for axis in range(2):
        tables = [(kernel.tables, kernel.curvatures)[axis == k][k] for k in range(2)]
        square = float(np.sum(kernel.steps[:, axis] ** 2))
        each.append(0.125 * square * np.maximum(Kernel(tuple(tables)).smooth(factors), 0.0))
    for factor in range(4):
        # Any window of lattice points may be the image of a cell.
        for _ in range(200):
            window = tuple(slice(k, k + 5) for k in rng.integers(0, np.array(kernel.lattice_shape) - 5))
            seen = bends[factor].reshape(kernel.lattice_shape)[window].max()
            suprema = sum(s[factor].reshape(kernel.lattice_shape)[window].max() for s in each)
            assert seen >= suprema
    assert relation.kind == "linear" and len(lattice) == 2


def test_shares_of_directions_sum_to_one_in_the_check() -> None:
    """Whatever the shares are, the largest s_k / share_k is at least the sum of the largest s_k if they sum to 1."""
    for name, cells in (("car-park-planar-v0", 12), ("integrator-chain-v0", 30)):
        problem = cg.make_problem(name, horizon=1)
        part = cg.synthesize(problem, cells, relation="linear").certificate.agents[0]
        shares = linear_check.linear_tables(problem.agents[0], part).shares
        assert np.all(shares >= 0.0) and shares.sum() == pytest.approx(1.0, abs=1e-12)
