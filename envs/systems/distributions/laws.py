# ruff: noqa: D102 (the methods of each law are those that `Law` describes)
"""Laws of noise along one axis: probabilities below and above a point, and a point for each standard normal number.

Simulations turn standard normal numbers into noise by quantiles, so that every law is driven by the same random
streams. Certificates only need the probabilities of intervals, ``P(left <= e < right)``, whose two tails every law
gives with a bound on their error. How much a lattice of means may miss between its points follows from the density p:
with ``g(m) = E v(m + e)``, ``0 <= v <= 1``, linear interpolation between points eta apart is above g by at most

    eta / 4 * (sum of the jumps of p)  +  eta^2 / 8 * (integral of the positive part of p'') ,

where p'' holds the jumps of p' as well (docs/theory/boxes.md, "Other laws").
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.special import expit, ndtr, stdtr, stdtrit

from ..backends import namespace, special
from .envelopes import RARE, Envelope, Tail, cut_envelope

CLOSED_FORM = 2e-15
"""Error of tails in closed form: a few units in the last place of 1, from their arguments and their functions."""

STUDENT = 1e-12
"""Error of the tails of Student's law, far above what was found in comparisons with fifty digits."""

TWISTED = 0.916063024702
"""Integral of the positive part of the second derivative of the normal density by the logarithm of its scale,
``(x^4 - 4 x^2 + 1) phi(x)``, rounded up: twice ``(x - x^3) phi(x)`` between the roots ``x^2 = 2 -+ sqrt(3)``."""

LAPLACE_TWISTED = 0.470125489050
"""The same for the Laplace density, ``(x^2 - 3 |x| + 1) p(x)``, with the roots ``|x| = (3 -+ sqrt(5)) / 2``."""

GAUSSIAN_SECOND, LOGISTIC_SECOND = 2.172890725682, 2.114105228624
"""Integrals of ``x^2 |p''|``, rounded up. Where p'' changes its sign at c and -c alone that is ``6 - 4 G(c)``, with
``G(x) = x^2 p'(x) - 2 x p(x) + 2 P(x)``, P the distribution function: G' is ``x^2 p''``."""

BENT = 0.483941449039
"""Integral of the positive part of the second derivative of the standard normal density, 2 phi(1), rounded up."""

LOGISTIC_BENT = 0.192450089730
"""The same for the standard logistic density, sqrt(3) / 9, rounded up."""

Tails = tuple[np.ndarray, np.ndarray]
"""Probabilities of at most a point, and of more."""


class Law(ABC):
    """A continuous law of the noise along one axis, in units of the state.

    Attributes
    ----------
    name : str
        What it is called in problem files.
    std : float
        Standard deviation (rounded).
    cdf_error : float
        Upper bound on the absolute error of both tails.
    is_portable : bool
        Whether `ppf_of_normal` takes arrays of other libraries than numpy.
    """

    name = ""
    cdf_error: float
    is_portable = True

    if TYPE_CHECKING:

        @property
        def std(self) -> float:
            """Standard deviation, positive (rounded)."""

    @property
    @abstractmethod
    def height(self) -> float:
        """Half the total variation of the density, from above: the height of its mode, if it has one."""

    @property
    @abstractmethod
    def jumps(self) -> float:
        """Sum of the jumps of the density, from above; infinite if that is not known."""

    @property
    @abstractmethod
    def convexity(self) -> float:
        """Integral of the positive part of the density's second derivative, jumps of the first one included."""

    @abstractmethod
    def tails(self, x: np.ndarray) -> Tails:
        """Return the probabilities of at most x, and of more than x, each with an error of ``cdf_error`` at most."""

    @abstractmethod
    def ppf_of_normal(self, z: np.ndarray) -> np.ndarray:
        """Return the quantiles (rounded) that standard normal numbers z are quantiles of, for simulation."""

    @abstractmethod
    def scaled(self, factor: float) -> Law:
        """Return the law of the noise times a positive factor."""

    def to_dict(self) -> dict[str, Any]:
        """Return the law as in problem files."""
        return {"law": self.name, **{field.name: getattr(self, field.name) for field in fields(self)}}  # type: ignore[arg-type]

    @property
    def envelope(self) -> Envelope | None:
        """The smallest known law whose exponential moments are above those of this one (rounded); None without one."""
        return None

    def interpolation_error(self, lattice_spacing: float) -> float:
        """Return an upper bound on what interpolation adds to a value between points ``lattice_spacing`` apart."""
        straight = 0.25 * lattice_spacing * self.jumps + 0.125 * lattice_spacing * lattice_spacing * self.convexity
        return min(1.0, straight * (1.0 + 1e-12))

    @property
    def top(self) -> float:
        """Where the density is largest; a mixture has the modes of its parts."""
        return 0.0

    @property
    def scale_sensitivity(self) -> float:
        """Half the total variation of x times the density at x, from above.

        With m the top, ``(x - m) p`` varies by the integral of p and that of ``|x - m| |p'|``, which are 1 each, and
        ``m p`` by twice ``|m|`` times the height.
        """
        return 1.0 + abs(self.top) * self.height

    def scale_convexity(self, mean: float = 0.0) -> float:
        """Return half the integral of ``|p + 3 x p' + x^2 p''|`` for ``mean`` plus the noise, from above.

        Infinite where the density p jumps, or nothing is known of it.
        """
        return math.inf

    def scale_charge(self, step: float) -> float:
        """Return an upper bound on what interpolation adds between scales whose logarithms are ``step`` apart.

        By the logarithm of the scale the slope of an expected value is at most ``scale_sensitivity``, and its second
        derivative at most ``scale_convexity``, for values up to 1 (docs/theory/boxes.md, "Noise that is larger in some
        places").
        """
        return min(
            1.0,
            0.5 * step * self.scale_sensitivity * (1.0 + 1e-12),
            0.125 * step * step * self.scale_convexity() * (1.0 + 1e-12),
        )

    def scale_step(self, interpolation_error: float) -> float:
        """Return about the widest step with this charge."""
        return max(
            2.0 * interpolation_error / self.scale_sensitivity,
            math.sqrt(8.0 * interpolation_error / self.scale_convexity()),
        )

    def _twisted(self, mean: float, second: float) -> float:
        """Return what ``scale_convexity`` is for a symmetric density, with ``second`` the integral of ``x^2 |p''|``.

        ``x p'`` has the integral 1 in absolute value, and ``p''`` twice ``convexity``.
        """
        m, first = abs(mean), 1.0 + 2.0 * abs(mean) * self.height
        moved = second + 2.0 * m * math.sqrt(2.0 * second * self.convexity) + 2.0 * m * m * self.convexity
        return 0.5 * (1.0 + 3.0 * first + moved) * (1.0 + 1e-9)

    def lattice_spacing(self, interpolation_error: float) -> float:
        """Return about the widest pitch with this charge."""
        # The positive root of a quadratic in the pitch.
        a, b = 0.125 * self.convexity, 0.25 * self.jumps
        return 2.0 * interpolation_error / (b + math.sqrt(b * b + 4.0 * a * interpolation_error))


@dataclass(frozen=True)
class Gaussian(Law):
    """Normal law with mean 0 and a standard deviation."""

    std: float
    name = "gaussian"
    cdf_error = CLOSED_FORM

    @property
    def envelope(self) -> Envelope | None:
        return Envelope(0.0, self.std, Tail.NORMAL)

    @property
    def height(self) -> float:
        return 0.39895 / self.std if self.std > 0.0 else math.inf  # no noise has no density

    @property
    def jumps(self) -> float:
        return 0.0

    @property
    def convexity(self) -> float:
        return BENT / (self.std * self.std)

    def tails(self, x: np.ndarray) -> Tails:
        return ndtr(x / self.std), ndtr(-x / self.std)

    def ppf_of_normal(self, z: np.ndarray) -> np.ndarray:
        return self.std * z

    def scale_convexity(self, mean: float = 0.0) -> float:
        return TWISTED if mean == 0.0 else self._twisted(mean, GAUSSIAN_SECOND)

    def scaled(self, factor: float) -> Law:
        return Gaussian(factor * self.std)


@dataclass(frozen=True)
class Uniform(Law):
    """Uniform law on an interval."""

    low: float
    high: float
    name = "uniform"
    cdf_error = CLOSED_FORM

    @property
    def std(self) -> float:
        return (self.high - self.low) / math.sqrt(12.0)

    @property
    def envelope(self) -> Envelope | None:
        return Envelope(0.5 * (self.low + self.high), self.std, Tail.LIGHT)

    @property
    def height(self) -> float:
        return (1.0 + 1e-15) / (self.high - self.low)

    @property
    def top(self) -> float:
        return min(max(0.0, self.low), self.high)

    @property
    def jumps(self) -> float:
        return 2.0 / (self.high - self.low)

    @property
    def convexity(self) -> float:
        return 0.0

    def tails(self, x: np.ndarray) -> Tails:
        width = self.high - self.low
        return np.clip((x - self.low) / width, 0.0, 1.0), np.clip((self.high - x) / width, 0.0, 1.0)

    def ppf_of_normal(self, z: np.ndarray) -> np.ndarray:
        found: np.ndarray = namespace(z).clip(
            self.low + (self.high - self.low) * special(z).ndtr(z), self.low, self.high
        )
        return found

    def scaled(self, factor: float) -> Law:
        return Uniform(factor * self.low, factor * self.high)


@dataclass(frozen=True)
class Triangular(Law):
    """Triangular law: the density rises from `low` to `mode` and falls to `high`."""

    low: float
    mode: float
    high: float
    name = "triangular"
    cdf_error = CLOSED_FORM

    @property
    def std(self) -> float:
        a, m, b = self.low, self.mode, self.high
        return math.sqrt(((b - a) ** 2 - (m - a) * (b - m)) / 18.0)

    @property
    def envelope(self) -> Envelope | None:
        # Two uniform laws of half the range, or anything in the range.
        is_even = self.mode - self.low == self.high - self.mode
        deviation = self.std if is_even else 0.5 * (self.high - self.low)
        return Envelope((self.low + self.mode + self.high) / 3.0, deviation, Tail.LIGHT)

    @property
    def height(self) -> float:
        return (2.0 + 1e-15) / (self.high - self.low)

    @property
    def top(self) -> float:
        return self.mode

    @property
    def jumps(self) -> float:
        # A side without width is a jump to the full height.
        return 2.0 / (self.high - self.low) if self.mode in (self.low, self.high) else 0.0

    @property
    def convexity(self) -> float:
        sides = [side for side in (self.mode - self.low, self.high - self.mode) if side > 0.0]
        return sum(2.0 / ((self.high - self.low) * side) for side in sides)

    def tails(self, x: np.ndarray) -> Tails:
        width, rise, fall = self.high - self.low, self.mode - self.low, self.high - self.mode
        inside = np.clip(x, self.low, self.high)
        # Each side in its own formula, which has all digits where the tail is small.
        below = (inside - self.low) ** 2 / (width * rise) if rise > 0.0 else np.zeros_like(inside)
        above = (self.high - inside) ** 2 / (width * fall) if fall > 0.0 else np.zeros_like(inside)
        first = inside <= self.mode
        return np.where(first, below, 1.0 - above), np.where(first, 1.0 - below, above)

    def ppf_of_normal(self, z: np.ndarray) -> np.ndarray:
        width, rise, fall = self.high - self.low, self.mode - self.low, self.high - self.mode
        below, above = special(z).ndtr(z), special(z).ndtr(-z)
        first, xp = below * width <= rise, namespace(z)
        lower, upper = self.low + xp.sqrt(below * width * rise), self.high - xp.sqrt(above * width * fall)
        found: np.ndarray = xp.where(first, lower, upper)
        return found

    def scale_convexity(self, mean: float = 0.0) -> float:
        if self.mode in (self.low, self.high):
            return math.inf
        # p'' is a mass at each corner, as large as the slope changes there.
        peak = 2.0 / (self.high - self.low)
        rise, fall = peak / (self.mode - self.low), peak / (self.high - self.mode)
        corners = ((self.low, rise), (self.mode, rise + fall), (self.high, fall))
        second = sum((mean + corner) ** 2 * change for corner, change in corners)
        return 0.5 * (4.0 + 6.0 * abs(mean + self.mode) * self.height + second) * (1.0 + 1e-9)

    def scaled(self, factor: float) -> Law:
        return Triangular(factor * self.low, factor * self.mode, factor * self.high)


@dataclass(frozen=True)
class Laplace(Law):
    """Laplace law with mean 0: density ``exp(-|x| / scale) / (2 scale)``, variance ``2 scale^2``."""

    scale: float
    name = "laplace"
    cdf_error = CLOSED_FORM

    @property
    def std(self) -> float:
        return math.sqrt(2.0) * self.scale

    @property
    def envelope(self) -> Envelope | None:
        return Envelope(0.0, self.std, Tail.LONG)

    @property
    def height(self) -> float:
        return 0.5 / self.scale

    @property
    def jumps(self) -> float:
        return 0.0

    @property
    def convexity(self) -> float:
        # The kink at 0 bends downwards, and counts nothing.
        return 1.0 / (self.scale * self.scale)

    def tails(self, x: np.ndarray) -> Tails:
        small = 0.5 * np.exp(-np.abs(x) / self.scale)
        return np.where(x <= 0.0, small, 1.0 - small), np.where(x <= 0.0, 1.0 - small, small)

    def ppf_of_normal(self, z: np.ndarray) -> np.ndarray:
        xp = namespace(z)
        found: np.ndarray = -xp.sign(z) * self.scale * (math.log(2.0) + special(z).log_ndtr(-xp.abs(z)))
        return found

    def scale_convexity(self, mean: float = 0.0) -> float:
        return LAPLACE_TWISTED if mean == 0.0 else self._twisted(mean, 2.0)

    def scaled(self, factor: float) -> Law:
        return Laplace(factor * self.scale)


@dataclass(frozen=True)
class Logistic(Law):
    """Logistic law with mean 0: ``P(e <= x) = 1 / (1 + exp(-x / scale))``, variance ``pi^2 scale^2 / 3``."""

    scale: float
    name = "logistic"
    cdf_error = CLOSED_FORM

    @property
    def std(self) -> float:
        return math.pi * self.scale / math.sqrt(3.0)

    @property
    def envelope(self) -> Envelope | None:
        return Envelope(0.0, self.std, Tail.LONG)

    @property
    def height(self) -> float:
        return 0.25 / self.scale

    @property
    def jumps(self) -> float:
        return 0.0

    @property
    def convexity(self) -> float:
        return LOGISTIC_BENT / (self.scale * self.scale)

    def tails(self, x: np.ndarray) -> Tails:
        return expit(x / self.scale), expit(-x / self.scale)

    def ppf_of_normal(self, z: np.ndarray) -> np.ndarray:
        found: np.ndarray = self.scale * (special(z).log_ndtr(z) - special(z).log_ndtr(-z))
        return found

    def scale_convexity(self, mean: float = 0.0) -> float:
        return self._twisted(mean, LOGISTIC_SECOND)

    def scaled(self, factor: float) -> Law:
        return Logistic(factor * self.scale)


@dataclass(frozen=True)
class StudentT(Law):
    """Student's law with mean 0, `df` > 2 degrees of freedom and a scale; variance ``scale^2 df / (df - 2)``."""

    scale: float
    df: float
    name = "student-t"
    cdf_error = STUDENT
    is_portable = False

    @property
    def std(self) -> float:
        return self.scale * math.sqrt(self.df / (self.df - 2.0))

    @property
    def envelope(self) -> Envelope | None:
        # No exponential moment is finite: noise larger than this is given up.
        most = -float(stdtrit(self.df, 0.5 * RARE))
        return cut_envelope(self.std, self.scale * most, 2.0 * float(stdtr(self.df, -most)) + 4.0 * STUDENT)

    @property
    def _peak(self) -> float:
        """Density of the standard law at 0 (rounded)."""
        nu = self.df
        return math.exp(math.lgamma(0.5 * (nu + 1.0)) - math.lgamma(0.5 * nu)) / math.sqrt(nu * math.pi)

    @property
    def height(self) -> float:
        return self._peak / self.scale * (1.0 + 1e-9)

    @property
    def jumps(self) -> float:
        return 0.0

    @property
    def convexity(self) -> float:
        # Twice the steepest slope of the density, which is where its second derivative is 0: x^2 = df / (df + 2).
        nu = self.df
        slope = self._peak * (nu + 1.0) / math.sqrt(nu * (nu + 2.0)) * (1.0 + 1.0 / (nu + 2.0)) ** (-0.5 * (nu + 3.0))
        return 2.0 * slope / (self.scale * self.scale) * (1.0 + 1e-9)

    def tails(self, x: np.ndarray) -> Tails:
        return stdtr(self.df, x / self.scale), stdtr(self.df, -x / self.scale)

    def ppf_of_normal(self, z: np.ndarray) -> np.ndarray:
        # The lower tail has all its digits.
        return -np.sign(z) * self.scale * stdtrit(self.df, ndtr(-np.abs(z)))

    def scale_convexity(self, mean: float = 0.0) -> float:
        # The density of the standard law bends upward beyond c.
        nu = self.df
        c = math.sqrt(nu / (nu + 2.0))
        density = self._peak * (1.0 + c * c / nu) ** (-0.5 * (nu + 1.0))
        slope = -density * (nu + 1.0) * c / (nu + c * c)
        return self._twisted(mean, 6.0 - 4.0 * (c * c * slope - 2.0 * c * density + 2.0 * float(stdtr(nu, c))))

    def scaled(self, factor: float) -> Law:
        return StudentT(factor * self.scale, self.df)
