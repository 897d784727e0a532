"""Shields keep their promise whatever the noise is: other laws, scales that depend on the state, and none at all."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from scipy.stats import binom

import certigym as cg
from certigym.envs.systems.distributions.noise import laws_of
from certigym.synthesis.extended_check.shields import Shield, noise_probabilities, shield_of, unknown_means
from certigym.synthesis.extended_check.shields.noise_probabilities import LawAxis, NoiseAxis, StillAxis
from certigym.synthesis.extended_check.shields.unknown_means import MeanBox
from composing import lawful, matrices, task
from kinds import mostly_thorough
from shield_trials import anything, episodes, the_worst
from test_noise_that_is_uneven import task as clocked
from test_noise_that_is_uneven import walker

FALSE_ALARM = 1e-6
"""Probability with which a statistical test here fails although all is right."""

EPISODES = 1_500
"""A rate that is .1 below p is refuted with probability above .99."""

LAWS: dict[str, dict[str, Any]] = {
    "normal": {"law": "gaussian", "std": 0.3},
    "laplace": {"law": "laplace", "scale": 0.2},
    "logistic": {"law": "logistic", "scale": 0.2},
    "student": {"law": "student-t", "scale": 0.2, "df": 3.5},
    "triangular": {"law": "triangular", "low": -0.5, "mode": 0.2, "high": 0.6},
    "uniform": {"law": "uniform", "low": -0.4, "high": 0.4},
    "truncated": {"law": "truncated-gaussian", "spread": 0.4, "low": -0.5, "high": 0.5},
}
EDGES = np.array([-2.0, -1.0, -0.97, 0.0, 0.5, 2.0])


def still() -> Any:
    """A state that is what it is told to be, beside one with noise."""
    return matrices(
        A=[[0.9, 0.0], [0.0, 1.0]], B=[[0.8], [-0.05]], noise_covariance=[[0.2, 0.0], [0.0, 0.0]],
        state_low=[-3.0, -1.0], state_high=[3.0, 1.0], initial_state=[-1.2, 0.3],
    )  # fmt: skip


PROBLEMS: dict[str, Any] = {
    "laplace, exact": (lambda: task(lawful()), 40, "exact"),
    "laplace, boxes": (lambda: task(lawful()), 40, "boxes"),
    "scale and still": (lambda: clocked(walker()), 24, "boxes"),
    "matrices and still": (lambda: task(still()), [24, 20], "boxes"),
}


@cache
def made(kind: str, share: float = 0.8) -> Shield:
    problem, cells, relation = PROBLEMS[kind]
    found = cg.synthesize(problem(), cells, relation=relation).certificate
    assert isinstance(found, cg.Certificate) and found.lower_bound > 0.05
    shield = shield_of(found, share * found.lower_bound)
    assert isinstance(shield, Shield)
    return shield


@pytest.mark.parametrize("name", list(LAWS))
@pytest.mark.parametrize("scale", [1.0, 2.5])
def test_masses_are_below_those_of_the_law_and_near_them(name: str, scale: float) -> None:
    """Against the tails by which the search computes, which are formulas of their own."""
    (law,) = laws_of([LAWS[name]], 1)
    axis, means = LawAxis(EDGES, law, True), np.linspace(-2.5, 2.5, 41)
    found = axis.masses(means, np.full(41, scale))
    below, above = law.tails((EDGES - means[:, None]) / scale)
    truth = np.where(below[:, 1:] < 0.5, np.diff(below, axis=1), -np.diff(above, axis=1))
    assert np.all(found <= truth + 2.0 * law.cdf_error)
    assert np.all(truth - found < 1e-11)


def test_a_state_without_noise_is_in_the_cell_of_its_mean() -> None:
    axis = StillAxis(EDGES)
    means = np.array([-2.1, -2.0, -0.98, -0.97, 1.999, 2.0, 2.0001, np.nan])
    cells = axis.place(means)
    np.testing.assert_array_equal(cells, [-1, 0, 1, 2, 4, 4, 5, np.nan])
    masses = axis.masses(cells, np.ones(8))
    np.testing.assert_array_equal(masses[[0, 6]], 0.0)
    np.testing.assert_array_equal(masses[1:6].argmax(axis=1), [0, 1, 2, 4, 4])
    assert np.all(masses[1:6].sum(axis=1) == 1.0) and np.all(np.isnan(masses[7]))


@pytest.mark.parametrize("name", list(LAWS))
@mostly_thorough("widths", [(0.3, 1.2), (1e-12, 1.0), (0.0, 1.4)])
def test_least_values_hold_all_over_the_box(name: str, widths: tuple[float, float]) -> None:
    """Means and scales between those that are read, three axes at once: a law, normal noise, none."""
    rng, count = np.random.default_rng(7), 30
    axes: tuple[Any, ...] = (
        LawAxis(EDGES, laws_of([LAWS[name]], 1)[0], True),
        NoiseAxis(EDGES, 0.3, False),
        StillAxis(EDGES),
    )
    low = rng.uniform(-2.2, 1.8, size=(3, count))
    high = low + widths[0] * np.array([[1.0], [0.2], [2.0]])
    least = np.ones((3, count)) * 0.15
    most = least * np.array([[widths[1]], [1.0], [1.0]])
    box = MeanBox.around(low, high, axes, np.ones(count, dtype=bool), (least, most))
    factor = (rng.random((5, 5, 5)) < 0.4).astype(float)  # cells that count or do not: the sharpest there are

    def value(places: Any, scales: Any) -> Any:
        tables = [axis.masses(place, scale) for axis, place, scale in zip(axes, places, scales, strict=True)]
        return np.einsum("abc,ma,mb,mc->m", factor, *tables)

    found = np.min([value(*read) for read in box.points], axis=0) - box.interpolation_error
    for _ in range(100):
        share = np.where((share := rng.random((3, count))) < 0.2, np.rint(share), share)
        means, scales = low + share * (high - low), least + rng.random((3, count)) * (most - least)
        places = [axis.place(mean) for axis, mean in zip(axes, means, strict=True)]
        assert np.all(found <= value(places, scales) + 1e-12)


def test_too_many_cells_are_unknown() -> None:
    axis = StillAxis(np.linspace(0.0, 1.0, 101))
    box = MeanBox.around(np.array([[0.1]]), np.array([[0.9]]), (axis,), np.ones(1, dtype=bool))
    assert all(np.isnan(axis.masses(places[0], scales[0])).all() for places, scales in box.points)


@mostly_thorough("kind", list(PROBLEMS), first=3)
def test_certified_inputs_are_worth_what_their_states_are(kind: str) -> None:
    """Q of the certified inputs is nearly V at least: boxes lose what cells do, and no more."""
    shield, rng, count = made(kind), np.random.default_rng(3), 300
    box = shield.problem.agents[0].workspace
    states = (box.low[:, None] + (box.high - box.low)[:, None] * rng.random((len(box.low), count)),)
    q = int(np.flatnonzero(~shield.problem.automaton.absorbing)[0])
    here = shield.certified_inputs(states, q, 0)
    q_values = shield.values.of_inputs(0, q, states, here)
    value = shield.values.of_states(states, np.full(count, q), np.zeros(count, dtype=np.int64))
    assert np.mean(q_values >= value - 1e-6) > 0.98 and value.max() > 0.1


@pytest.mark.parametrize("kind", list(PROBLEMS))
@mostly_thorough("propose", [anything, the_worst])
def test_nobody_can_break_the_promise(kind: str, propose: Any) -> None:
    shield = made(kind)
    found = episodes(shield, propose, EPISODES, 1)
    assert binom.cdf(found["success"].sum(), EPISODES, shield.probability) >= FALSE_ALARM
    assert found["slack"] >= 0.0 and found["overridden"] > 0.0
    assert propose is the_worst or found["overridden"] < 1.0


def test_a_shield_that_takes_the_least_scale_alone_is_caught(monkeypatch: pytest.MonkeyPatch) -> None:
    """Noise is taken for quieter than it is: what is let through is worth less than it seems."""
    shield, true = made("scale and still"), unknown_means.enclosed_scales
    rng, count = np.random.default_rng(5), 200
    states = (np.vstack([rng.uniform(-0.6, 0.6, count), np.full(count, 0.4)]),)
    inputs = (rng.uniform(-1.0, 1.0, (shield.problem.agents[0].n_inputs, count)),)
    q = int(np.flatnonzero(~shield.problem.automaton.absorbing)[0])
    honest = shield.values.of_inputs(3, q, states, inputs)
    monkeypatch.setattr(unknown_means, "enclosed_scales", lambda *a: tuple(0.5 * end for end in true(*a)))
    quieter = shield.values.of_inputs(3, q, states, inputs)
    assert honest.max() > 0.5 and np.max(quieter - honest) > 0.02


def test_a_shield_that_reads_one_cell_alone_is_caught(monkeypatch: pytest.MonkeyPatch) -> None:
    """A mean that is off by rounding may lie in either of two cells: both count."""
    axis = StillAxis(EDGES)
    box = MeanBox.around(np.array([[-1e-16]]), np.array([[1e-16]]), (axis,), np.ones(1, dtype=bool))
    assert {float(places[0, 0]) for places, _ in box.points} == {2.0, 3.0}
    monkeypatch.setattr(noise_probabilities.StillAxis, "steps", lambda self, sides, most: 0)
    box = MeanBox.around(np.array([[-1e-16]]), np.array([[1e-16]]), (axis,), np.ones(1, dtype=bool))
    assert {float(places[0, 0]) for places, _ in box.points} == {2.0}
