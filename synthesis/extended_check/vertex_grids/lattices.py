"""Second derivatives of means on a lattice, where the noise of every state is normal and of one size, or none.

Let G(z) = E W(z + w), w normal and independent along each axis; along axes without noise W is linear from edge to edge,
and continuous. Lengths count in deviations of the noise. Points of the *lattice* are h apart along axes with noise;
along others they are both ends of every interval. Derivatives there are products of tables, one for each axis.

**Theorem.** Let z be in a box of the lattice, p any vector, and let i and j run over axes, but not twice over one
without noise. Then ``sum p_i p_j G_ij(z)`` is at most its largest value at the corners of the box, plus, for each of
its terms,

    |p_i p_j| sum_k h^2 / 8 N_k B,    k over the axes with noise.

B^2 is the mean, around a corner, of the square of W (of slopes of W along those of i and j that have no noise), less
any polynomial of fewer degrees than G is differentiated along axes with noise; and N_k^2 = exp(n h^2 / 4) prod_e
q(o_e), n axes with noise, o_e how often G_ij, and twice more along k, is differentiated along axis e, and ``q(o) =
sum_m binom(o, m)^2 (h / 2)^(2 (o - m)) m!``. First derivatives of G are at most N B, too.

*Proof.* Along an axis without noise all is linear. Along others a function is at most its multilinear interpolation,
and an eighth of the square of the step times what it bends downward (``backups``, one cell). A derivative of order o is
the mean of W times the Hermite polynomials He_o of the noise, and that of polynomials of lower degree is 0. Let c be
the corner nearest to z = c + d, |d_e| <= h / 2. The integral of |W - polynomial| |He(x - d)| phi(x - d) is at most, by
Cauchy and Schwarz, B times the root of that of He(x - d)^2 phi(x - d)^2 / phi(x), which is exp(|d|^2) E He(v + d)^2, v
standard normal; and He_o(v + d) is the sum of binom(o, m) d^(o - m) He_m(v), which are orthogonal with the squares m!.
QED

Squares of what is multilinear on a cell are at most the interpolation of those at its corners. The best polynomial of
degree 2 takes the squares of G, of first and mixed derivatives, and halves of those of second ones from the mean
square.

*Kinks.* Across an edge e of an axis k without noise W bends by a jump of its slope, whose mean kappa counts where it is
upward: if y moves by y', y'' along a side of a cell, it leaves at most kappa (|y'| + |y''|) s (1 - s) (``backups``).

By hand: numbers of tables are off by some units of densities and of what these are multiplied with, over the width of
an interval; of all intervals together that is less than a tenth of GRAIN over the square of the narrowest one. What is
further than FAR deviations away is left out: of W times a Hermite polynomial of degree 2 that leaves out at most the
integral of |x^2 - 1| phi(x) beyond it, 2 FAR phi(FAR) < 2e-15, a hundredth of GRAIN.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Self

import numpy as np
from scipy.special import ndtr

from ...checker import Refused
from ...checker.intervals import up
from ...checker.rigorous import Array, Truth, Whole
from .bands import Bands
from .closed_loops import ClosedLoop
from .images import Means, Vertices, with_vertices
from .noise_bounds import Noise, Normal

STEPS = 0.2, 0.25, 0.3, 0.4, 0.5  # of a lattice, in deviations: the first one with few points, or the last
FEW_POINTS = 250_000
GRAIN = 2e-13  # of the largest value, by which means and their derivatives are off where cells are a deviation wide
FAR = 8.6  # deviations that tables look far
FINEST = 0.02  # deviations that a cell is wide at least
MOST_POINTS, MOST_NUMBERS = 3_000_000, 30_000_000  # of a lattice, and of its tables
MOST_LOOKED, MOST_IN_ALL = (
    3000,
    15_000_000,
)  # points that a cell looks at, and all of them: what asks for more is given up
AT_ONCE = 20_000  # points that are looked at at once
GATHERED = 100.0  # products that take as long as one with a number that is looked up
SAME = 1e-15  # share of its size by which noise may vary and still count as of one size: what its bounds are rounded by


def _norm(orders: Sequence[int], noisy: Sequence[bool], step: float) -> float:
    """Return N: how much a derivative of these orders is at most, beside the root of a mean square."""
    h2, square = 0.25 * step * step, 1.0
    for order, has_noise in zip(orders, noisy, strict=True):
        if has_noise:
            terms = (math.comb(order, m) ** 2 * h2 ** (order - m) * math.factorial(m) for m in range(order + 1))
            square *= math.exp(h2) * sum(terms)
    return math.sqrt(square) * (1.0 + 1e-9)


def _tables(points: Array, edges: Array) -> list[Array]:
    """Return weights (N, 2 n) of both ends of intervals in means around points, and in their derivatives, by order."""
    t = edges - points[:, None]
    phi, tail = np.exp(-0.5 * t * t) / math.sqrt(2.0 * math.pi), ndtr(-np.abs(t))
    # probabilities as differences of the smaller tails
    right = t[:, 1:] + t[:, :-1] > 0.0
    above, below = np.where(t > 0.0, tail, 1.0 - tail), np.where(t > 0.0, 1.0 - tail, tail)
    # densities at both ends of an interval and their derivatives in z; t phi falls to 0 where phi does
    first, last, turned = phi[:, :-1], phi[:, 1:], t * phi
    mass, width = np.where(right, -np.diff(above, axis=1), np.diff(below, axis=1)), np.diff(edges)
    rising = (first - last - t[:, :-1] * mass) / width
    slope, bend = mass / width - last, (first - last) / width - turned[:, 1:]
    each = [(mass - rising, rising), (first - last - slope, slope), (turned[:, :-1] - turned[:, 1:] - bend, bend)]
    tables = [np.stack(pair, axis=-1).reshape(len(points), -1) for pair in each]
    is_near = np.repeat((t[:, 1:] > -FAR) & (t[:, :-1] < FAR), 2, axis=1)
    return [np.where(is_near, table, 0.0) for table in tables]


def _slopes(W: Array, k: int, width: Array) -> Array:
    """Return slopes along axis k at both ends of every interval of numbers (.., 2 n, ..)."""
    ends = np.moveaxis(W, k, -1)
    slopes = (ends[..., 1::2] - ends[..., ::2]) / width
    return np.moveaxis(np.repeat(slopes, 2, axis=-1), -1, k)


def _listed(first: Whole, count: Whole, strides: Sequence[int], slowest: int = 0) -> tuple[Whole, Whole]:
    """Return the places (P,) of all numbers in boxes of a table, box after box, and where each box begins (M,).

    Boxes hold ``count`` (d, M) numbers along each axis, from ``first`` on; one axis runs slowest.
    """
    order = [slowest, *(k for k in range(len(first)) if k != slowest)]
    sizes = np.prod(count, axis=0)
    begins = np.cumsum(sizes) - sizes
    within, places = np.arange(int(sizes.sum())) - np.repeat(begins, sizes), np.zeros(int(sizes.sum()), dtype=np.int64)
    inner = np.ones(len(sizes), dtype=np.int64)
    for k in order[::-1]:
        own = (within // np.repeat(inner, sizes)) % np.repeat(count[k], sizes)
        places += (np.repeat(first[k], sizes) + own) * strides[k]
        inner = inner * count[k]
    return places, begins


def _strides(shape: Sequence[int]) -> list[int]:
    return [math.prod(shape[k + 1 :]) for k in range(len(shape))]


@dataclass(frozen=True, eq=False)
class Lattice:
    """Points around a window of states: first numbers (d,), and tables of each axis by order, none without noise.

    ``deviation`` (d,) is that of the noise, 0 without any; ``shape`` counts points, ``step`` apart; ``grain``
    is what means are off by, beside the largest value.
    """

    edges: tuple[Array, ...]
    deviation: Array
    first: Array
    tables: list[list[Bands]]
    shape: tuple[int, ...]
    step: float
    grain: float

    @classmethod
    def of(cls, edges: tuple[Array, ...], deviation: Array, window: Array) -> Self:
        """Return the lattice around a window (2, d); ``Refused`` where it is too fine or too large."""
        d, noisy = len(edges), deviation > 0.0
        own = [axis / (deviation[k] if noisy[k] else 1.0) for k, axis in enumerate(edges)]
        ends = window / np.where(noisy, deviation, 1.0)
        finest = min([1.0, *(float(np.diff(own[k]).min()) for k in np.flatnonzero(noisy))])
        if not np.all(np.isfinite(ends)) or not np.all(ends[0] < ends[1]) or finest < FINEST:
            raise Refused("cells are too narrow for the noise, or a lattice has no ends")
        for step in STEPS:
            lengths = np.ceil((ends[1] - ends[0]) / step) + 1.0
            shape = [lengths[k] if noisy[k] else 2.0 * len(edges[k]) - 2.0 for k in range(d)]
            if np.prod(shape) <= FEW_POINTS:
                break
        numbers = sum(3.0 * shape[k] * 2.0 * len(edges[k]) for k in np.flatnonzero(noisy))
        if np.prod(shape) > MOST_POINTS or numbers > MOST_NUMBERS:
            raise Refused(f"a lattice of more than {MOST_POINTS} points, or of more than {MOST_NUMBERS} numbers")
        counts = tuple(int(count) for count in shape)
        points = [ends[0, k] + step * np.arange(counts[k]) for k in range(d)]
        tables = [[Bands.of(each) for each in _tables(points[k], own[k])] if noisy[k] else [] for k in range(d)]
        return cls(edges, deviation, ends[0], tables, counts, step, GRAIN / finest**2)

    @property
    def noisy(self) -> list[bool]:
        """Which axes have noise."""
        return [bool(tables) for tables in self.tables]

    def orders(self) -> list[tuple[int, ...]]:
        """Return the orders of all second derivatives, those along single axes without noise left out."""
        axes = range(len(self.edges))
        each = [tuple((k == i) + (k == j) for k in axes) for i in axes for j in axes if i <= j]
        return [own for own in each if not any(o == 2 and not has for o, has in zip(own, self.noisy, strict=True))]

    def mean_squares(self, W: Array, means: Smoothed) -> dict[tuple[int, ...], Array]:
        """Return B at all points for first derivatives, by which axes without noise slopes are taken along."""
        still, result = [k for k, has in enumerate(self.noisy) if not has], {}
        none = (0,) * W.ndim
        for chosen in (some for count in range(3) for some in itertools.combinations(still, count)):
            slopes = W
            for k in chosen:
                slopes = _slopes(slopes, k, np.diff(self.edges[k]))
            square = Smoothed(self, slopes * slopes).at(none)
            if not chosen:  # polynomials of degree 0
                square = square - means.at(none) ** 2
            square = np.maximum(square, 0.0) + 8.0 * self.grain * float(np.abs(slopes).max()) ** 2
            result[tuple(int(k in chosen) for k in range(W.ndim))] = np.sqrt(square)
        return result

    def rest_of_square(self, W: Array, means: Smoothed, root: Array) -> Array:
        """Return B at all points for third and further derivatives without slopes, from that for first ones."""
        noisy, square, d = [k for k, has in enumerate(self.noisy) if has], root**2, W.ndim
        for k in noisy:
            square = square - means.at(tuple(int(e == k) for e in range(d))) ** 2
            square = square - means.at(tuple(2 * int(e == k) for e in range(d))) ** 2 / 2.0
        for pair in itertools.combinations(noisy, 2):
            square = square - means.at(tuple(int(e in pair) for e in range(d))) ** 2
        return np.asarray(np.sqrt(np.maximum(square, 0.0) + 8.0 * self.grain * float(np.abs(W).max()) ** 2))

    def kinks(self, W: Array, k: int) -> Array:
        """Return kappa (.., n - 1, ..) at the inner edges of axis k, which has no noise."""
        ends = np.moveaxis(Smoothed(self, _slopes(W, k, np.diff(self.edges[k]))).at((0,) * W.ndim), k, -1)
        return np.moveaxis(ends[..., 2::2] - ends[..., 1:-1:2], -1, k)


@dataclass(frozen=True, eq=False)
class Smoothed:
    """Derivatives of means of numbers (2 n_1, ..) at all points of a lattice; sums along first axes are made once."""

    lattice: Lattice
    numbers: Array
    known: dict[tuple[int, ...], Array] = field(default_factory=dict)

    def at(self, orders: tuple[int, ...]) -> Array:
        """Return the derivative of these orders along the first axes, summed along those alone."""
        if not orders:
            return self.numbers
        if orders not in self.known:
            k, W, lattice = len(orders) - 1, self.at(orders[:-1]), self.lattice
            if lattice.tables[k]:
                W = lattice.tables[k][orders[-1]].along(W, k)
            elif orders[-1]:
                W = _slopes(W, k, np.diff(lattice.edges[k]))
            self.known[orders] = W
        return self.known[orders]


@dataclass(frozen=True, eq=False)
class LatticeImages:
    """Where a closed loop leads, on a lattice: what means are at vertices, and where cells look for how far they bend.

    Attributes
    ----------
    vertices : Vertices
        Means of W around the images of vertices.
    known : (S,) bool
        Cells whose images are known, and on the lattice.
    cells : (M,) int array
        Those cells, which look at few points first.
    start, count : (d, M) int arrays
        The first point along each axis, and how many there are.
    p, q : (n, d, M) arrays
        Along each side of a cell: what images move by, and by how much that varies, in deviations where there is noise.
    bends : (n, d, M) array
        By how much images may bend.
    rho : (d, M) array
        What images of cells and of their vertices may be off by.
    """

    lattice: Lattice
    vertices: Vertices
    known: Truth
    cells: Whole
    start: Whole
    count: Whole
    p: Array
    q: Array
    bends: Array
    rho: Array

    @classmethod
    def of(
        cls,
        loop: ClosedLoop,
        lattice: Lattice,
        noises: Sequence[Noise | None],
        near: float,
        vertices: Vertices | None = None,
    ) -> Self:
        """Return the images of a closed loop, of whose noise ``near`` deviations are looked at around vertices.

        Means at vertices are those around their images, unless others are given.
        """
        d, edges, noisy = len(lattice.edges), lattice.edges, lattice.noisy
        known = np.all(np.isfinite(loop.ends), axis=(0, 1)) & np.all(np.isfinite(loop.bends), axis=(0, 1))
        known &= np.all(np.isfinite(loop.slopes), axis=(0, 1, 2))
        rho, ends = with_vertices(loop, loop.ends[:, :d], loop.centre[:d])
        known &= np.all(np.isfinite(rho), axis=0) & np.all(np.isfinite(ends), axis=(0, 1))
        sizes = loop.ends[:, d:][:, noisy]
        known &= np.all(np.abs(sizes - lattice.deviation[noisy, None]) <= SAME * sizes[1], axis=(0, 1))
        unit, each = np.where(noisy, lattice.deviation, 1.0), list[tuple[Any, Any]]()
        for k, axis in enumerate(edges):
            low, high = np.where(known, ends[:, k], axis[0])
            if noisy[k]:
                # a little further than rounding may lead
                start, stop = (np.floor((low / unit[k] - lattice.first[k]) / lattice.step - 1e-6),
                               np.ceil((high / unit[k] - lattice.first[k]) / lattice.step + 1e-6))  # fmt: skip
                known &= (start >= 0) & (stop < lattice.shape[k])
            else:
                known &= (low > axis[0]) & (high < axis[-1])
                start = 2.0 * (np.searchsorted(axis, low, side="left") - 1)
                stop = 2.0 * np.searchsorted(axis, high, side="right") - 1.0
            each.append((start, stop - start + 1.0))
        start, count = (np.where(known, np.stack(own), 1.0) for own in zip(*each, strict=True))
        looked = np.where(known, np.prod(count, axis=0), 0.0)
        order = np.argsort(looked, kind="stable")
        known &= looked <= MOST_LOOKED
        known[order[np.cumsum(looked[order]) > MOST_IN_ALL]] = False
        cells = order[known[order]]
        slopes = loop.slopes[:, :, :d, cells] / unit[:, None]
        p = 0.5 * slopes[:, 0] + 0.5 * slopes[:, 1]
        q = np.maximum(up(slopes[:, 1] - p), up(p - slopes[:, 0])) + 1e-15 * np.abs(p)
        whole = [own[:, cells].astype(np.int64) for own in (start, count)]
        vertices = vertices or Means.of(loop, edges, noises, near)
        bends, rho = loop.bends[:, :d, cells] / unit[:, None], rho[:, cells] / unit[:, None]
        return cls(lattice, vertices, known, cells, whole[0], whole[1], p, q, bends, rho)

    @property
    def size(self) -> int:
        """How many numbers it holds."""
        return self.vertices.size + 3 * self.p.size + int(self._looked.sum())

    def work(self) -> float:
        """Return about how many products means at vertices and bounds on cells take."""
        points, numbers = math.prod(self.lattice.shape), sum(2 * len(axis) for axis in self.lattice.edges)
        looked, terms = float(self._looked.sum()), len(self.lattice.orders())
        return self.vertices.products + terms * (GATHERED * len(self.p) * looked + points * numbers)

    def cost(self, W: Array) -> tuple[Array, Array]:
        """Return what is taken off all corners (S,) of cells, and bounds on second derivatives (n, S)."""
        lattice, noisy, (ways, d, M) = self.lattice, self.lattice.noisy, self.p.shape
        means = Smoothed(lattice, W)
        orders, roots = lattice.orders(), lattice.mean_squares(W, means)
        grain = lattice.grain * float(np.abs(W).max())
        table = np.stack([means.at(own).ravel() for own in orders], axis=1)
        largest = {own: self._largest(root) for own, root in roots.items()}
        rest = largest | {(0,) * d: self._largest(lattice.rest_of_square(W, means, roots[(0,) * d]))}
        # p_i p_j of each term, and what it varies by
        terms, varies, spare = np.empty((M, ways, len(orders))), np.empty((M, ways, len(orders))), np.zeros((ways, M))
        far = np.abs(self.p) + self.q
        for n, own in enumerate(orders):
            i, j = (k for k, order in enumerate(own) for _ in range(order))
            both = 1.0 if i == j else 2.0
            terms[:, :, n] = both * (self.p[:, i] * self.p[:, j]).T
            most = both * far[:, i] * far[:, j]
            varies[:, :, n] = most.T - np.abs(terms[:, :, n]) + 4e-15 * most.T
            spare += most * (self._between(own) * rest[self._still(own)] + grain)
        bends = np.maximum(self._most(np.concatenate([table, np.abs(table)], axis=1), [terms, varies]), 0.0) + spare
        # What images bend, and are off by, times first derivatives; kinks where there is no noise.
        always = np.full(M, grain)
        for k in range(d):
            unit = tuple(int(e == k) for e in range(d))
            first = _norm(unit if noisy[k] else (0,) * d, noisy, lattice.step) * largest[self._still(unit)]
            at_points = self._largest(np.abs(means.at(unit))) + self._between(unit) * rest[self._still(unit)]
            first = np.minimum(first, at_points) + grain
            bends += self.bends[:, k] * first
            always += self.rho[k] * first
            if not noisy[k]:
                kappa = self._kinks(W, k) + 2.0 * self._between((0,) * d) * largest[unit] * self._planes(k)
                bends += 2.0 * (far[:, k] + self.bends[:, k]) * (kappa + grain)
        every, all_bends = np.zeros(len(self.known)), np.zeros((ways, len(self.known)))
        every[self.cells], all_bends[:, self.cells] = always, bends
        return every * (1.0 + 1e-12), all_bends * (1.0 + 1e-12)

    def _still(self, orders: Sequence[int]) -> tuple[int, ...]:
        """Return along which axes without noise slopes are taken."""
        return tuple(0 if has else order for order, has in zip(orders, self.lattice.noisy, strict=True))

    def _between(self, orders: tuple[int, ...]) -> float:
        """Return what a derivative may be above those at points, beside the root of a mean square."""
        noisy, step = self.lattice.noisy, self.lattice.step
        more = (tuple(o + 2 * (e == k) for e, o in enumerate(orders)) for k, has in enumerate(noisy) if has)
        return step * step / 8.0 * sum(_norm(own, noisy, step) for own in more)

    @cached_property
    def _looked(self) -> Whole:
        """How many points (M,) each cell looks at."""
        return np.asarray(np.prod(self.count, axis=0))

    @cached_property
    def _points(self) -> tuple[Whole, Whole]:
        """The points that cells look at, cell after cell, and where those of each cell begin."""
        return _listed(self.start, self.count, _strides(self.lattice.shape))

    def _most(self, table: Array, weights: list[Array]) -> Array:
        """Return the largest sums (n, M) of rows of a table (points, k) that each cell looks at, weights (M, n, k)."""
        (places, begins), factors = self._points, np.concatenate(weights, axis=2)
        result, first = np.zeros(factors.shape[:2]), 0
        while first < len(self.cells):
            # cells that look at as many points, some at a time
            size = int(self._looked[first])
            last = min(int(np.searchsorted(self._looked, size, side="right")), first + AT_ONCE // size + 1)
            here = places[begins[first] : begins[first] + (last - first) * size]
            looked = table[here].reshape(last - first, size, -1)
            result[first:last] = (factors[first:last] @ looked.transpose(0, 2, 1)).max(axis=2)
            first = last
        return result.T

    def _largest(self, table: Array) -> Array:
        """Return the largest number (M,) of a table that each cell looks at."""
        places, begins = self._points
        return np.asarray(np.maximum.reduceat(table.ravel()[places], begins)) if len(begins) else np.zeros(0)

    def _planes(self, k: int) -> Array:
        """Return how many inner edges (M,) of axis k the image of each cell may meet."""
        return self.count[k] // 2 - 1

    def _kinks(self, W: Array, k: int) -> Array:
        """Return sums (M,) over the edges of axis k that images may meet: of the largest kinks upward there."""
        kinks, result = np.maximum(self.lattice.kinks(W, k), 0.0), np.zeros(len(self.cells))
        met = np.flatnonzero(self._planes(k))
        if len(met):
            # For each edge that is met the largest kink, then the sum over edges.
            start, count = self.start[:, met].copy(), self.count[:, met].copy()
            start[k], count[k] = start[k] // 2, self._planes(k)[met]
            places, _ = _listed(start, count, _strides(kinks.shape), slowest=k)
            each = np.repeat(np.prod(count, axis=0) // count[k], count[k])
            most = np.maximum.reduceat(kinks.ravel()[places], np.cumsum(each) - each)
            result[met] = np.add.reduceat(most, np.cumsum(count[k]) - count[k])
        return result


def deviations_of(loop_sizes: Array, noises: Sequence[Noise | None]) -> Array:
    """Return deviations (d,) of noise of one size, from sizes (d, V); ``Refused`` if it is of another law or varies."""
    result = np.zeros(len(noises))
    for k, (noise, own) in enumerate(zip(noises, loop_sizes, strict=True)):
        if noise is not None:
            if not isinstance(noise, Normal) or not own.min() > 0.0 or own.max() - own.min() > SAME * own.max():
                raise Refused("a lattice is for normal noise of one size along each axis")
            result[k] = own[0]
    return result
