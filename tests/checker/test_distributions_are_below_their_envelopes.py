"""Exponential moments of every distribution are at most those of its envelope, whose mean is that of the distribution.

Moments are integrated with mpmath. Distributions are random, of all kinds, mixtures among them; Student's is compared
where its noise is not given up, and what is given up with its tail.
"""

from __future__ import annotations

import math
from typing import Any

import mpmath
import numpy as np
import pytest

from certigym.synthesis.checker.distributions import LIGHT, LONG, NORMAL, read_distribution
from certigym.synthesis.checker.fields import Entry, Unreadable
from kinds import mostly_thorough


def pieces(law: dict[str, Any]) -> list[tuple[float, Any, list[float]]]:
    """Weights, densities and places to integrate between, of the parts of a distribution."""
    kind = law["law"]
    if kind == "mixture":
        total = sum(part["weight"] for part in law["parts"])
        found = []
        for part in law["parts"]:
            for weight, density, ends in pieces(part):
                shifted = [end + part["mean"] for end in ends]
                found.append((weight * part["weight"] / total, lambda x, f=density, m=part["mean"]: f(x - m), shifted))
        return found
    if kind == "gaussian":
        s = law["std"]
        return [(1.0, lambda x: mpmath.npdf(x, 0, s), [-12 * s, -3 * s, 0.0, 3 * s, 12 * s])]
    if kind == "uniform":
        a, b = law["low"], law["high"]
        return [(1.0, lambda x: 1 / mpmath.mpf(b - a), [a, b])]
    if kind == "triangular":
        a, c, b = law["low"], law["mode"], law["high"]

        def triangle(x: Any) -> Any:
            left = c > a and x < c
            return 2 / mpmath.mpf(b - a) * ((x - a) / (c - a) if left else (b - x) / (b - c) if b > c else 1)

        return [(1.0, triangle, [a, c, b])]
    if kind == "truncated-gaussian":
        s, a, b = law["spread"], law["low"], law["high"]
        mass = mpmath.ncdf(b / s) - mpmath.ncdf(a / s)
        return [(1.0, lambda x: mpmath.npdf(x, 0, s) / mass, [a, 0.5 * (a + b), b])]
    if kind == "laplace":
        s = law["scale"]
        return [(1.0, lambda x: mpmath.exp(-abs(x) / s) / (2 * s), [-200 * s, -20 * s, 0.0, 20 * s, 200 * s])]
    assert kind == "logistic"
    s = law["scale"]
    return [(1.0, lambda x: mpmath.sech(x / (2 * s)) ** 2 / (4 * s), [-200 * s, -20 * s, 0.0, 20 * s, 200 * s])]


def mean_of(law: dict[str, Any], function: Any) -> Any:
    return sum(w * mpmath.quad(lambda x, f=density: f(x) * function(x), ends) for w, density, ends in pieces(law))


def random_law(rng: np.random.Generator, kind: str) -> dict[str, Any]:
    a, b = sorted(rng.uniform(-2.0, 3.0, 2).tolist())
    size = float(rng.uniform(0.2, 2.0))
    match kind:
        case "gaussian":
            return {"law": kind, "std": size}
        case "uniform":
            return {"law": kind, "low": a, "high": b}
        case "triangular":
            mode = float(rng.choice((a, b, 0.25 * a + 0.75 * b)))
            return {"law": kind, "low": a, "mode": mode, "high": b}
        case "even triangle":
            return {"law": "triangular", "low": -size, "mode": 0.0, "high": size}
        case "cut":
            low = float(rng.uniform(-2.0, 0.5))
            return {"law": "truncated-gaussian", "spread": size, "low": low, "high": low + 1.5}
        case "even cut":
            end = float(rng.uniform(0.3, 3.0))
            return {"law": "truncated-gaussian", "spread": size, "low": -end, "high": end}
        case "mixture":
            kinds = rng.choice(("gaussian", "uniform", "triangular", "laplace"), 2)
            means = rng.normal(size=2).tolist()
            return {
                "law": kind,
                "parts": [
                    {**random_law(rng, str(k)), "weight": float(rng.uniform(0.1, 2.0)), "mean": m}
                    for k, m in zip(kinds, means, strict=True)
                ],
            }
    return {"law": kind, "scale": size}


KINDS = ("gaussian", "uniform", "triangular", "even triangle", "cut", "even cut", "laplace", "logistic", "mixture")


@mostly_thorough("kind", KINDS, first=3)
def test_exponential_moments_are_below_those_of_the_envelope(kind: str) -> None:
    rng = np.random.default_rng(KINDS.index(kind))
    tightest = mpmath.mpf(0)
    with mpmath.workdps(16):
        for _ in range(4):
            law = random_law(rng, kind)
            own = read_distribution(Entry(law, "it"))
            mean = mean_of(law, lambda x: x)
            assert abs(mean - own.mean) <= own.off + 1e-9, law
            assert own.tail == (
                NORMAL if kind == "gaussian" else LONG if "la" in kind[:2] or "lo" in kind[:2] else own.tail
            )
            assert own.tail >= LIGHT or kind == "gaussian"
            assert own.lost == 0.0
            for share in (-0.95, -0.6, -0.1, 0.1, 0.6, 0.95):
                a = share * math.sqrt(2.0) / own.deviation if own.tail == LONG else share * 4.0 / own.deviation
                moment = mean_of(law, lambda x, a=a, m=mean: mpmath.exp(a * (x - m)))
                half = (a * own.deviation) ** 2 / 2
                most = 1 / (1 - half) if own.tail == LONG else mpmath.exp(half)
                assert moment <= most * (1 + 1e-9), (law, a)
                tightest = max(tightest, (moment - 1) / (most - 1))
    # deviations are the smallest ones for some, and of use for all
    assert tightest > (0.9 if kind in ("gaussian", "uniform", "even triangle", "laplace") else 0.02)


def test_students_distribution_is_below_its_envelope_where_it_is_not_given_up() -> None:
    for scale, df in ((1.0, 3.0), (0.5, 5.0), (2.0, 12.0)):
        own = read_distribution(Entry({"law": "student-t", "scale": scale, "df": df}, "it"))
        assert own.tail == LONG and 0.0 < own.lost < 2e-7
        with mpmath.workdps(16):
            factor = mpmath.gamma((df + 1) / 2) / (mpmath.sqrt(df * mpmath.pi) * mpmath.gamma(df / 2) * scale)

            def density(x: Any, scale: float = scale, df: float = df, factor: Any = factor) -> Any:
                return factor * (1 + (x / scale) ** 2 / df) ** (-(df + 1) / 2)

            cut = mpmath.findroot(
                lambda b, f=density, lost=own.lost: 2 * mpmath.quad(f, [b, 2 * b, 20 * b, mpmath.inf]) / lost - 1,
                (0.5 * scale * 1e7 ** (1 / df), 2.0 * scale * 1e7 ** (1 / df)),
            )
            for share in (0.1, 0.5, 0.9):
                a = share * math.sqrt(2.0) / own.deviation
                places = [-cut, -cut / 30, 0, cut / 30, cut]
                moment = mpmath.quad(lambda x, a=a, f=density: f(x) * mpmath.exp(a * x), places)
                assert moment <= 1 / (1 - (a * own.deviation) ** 2 / 2), (scale, df, share)


@pytest.mark.parametrize(
    "law",
    [
        {"law": "gaussian", "std": -1.0}, {"law": "uniform", "low": 1.0, "high": 1.0}, {"law": "laplace", "scale": 0.0},
        {"law": "triangular", "low": 0.0, "mode": 2.0, "high": 1.0}, {"law": "student-t", "scale": 1.0, "df": 2.0},
        {"law": "truncated-gaussian", "spread": 0.0, "low": -1.0, "high": 1.0}, {"law": "mixture", "parts": []},
        {"law": "gaussian"}, {"law": "gaussian", "std": 1.0, "mean": 0.0}, {"law": "cauchy", "scale": 1.0}, {},
        "gaussian",
        {"law": "mixture", "parts": [{"law": "gaussian", "std": 1.0}]}, {"law": "logistic", "scale": -1.0},
        {"law": "mixture", "parts": [{"law": "gaussian", "std": 1.0, "weight": 0.0, "mean": 0.0}]},
        {"law": "mixture", "parts": [{"law": "student-t", "scale": 1.0, "df": 3.0, "weight": 1.0, "mean": 0.0}]},
    ],
)  # fmt: skip
def test_what_is_no_distribution_is_unreadable(law: Any) -> None:
    with pytest.raises(Unreadable):
        read_distribution(Entry(law, "it"))


@pytest.mark.parametrize("name", [[], {}])
def test_a_law_whose_name_is_no_text_is_unreadable(name: Any) -> None:
    with pytest.raises(Unreadable):
        read_distribution(Entry({"law": name}, "it"))
