"""Laws of noise once more, for checks: masses of cells and charges of lattices, from formulas of their own.

Nothing of a law of this package but its parameters is used: distribution functions come from hyperbolic functions, the
incomplete beta function and the complementary error function. Each is off by less than ``law_error``. A law of this
package without a formula here is refused. Laws of others are what their authors state, and verdicts name them.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import betainc, erfc

from ....envs.systems.distributions import Law, is_own_law
from ...relations.grids import FloatArray
from .stated import state

ERRORS = {
    "gaussian": 1e-15,
    "uniform": 1e-15,
    "triangular": 1e-15,
    "laplace": 1e-15,
    "logistic": 1e-15,
    "student-t": 4e-13,
    "truncated-gaussian": 4e-13,
}
"""Errors of distribution functions: a few units in the last place of 1, or far above what comparisons have shown."""


OUTWARD = 1.0 + 1e-12
"""Factor on charges, far above their rounding."""


class Floats:
    """Functions of doubles; proofs put balls in their place."""

    number, sqrt, exp, log, log1p, erf, erfc = float, math.sqrt, math.exp, math.log, math.log1p, math.erf, math.erfc
    lgamma, pi = math.lgamma, math.pi

    @staticmethod
    def betainc(a: float, b: float, x: float) -> float:
        """Return the regularized incomplete beta function."""
        return float(betainc(a, b, x))


FLOATS = Floats()


def law_error(law: Law) -> float:
    """Upper bound on the error of ``probability_below``."""
    data = _numbers(law)
    if data["law"] == "mixture":
        return max(law_error(part) for part in data["laws"]) + 5e-16 * len(data["laws"])
    return float(ERRORS[data["law"]] if data["law"] in ERRORS else _by_author(law).cdf_error)


def masses_of_law(law: Law, edges: FloatArray, means: FloatArray, scale: float = 1.0) -> FloatArray:
    """Masses (Z, S) of cells around means (Z,), from below, of noise that is multiplied with a scale."""
    below = probability_below(law, (edges - means[:, None]) / scale)
    return np.maximum(np.diff(below, axis=1) - 2.0 * law_error(law), 0.0)


def probability_below(law: Law, x: NDArray[np.float64]) -> NDArray[np.float64]:
    """Probability of noise of at most x."""
    data = _numbers(law)
    match data["law"]:
        case "gaussian":
            result = 0.5 * erfc(-x / (data["std"] * math.sqrt(2.0)))
        case "uniform":
            result = (np.minimum(np.maximum(x, data["low"]), data["high"]) - data["low"]) / (data["high"] - data["low"])
        case "triangular":
            result = _triangular(data, x)
        case "laplace":
            result = 0.5 * (1.0 - np.sign(x) * np.expm1(-np.abs(x) / data["scale"]))
        case "logistic":
            result = 0.5 * (1.0 + np.tanh(0.5 * x / data["scale"]))
        case "student-t":
            square = (x / data["scale"]) ** 2
            share = square / (data["df"] + square)
            # Near the middle one less the share would have lost the digits of the share.
            middle = 0.5 + 0.5 * np.sign(x) * betainc(0.5, 0.5 * data["df"], share)
            tail = 0.5 * betainc(0.5 * data["df"], 0.5, data["df"] / (data["df"] + square))
            result = np.where(share < 0.5, middle, np.where(x > 0.0, 1.0 - tail, tail))
        case "truncated-gaussian":
            ends = np.array([data["low"], data["high"]])
            low, high = _normal_below(ends, data["spread"])
            result = (_normal_below(np.clip(x, *ends), data["spread"]) - low) / (high - low)
        case "mixture":
            parts = zip(data["weights"], data["means"], data["laws"], strict=True)
            result = sum(weight * probability_below(part, x - mean) for weight, mean, part in parts)
        case _:
            result = _by_author(law).tails(x)[0]
    return np.asarray(result)


def _normal_below(x: NDArray[np.float64], spread: float) -> NDArray[np.float64]:
    return np.asarray(0.5 * erfc(-x / (spread * math.sqrt(2.0))))


def _triangular(data: dict[str, float], x: NDArray[np.float64]) -> NDArray[np.float64]:
    """Integral of the density, which is linear on either side of the mode."""
    low, mode, high = data["low"], data["mode"], data["high"]
    peak, at = 2.0 / (high - low), np.clip(x, low, high)
    rising, falling = np.minimum(at, mode) - low, np.maximum(at, mode) - mode
    left = 0.5 * peak * rising * (rising / (mode - low)) if mode > low else np.zeros_like(at)
    slope = falling / (high - mode) if high > mode else np.zeros_like(at)
    return np.asarray(left + falling * peak * (1.0 - 0.5 * slope))


def law_charge(law: Law, lattice_spacing: float) -> float:
    """What linear interpolation between points of a lattice may add to an expected value, for values up to 1.

    A quarter of ``lattice_spacing`` times the jumps of the density, and an eighth of its square times the positive part
    of the second derivative.
    """
    interpolation_error = exact_charge(law, lattice_spacing, FLOATS) * OUTWARD
    state("charge", exact_charge, law, lattice_spacing, interpolation_error)
    return float(interpolation_error)


def exact_charge(law: Law, lattice_spacing: float, m: Any) -> Any:
    """The same, up to the rounding of the functions ``m``."""
    step, (jumps, convexity) = m.number(lattice_spacing), _shape(law, m)
    return 0.25 * step * jumps + 0.125 * step * step * convexity


def scale_charge(law: Law, step: float) -> float:
    """What linear interpolation between scales whose logarithms are ``step`` apart may add, for values up to 1.

    Half a step times the slope, or an eighth of the squared step times the second derivative, whichever is less. With
    ``D p = (x p)'`` and a density p they are at most the integrals of the positive parts of D p and of D D p.
    """
    interpolation_error = exact_scale_charge(law, step, FLOATS) * OUTWARD
    state("charge", exact_scale_charge, law, step, interpolation_error)
    return float(interpolation_error)


def exact_scale_charge(law: Law, step: float, m: Any) -> Any:
    """The same, up to the rounding of the functions ``m``."""
    width = m.number(step)
    slope, convexity = 0.5 * width * _slope_of_scale(law, 0.0, m), 0.125 * width * width * _bend_of_scale(law, 0.0, m)
    return slope if slope < convexity else convexity


def _bend_of_scale(law: Law, mean: float, m: Any) -> Any:
    """Integral of the positive part of ``D D p = p + 3 x p' + x^2 p''`` for ``mean`` plus noise, from above.

    It is half that of ``|D D p|``, whose total integral is 0. Exact for the normal and the Laplace law about 0; for
    others the three parts are bounded one by one.
    """
    data = _numbers(law, m)
    match data["law"]:
        case "mixture":
            parts = zip(data["weights"], data["means"], data["laws"], strict=True)
            return sum(weight * _bend_of_scale(part, mean + own, m) for weight, own, part in parts)
        case "gaussian" if mean == 0.0:
            # D D p = (x^4 - 4 x^2 + 1) p is the derivative of (x - x^3) p, which is 0 at 0 and far out.
            near, far = m.sqrt(2.0 - m.sqrt(3.0)), m.sqrt(2.0 + m.sqrt(3.0))
            return 2.0 * sum(abs(x - x**3) * m.exp(-0.5 * x * x) for x in (near, far)) / m.sqrt(2.0 * m.pi)
        case "laplace" if mean == 0.0:
            # D D p = (x^2 - 3 |x| + 1) p is the derivative of (x - x |x|) p.
            near, far = 0.5 * (3.0 - m.sqrt(5.0)), 0.5 * (3.0 + m.sqrt(5.0))
            return sum(abs(x - x * x) * m.exp(-x) for x in (near, far))
        case "triangular" if data["low"] < data["mode"] < data["high"]:
            low, top, high = (mean + data[key] for key in ("low", "mode", "high"))
            peak = 2.0 / (high - low)
            left, right = peak / (top - low), peak / (high - top)
            second = low * low * left + top * top * (left + right) + high * high * right
            return 2.0 + 3.0 * abs(top) * peak + 0.5 * second
        case "gaussian":
            # It bends upward beyond one deviation.
            inside = 0.5 + 0.5 * m.erf(m.sqrt(0.5))
            second = 6.0 - 4.0 * (2.0 * inside - 3.0 * m.exp(-0.5) / m.sqrt(2.0 * m.pi))
            height = 1.0 / (m.sqrt(2.0 * m.pi) * data["std"])
        case "laplace":
            second, height = 2.0, 0.5 / data["scale"]
        case "logistic":
            # It bends upward where the distribution function is beyond (3 + sqrt(3)) / 6, with the density 1/6.
            c, share = m.log(2.0 + m.sqrt(3.0)), (3.0 + m.sqrt(3.0)) / 6.0
            second = 6.0 - 4.0 * (c * c / 6.0 * (1.0 - 2.0 * share) - c / 3.0 + 2.0 * share)
            height = 0.25 / data["scale"]
        case "student-t":
            nu = data["df"]
            log = m.lgamma(0.5 * (nu + 1.0)) - m.lgamma(0.5 * nu) - 0.5 * m.log(nu * m.pi)
            square = nu / (nu + 2.0)
            density = m.exp(log - 0.5 * (nu + 1.0) * m.log1p(square / nu))
            share = 0.5 + 0.5 * m.betainc(0.5, 0.5 * nu, square / (nu + square))
            slope = -density * (nu + 1.0) / (nu + square)  # over c
            second = 6.0 - 4.0 * (square * m.sqrt(square) * slope - 2.0 * m.sqrt(square) * density + 2.0 * share)
            height = m.exp(log) / data["scale"]
        case _:
            return math.inf  # the density jumps, or nothing is known of it
    convexity, away = _shape(law, m)[1], abs(mean)
    moved = second + 2.0 * away * m.sqrt(2.0 * second * convexity) + 2.0 * away * away * convexity
    return 0.5 * (1.0 + 3.0 * (1.0 + 2.0 * away * height) + moved)


def _slope_of_scale(law: Law, mean: float, m: Any) -> Any:
    """Most that an expected value of a function up to 1 changes by the logarithm of the scale of ``mean`` plus noise.

    Infinite for laws whose density is not known to have one top.
    """
    data = _numbers(law, m)
    if data["law"] == "mixture":
        parts = zip(data["weights"], data["means"], data["laws"], strict=True)
        return sum(weight * _slope_of_scale(part, mean + own, m) for weight, own, part in parts)
    peak = _peak(data, mean, m)
    return math.inf if peak is None else 1.0 + abs(mean + peak[0]) * peak[1]


def law_height(law: Law) -> float:
    """Half the total variation of the density, from above."""
    data = _numbers(law)
    if data["law"] == "mixture":
        return sum(weight * law_height(part) for weight, part in zip(data["weights"], data["laws"], strict=True))
    peak = _peak(data, 0.0, FLOATS)
    return float(_by_author(law).height if peak is None else peak[1] * OUTWARD)


def _peak(data: dict[str, Any], mean: float, m: Any) -> tuple[Any, Any] | None:
    """Where a density has its top, and how high it is; of several tops the one nearest to ``-mean``. None: unknown."""
    match data["law"]:
        case "uniform":  # any point of the interval is a top
            top, height = min(max(-mean, data["low"]), data["high"]), 1.0 / (data["high"] - data["low"])
        case "triangular":
            top, height = data["mode"], 2.0 / (data["high"] - data["low"])
        case "gaussian" if data["std"] == 0.0:
            top, height = 0.0, math.inf  # no noise has no density
        case "gaussian":
            top, height = 0.0, 1.0 / (m.sqrt(2.0 * m.pi) * data["std"])
        case "laplace":
            top, height = 0.0, 0.5 / data["scale"]
        case "logistic":
            top, height = 0.0, 0.25 / data["scale"]
        case "student-t":
            nu = data["df"]
            log = m.lgamma(0.5 * (nu + 1.0)) - m.lgamma(0.5 * nu) - 0.5 * m.log(nu * m.pi)
            top, height = 0.0, m.exp(log) / data["scale"]
        case "truncated-gaussian":
            top = min(max(0.0, data["low"]), data["high"])
            peak = m.exp(-0.5 * (top / data["spread"]) ** 2) / (m.sqrt(2.0 * m.pi) * data["spread"])
            height = peak / _share(data, m)
        case _:
            return None
    return top, height


def _shape(law: Law, m: Any) -> tuple[Any, Any]:
    """Sum of the jumps of the density, and integral of the positive part of its second derivative."""
    data = _numbers(law, m)
    match data["law"]:
        case "gaussian":
            # The second derivative is positive beyond one deviation; the slope there is phi(1).
            return 0.0, 2.0 * m.exp(-0.5) / m.sqrt(2.0 * m.pi) / data["std"] ** 2
        case "uniform":
            return 2.0 / (data["high"] - data["low"]), 0.0
        case "triangular":
            low, mode, high = data["low"], data["mode"], data["high"]
            peak = 2.0 / (high - low)
            convexity = (peak / (mode - low) if mode > low else 0.0) + (peak / (high - mode) if high > mode else 0.0)
            return (peak if mode in (low, high) else 0.0), convexity
        case "laplace":
            return 0.0, 1.0 / data["scale"] ** 2
        case "logistic":
            return 0.0, m.sqrt(3.0) / 9.0 / data["scale"] ** 2
        case "student-t":
            return 0.0, 2.0 * _steepest(data["df"], m) / data["scale"] ** 2
        case "truncated-gaussian":
            return _truncated(data, m)
        case "mixture":
            shapes = [_shape(part, m) for part in data["laws"]]
            jumps, convexity = (sum(w * s[k] for w, s in zip(data["weights"], shapes, strict=True)) for k in (0, 1))
            return jumps, convexity
    own = _by_author(law)
    return own.jumps, own.convexity


def _by_author(law: Law) -> Law:
    """Return a law of others, whose author answers for what it states; raise ValueError for one of this package."""
    if is_own_law(law):
        raise ValueError(f"the check has no formula of its own for the law {law.name!r}; add it to `checked_laws`")
    return law


def _steepest(nu: float, m: Any) -> Any:
    """Largest slope of the standard density of Student's law, where ``x^2 = nu / (nu + 2)``."""
    x = m.sqrt(nu / (nu + 2.0))
    log = m.lgamma(0.5 * (nu + 1.0)) - m.lgamma(0.5 * nu) - 0.5 * m.log(nu * m.pi)
    density = m.exp(log - 0.5 * (nu + 1.0) * m.log1p(x * x / nu))
    return density * (nu + 1.0) * x / (nu + x * x)


def _share(data: dict[str, Any], m: Any) -> Any:
    """Probability of the interval of a truncated law before it was truncated."""
    first, last = (0.5 * m.erfc(-data[end] / (data["spread"] * m.sqrt(2.0))) for end in ("low", "high"))
    return last - first


def _truncated(data: dict[str, Any], m: Any) -> tuple[Any, Any]:
    low, high, spread = data["low"], data["high"], data["spread"]
    scale = 1.0 / (m.sqrt(2.0 * m.pi) * spread * _share(data, m))
    left, right = (scale * m.exp(-0.5 * (end / spread) ** 2) for end in (low, high))
    convexity = 2.0 * m.exp(-0.5) * scale / spread + (abs(low) * left + abs(high) * right) / spread**2
    return left + right, convexity


def _numbers(law: Law, m: Any = FLOATS) -> dict[str, Any]:
    """The name of a law and its numbers, as numbers of ``m``."""
    return {"law": law.name, **{k: m.number(own) if isinstance(own, float) else own for k, own in vars(law).items()}}
