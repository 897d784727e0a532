# ruff: noqa: D102 (the methods of each law are those that `Law` describes)
"""Laws of noise that are made from others: truncated, mixed, or taken from `scipy.stats`."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import ndtr

from ..arguments import shown
from ..backends import namespace, special
from .envelopes import Envelope, Tail
from .laws import BENT, Law, Tails

BISECTIONS = 60
"""Halvings of the interval between the quantiles of the parts of a mixture."""


@dataclass(frozen=True)
class TruncatedGaussian(Law):
    """Normal law with mean 0 and standard deviation `spread` (before truncation), given that it lies in an interval."""

    spread: float
    low: float
    high: float
    name = "truncated-gaussian"
    cdf_error = 1e-12
    """Holds for intervals of probability .01 at least, which is asked for."""

    @property
    def share(self) -> float:
        """Probability of the interval (rounded)."""
        low, high = self.low / self.spread, self.high / self.spread
        # On one side of 0 the difference of the small tails has more digits.
        return float(ndtr(high) - ndtr(low) if low <= 0.0 else ndtr(-low) - ndtr(-high))

    def _density(self, x: float) -> float:
        return math.exp(-0.5 * (x / self.spread) ** 2) / (math.sqrt(2.0 * math.pi) * self.spread * self.share)

    @property
    def std(self) -> float:
        mean = self.spread**2 * (self._density(self.low) - self._density(self.high))
        ends = self.low * self._density(self.low) - self.high * self._density(self.high)
        return math.sqrt(max(self.spread**2 * (1.0 + ends) - mean**2, 0.0))

    @property
    def envelope(self) -> Envelope | None:
        half = 0.5 * (self.high - self.low)
        if self.low == -self.high:  # what is cut evenly has smaller moments than before
            return Envelope(0.0, min(self.spread, half), Tail.LIGHT)
        return Envelope(self.spread**2 * (self._density(self.low) - self._density(self.high)), half, Tail.LIGHT)

    @property
    def top(self) -> float:
        return min(max(0.0, self.low), self.high)

    @property
    def height(self) -> float:
        return self._density(self.top) * (1.0 + 1e-9)

    @property
    def jumps(self) -> float:
        return (self._density(self.low) + self._density(self.high)) * (1.0 + 1e-9)

    @property
    def convexity(self) -> float:
        slopes = sum(abs(end) * self._density(end) for end in (self.low, self.high)) / self.spread**2
        return (BENT / (self.spread**2 * self.share) + slopes) * (1.0 + 1e-9)

    def tails(self, x: np.ndarray) -> Tails:
        at, low, high = (np.clip(x, self.low, self.high) / self.spread, self.low / self.spread, self.high / self.spread)
        below, above = _between(low, at) / self.share, _between(at, high) / self.share
        return np.clip(below, 0.0, 1.0), np.clip(above, 0.0, 1.0)

    def ppf_of_normal(self, z: np.ndarray) -> np.ndarray:
        low = self.low / self.spread
        below, xp = float(ndtr(low)), namespace(z)
        quantile = special(z).ndtri(xp.clip(below + self.share * special(z).ndtr(z), 0.0, 1.0))
        found: np.ndarray = xp.clip(self.spread * quantile, self.low, self.high)
        return found

    def scaled(self, factor: float) -> Law:
        return TruncatedGaussian(factor * self.spread, factor * self.low, factor * self.high)


@dataclass(frozen=True)
class Mixture(Law):
    """With probability ``weights[k]`` the noise is ``means[k]`` plus noise of the law ``laws[k]``."""

    weights: tuple[float, ...]
    means: tuple[float, ...]
    laws: tuple[Law, ...]
    name = "mixture"
    is_portable = False

    @property
    def cdf_error(self) -> float:  # type: ignore[override]
        """Upper bound on the absolute error of both tails: the largest one of the parts, and rounding."""
        return max(law.cdf_error for law in self.laws) + 1e-15 * len(self.laws)

    @property
    def std(self) -> float:
        mean = sum(w * m for w, m in zip(self.weights, self.means))
        return math.sqrt(
            sum(w * (law.std**2 + (m - mean) ** 2) for w, m, law in zip(self.weights, self.means, self.laws))
        )

    @property
    def envelope(self) -> Envelope | None:
        known = [part for law in self.laws if (part := law.envelope) is not None and part.lost == 0.0]
        if len(known) < len(self.laws):
            return None
        means = [m + part.mean for m, part in zip(self.means, known)]
        # The part is drawn first, a bounded number, and then its noise.
        half, widest = 0.5 * (max(means) - min(means)), max(part.deviation for part in known)
        mean = sum(w * m for w, m in zip(self.weights, means))
        return Envelope(mean, math.hypot(half, widest), max(Tail.LIGHT, *(part.tail for part in known)))

    @property
    def height(self) -> float:
        return sum(w * law.height for w, law in zip(self.weights, self.laws))

    @property
    def scale_sensitivity(self) -> float:
        tops = [mean + law.top for mean, law in zip(self.means, self.laws)]
        return sum(w * (1.0 + abs(top) * law.height) for w, top, law in zip(self.weights, tops, self.laws))

    def scale_convexity(self, mean: float = 0.0) -> float:
        return sum(w * law.scale_convexity(mean + m) for w, m, law in zip(self.weights, self.means, self.laws))

    @property
    def jumps(self) -> float:
        return sum(w * law.jumps for w, law in zip(self.weights, self.laws))

    @property
    def convexity(self) -> float:
        return sum(w * law.convexity for w, law in zip(self.weights, self.laws))

    def tails(self, x: np.ndarray) -> Tails:
        parts = [law.tails(x - m) for m, law in zip(self.means, self.laws)]
        below, above = (sum(w * tail[k] for w, tail in zip(self.weights, parts)) for k in (0, 1))
        return np.asarray(below), np.asarray(above)

    def ppf_of_normal(self, z: np.ndarray) -> np.ndarray:
        z = np.asarray(z, dtype=float)
        # Quantiles of a mixture lie between those of its parts; bisection to the last bit is the same for all shapes.
        ends = np.stack([m + law.ppf_of_normal(z) for m, law in zip(self.means, self.laws)])
        low, high = ends.min(axis=0), ends.max(axis=0)
        below, above = ndtr(z), ndtr(-z)
        for _ in range(BISECTIONS):
            middle = 0.5 * (low + high)
            tails = self.tails(middle)
            # Compare the smaller tails, which have all their digits.
            left = np.where(z < 0.0, tails[0] < below, tails[1] > above)
            low, high = np.where(left, middle, low), np.where(left, high, middle)
        return 0.5 * (low + high)

    def scaled(self, factor: float) -> Law:
        means = tuple(factor * m for m in self.means)
        return Mixture(self.weights, means, tuple(law.scaled(factor) for law in self.laws))

    def to_dict(self) -> dict[str, Any]:
        rows = zip(self.weights, self.means, self.laws)
        return {"law": self.name, "parts": [{"weight": w, "mean": m, **law.to_dict()} for w, m, law in rows]}


@dataclass(frozen=True, eq=False, repr=False)
class ScipyLaw(Law):
    """A frozen continuous law of ``scipy.stats``, with bounds on its errors and its density.

    Parameters
    ----------
    frozen : object
        For example ``scipy.stats.gamma(2.0, loc=-2.0)``.
    cdf_error : float
        Upper bound on the absolute error of ``cdf`` and ``sf``: whoever states it answers for it.
    variation : float
        Total variation of the density, from above: twice its height if it has one mode.
    """

    frozen: Any
    cdf_error: float
    variation: float
    name = "scipy"
    is_portable = False

    @property
    def std(self) -> float:
        return float(self.frozen.std())

    def __post_init__(self) -> None:
        for name in ("cdf_error", "variation"):
            if not 0.0 < getattr(self, name) < math.inf:
                raise ValueError(f"`{name}`: expected a positive number, got {getattr(self, name)!r}")
        if not 0.0 < self.std < math.inf:
            raise ValueError(f"`frozen`: expected a law with a finite variance, got the deviation {self.std:g}")

    @property
    def height(self) -> float:
        return 0.5 * self.variation

    @property
    def jumps(self) -> float:
        return self.variation

    @property
    def convexity(self) -> float:
        return 0.0

    def tails(self, x: np.ndarray) -> Tails:
        return np.asarray(self.frozen.cdf(x)), np.asarray(self.frozen.sf(x))

    def ppf_of_normal(self, z: np.ndarray) -> np.ndarray:
        lower = self.frozen.ppf(ndtr(np.minimum(z, 0.0)))
        return np.where(z < 0.0, lower, self.frozen.isf(ndtr(-np.maximum(z, 0.0))))

    def scaled(self, factor: float) -> Law:
        raise ValueError("`noise`: expected laws that can be scaled, got one of scipy; give the scaled law itself")

    def to_dict(self) -> dict[str, Any]:
        import scipy.stats

        name = str(getattr(getattr(self.frozen, "dist", None), "name", ""))
        if type(getattr(scipy.stats, name, None)) is not type(getattr(self.frozen, "dist", None)):
            raise ValueError("`noise`: expected a law that `scipy.stats` knows by name, got one that no file can hold")
        numbers = {"name": name, "args": list(self.frozen.args), **self.frozen.kwds}
        return {
            "law": "scipy", **numbers, "cdf_error": self.cdf_error, "variation": self.variation
        }  # fmt: skip

    def __repr__(self) -> str:
        name = getattr(getattr(self.frozen, "dist", None), "name", "a law")
        return f"ScipyLaw({name}, args {self.frozen.args}, {self.frozen.kwds}, error {self.cdf_error:g})"


def scipy_law(entry: Mapping[str, Any]) -> ScipyLaw:
    """Return a law of ``scipy.stats``, given by its name and numbers, or as a frozen law; ValueError if it is none."""
    numbers = {key: value for key, value in entry.items() if key not in ("law", "name", "args")}
    stated = {key: numbers.pop(key, None) for key in ("cdf_error", "variation")}
    if not all(isinstance(value, int | float) and not isinstance(value, bool) for value in stated.values()):
        raise ValueError(
            "`noise`: expected `cdf_error` and `variation`, the total variation of the density, beside a law of scipy, "
            f"got {shown(stated)}"
        )
    frozen = entry["law"]
    if frozen == "scipy":
        import scipy.stats  # takes a second, which only those wait for who ask for it

        dist = getattr(scipy.stats, str(entry.get("name")), None)
        if not isinstance(dist, scipy.stats.rv_continuous):
            raise ValueError(f"`noise`: expected the name of a continuous law of scipy, got {shown(entry.get('name'))}")
        try:
            frozen = dist(*entry.get("args", []), **numbers)
        except (TypeError, ValueError) as error:
            raise ValueError(f"`noise`: {error}") from None
    return ScipyLaw(frozen, **stated)


def _between(low: Any, high: Any) -> np.ndarray:
    """Return ``Phi(high) - Phi(low)``, from the tails that are small."""
    return np.where(np.asarray(low) > 0.0, ndtr(-low) - ndtr(-high), ndtr(high) - ndtr(low))
