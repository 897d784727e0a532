"""Noise of any law: tails to fifty digits, charges above what interpolation adds, certificates below the truth."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mpmath
import numpy as np
import pytest
import scipy.stats

import certigym as cg
from certigym.envs.systems.distributions.laws import Law, Logistic
from certigym.envs.systems.distributions.noise import KINDS, laws_of
from certigym.synthesis.abstraction.kernels.box_kernel import BoxKernel
from certigym.synthesis.abstraction.kernels.kernel import Kernel, law_table
from certigym.synthesis.certificates.cell_probabilities import lost_to_rounding
from certigym.synthesis.certificates.cell_probabilities.checked_laws import (
    law_charge,
    law_error,
    law_height,
    masses_of_law,
    probability_below,
    scale_charge,
)
from certigym.synthesis.checker.distributions import read_distribution
from certigym.synthesis.checker.fields import Entry
from kinds import mostly_thorough

DECLARED: list[dict[str, Any]] = [
    {"law": "gaussian", "std": 0.3},
    {"law": "uniform", "low": -0.5, "high": 0.4},
    {"law": "triangular", "low": -0.5, "mode": 0.1, "high": 0.6},
    {"law": "triangular", "low": -0.2, "mode": -0.2, "high": 0.6},
    {"law": "laplace", "scale": 0.2},
    {"law": "logistic", "scale": 0.15},
    {"law": "student-t", "scale": 0.2, "df": 3.5},
    {"law": "student-t", "scale": 0.2, "df": 500.0},
    {"law": "truncated-gaussian", "spread": 0.4, "low": -0.3, "high": 0.7},
    {
        "law": "mixture",
        "parts": [
            {"weight": 0.7, "mean": -0.1, "law": "gaussian", "std": 0.2},
            {"weight": 0.3, "mean": 0.3, "law": "uniform", "low": -0.2, "high": 0.2},
        ],
    },
]
NAMES = [f"{k}-{entry['law']}" for k, entry in enumerate(DECLARED)]
LAWS: list[Law] = [laws_of([entry], 1)[0] for entry in DECLARED]


def cdf_ball(entry: dict[str, Any], x: float) -> Any:
    """Return the probability of at most x to fifty digits, from definitions."""
    x = mpmath.mpf(x)
    numbers = {key: mpmath.mpf(value) for key, value in entry.items() if isinstance(value, float)}
    match entry["law"]:
        case "gaussian":
            return mpmath.ncdf(x / numbers["std"])
        case "uniform":
            low, high = numbers["low"], numbers["high"]
            return min(max((x - low) / (high - low), mpmath.mpf(0)), mpmath.mpf(1))
        case "triangular":
            low, mode, high = numbers["low"], numbers["mode"], numbers["high"]
            if x <= low or x >= high:
                return mpmath.mpf(x >= high)
            if x <= mode:
                return (x - low) ** 2 / ((high - low) * (mode - low))
            return 1 - (high - x) ** 2 / ((high - low) * (high - mode))
        case "laplace":
            tail = mpmath.exp(-abs(x) / numbers["scale"]) / 2
            return tail if x < 0 else 1 - tail
        case "logistic":
            return 1 / (1 + mpmath.exp(-x / numbers["scale"]))
        case "student-t":
            nu, t = numbers["df"], x / numbers["scale"]
            tail = mpmath.betainc(nu / 2, mpmath.mpf(1) / 2, 0, nu / (nu + t * t), regularized=True) / 2
            return tail if t < 0 else 1 - tail
        case "truncated-gaussian":
            ends = [mpmath.ncdf(numbers[key] / numbers["spread"]) for key in ("low", "high")]
            at = mpmath.ncdf(min(max(x, numbers["low"]), numbers["high"]) / numbers["spread"])
            return (at - ends[0]) / (ends[1] - ends[0])
    return sum(mpmath.mpf(part["weight"]) * cdf_ball(part, x - mpmath.mpf(part["mean"])) for part in entry["parts"])


@pytest.mark.parametrize(("entry", "law"), list(zip(DECLARED, LAWS, strict=True)), ids=NAMES)
def test_tails_have_the_errors_they_say(entry: dict[str, Any], law: Law) -> None:
    """Both wings' formulas against fifty digits, from the far left to the far right, and close to the middle."""
    x = np.concatenate([np.linspace(-1.5, 1.5, 61), [-30.0, -5.0, -1e-3, -1e-7, 1e-9, 1e-5, 5.0, 30.0]])
    below, above = law.tails(x)
    checked = probability_below(law, x)
    with mpmath.workdps(50):
        for k, at in enumerate(x.tolist()):
            truth = cdf_ball(entry, at)
            assert abs(mpmath.mpf(float(below[k])) - truth) <= law.cdf_error
            assert abs(mpmath.mpf(float(above[k])) - (1 - truth)) <= law.cdf_error
            assert abs(mpmath.mpf(float(checked[k])) - truth) <= law_error(law)
    assert law_error(law) <= law.cdf_error


def test_every_law_of_the_package_is_declared_here() -> None:
    """A new one has to stand all tests of this page."""
    assert {entry["law"] for entry in DECLARED} == {*KINDS, "mixture"}


class Stranger(Logistic):
    """A law whose density is said to bend less than it does."""

    name = "stranger"
    bend = 1e-3


TWINS = [law_error, law_height, lambda law: law_charge(law, 0.1), lambda law: probability_below(law, np.zeros(1))]


@pytest.mark.parametrize("twin", TWINS)
def test_the_check_takes_nothing_of_a_law_of_the_package_from_the_search(
    monkeypatch: pytest.MonkeyPatch, twin: Any
) -> None:
    """The one sabotage is a law without a formula of the check; the other are numbers that the search alone has."""
    stranger = Stranger(0.15)
    twin(stranger)  # whoever writes a law answers for it
    monkeypatch.setitem(KINDS, "stranger", Stranger)
    with pytest.raises(ValueError, match="no formula of its own"):
        twin(stranger)
    for law in LAWS:
        parts = law.laws if hasattr(law, "laws") else (law,)
        honest = twin(law)
        with monkeypatch.context() as patch:
            for name in ("jumps", "convexity", "height", "tails", "cdf_error", "scale_sensitivity", "scale_convexity"):
                for part in (law, *parts):
                    patch.setattr(type(part), name, None)
            np.testing.assert_array_equal(twin(law), honest)
            scale_charge(law, 0.1)


def test_a_certificate_of_a_law_without_a_formula_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    certificate = cg.synthesize(reach([Stranger(0.15)]), 40, relation="boxes").certificate
    report = cg.check(certificate)
    assert report and "what their authors state of Stranger(scale=0.15)" in str(report)
    monkeypatch.setitem(KINDS, "stranger", Stranger)
    report = cg.check(certificate)
    assert not report and "no formula of its own for the law 'stranger'" in str(report)


def test_laws_of_others_have_names_of_their_own() -> None:
    class Gaussian(Stranger):
        name = "gaussian"

    with pytest.raises(ValueError, match="name of its own"):
        laws_of([Gaussian(0.15)], 1)


def test_verdicts_name_laws_of_scipy_and_no_others() -> None:
    gamma = {"law": scipy.stats.gamma(2.0, loc=-0.4, scale=0.2), "cdf_error": 1e-12, "variation": 4.0}
    report = cg.check(cg.synthesize(reach([gamma]), 40, relation="exact"))
    assert report and "what their authors state of ScipyLaw(gamma" in str(report)
    report = cg.check(cg.synthesize(reach([DECLARED[4]]), 40, relation="exact"))
    assert report and "authors" not in str(report)


@pytest.mark.parametrize("spread", [1e8, 30.0, 3.0, 0.5])
@pytest.mark.parametrize(("low", "high"), [(1.0, 2.0), (-1.0, 1.5), (-1e-6, 3e-6), (0.2, 0.2001)])
def test_means_of_cut_normal_laws_have_their_digits(spread: float, low: float, high: float) -> None:
    with mpmath.workdps(60):
        a, b = (mpmath.mpf(end) / mpmath.mpf(spread) for end in (low, high))
        truth = spread * (mpmath.npdf(a) - mpmath.npdf(b)) / (mpmath.ncdf(b) - mpmath.ncdf(a))
        found = read_distribution(
            Entry({"law": "truncated-gaussian", "spread": spread, "low": low, "high": high}, "law")
        )
        assert abs(found.mean - truth) <= found.off


@pytest.mark.parametrize("law", LAWS, ids=NAMES)
def test_standard_normal_numbers_become_noise_of_the_law(law: Law) -> None:
    """Quantiles of quantiles, moments, and the same bits for one number and for many."""
    z = np.random.default_rng(0).standard_normal(20_000)
    noise = law.ppf_of_normal(z)
    np.testing.assert_allclose(law.tails(noise)[0], scipy.stats.norm.cdf(z), atol=1e-9)
    assert abs(float(noise.std()) - law.std) < 0.05 * law.std
    one_by_one = [law.ppf_of_normal(np.array([number]))[0] for number in z[:50]]
    assert noise[:50].tobytes() == np.array(one_by_one).tobytes()


@pytest.mark.parametrize("law", LAWS, ids=NAMES)
@pytest.mark.parametrize("share", [0.1, 0.7])
def test_interpolation_adds_no_more_than_the_charge(law: Law, share: float) -> None:
    """For step functions with values in [0, 1], and nearly as much for some: no tolerance but rounding."""
    rng, lattice_spacing = np.random.default_rng(1), share * law.std
    largest = 0.0
    for _ in range(200):
        edges = np.sort(rng.uniform(-1.5, 1.5, 6))
        values = rng.integers(0, 2, 5).astype(float)
        means = np.linspace(0.0, lattice_spacing, 21)
        below = law.tails(edges[None] - means[:, None])[0]
        expected = np.diff(below, axis=1) @ values
        line = np.linspace(expected[0], expected[-1], 21)
        largest = max(largest, float((line - expected).max()))
    assert 0.05 * law.interpolation_error(lattice_spacing) < largest <= law.interpolation_error(lattice_spacing) + 1e-12
    assert law.interpolation_error(lattice_spacing) == pytest.approx(
        min(1.0, law_charge(law, lattice_spacing)), rel=2e-5
    )


@pytest.mark.parametrize("law", LAWS[1:], ids=NAMES[1:])
def test_masses_are_below_the_truth_and_the_check_takes_off_less(law: Law) -> None:
    means, edges = np.linspace(-1.0, 1.0, 37), np.linspace(-1.3, 1.2, 41)
    table, loss = law_table(means, edges, law)
    masses, checked = table.toarray(), masses_of_law(law, edges, means)
    truth = np.diff(law.tails(edges[None] - means[:, None])[0], axis=1)
    assert np.all(masses <= np.maximum(truth - law.cdf_error, 0.0)) and np.all(masses <= checked)
    assert np.all((truth - masses).sum(axis=1) <= loss)


@pytest.mark.parametrize("law", LAWS[1:], ids=NAMES[1:])
def test_what_the_check_may_lack_is_counted(law: Law) -> None:
    """Masses of the check and what it says to be lost make up for the largest masses that its errors allow."""
    means, edges = np.linspace(-1.0, 1.0, 37), np.linspace(-1.3, 1.2, 41)
    most = np.diff(probability_below(law, edges - means[:, None]), axis=1) + 2.0 * law_error(law)
    problem = reach([law])
    part = cg.synthesize(problem, 40, relation="exact").certificate.proof.agents[0]
    cells = part.grid.n_cells
    lost = lost_to_rounding(problem.agents[0], part)
    assert (most - masses_of_law(law, edges, means)).sum(axis=1).max() / 40 <= lost / cells


def reach(noise: Any, **changes: Any) -> cg.Problem:
    """Return a scalar reach-avoid problem with some noise."""
    arguments: dict[str, Any] = {"A": [[0.9]], "B": [[1.0]], "initial_state": [-3.0], **changes}
    boxes = {"state_low": [-5.0], "state_high": [5.0], "input_low": [-1.0], "input_high": [1.0]}
    agent = cg.LinearAgent(name="robot", noise=noise, **boxes, **arguments)
    regions = {"goal": cg.Proposition("robot", [1.0], [2.0]), "bad": cg.Proposition("robot", [-1.0], [-0.5])}
    task = cg.Specification("(!bad) U goal", "co-safe")
    return cg.Problem(name="noisy", agents=[agent], propositions=regions, specification=task, horizon=6)


@pytest.mark.parametrize("entry", DECLARED[1:], ids=NAMES[1:])
@mostly_thorough("relation", ["exact", "boxes"])
def test_certificates_are_valid_and_below_rollouts(entry: dict[str, Any], relation: str) -> None:
    """Checked, and not refuted by 20,000 rollouts of the continuous system (false alarm 1e-6, all tests together)."""
    problem = reach([entry])
    certificate = cg.synthesize(problem, 80, relation=relation).certificate
    report = cg.check(certificate, problem)
    assert report.valid, report.failures
    assert certificate.lower_bound > 0.2
    verdict = cg.validate(certificate, 20_000, seed=3, confidence=1.0 - 1e-6 / 16)
    assert verdict.verdict != "refuted"


def test_exact_values_are_those_of_dense_programming() -> None:
    """Backward induction with scipy's distribution function, on the cells and targets of the model."""
    law = scipy.stats.laplace(scale=0.2)
    problem = reach([DECLARED[4]])
    certificate = cg.synthesize(problem, 40, relation="exact").certificate
    part = certificate.proof.agents[0]
    edges, targets = part.grid.edges[0], part.lattice[0]
    masses = np.diff(law.cdf(edges[None] - targets[:, None]), axis=1)
    centres = 0.5 * (edges[1:] + edges[:-1])
    goal, bad = (1.0 <= centres) & (centres < 2.0), (-1.0 <= centres) & (centres < -0.5)
    start = int(np.searchsorted(edges, -3.0, side="right")) - 1
    value = np.zeros(len(centres))
    undecided = int(np.flatnonzero(~problem.automaton.absorbing)[0])
    for t in reversed(range(problem.horizon)):
        after = np.where(goal, 1.0, np.where(bad, 0.0, value))
        chosen = part.policy[t, undecided]
        value = np.where(chosen >= 0, (masses @ after)[np.maximum(chosen, 0)], 0.0)
    assert certificate.lower_bound <= value[start] <= certificate.lower_bound + 1e-8


def test_a_sharper_law_than_the_real_one_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """The search believes in noise that is smaller by one per cent."""
    from certigym.synthesis.abstraction.models import agent_models

    problem, truth = reach([DECLARED[1]]), agent_models.law_table
    with monkeypatch.context() as patch:
        patch.setattr(agent_models, "law_table", lambda means, edges, law: truth(means, edges, law.scaled(0.99)))
        broken = cg.synthesize(problem, 80, relation="exact").certificate
    assert not cg.check(broken, problem)


def test_a_charge_left_out_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    problem = reach([DECLARED[4]])
    with monkeypatch.context() as patch:
        patch.setattr(BoxKernel, "backup", Kernel.backup)
        broken = cg.synthesize(problem, 80, relation="boxes").certificate
    assert cg.check(cg.synthesize(problem, 80, relation="boxes").certificate, problem).valid
    assert not cg.check(broken, problem)


def test_laws_of_scipy_are_taken_with_the_error_that_is_stated(tmp_path: Path) -> None:
    """A skewed law, frozen or by its name: certified under ``exact``, written to a file, and not refuted."""
    law = {"law": scipy.stats.gamma(4.0, loc=-0.4, scale=0.1), "cdf_error": 1e-12, "variation": 4.6}
    problem = reach([law])
    certificate = cg.synthesize(problem, 80).certificate
    assert cg.check(certificate, problem).valid and certificate.proof.agents[0].relation["kind"] == "exact"
    verdict = cg.validate(certificate, 20_000, seed=4, confidence=1.0 - 1e-6)
    assert verdict.verdict != "refuted"
    cg.save(certificate, tmp_path / "certificate.npz")
    assert cg.check(cg.load(tmp_path / "certificate.npz"), problem).valid


@pytest.mark.parametrize(
    ("noise", "message"),
    [
        ([{"law": "cauchy", "scale": 1.0}], "one of the laws gaussian, uniform"),
        ([{"law": "uniform", "low": 1.0, "high": 0.0}], "low < high"),
        ([{"law": "student-t", "scale": 1.0, "df": 2.0}], "more than 2 degrees of freedom"),
        ([{"law": "truncated-gaussian", "spread": 1.0, "low": 5.0, "high": 6.0}], "a probability of at least 0.01"),
        ([{"law": "scipy", "name": "gamma", "args": [4.0]}], "`cdf_error` and `variation`"),
    ],
)
def test_wrong_laws_are_refused_in_words(noise: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        reach(noise)


@pytest.mark.parametrize("relation", ["linear", "paper"])
def test_relations_for_gaussian_noise_refuse_other_laws(relation: str) -> None:
    with pytest.raises(ValueError, match="is for Gaussian noise"):
        cg.synthesize(reach([DECLARED[1]]), 40, relation=relation)
