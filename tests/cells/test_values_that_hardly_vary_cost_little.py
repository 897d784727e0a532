"""What interpolation adds is charged by how much values vary within reach of the noise, in search and check alike.

Lemma Boxes.8 (docs/theory/boxes.md): expected values are computed here from distribution functions, point by point.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import certigym as cg
from certigym.envs.systems.distributions.composed_laws import Mixture
from certigym.envs.systems.distributions.laws import Gaussian, Laplace, Law, Uniform
from certigym.synthesis.abstraction.kernels import proximity_error
from certigym.synthesis.abstraction.kernels.box_kernel import box_kernel_of
from certigym.synthesis.abstraction.kernels.proximity_error import over_windows
from certigym.synthesis.extended_check.steps import proximity_slack
from certigym.synthesis.relations.grids import Grid, MeanAxis, ScaleAxis

LAWS: list[Law] = [
    Gaussian(0.3),
    Laplace(0.2),
    Uniform(-0.5, 0.4),
    Mixture((0.8, 0.2), (0.0, 0.1), (Gaussian(0.2), Gaussian(0.5))),
]


@pytest.mark.parametrize("law", LAWS, ids=lambda law: law.name)
@pytest.mark.parametrize("is_scaled", [False, True])
@pytest.mark.parametrize("kind", ["flat", "step", "any"])
def test_interpolants_stay_below_the_truth(law: Law, is_scaled: bool, kind: str) -> None:
    edges = np.linspace(-6.0, 6.0, 49)
    means, levels = np.linspace(-4.0, 4.0, 161), np.log(np.linspace(0.5, 2.0, 30))
    levels = np.linspace(levels[0], levels[-1], 30)
    rng = np.random.default_rng(3)
    values = {
        "flat": np.full(48, 0.9),
        "step": np.where(np.arange(48) < 30, 0.999, 0.2),
        "any": rng.random(48),
    }[kind]
    axes = [ScaleAxis(0), MeanAxis(0)] if is_scaled else [MeanAxis(0)]
    lattice = (levels, means) if is_scaled else (means,)
    kernel = box_kernel_of(Grid((edges,)), lattice, [law], axes)
    if kernel.near is None:
        assert not is_scaled and law.name == "gaussian"  # second differences say more
        return
    table = kernel.backup(values[None])[0].reshape(kernel.points)
    at_level, at = rng.uniform(levels[1], levels[-2], 200), rng.uniform(means[1], means[-2], 200)
    if not is_scaled:
        at_level = np.zeros(200)
    truth = np.array([_expected(values, edges, law, m, np.exp(level)) for m, level in zip(at, at_level, strict=True)])
    found = _interpolated(table, lattice, [at_level, at] if is_scaled else [at])
    assert np.all(found <= truth + 1e-15)
    if kind == "flat":
        # In the middle of values that do not vary next to nothing is lost.
        middle = np.abs(at) < 1.0
        assert np.all(
            truth[middle] - found[middle] < 5e-6 if law.name != "uniform" else truth[middle] - found[middle] < 1e-8
        )


def _expected(values: np.ndarray, edges: np.ndarray, law: Law, mean: float, scale: float) -> float:
    below = law.scaled(scale).tails(edges - mean)[0]
    return float(values @ np.diff(below))


def _interpolated(table: np.ndarray, lattice: Any, places: list[np.ndarray]) -> np.ndarray:
    if len(lattice) == 1:
        return np.interp(places[0], lattice[0], table)
    rows = np.array([np.interp(places[1], lattice[1], row) for row in table])
    return np.array([np.interp(level, lattice[0], column) for level, column in zip(places[0], rows.T, strict=True)])


def test_extremes_over_windows_are_those_of_a_loop() -> None:
    rng = np.random.default_rng(0)
    values = rng.random((20, 3))
    first = rng.integers(0, 20, (2, 15))
    last = np.minimum(first + rng.integers(0, 20, (2, 15)), 19)
    window = proximity_error.NearWindow.of(first, last)
    pairs = list(zip(first.ravel(), last.ravel(), strict=True))
    for is_largest, extreme in ((False, np.minimum), (True, np.maximum)):
        loop = np.array([extreme.reduce(values[a : b + 1]) for a, b in pairs])
        np.testing.assert_array_equal(over_windows(values, window, 0, extreme)[window.number], loop)
        np.testing.assert_array_equal(proximity_slack._ends(values, window, 0, is_largest)[window.number], loop)


def chemostat(law: dict[str, Any]) -> cg.Problem:
    """Return a population that is kept in a band, by noise that grows with it."""
    vat = cg.Agent(
        name="vat",
        states=["x"],
        inputs=["u"],
        dynamics=["x + u"],
        noise=[law],
        noise_scale=["0.05 + 0.005*x"],
        state_low=[0.5],
        state_high=[5.5],
        input_low=[-1],
        input_high=[1],
        initial_state=[3],
    )
    return cg.Problem(
        name="vat",
        horizon=30,
        agents=[vat],
        propositions={"band": cg.Proposition("vat", [2.4], [3.6])},
        specification=cg.Specification("G band", "finite-trace"),
    )


@pytest.mark.thorough
@pytest.mark.parametrize(
    "law", [{"law": "gaussian", "std": 1.0}, {"law": "laplace", "scale": 0.4}], ids=lambda law: law["law"]
)
def test_long_tasks_lose_nothing_by_their_length(law: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> None:
    """Thirty steps of plain charges cost half a hundredth and more."""
    problem = chemostat(law)
    certificate = cg.synthesize(problem, 100, relation="boxes").certificate
    assert certificate.lower_bound > 0.999
    assert cg.check(certificate)
    # Who forgets that noise may leave the windows, and what it meets there, claims too much.
    monkeypatch.setattr(
        proximity_error, "_left", lambda edges, points, own, k, window: np.full(window.first.size, -1e-6)
    )
    bold = cg.synthesize(problem, 100, relation="boxes").certificate
    assert bold.lower_bound > certificate.lower_bound and not cg.check(bold)


def test_the_check_needs_windows_of_its_own_masses(monkeypatch: pytest.MonkeyPatch) -> None:
    """A window out of which noise carries more often than the search says is found by the check."""
    problem = chemostat({"law": "gaussian", "std": 1.0})
    monkeypatch.setattr(
        proximity_error.ProximityError,
        "of_values",
        lambda self, values, most, interpolation_error: 0.0 * interpolation_error,
    )
    bold = cg.synthesize(problem, 40, relation="boxes").certificate
    assert bold.lower_bound > 0.0 and not cg.check(bold)
