"""What laws of noise mean: balls around their probabilities, with which proofs compare the numbers of all formulas."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from certigym.envs.systems.distributions.composed_laws import Mixture, TruncatedGaussian
from certigym.envs.systems.distributions.laws import Law


@dataclass(frozen=True)
class ExactLaw:
    """Balls around probabilities, of balls of python-flint.

    Laws that are given by the numbers of others alone raise NotImplementedError.
    """

    law: Law

    def sf_ball(self, x: Any) -> Any:
        """Probability of more than x."""
        if self.law.name not in ABOVE:
            raise NotImplementedError(f"the law {self.law.name!r}, whose probabilities are numbers of its author")
        return ABOVE[self.law.name](self.law, x)

    def cdf_ball(self, x: Any) -> Any:
        """Probability of at most x."""
        law: Any = self.law
        if law.name in ("uniform", "triangular"):
            return 1 - self.sf_ball(x)
        if isinstance(law, TruncatedGaussian):
            return ExactLaw(TruncatedGaussian(law.spread, -law.high, -law.low)).sf_ball(-x)
        if isinstance(law, Mixture):
            return _weighed(law, [ExactLaw(part).cdf_ball(x - m) for m, part in zip(law.means, law.laws)])
        return self.sf_ball(-x)  # symmetric about 0

    def exact_mean(self, a: Any, b: Any) -> Any:
        """Expectation of the noise where it is between the balls a and b, else 0."""
        law: Any = self.law
        if law.name == "gaussian":
            first, last = ((-((x / law.std) ** 2) / 2).exp() for x in (a, b))
            return (first - last) * law.std / (2 * type(a).pi()).sqrt()
        if law.name == "uniform":
            low, high = type(a)(law.low), type(a)(law.high)
            first, last = (x.max(low).min(high) for x in (a, b))
            return (last**2 - first**2) / (2 * (high - low))
        raise NotImplementedError(f"the law {law.name!r}, on linear cells")


def _normal(x: Any) -> Any:
    """Probability of more than x under the standard normal law."""
    return (x / type(x)(2).sqrt()).erfc() / 2


def _uniform(law: Any, x: Any) -> Any:
    low, high = type(x)(law.low), type(x)(law.high)
    return (high - x.max(low).min(high)) / (high - low)


def _triangular(law: Any, x: Any) -> Any:
    low, mode, high = (type(x)(end) for end in (law.low, law.mode, law.high))
    fallen, total = high - x.max(mode).min(high), type(x)(0)
    if high > mode:
        total += fallen**2 / ((high - low) * (high - mode))
    if mode > low:  # the density rises from 0 to its peak: the whole side less what lies before x
        total += ((mode - low) ** 2 - (x.max(low).min(mode) - low) ** 2) / ((high - low) * (mode - low))
    return total


def _student_t(law: Any, x: Any) -> Any:
    nu, half = type(x)(law.df), type(x)(1) / 2
    square = (x / law.scale) ** 2
    share = square / (nu + square)
    if share < half:  # each incomplete beta function where its argument is small
        return _by_side(x, (1 - share.beta_lower(half, nu / 2, True)) / 2)
    return _by_side(x, (nu / (nu + square)).beta_lower(nu / 2, half, True) / 2)


def _truncated(law: Any, x: Any) -> Any:
    low, high = type(x)(law.low), type(x)(law.high)
    first, at, last = (_normal(end / law.spread) for end in (low, x.max(low).min(high), high))
    return (at - last) / (first - last)


def _mixture(law: Any, x: Any) -> Any:
    return _weighed(law, [ExactLaw(part).sf_ball(x - m) for m, part in zip(law.means, law.laws)])


def _weighed(law: Any, parts: list[Any]) -> Any:
    """The mean of balls; weights that sum to 1 up to rounding count by their shares."""
    balls = [type(parts[0])(w) for w in law.weights]
    return sum(w * part for w, part in zip(balls, parts)) / sum(balls)


def _by_side(x: Any, tail: Any) -> Any:
    """Probability of more than x, given that of more than ``|x|`` of a symmetric law."""
    if x > 0:
        return tail
    return 1 - tail if x < 0 else tail.union(1 - tail)


ABOVE: dict[str, Callable[[Any, Any], Any]] = {
    "gaussian": lambda law, x: _normal(x / law.std),
    "uniform": _uniform,
    "triangular": _triangular,
    "laplace": lambda law, x: _by_side(x, (-abs(x) / law.scale).exp() / 2),
    "logistic": lambda law, x: 1 / (1 + (x / law.scale).exp()),
    "student-t": _student_t,
    "truncated-gaussian": _truncated,
    "mixture": lambda law, x: _weighed(law, [ExactLaw(part).sf_ball(x - m) for m, part in zip(law.means, law.laws)]),
}
"""Probabilities of more than x, by names of laws."""
