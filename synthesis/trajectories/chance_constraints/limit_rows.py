"""Inequalities along nominal paths, of many candidates of feedback at once, and how probably one of them fails.

The mathematics is that of docs/theory/paths.md, "Agents of any dynamics", in plain floating point.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import erfc, erfcx, log_ndtr, ndtr

from ....envs.systems.distributions import Tail
from ...relations.grids import FloatArray

OUTWARD = 1.0 + 1e-7
"""Factor on linearization errors and failures of what is claimed: the check rounds outward, by its own enclosures."""

INWARD = 1e-9
"""Share of the size of a number by which distances are shortened."""

LEAST_CORRELATION = 0.1
"""Correlation with what was asked a step earlier from which on that counts."""

SHARES = (1.0, 0.8, 0.6, 0.4, 0.2)
"""Probabilities of all strips for which rows are chosen to be strips or tails."""

PARTS = ("low", "high", "strip", "variance", "largest", "correlation")
"""Lists of rows that are kept side by side."""

NODES, WEIGHTS = (np.array([0.5, 0.5])[:, None] * np.polynomial.legendre.leggauss(8)) + np.array([0.5, 0.0])[:, None]
"""Where a normal number is that is beyond an end, as shares of how far beyond matters, and what of it is there."""

FAR_BEYOND, KEPT_TO = 8.0, 6.0
"""How far beyond an end a normal number is at most, in units of about what it is beyond it by; and in deviations given
it, by which another one is kept then."""

PAIR = "pair"
"""Beginning of the names of rows about two agents."""


@dataclass(eq=False)
class Worth:
    """Rows of inequalities of N candidates: distances, strips and variances, lists of arrays (N, J).

    ``largest`` is what the step that adds most adds to each variance, or all of it where nothing is known.
    ``correlation`` is that with the same row one step earlier, of which the names tell, 0 where there is none.
    """

    low: list[FloatArray] = field(default_factory=list)
    high: list[FloatArray] = field(default_factory=list)
    strip: list[FloatArray] = field(default_factory=list)
    variance: list[FloatArray] = field(default_factory=list)
    largest: list[FloatArray] = field(default_factory=list)
    correlation: list[FloatArray] = field(default_factory=list)
    names: list[str] = field(default_factory=list)
    shared: list[bool] = field(default_factory=list)
    """Whether rows are about this agent and another one."""
    stopped: NDArray[np.bool_] | None = None
    """Of which candidates (N,) variances are upper bounds, on noise whose size depends on the past; None for none."""
    tail: Tail = Tail.NORMAL
    """What is known of the tails of the noise."""
    lost: float = 0.0
    """Probability of noise that is given up."""

    @property
    def own(self) -> Worth:
        """The rows that are about this agent alone."""
        kept = [rows for *rows, shared in zip(*self._parts, self.shared, strict=True) if not shared]
        names = [name for name in self.names if not name.startswith(PAIR)]
        parts: dict[str, Any] = dict(zip(PARTS, ([rows[k] for rows in kept] for k in range(len(PARTS))), strict=True))
        return replace(self, **parts, names=names, shared=[False] * len(kept))

    @property
    def _parts(self) -> tuple[list[FloatArray], ...]:
        return tuple(getattr(self, name) for name in PARTS)

    def add(
        self,
        low: FloatArray,
        high: FloatArray,
        strip: FloatArray,
        variance: FloatArray,
        names: list[str],
        largest: FloatArray | None = None,
        correlation: FloatArray | float = 0.0,
    ) -> None:
        """Add rows (N, J)."""
        self.shared.append(bool(names) and names[0].startswith(PAIR))
        shape = variance.shape
        most = variance if largest is None else largest
        values = (low, high, strip, variance, most, np.broadcast_to(correlation, shape))
        for kept, new in zip(self._parts, values, strict=True):
            kept.append(new if new.shape == shape else np.broadcast_to(new, shape))
        self.names += names

    def extend(self, other: Worth) -> None:
        """Add the rows of another agent of a team."""
        for name in (*PARTS, "names", "shared"):
            getattr(self, name).extend(getattr(other, name))
        self.tail, self.lost = max(self.tail, other.tail), self.lost + other.lost
        if other.stopped is not None:
            self.stop(other.stopped)

    def stop(self, which: NDArray[np.bool_]) -> None:
        """Note of which candidates (N,) variances are upper bounds."""
        self.stopped = which if self.stopped is None else self.stopped | which

    def flattened(self, owners: Sequence[str]) -> Worth:
        """Return the rows of N agents, with their names, as those of one team (1, N J)."""
        parts: dict[str, Any] = {
            name: [rows.reshape(1, -1) for rows in part] for name, part in zip(PARTS, self._parts, strict=True)
        }
        names = self._by_rows()
        told = [f"agent `{owner}`, {name}" for rows in names for owner in owners for name in rows]
        stopped = None if self.stopped is None else np.array([bool(np.any(self.stopped))])
        lost = len(owners) * self.lost
        return replace(self, **parts, names=told, shared=[*self.shared], stopped=stopped, lost=lost)

    def _by_rows(self) -> list[list[str]]:
        """Return the names, part by part."""
        ends = np.cumsum([rows.shape[1] for rows in self.low])
        return [self.names[a:b] for a, b in zip([0, *ends[:-1]], ends, strict=True)]

    def weakest(self, candidate: int = 0) -> str:
        """Return the row of a candidate that costs most, in words."""
        costs = self._soft[candidate]
        return self.names[int(np.argmax(costs))] if len(costs) else "nothing"

    def nearest(self, candidate: int = 0) -> dict[int, float]:
        """Return, by times, how many deviations the nearest limit or strip of a candidate is away."""
        low, high, strip, variance, *_ = (part[candidate] for part in self._all)
        return nearest_by_times([int(name.rpartition(" ")[2]) for name in self.names], low, high, strip, variance)

    @cached_property
    def _all(self) -> tuple[FloatArray, ...]:
        return tuple(np.concatenate(part, axis=1) for part in self._parts)

    def _by_moments(self) -> tuple[FloatArray, FloatArray]:
        """Return both tails (N, J) of each row by exponential moments."""
        low, high, strip, variance, largest, _ = self._all
        below, above = (_by_moments(np.minimum(end, strip), variance, self.tail, largest) for end in (low, high))
        return below, above

    def scores(self, first: bool = False) -> FloatArray:
        """Return numbers (N,) that grow with the failure, also where that is 1: logarithms of sums of soft tails.

        With ``first`` rows count for what they add to the failure of the row before them.
        """
        total = self._soft.sum(axis=1)
        if first and self._is_normal:
            total = np.minimum(total, self._first(_soft).sum(axis=1))
        return np.log(np.maximum(total, 1e-300))

    @property
    def _is_normal(self) -> bool:
        """Whether what is known of earlier rows counts."""
        return not self.tail and self.stopped is None

    def _first(self, tails: Callable[[FloatArray, FloatArray], FloatArray]) -> FloatArray:
        """Return about what each row (N, J) adds to the failure of the one before it: it fails, and that one does not.

        The check has a bound for the best of more earlier rows (docs/theory/paths.md, Theorem Paths.12).
        """
        low, high, strip, variance, *_, correlation = self._all
        earlier = self._earlier
        sd, total = np.sqrt(np.maximum(variance, 1e-300)), np.zeros(low.shape)
        known = (earlier >= 0) & (correlation > LEAST_CORRELATION)
        for side in (low, high):
            end = np.minimum(side, strip)
            z = np.where(np.isfinite(end), end, 1e3) / sd
            share = np.ones(z.shape)
            at = np.nonzero(known & (z > 0.0) & (z < 38.0) & (z[:, earlier] > 0.0))
            if len(at[0]):
                share[at] = _kept_before(z[at], z[at[0], earlier[at[1]]], correlation[at])
            total += tails(end, variance) * share
        return total

    @cached_property
    def _earlier(self) -> NDArray[np.int64]:
        """Of each row (J,) the place of the same one a step earlier, or -1."""
        place, earlier = dict[tuple[str, int], int](), []
        for k, name in enumerate(self.names):
            what, _, t = name.rpartition(" ")
            earlier.append(place.get((what, int(t) - 1), -1))
            place[what, int(t)] = k
        return np.array(earlier, dtype=np.int64)

    @cached_property
    def _soft(self) -> FloatArray:
        """What each row (N, J) adds to the failure; where the limit is broken it goes on to grow."""
        low, high, strip, variance, *_ = self._all
        if self.tail:
            return np.add(*self._by_moments())
        one, other, inner = (_soft(distance, variance) for distance in (low, high, strip))
        both = 2.0 * _soft(np.minimum(np.minimum(low, high), strip), variance)
        apart = 2.0 * inner + np.where(low < strip, one, 0.0) + np.where(high < strip, other, 0.0)
        found = np.minimum(both, apart)
        if self.stopped is None:
            return found
        sides = sum(2.0 * _soft(np.minimum(end, strip), variance) for end in (low, high))
        return np.where(self.stopped[:, None], sides, found)

    def failures(self, first: bool = False) -> FloatArray:
        """Return upper bounds (N,) on the probabilities that an inequality fails, up to rounding.

        With ``first`` an estimate of them if rows count for what they add to the failure of the row before them.
        """
        low, high, strip, variance, *_ = self._all
        if self.tail:
            below, above = (np.sum(np.minimum(side, 1.0), axis=1) for side in self._by_moments())
            return np.asarray(np.minimum(1.0, (below + above + self.lost) * OUTWARD))
        both = np.minimum(2.0 * _tails(np.minimum(np.minimum(low, high), strip), variance), 1.0)
        inner = np.minimum(2.0 * _tails(strip, variance), 1.0)
        outer = np.where(low < strip, _tails(low, variance), 0.0) + np.where(high < strip, _tails(high, variance), 0.0)
        best = np.ones(len(low))
        for share in SHARES:
            as_strip = share * both <= share * inner + outer
            chosen = np.where(as_strip, both, inner)
            with np.errstate(divide="ignore"):
                kept = np.sum(np.log1p(-chosen), axis=1)
            best = np.minimum(best, -np.expm1(kept) + np.sum(np.where(as_strip, 0.0, outer), axis=1))
        if self.stopped is not None:
            sides = sum(2.0 * _tails(np.minimum(end, strip), variance).sum(axis=1) for end in (low, high))
            best = np.where(self.stopped, sides, best)
        if first and self._is_normal:
            best = np.minimum(best, self._first(_tails).sum(axis=1))
        return np.minimum(1.0, best * OUTWARD)


def nearest_by_times(
    times: Sequence[int], low: FloatArray, high: FloatArray, strip: FloatArray, variance: FloatArray
) -> dict[int, float]:
    """Return how many deviations the nearest of some distances (J,) is away, by their times; infinite without noise."""
    distance = np.minimum(np.minimum(low, high), strip)
    away = np.where(variance > 0.0, _quotient(distance, variance), np.where(distance > 0.0, np.inf, -np.inf))
    found = dict[int, float]()
    for t, own in zip(times, away.tolist(), strict=True):
        found[t] = min(own, found.get(t, np.inf))
    return found


def least_by_times(each: Sequence[Mapping[int, float]]) -> dict[int, float]:
    """Return the least of what is known at each time."""
    return {t: min(own.get(t, np.inf) for own in each) for t in sorted({t for own in each for t in own})}


def _quotient(distance: FloatArray, variance: FloatArray) -> FloatArray:
    """Return distances in deviations, between -1000 and 1000."""
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        z = distance / np.sqrt(np.maximum(variance, 1e-300))
    return np.clip(np.where(distance == np.inf, np.inf, np.where(np.isnan(z), -1e3, z)), -1e3, 1e3)


def _kept_before(a: FloatArray, b: FloatArray, correlation: FloatArray) -> FloatArray:
    """Return about P(Y <= b | X > a) of standard normal numbers, all (K,), a and b above 0.

    Where the correlation is large Y is kept by what is hardly beyond a: there the integral is taken.
    """
    r = np.sqrt(np.maximum(1.0 - correlation * correlation, 1e-12))
    far = np.minimum(
        FAR_BEYOND / (a + 1.0 / (1.0 + a)), (KEPT_TO * r + np.maximum(b - correlation * a, 0.0)) / correlation
    )
    beyond = NODES[:, None] * far
    # the density beyond a, given that X is
    density = np.exp(-a * beyond - 0.5 * beyond * beyond) * np.sqrt(2.0 / np.pi) / erfcx(a / np.sqrt(2.0))
    kept = ndtr((b - correlation * (a + beyond)) / r)
    return np.minimum(np.sum(WEIGHTS[:, None] * density * kept, axis=0) * far, 1.0)


def _soft(distance: FloatArray, variance: FloatArray) -> FloatArray:
    return np.where(distance == np.inf, 0.0, -log_ndtr(_quotient(distance, variance)))


def _tails(distance: FloatArray, variance: FloatArray) -> FloatArray:
    tail = 0.5 * erfc(_quotient(distance, variance) / np.sqrt(2.0)) + 2e-300
    return np.where(distance == np.inf, 0.0, np.where(variance > 0.0, tail, np.where(distance > 0.0, 0.0, 1.0)))


def _by_moments(distance: FloatArray, variance: FloatArray, kind: Tail, largest: FloatArray) -> FloatArray:
    """Return bounds on tails by exponential moments; beyond 1 where a limit is broken, so that scores go on."""
    z = _quotient(distance, variance)
    if kind == Tail.LONG:
        with np.errstate(divide="ignore", invalid="ignore"):
            share = np.clip(np.nan_to_num(largest / variance, nan=1.0), 1e-4, 1.0)
        more = np.sqrt(1.0 + 2.0 * share * np.square(np.minimum(z, 1e3))) - 1.0
        inside = np.exp((np.log1p(0.5 * more) - more) / share)
    else:
        inside = np.exp(-0.5 * z * z)
    tail = np.where(z > 0.0, inside + 2e-300, 1.0 + 0.5 * z * z)
    return np.where(distance == np.inf, 0.0, np.where((variance > 0.0) | (distance <= 0.0), tail, 0.0))
