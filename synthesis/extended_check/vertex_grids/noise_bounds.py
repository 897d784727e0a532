"""Noise along one axis, in units of its size: what planes and intervals are worth as seen from where a cell may lead.

For a number w of a law with the density f let ``S(t) = P(w > t)``, ``R(t) = E w 1(w > t)``, and tau = (e - y) / sigma.
Then ``P(y + sigma w > e) = S(tau)``, and ``E (y + sigma w - e)^+`` has the derivatives S in y and R in sigma, and the
second ones f, tau f and tau^2 f, over sigma.

So what is asked of a law are upper bounds on S, R, |tau|^p f and |tau|^p |f'|, p = 0
.. 2, for tau between two numbers, and where f jumps, and by how much: S has a kink there.

``Normal`` has closed forms. ``Tabled`` cuts the line into bins and bounds f and f' on each of them, by the most of all
of their factors; the largest numbers on ranges of bins are tabled, too. Distribution functions, and how far they may be
off, are those of ``checked_laws``. **Lemma.** Between two points h apart at which S is known the integral of S is that
of its chord, but for ``h^3 / 12`` times the largest |f'|, and ``h^2 / 8`` times the jumps of f. QED
"""

from __future__ import annotations

import math
from functools import cache, lru_cache
from typing import Any, NamedTuple

import numpy as np
from scipy.special import ndtri

from ....envs.systems.distributions import Gaussian, Law, is_own_law
from ...certificates.cell_probabilities import law_error, law_height, normal_hats, probability_below
from ...checker import Refused, rigorous
from ...checker.rigorous import Array, U

FAR = 38.0  # deviations beyond which normal densities count as at them
FINE = 2048  # intervals of a deviation for which they and tails are tabled
BIN, WIDEST = 256, 40  # bins of a unit of other laws, and where the last ones begin
CENTRED = 10.0  # units that the mean may be away from 0: beyond WIDEST all laws fall faster than |t|^-2 then
PARTS = 16  # parts of a bin, at whose ends S is known where it is integrated
OUTWARD = 1.0 + 1e-9  # far more than what densities and their factors are rounded by
MOVED = 1e-13  # far more than what a distribution function changes by where its argument is rounded


class Seen(NamedTuple):
    """Upper bounds (S, n + 1) at planes, and ``mass`` (S, n), probabilities of intervals.

    ``dens`` and ``slope`` are of |tau|^p f and |tau|^p |f'|, for p = 0 and, where sizes vary, 1 and 2; ``rest`` is that
    of |R|, None where they do not. ``leaps`` are jumps of f and the largest |tau|, or None where there are none.
    """

    mass: Array
    dens: list[Array]
    slope: list[Array]
    rest: Array | None
    leaps: tuple[Array, Array] | None


class Normal:
    """Standard normal noise."""

    is_even = True
    mean_size = deviation = 1.0  # E |w| at most
    largest = 0.25, 0.4  # tau f and R at most

    def seen(self, before: Array, after: Array, least: Array, most: Array, is_sized: bool = True) -> Seen:
        """Return what planes with e - y between ``before`` and ``after`` are worth, for sizes from least to most."""
        near = np.maximum(np.maximum(before, -after), 0.0) / most * (1.0 - 4.0 * U)
        far = np.maximum(np.abs(before), np.abs(after)) / least * (1.0 + 4.0 * U)
        table, powers = _densities(), []
        for p in range(4 if is_sized else 2):
            # t^p phi(t) rises up to the root of p, and falls after it
            t = np.minimum(np.clip(np.sqrt(p), near, np.maximum(near, far)), FAR)
            powers.append(table[p][(t * FINE).astype(np.int64)])
        # f' = -t f, and R = f
        return Seen(_masses(before, after, least, most), powers[:-1], powers[1:], powers[0] if is_sized else None, None)

    def hats(self, points: Array, sizes: Array, axis: Array) -> tuple[Array, float]:
        """Return means (V, 2 n) of both hats of all intervals around points, and what a row lacks at most."""
        return normal_hats(points, axis, sizes[:, None])

    def reach(self, probability: float) -> float:
        """Return beyond which number noise has about a probability, to either side."""
        return float(-ndtri(max(probability, 1e-300)))

    def drawn(self, z: Array) -> Array:
        """Return numbers of the law, from standard normal ones."""
        return z

    def beyond(self, distance: Array, size: Array, side: int) -> Array:
        """Return upper bounds on the probability that noise goes further than a distance to one side (-1 or 1)."""
        return np.asarray(rigorous.tail(np.maximum(distance, 0.0) / size * (1.0 - 4.0 * U))[1])


def _masses(before: Array, after: Array, least: Array, most: Array) -> Array:
    """Return upper bounds (S, n) on the probabilities of intervals between planes: ``e - y`` is between both ends."""
    x, z = after[:, 1:], before[:, :-1]
    x = np.where(x > 0.0, x / least, x / most)
    z = np.where(z > 0.0, z / most, z / least)
    # tails at both ends, rounded outward; of the same side where both ends are on it
    x, z = x + 4.0 * U * np.abs(x), z - 4.0 * U * np.abs(z)
    (x_low, x_high), (z_low, z_high) = _tails(np.abs(x)), _tails(np.abs(z))
    mass = np.select([z >= 0.0, x <= 0.0], [z_high - x_low, x_high - z_low], 1.0 - x_low - z_low)
    return np.clip(mass + 4.0 * U, 0.0, 1.0)


@cache
def _densities() -> Array:
    """Return upper bounds (4, n) on ``t^p phi(t)``, p = 0 .. 3, from each multiple of 1 / FINE to the next, to FAR."""
    t = np.arange(math.ceil(FAR * FINE) + 1) / FINE
    best = [np.clip(np.sqrt(p), t, t + 1.0 / FINE) for p in range(4)]
    return np.stack([own**p * rigorous.density_at(own, 4.0)[1] * (1.0 + 2.0**-36) for p, own in enumerate(best)])


@cache
def _tail_table() -> tuple[Array, Array]:
    t = np.arange(math.ceil(FAR * FINE) + 2) / FINE
    low, high = rigorous.tail(t)
    # from t to the next one: below at its end, above at its beginning
    return low[1:], high[:-1]


def _tails(t: Array) -> tuple[Array, Array]:
    """Return bounds on the probability that normal noise is larger than t deviations, t >= 0."""
    place = (np.minimum(t, FAR) * FINE).astype(np.int64)
    low, high = _tail_table()
    return np.where(t > FAR, 0.0, low[place]), high[place]


class Tabled:
    """Noise of another law of the package: w is the noise over ``unit``, which is no less than its deviation."""

    def __init__(self, law: Law, unit: float) -> None:
        self.law, self.unit, self.off = law, unit, law_error(law) + MOVED
        # Bins between points, and two that have no end: there all of |t|^p f and |t|^p |f'| fall (``CENTRED``).
        self.points = np.arange(-WIDEST * BIN, WIDEST * BIN + 1) / BIN
        left = np.concatenate([self.points[:1] - 1.0 / BIN, self.points])
        right = left + 1.0 / BIN
        dens, slope = (own * unit**k for k, own in enumerate(_bounds(law, left * unit, right * unit), 1))
        size = np.maximum(np.abs(left), np.abs(right))
        size[[0, -1]] = WIDEST
        tails = self.above(self.points)
        self.low, self.high = np.append(tails[0], 0.0), np.append(1.0, tails[1])
        # R by Cauchy and Schwarz, from either side.
        self.deviation = law.std / unit
        square = (self.deviation**2 + self.mean**2) * OUTWARD
        self.mean_size = max(1.0, math.sqrt(square))
        rest = np.minimum(np.sqrt(square * self.high), np.sqrt(square * (1.0 - self.low)) + self.mean)
        table = np.stack([own * size**p for p in range(3) for own in (dens, slope)] + [rest], axis=1) * OUTWARD
        self.largest = float(table[:, 2].max()), float(rest.max()) * OUTWARD  # tau f and R at most
        # The largest numbers of 1, 2, 4 .. bins.
        levels = [table]
        while 2 ** len(levels) <= len(table):
            last, step = levels[-1], 2 ** (len(levels) - 1)
            levels.append(np.concatenate([np.maximum(last[:-step], last[step:]), last[-step:]]))
        self.on_ranges = np.concatenate(levels)
        self.of_one_size = self.on_ranges[:, :2].copy()
        self.jumps = [(at / unit, jump * unit * OUTWARD) for at, jump in _jumps(law)]
        # Integrals of S from the first point on, added up as whole numbers of 2^-52, and what they are off by.
        self.fine = np.arange(-WIDEST * BIN * PARTS, WIDEST * BIN * PARTS + 1) / (BIN * PARTS)
        self.middle, part = np.mean(self.above(self.fine), axis=0), 1.0 / (BIN * PARTS)
        each = np.rint(0.5 * part * (self.middle[1:] + self.middle[:-1]) * 2.0**52).astype(np.int64)
        self.area = np.append(0, np.cumsum(each)) / 2.0**52
        self.bend = np.repeat(slope[1:-1] * part**2 / 12.0, PARTS)
        for at, jump in self.jumps:
            place = int((at + WIDEST) * BIN * PARTS)
            self.bend[place - 1 : place + 2] += 0.25 * jump * part
        self.area_off = np.append(0.0, np.cumsum(part * (self.bend + self.off) + 2.0**-52)) * OUTWARD

    @property
    def is_even(self) -> bool:
        """Whether it is the same to both sides."""
        low, mode, high = (getattr(self.law, name, math.nan) for name in ("low", "mode", "high"))
        return self.law.name in EVEN or (low == -high and not mode > 0.0 and not mode < 0.0)

    @property
    def mean(self) -> float:
        """The size of E w, at most (0 for most laws)."""
        envelope = self.law.envelope
        return math.inf if envelope is None else abs(envelope.mean) / self.unit * OUTWARD

    def above(self, t: Array) -> tuple[Array, Array]:
        """Return bounds on S."""
        value = 1.0 - probability_below(self.law, t * self.unit)
        return np.clip(value - self.off, 0.0, 1.0), np.clip(value + self.off, 0.0, 1.0)

    def seen(self, before: Array, after: Array, least: Array, most: Array, is_sized: bool = True) -> Seen:
        """Return what planes with e - y between ``before`` and ``after`` are worth, for sizes from least to most."""
        low, high = before / np.where(before < 0.0, least, most), after / np.where(after > 0.0, least, most)
        low, high = low - 4.0 * U * np.abs(low), high + 4.0 * U * np.abs(high)
        first, last = (
            (np.clip(np.floor(own * BIN), -WIDEST * BIN - 1, WIDEST * BIN) + (WIDEST * BIN + 1)).astype(np.int64)
            for own in (low, high)
        )
        level = np.frexp(last - first + 1)[1] - 1
        start, table = level * (len(self.points) + 1), self.on_ranges if is_sized else self.of_one_size
        either = np.maximum(table[start + first], table[start + last - 2**level + 1])
        numbers = [*np.ascontiguousarray(np.moveaxis(either, -1, 0))]
        dens, slope, rest = numbers[:6:2], numbers[1:6:2], numbers[-1] if is_sized else None
        mass = np.clip(self.high[first[:, :-1]] - self.low[last[:, 1:]] + 4.0 * U, 0.0, 1.0)
        leaps = None
        if self.jumps:
            each = [np.where((low <= at) & (at <= high), jump, 0.0) for at, jump in self.jumps]
            leaps = np.sum(each, axis=0), np.maximum(np.abs(low), np.abs(high))
        return Seen(mass, dens, slope, rest, leaps)

    def hats(self, points: Array, sizes: Array, axis: Array) -> tuple[Array, float]:
        """Return means (V, 2 n) of both hats of all intervals around points, and what a row lacks at most."""
        t = (axis - points[:, None]) / sizes[:, None]
        low, high = self.above(t)
        area, off = self._area(t, 0.5 * low + 0.5 * high)
        width = np.diff(t, axis=1)
        # The mean of S over an interval: the hat that rises has that less S at the end, the other one S less that.
        mean, spare = np.diff(area, axis=1) / width, (np.diff(off, axis=1) + 1e-13) / width + 1e-14
        table = np.stack([low[:, :-1] - mean - spare, mean - spare - high[:, 1:]], axis=-1)
        lack = np.sum(2.0 * spare + (high - low)[:, :-1] + (high - low)[:, 1:], axis=1)
        return np.maximum(table, 0.0).reshape(len(points), -1), float(lack.max()) * OUTWARD

    def _area(self, t: Array, above: Array) -> tuple[Array, Array]:
        """Return the integral of S from -WIDEST to t, and a number that grows by what integrals are off by."""
        at = np.clip(t, -WIDEST, WIDEST)
        place = np.minimum(((at + WIDEST) * (BIN * PARTS)).astype(np.int64), len(self.fine) - 2)
        step, start = at - self.fine[place], self.middle[place]
        area = self.area[place] + 0.5 * step * (start + np.where(at == t, above, start))
        off = self.area_off[place] + step * (self.bend[place] + self.off)
        # beyond the last points S is 1 and 0, but for its tails
        beyond, (left, right) = t - at, (1.0 - self.low[0], self.high[-1])
        return area + np.minimum(beyond, 0.0), off + np.where(beyond < 0.0, left, right) * beyond

    def reach(self, probability: float) -> float:
        """Return beyond which number noise has about a probability, to either side."""
        rarer = np.maximum(self.high[1:], 1.0 - self.low[:-1][::-1]) <= probability
        return float(self.points[np.argmax(rarer)]) if rarer.any() else float(WIDEST)

    def drawn(self, z: Array) -> Array:
        """Return numbers of the law, from standard normal ones."""
        return self.law.ppf_of_normal(z) / self.unit

    def beyond(self, distance: Array, size: Array, side: int) -> Array:
        """Return upper bounds on the probability that noise goes further than a distance to one side (-1 or 1)."""
        t = np.maximum(distance, 0.0) / size * (1.0 - 4.0 * U)
        return self.above(t)[1] if side > 0 else np.asarray(1.0 - self.above(-t)[0])


Noise = Normal | Tabled


@lru_cache(maxsize=8)
def noise_of(law: Law | None, unit: float) -> Noise:
    """Return the noise of a law in units of a number; None is the normal law of that deviation."""
    if law is None or law == Gaussian(unit):
        return Normal()
    if not is_own_law(law) or law.std > unit * OUTWARD or law.envelope is None:
        raise Refused(f"the law {law.name!r} is not one that grids of vertices know")
    noise = Tabled(law, unit)
    # Bins must see all that does not fall: parts of mixtures are no wider than the unit, and two of it from the mean.
    if not noise.mean <= CENTRED:
        raise Refused(f"the mean of the noise is {noise.mean:.3g} times its deviation: add it to the dynamics")
    return noise


EVEN = ("gaussian", "laplace", "logistic", "student-t")


def _bounds(law: Law, left: Array, right: Array) -> tuple[Array, Array]:
    """Return the largest densities, and their largest slopes in size, between two points each."""
    far = np.maximum(np.abs(left), np.abs(right))
    near = np.where(left * right <= 0.0, 0.0, np.minimum(np.abs(left), np.abs(right)))
    data: Any = law
    match law.name:
        case "gaussian":
            dens = np.exp(-0.5 * (near / data.std) ** 2) / (math.sqrt(2.0 * math.pi) * data.std)
            return dens, dens * far / data.std**2
        case "laplace":
            dens = 0.5 * np.exp(-near / data.scale) / data.scale
            return dens, dens / data.scale
        case "logistic":
            dens = 0.25 / np.cosh(np.minimum(0.5 * near / data.scale, 350.0)) ** 2 / data.scale
            return dens, dens * np.tanh(0.5 * far / data.scale) / data.scale
        case "student-t":
            square, nu = data.df * data.scale**2, data.df
            dens = law_height(law) * np.exp(-0.5 * (nu + 1.0) * np.log1p(near**2 / square))
            steep = np.clip(math.sqrt(square), near, far)
            return dens, dens * (nu + 1.0) * steep / (square + steep**2)
        case "uniform":
            met = (left <= data.high) & (right >= data.low)
            return met / (data.high - data.low), np.zeros(len(left))
        case "triangular":
            low, mode, high = data.low, data.mode, data.high
            peak, at = 2.0 / (high - low), np.clip(mode, left, right)
            rise, fall = peak / (mode - low) if mode > low else 0.0, peak / (high - mode) if high > mode else 0.0
            dens = np.where(at < mode, peak - (mode - at) * rise, peak - (at - mode) * fall)
            met = (left <= high) & (right >= low)
            on_left, on_right = met & (left <= mode), met & (right >= mode)
            # where only a corner is met rounding must not leave less than 0
            return np.where(met, np.maximum(dens, 0.0), 0.0), np.maximum(rise * on_left, fall * on_right)
        case "truncated-gaussian":
            met = (left <= data.high) & (right >= data.low)
            top = min(max(0.0, data.low), data.high)
            peak = law_height(law) * math.exp(0.5 * (top / data.spread) ** 2)
            dens = met * peak * np.exp(-0.5 * (near / data.spread) ** 2)
            return dens, dens * np.minimum(far, max(abs(data.low), abs(data.high))) / data.spread**2
        case "mixture":
            parts = zip(data.weights, data.means, data.laws, strict=True)
            each = [(weight, _bounds(part, left - mean, right - mean)) for weight, mean, part in parts]
            dens, slope = (np.sum([weight * own[k] for weight, own in each], axis=0) for k in (0, 1))
            return dens, slope
    raise Refused(f"the law {law.name!r} is not one that grids of vertices know")


def _jumps(law: Law) -> list[tuple[float, float]]:
    """Return where a density jumps, and by how much."""
    data: Any = law
    match law.name:
        case "uniform":
            return [(end, 1.0 / (data.high - data.low)) for end in (data.low, data.high)]
        case "triangular":
            return [(data.mode, 2.0 / (data.high - data.low))] if data.mode in (data.low, data.high) else []
        case "truncated-gaussian":
            return [(end, float(_bounds(law, np.array([end]), np.array([end]))[0][0])) for end in (data.low, data.high)]
        case "mixture":
            parts = zip(data.weights, data.means, data.laws, strict=True)
            return [(mean + at, weight * jump) for weight, mean, part in parts for at, jump in _jumps(part)]
    return []
