"""Every kernel entry is at most the true Gaussian mass of its cell, and misses no more than it says."""

import mpmath
import numpy as np
import pytest

from certigym.synthesis.abstraction.kernels.kernel import (
    MANY_PRODUCTS,
    AxisTable,
    Kernel,
    gaussian_masses,
    gaussian_table,
)

mpmath.mp.dps = 50


def true_mass(mean: float, low: float, high: float, std: float) -> mpmath.mpf:
    a, b = (
        (mpmath.mpf(low) - mpmath.mpf(mean)) / mpmath.mpf(std),
        (mpmath.mpf(high) - mpmath.mpf(mean)) / mpmath.mpf(std),
    )
    return mpmath.ncdf(b) - mpmath.ncdf(a) if b < 0 else mpmath.ncdf(-a) - mpmath.ncdf(-b)


@pytest.mark.parametrize("std", [0.05, 0.5, 3.0])
def test_entries_are_below_the_true_masses_and_tight(std: float) -> None:
    edges = np.linspace(-5.0, 5.0, 41)
    means = np.array([-6.1, -4.875, -0.125, 0.0, 0.1, 2.49, 4.9, 5.3])
    masses, loss = gaussian_masses(means, edges, std)
    for z, row in zip(means, masses):
        missing = mpmath.mpf(0)
        for s, entry in enumerate(row):
            truth = true_mass(z, edges[s], edges[s + 1], std)
            assert mpmath.mpf(float(entry)) <= truth
            assert truth - mpmath.mpf(float(entry)) <= mpmath.mpf(1e-12) * truth + mpmath.mpf(1e-12) + mpmath.mpf(1e-60)
            missing += truth - mpmath.mpf(float(entry))
        assert missing <= loss <= 1e-11


def test_the_standard_deviation_is_used_not_the_variance() -> None:
    masses, _ = gaussian_masses(np.zeros(1), np.array([-0.5, 0.5]), 0.5)
    assert masses[0, 0] == pytest.approx(0.6826894921370859, abs=1e-13)


def test_rows_sum_to_at_most_one() -> None:
    masses, _ = gaussian_masses(np.linspace(-1, 1, 201), np.linspace(-9, 9, 3001), 0.3)
    assert np.all(masses.sum(axis=1) <= 1.0)


def test_pushing_and_smoothing_are_adjoint_in_two_dimensions() -> None:
    rng = np.random.default_rng(3)
    first, _ = gaussian_masses(np.linspace(-1, 1, 7), np.linspace(-1, 1, 6), 0.4)
    second, _ = gaussian_masses(np.linspace(0, 1, 4), np.linspace(0, 1, 4), 0.2)
    kernel = Kernel((AxisTable.dense(first), AxisTable.dense(second)))
    values, masses = rng.random((2, 15)), rng.random((3, 15))
    policy = rng.integers(-1, 28, size=15)
    expected = kernel.backup(values)[:, np.maximum(policy, 0)] * (policy >= 0)
    np.testing.assert_allclose(masses @ expected.T, kernel.propagate(masses, policy) @ values.T, rtol=1e-13)
    table = np.einsum("as,bt->abst", first, second).reshape(28, 15)
    np.testing.assert_allclose(kernel.backup(values), values @ table.T, rtol=1e-13)


@pytest.mark.parametrize("std", [0.05, 0.5, 30.0])
def test_banded_tables_are_the_dense_ones(std: float) -> None:
    edges, means = np.linspace(-20.0, 5.0, 501), np.sort(np.random.default_rng(0).uniform(-25, 9, 700))
    dense, missing = gaussian_masses(means, edges, std)
    banded, loss = gaussian_table(means, edges, std)
    table = banded.toarray()
    assert np.all(table <= dense) and np.max(dense - table) < 1e-18 and loss < 1e-11 and missing < 1e-11
    rng = np.random.default_rng(1)
    values, masses = rng.random((3, 500)), rng.random((2, 700))
    np.testing.assert_allclose(banded.backup(values), values @ table.T, rtol=1e-13)
    np.testing.assert_allclose(banded.propagate(masses), masses @ table, rtol=1e-13)
    assert std > 1 or sum(entries.size for *_, entries in banded.blocks) < 0.7 * dense.size


def test_rows_with_narrow_support_are_smoothed_alike() -> None:
    edges, means = np.linspace(-20.0, 5.0, 1201), np.linspace(-21.0, 6.0, 1500)
    banded, _ = gaussian_table(means, edges, 0.5)
    rng = np.random.default_rng(2)
    values = rng.random((9, 1200))
    for row, (a, b) in enumerate(
        [(0, 1200), (0, 1), (1199, 1200), (200, 440), (3, 3), (64, 128), (63, 65), (900, 1200)]
    ):
        values[row, :a] = values[row, b:] = 0.0
    np.testing.assert_allclose(banded.backup(values), values @ banded.toarray().T, rtol=1e-12, atol=1e-300)
    stacked = values.reshape(3, 3, 1200)
    np.testing.assert_allclose(banded.backup(stacked).reshape(9, -1), banded.backup(values), rtol=1e-12)


def test_masses_on_few_lattice_points_are_pushed_alike() -> None:
    edges, means = np.linspace(-20.0, 5.0, 1201), np.linspace(-21.0, 6.0, 1500)
    banded, _ = gaussian_table(means, edges, 0.5)
    rng = np.random.default_rng(3)
    masses = rng.random((3, 20, 1500)) * (rng.random(1500) < 0.2)
    masses[..., 300:700] = 0.0
    assert masses.size // 1500 * sum(entries.size for *_, entries in banded.blocks) > MANY_PRODUCTS
    expected = masses @ banded.toarray()
    np.testing.assert_allclose(banded.propagate(masses), expected, rtol=1e-12, atol=1e-300)
    np.testing.assert_allclose(banded.propagate(masses[0, :1]), expected[0, :1], rtol=1e-12, atol=1e-300)
    assert not banded.propagate(np.zeros((400, 1500))).any()
