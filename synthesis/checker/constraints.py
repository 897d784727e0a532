"""Chance constraints along a trajectory: an upper bound on the probability that one of them fails.

Each constraint is about a linear form g of the noise, of mean 0: ``-low <= g <= high``, and, where a tube needs it,
``|g| <= width``. V is an upper bound on its variance, or on that of what is above the noise (``distributions``).

**Theorem** (strips). For normal noise P(a constraint fails) <= 1 - prod_j (1 - P(|g_j| > d_j)), d_j the nearest end.

*Proof.* Strips hold together at least as probably as if the numbers were independent (Sidak, Journal of the American
Statistical Association 62, 1967: each strip is about one normal number). A larger variance only lowers the product. QED

**Theorem** (first failures). For events A_1, A_2, .., and for any of them an earlier one, ``e(k) < k``, or none,
P(some A_k) <= sum_k P(A_k and not A_e(k)).

**Theorem** (``beyond``). Let X and Y be standard normal with a correlation of at least rho, 0 < rho < 1. With
Q(z) = P(X > z), c(y) = (a - rho y) / r, r^2 = 1 - rho^2, and any numbers b = y_0 > y_1 > .. > y_n,

    P(X > a, Y <= b) <= sum_i P(y_(i+1) < Y <= y_i) q_i + P(Y <= y_n) Q(c(y_n)),

where q_i = Q(c(y_i)), or the mean of that and Q(c(y_(i+1))) where y_(i+1) >= 0 and c(y_i) >= 0. It grows with b, and
as a falls. *Proofs.* docs/theory/paths.md, Theorem Paths.12 and Lemma Paths.13.

Where the size of normal noise depends on the past, g is a Brownian motion read at a random time of at most V: it
exceeds d with at most twice the tail of a normal number with the variance V (reflection principle). Other noise has the
tails of its exponential moments. In both cases all tails are added up.

**Theorem** (``sized``). Let n = N w be the noise of an agent before it is scaled, and s the size of component k on the
tube, which may depend on states, inputs, disturbances or the time. The component adds a form with at most the factor
``sup |s|`` to the error, and s times the mean of n. If s depends on more than the time, the form is a martingale whose
size depends on the past (STOPPED); else its factor is known, up to what s is rounded by. QED
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from . import rigorous
from .distributions import LIGHT, NORMAL, STOPPED
from .error_system import Forms, covariance_of
from .expressions import names_in
from .fields import Refused
from .intervals import add, down, interval, mul, up
from .jets import value_on
from .problem import Agent, Problem
from .rigorous import Array, Truth, U, Whole

EARLIER, LEAST = 4, 1e-8  # last times that some were asked for before; tails that count as they are
LEAST_RHO, MOST_RHO = 0.1, 1.0 - 1e-9  # correlations that are looked at, and what larger ones are taken for
PIECES, PIECE = 64, 0.1  # pieces of the integral, and how far c moves in each
# More than sums and products of 8,000 numbers of one sign are rounded by; longer sums count it once per 8,000.
ROUNDED = 1.0 + 2.0**-40


class Constraints:
    """Constraints and their forms; ``kinds`` (W,) of sources of noise, and a probability of noise that is given up."""

    def __init__(self, kinds: Whole) -> None:
        self.kinds, self.lost = kinds, 0.0
        self.rows: list[Array] = []
        self.first: list[Array] = []
        self.earlier: list[tuple[Array, Forms]] = []
        self.sources: list[Truth] = []
        self.labels: list[str] = []

    def add(self, low: Any, high: Any, width: Any, forms: Forms, labels: Sequence[str]) -> None:
        """Ask for ``-low <= g <= high`` and ``|g| <= width`` (J,); what is nan is not kept at all."""
        sides = [np.minimum(end, width) + 0.0 * forms.variance for end in (low, high)]  # nan stays nan
        ends = np.where(np.isnan(sides), -np.inf, sides)
        self.rows.append(np.concatenate([ends, forms.variance[None]]))
        self.sources.append(forms.sources)
        self.labels += labels
        # What each adds to the failure of those before it: of normal ones together with some of these.
        kinds = self._kinds(forms.sources)
        known = [_tails_by_kind(end, forms.variance, forms.largest, kinds) for end in ends]
        each = np.where(ends < 0.0, 1.0, known)  # below 0 a larger variance makes tails smaller
        normal = np.flatnonzero(kinds == NORMAL)
        here = normal[np.any((each > LEAST) & (each < 1.0), axis=0)[normal]]
        for before, earlier in self.earlier if len(here) else ():
            each[:, here] = np.minimum(each[:, here], _first_failures(ends[:, here], forms.at(here), before, earlier))
        self.first.append(each.sum(axis=0))
        if len(normal):
            self.earlier = [*self.earlier, (ends[:, normal], forms.at(normal))][-EARLIER:]

    def _kinds(self, sources: Truth) -> Whole:
        """Return of which kind forms (J,) are: of the heaviest one among their sources (J, W)."""
        return np.asarray(np.where(sources, self.kinds, NORMAL).max(axis=1, initial=NORMAL))

    def failure(self) -> float:
        """Return an upper bound on the probability that one of them fails."""
        low, high, variance = np.concatenate(self.rows, axis=1)
        sources, first = np.concatenate(self.sources), np.concatenate(self.first)
        strips = np.minimum(2.0 * tails(np.minimum(low, high), variance), 1.0)
        # Forms that share no source are independent; of the strips of others than normal ones nothing is known.
        component, strips = _components(sources), np.where(self._kinds(sources) == NORMAL, strips, 1.0)
        members = [component == k for k in range(int(component.max(initial=-1)) + 1)]
        each = [min(1.0, _union(strips[own]), float(first[own].sum()) * _rounded(int(own.sum()))) for own in members]
        return min(1.0, (_union(np.array(each)) + self.lost) * ROUNDED)

    def nearest(self) -> dict[int, tuple[float, str]]:
        """Return, by times, how many deviations the nearest end of a constraint is away (from below), and of which."""
        low, high, variance = np.concatenate(self.rows, axis=1)
        away, found = _in_deviations(np.minimum(low, high), variance), dict[int, tuple[float, str]]()
        for k in np.argsort(away, kind="stable"):
            found.setdefault(int(self.labels[k].rpartition(" ")[2]), (float(away[k]), self.labels[k]))
        return found


def _components(sources: Truth) -> Whole:
    """Return the component (J,) of each constraint: those that share a source (J, W), at first or second hand."""
    component = np.arange(len(sources))
    for shared in sources.T:
        if np.any(shared):
            members = np.isin(component, component[shared])
            component[members] = component[members].min()
    return np.unique(component, return_inverse=True)[1].reshape(-1)


def _first_failures(ends: Array, forms: Forms, before: Array, earlier: Forms) -> Array:
    """Return upper bounds (2, J) on P(a form is beyond an end (2, J), and some earlier one (2, K) is kept)."""
    covariance, off = covariance_of(forms, earlier)
    # Earlier ends in deviations from above, correlations from below, with either sign; of ends below 0 nothing is said.
    ends, before = (np.where(some >= 0.0, some, np.nan) for some in (ends, before))
    least = np.maximum(2.0 * np.abs(earlier.moved) - earlier.size, 0.0)
    least = np.sqrt(np.sum(least * least, axis=(1, 2)) * (1.0 - 4.0 * U * (8.0 + least[0].size)))
    own, found = np.sqrt(forms.variance)[:, None], []
    with np.errstate(all="ignore"):
        rho = (np.abs(covariance) - off) / (own * np.sqrt(earlier.variance)) * (1.0 - 16.0 * U)
        rho = np.where(rho > LEAST_RHO, np.minimum(rho, MOST_RHO), np.nan)
        for side, end in enumerate(ends):
            b = np.where((covariance > 0.0) == bool(side), before[1], before[0]) / least * (1.0 + 8.0 * U)
            a = end[:, None] / own * (1.0 - 8.0 * U) + 0.0 * rho
            # the one that is kept least often where a form is beyond a, and there somewhat, as it mostly is
            kept = (b - rho * (a + 1.0 / (1.0 + a))) / np.sqrt(1.0 - rho * rho)
            best = np.where(np.isfinite(kept), kept, np.inf).argmin(axis=1)[:, None]
            # without an earlier one these are nan, of which nothing is known
            found.append(beyond(*(np.take_along_axis(part, best, axis=1) for part in (a, b, rho))))
    return np.array(found)


def beyond(a: Array, b: Array, rho: Array) -> Array:
    """Return upper bounds (J,) on P(X > a, Y <= b) for columns (J, 1), correlations being at least rho."""
    r, one = np.sqrt((1.0 - rho) * (1.0 + rho)), np.ones(1)
    y = b - PIECE * (r / rho) * np.arange(PIECES + 1)
    c = (a - rho * y) / r - 16.0 * U * (np.abs(a) + np.abs(y)) / r
    tail, below = tails(c, one), tails(-y, one)
    mass = np.maximum(below[:, :-1] + tails(y, one)[:, 1:] - 1.0 + 4.0 * U, 0.0)
    chord = (y[:, 1:] >= 0.0) & (c[:, :-1] >= 0.0)
    mean = np.where(chord, 0.5 * (tail[:, :-1] + tail[:, 1:]), tail[:, :-1])
    return np.asarray((np.sum(mass * mean, axis=1) + below[:, -1] * tail[:, -1]) * ROUNDED)


def _union(each: Array) -> float:
    """Return an upper bound on the probability of any of some events that are independent, or better than that."""
    if np.any(each >= 1.0):  # no logarithm of 0
        return 1.0
    # 1 - prod (1 - p): logarithms of one sign, off by some units in the last place of themselves
    return float(-np.expm1(np.sum(np.log1p(-each)))) * _rounded(len(each))


def _rounded(count: int) -> float:
    """Return a factor beyond what sums and products of so many numbers of one sign are rounded by."""
    return float(ROUNDED ** (1 + count // 8000))


def _tails_by_kind(distance: Array, variance: Array, largest: Array, kinds: Whole) -> Array:
    """Return upper bounds (J,) on P(g > distance), whatever the noise is made of."""
    # How many deviations there are to the end, from below.
    z = _in_deviations(distance, variance)
    normal, light, long = tails(distance, variance), _light_tail(z), _long_tail(z, variance, largest)
    # normal noise whose size depends on the past is sub-Gaussian, too
    stopped = np.minimum(np.minimum(2.0 * normal, light), 1.0)
    return np.select([kinds == NORMAL, kinds == STOPPED, kinds == LIGHT], [normal, stopped, light], long)


def _in_deviations(distance: Array, variance: Array) -> Array:
    """Return lower bounds (J,) on distances in deviations; infinite ends for what is kept, or not, for sure."""
    with np.errstate(all="ignore"):
        z = np.where(np.isnan(variance), -np.inf, distance) / np.sqrt(variance)
        # root and quotient round by U each, and a smaller z has a larger tail
        z = z - 8 * U * np.minimum(np.abs(z), 1e300)
        z = np.where(variance > 0, z, np.where((distance > 0) & ~np.isnan(variance), np.inf, -np.inf))
        return np.where(np.isnan(z), -np.inf, z)


def tails(distance: Array, variance: Array) -> Array:
    """Return upper bounds (J,) on P(g > distance) for normal g of mean 0 and a variance of at most this.

    Without noise a distance is kept if it is positive. Distances or variances of which nothing is known are not kept.
    """
    z = _in_deviations(distance, variance)
    with np.errstate(all="ignore"):
        low, high = rigorous.tail(np.minimum(np.abs(z), 37.0))
        tail = np.where(z >= 0, high, up(1.0 - low))
    return np.where(z == -np.inf, 1.0, np.where(z == np.inf, 0.0, tail))


def _light_tail(z: Array) -> Array:
    """Return exp(-z^2 / 2) from above, and 1 where z <= 0."""
    size = np.clip(z, 0.0, 1e3)
    return _where_it_is(z, rigorous.exp(-0.5 * size * size * (1.0 - 4.0 * U))[1])


def _long_tail(z: Array, variance: Array, largest: Array) -> Array:
    """Return ((1 + r)/2 exp(1 - r))^n from above, where n = V/v and r^2 = 1 + 2 z^2 / n; 1 where z <= 0."""
    with np.errstate(all="ignore"):
        # any v will do that is at least what one step adds: n may be smaller than it is
        n = np.clip(np.nan_to_num(variance / largest, nan=1.0) * (1.0 - 4.0 * U), 1.0, 1e4)
        size = np.clip(z, 0.0, 1e6)
        r = down(np.sqrt(1.0 + 2.0 * (size * size / n) * (1.0 - 8.0 * U)))
        exponent = n * (rigorous.log(up(0.5 + 0.5 * r))[1] + up(1.0 - r))
        return _where_it_is(z, rigorous.exp(np.minimum(exponent + 8.0 * U * n * (1.0 + r), 0.0))[1])


def _where_it_is(z: Array, tail: Array) -> Array:
    """Return a tail beyond z > 0 deviations; 1 below, also where nothing is known, and 0 where nothing is beyond."""
    return np.where(z <= 0.0, 1.0, np.where(z == np.inf, 0.0, np.minimum(tail, 1.0)))


def kinds_of(problem: Problem) -> Whole:
    """Return what is known of the tails of each source (W,)."""
    kinds = list[int]()
    for agent in problem.agents:
        for column, envelope in zip(agent.noise.T, agent.envelopes, strict=True):
            stopped = envelope.tail == NORMAL and _varies(agent) and np.any(column != 0.0)
            kinds.append(STOPPED if stopped else envelope.tail)
    return np.array([*kinds, *[NORMAL] * problem.agents[0].shared_noise.shape[1]], dtype=np.int64)


def _varies(agent: Agent) -> bool:
    """Return whether sizes are other than numbers at each time."""
    return bool(names_in(agent.scale) & {*agent.states, *agent.inputs, *agent.disturbances})


def sized(agent: Agent, factor: Array, leaves: dict[str, Array], t: int) -> tuple[Array, Array, Array]:
    """Return factors (d, W) of the noise of a step, what they may be off by, and ends (2, d) of what else it adds.

    ``factor`` (d, W) is that before it is scaled, ``leaves`` are ends (2, 1) of names on the tube. ``Refused`` if a
    size is not known, or if a source may cancel where sizes are not.
    """
    ends = np.concatenate([value_on(tree, leaves) for tree in agent.scale], axis=1)
    if not np.all(np.isfinite(ends)):
        raise Refused(f"the size of the noise of `{agent.name}` is not known on the tube at time {t}")
    own = slice(0, factor.shape[1] - agent.shared_noise.shape[1])  # shared sources are not scaled
    if _varies(agent) and np.any((factor[:, own] != 0.0).sum(axis=0) > 1):
        raise Refused(f"a source of the noise of `{agent.name}` that has a scale moves several states")
    scaled, off, size = factor.copy(), np.zeros(factor.shape), up(np.abs(ends).max(axis=0))[:, None]
    scaled[:, own] *= np.where(ends.sum(axis=0)[:, None] < 0.0, -size, size)
    if not _varies(agent):
        off[:, own] = np.abs(factor[:, own]) * (up(ends[1] - ends[0])[:, None] + 8.0 * U * size)
    return scaled, off, mul(ends, mean_of(agent))


def mean_of(agent: Agent) -> Array:
    """Return ends (2, d) of the mean of the noise of an agent, before it is scaled."""
    mean = np.zeros((2, len(agent.states)))
    for column, own in zip(agent.noise.T, agent.envelopes, strict=True):
        if own.mean or own.off:
            ends = np.stack([down(own.mean - np.full(len(column), own.off)), up(own.mean + own.off + 0.0 * column)])
            mean = add(mean, mul(interval(column), ends))
    return mean
