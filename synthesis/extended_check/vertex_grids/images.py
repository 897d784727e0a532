"""Where cells of a grid lead, as planes and intervals see it: means of values at corners, and how far means bend.

The formulas are those of ``backups``: along each axis W is a sum of kinks and jumps at planes, and of slopes between
them. Points and cells are cut into blocks, which look at what is near their images only (``Images``: the lemma).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...checker.intervals import down, up
from ...checker.rigorous import Array, Truth, U, Whole
from .closed_loops import ClosedLoop, corners_of
from .noise_bounds import Noise, Seen

TINY = 1e-18  # more than what sums lose where products are too small for single precision
LEAST = np.float32(1e-18)  # of numbers in single precision that are not 0
ROUNDED = 1.0 + 2.0**-26  # more than sums of 2^22 products of numbers of one sign, and their factors, are rounded by
Singles = NDArray[np.float32]
AT_ONCE = 2**22  # numbers that are formed at once
BESIDE = 2e5  # products that a block of points costs beside its own


def _features(W: Array, k: int, edges: Array) -> Array:
    """Return kinks (n + 1), jumps (n + 1) and slopes (n), one after the other along axis k of numbers (.., 2 n, ..)."""
    ends = np.moveaxis(W, k, -1)
    low, high, nothing = ends[..., ::2], ends[..., 1::2], np.zeros((*ends.shape[:-1], 1))
    slopes = (high - low) / np.diff(edges)
    kinks = np.diff(np.concatenate([nothing, slopes, nothing], axis=-1), axis=-1)
    jumps = np.concatenate([low, nothing], axis=-1) - np.concatenate([nothing, high], axis=-1)
    return np.moveaxis(np.concatenate([kinks, jumps, slopes], axis=-1), -1, k)


def _largest_ends(table: Array, axes: Sequence[int]) -> Array:
    """Return the larger number of both ends of every interval along some axes."""
    for k in axes:
        ends = np.moveaxis(table, k, 0)
        table = np.moveaxis(np.maximum(ends[::2], ends[1::2]), 0, k)
    return table


def contracted(table: Any, weights: Sequence[Any], last: Sequence[Sequence[Any]] = ((),)) -> Any:
    """Return sums (.., n) over a table, each number times a weight (n, .) along every axis.

    ``last`` are choices of the weights of the axes that remain, one or two: a row of sums for each of them.
    """
    n = len((*weights, *last[0])[0])
    result, flat = np.empty((len(last), n), dtype=table.dtype), table.reshape(len(table), -1)
    for some in np.array_split(np.arange(n), n * flat.shape[1] // AT_ONCE + 1):
        total = table[None]
        if weights:
            total = (weights[0][some] @ flat).reshape(len(some), *table.shape[1:])
        for weight in weights[1:]:
            total = np.einsum("na,na...->n...", weight[some], total)
        for row, own in zip(result, last, strict=True):
            # all axes but the last one are gone after this
            each = total if len(own) < 2 else own[0][some] @ table if not weights else _product(own[0][some], total)
            row[some] = np.einsum("na,na->n", own[-1][some], each) if own else total
    return result if last[0] else result[0]


def _product(weights: Any, tables: Any) -> Any:
    return (weights[:, None] @ tables)[:, 0]


def blocks_of(first: Whole, last: Whole) -> Iterator[tuple[Whole, tuple[slice, ...]]]:
    """Yield blocks of a grid of points that need the intervals ``first <= s < last`` (d, n_1, ..) of each axis.

    They are the places of its points, and along each axis the intervals that all of them need. A block is cut in two
    where that saves most, as long as it saves a fifth of the products; points that need none are in no block.
    """
    d, places = len(first), np.arange(first[0].size).reshape(first.shape[1:])

    def windows(block: tuple[slice, ...]) -> list[slice]:
        here = (slice(None), *block)
        ends = first[here].reshape(d, -1).min(axis=1), last[here].reshape(d, -1).max(axis=1)
        return [slice(int(a), int(b)) for a, b in zip(*ends, strict=True)]

    def products(block: tuple[slice, ...]) -> float:
        sides = [2.0 * max(0, own.stop - own.start) for own in windows(block)]
        return BESIDE + math.prod(own.stop - own.start for own in block) * math.prod(sides)

    whole: tuple[int, ...] = places.shape
    waiting = [tuple(slice(0, count) for count in whole)]
    while waiting:
        block = waiting.pop()
        halves = []
        for k, own in enumerate(block):
            if own.stop - own.start > 1:
                middle = (own.start + own.stop) // 2
                sides = slice(own.start, middle), slice(middle, own.stop)
                halves.append([(*block[:k], side, *block[k + 1 :]) for side in sides])
        best = min(halves, key=lambda pair: sum(map(products, pair)), default=[])
        if best and sum(map(products, best)) < 0.8 * products(block):
            waiting += best
        elif all(own.start < own.stop for own in windows(block)):
            yield places[block].ravel(), tuple(windows(block))


def _reached(low: Array, high: Array, axis: Array) -> tuple[Whole, Whole]:
    """Return the first interval that meets ``low .. high``, ends included, and the one after the last."""
    first = np.clip(np.searchsorted(axis, low, side="left") - 1, 0, len(axis) - 2)
    return first, np.clip(np.searchsorted(axis, high, side="right"), first + 1, len(axis) - 1)


def with_vertices(ends: Array, at: Array, rho: Array, edges: tuple[Array, ...]) -> tuple[Array, Array]:
    """Return what images of vertices of cells may be off by (k, S), and ends (2, k, S) of images, theirs among them.

    What is read at a vertex, and where it may lead, belongs to the images of cells, too: ``at`` and ``rho`` (k, V).
    """
    shape, d = tuple(len(axis) for axis in edges), len(edges)
    largest, least, most = (
        np.stack([corners_of(own.reshape(shape), d).reshape(ends.shape[2], -1).max(axis=1) for own in table])
        for table in (rho, rho - at, at + rho)
    )
    return largest, np.stack([np.minimum(ends[0], down(-least)), np.maximum(ends[1], up(most))])


def _part(W: Array, windows: tuple[slice, ...]) -> Array:
    return W[tuple(slice(2 * own.start, 2 * own.stop) for own in windows)]


@dataclass(frozen=True, eq=False)
class Means:
    """Weights of means around points, by blocks of them: what is further away is left out.

    Attributes
    ----------
    blocks : list of (places, windows, d arrays (M, 2 n))
        Means of both hats of the intervals of each axis that are near, from below.
    lack, count : float, int
        What a row lacks at most along all axes, and how many numbers rows have.
    """

    blocks: list[tuple[Whole, tuple[slice, ...], list[Array]]]
    lack: float
    count: int

    @classmethod
    def of(cls, centre: Array, edges: tuple[Array, ...], noises: Sequence[Noise | None], near: float) -> Means:
        """Return weights around images (2 d, V) of the vertices of a grid, means first; what is not known has none.

        Where there is noise what is more than ``near`` deviations away is left out.
        """
        d, shape = len(edges), tuple(len(axis) for axis in edges)
        known, size = np.all(np.isfinite(centre), axis=0), _sizes(centre[d:], noises)
        first, last, each = [], [], []
        for k, axis in enumerate(edges):
            y = np.where(known, centre[k], axis[0])
            away = near * np.where(known, size[k], 0.0) * (noises[k] is not None)
            start, stop = _reached(y - away, y + away, axis)
            first.append(np.where(known, start, len(axis)).reshape(shape))
            last.append(np.where(known, stop, 0).reshape(shape))
        lack, count = 0.0, 0
        for places, windows in blocks_of(np.stack(first), np.stack(last)):
            some = places[known[places]]
            weights = list[Array]()
            missing = 0.0
            for k, own in enumerate(windows):
                table, off = hats_at(centre[k, some], size[k, some], edges[k][own.start : own.stop + 1], noises[k])
                weights.append(table)
                missing += off
            each.append((some, windows, weights))
            lack, count = max(lack, missing), max(count, sum(table.shape[1] for table in weights))
        return cls(each, lack, count)

    @property
    def size(self) -> int:
        """How many numbers it holds."""
        return sum(table.size for _, _, weights in self.blocks for table in weights)

    @property
    def products(self) -> float:
        """How many products a mean around all points takes."""
        return sum(len(places) * math.prod(own.shape[1] for own in weights) for places, _, weights in self.blocks)

    def around(self, W: Array, n: int) -> Array:
        """Return means of W, which is not negative, around n points (n,)."""
        result = np.zeros(n)
        for places, windows, weights in self.blocks:
            result[places] = contracted(_part(W, windows), weights)
        return result

    def below(self, W: Array) -> Array:
        """Return means of W around the images of all vertices (V,), less what they may be above."""
        off = 1.01 * self.lack + 4.0 * U * (self.count + 8.0) * 2**W.ndim
        return self.around(W, math.prod(k // 2 + 1 for k in W.shape)) - float(np.abs(W).max()) * off


@dataclass(frozen=True, eq=False)
class Weights:
    """What planes and intervals of one axis weigh at most as seen from cells, in single precision (S, .).

    ``mass`` are probabilities of intervals, ``seconds`` and ``firsts`` weights of features for second and first
    derivatives along each side of the cell, ``off`` the same for what images may be off by.
    """

    mass: Singles
    seconds: list[Singles]
    firsts: list[Singles]
    off: Singles

    @classmethod
    def of(cls, planes: Planes | Crossed, moves: Sequence[Sequence[Array]], off: Sequence[Array]) -> Weights:
        """Return the weights, for y and sigma that move and bend so far, and may be off by so much."""
        seconds = [_rounded_up(planes.second(*own)) for own in moves]
        firsts = [_rounded_up(planes.first(*own[:2])) for own in moves]
        return cls(_rounded_up(planes.mass), seconds, firsts, _rounded_up(planes.first(*off)))

    @property
    def size(self) -> int:
        """How many numbers of double precision would take as much room."""
        return (self.mass.size + self.off.size + sum(own.size for own in (*self.seconds, *self.firsts))) // 2


@dataclass(frozen=True, eq=False)
class Images:
    """Where a closed loop leads: weights of means at vertices, and bounds on weights on the images of cells.

    **Lemma.** Let G be the mean of W where the next state is in a box, and else 0. F is at least G, and at most ``max W
    * P(outside)`` above it. So what is below F at corners, less that, is below G, and G bends by the features of W in
    the box, and by its jumps to 0 beyond: cells look at what is near. QED

    Attributes
    ----------
    edges : d arrays (n + 1,)
        Those of the grid.
    vertices : Means
        Of W around the images of vertices.
    blocks : list of (places, windows, d of Weights)
        Cells of each block, intervals that are near their images, and what planes of each axis weigh from there.
    beyond : (S,)
        Upper bounds on the probability of what is not near.
    known : (S,) bool
        Cells whose images are known.
    """

    edges: tuple[Array, ...]
    vertices: Means
    blocks: list[tuple[Whole, tuple[slice, ...], list[Weights]]]
    beyond: Array
    known: Truth

    @property
    def size(self) -> int:
        """How many numbers it holds."""
        return self.vertices.size + sum(own.size for _, _, weights in self.blocks for own in weights)

    def work(self) -> float:
        """Return about how many products means at vertices and bounds on cells take."""
        d = len(self.edges)
        pairs = sum(
            len(places) * math.prod(own.stop - own.start for own in windows) for places, windows, _ in self.blocks
        )
        # of a cell with another one: its mean and all that F may bend
        return self.vertices.products + 2.0**d * (1.0 + 4.0 * d + 4.5 * d * (d - 1)) * pairs

    @classmethod
    def of(cls, loop: ClosedLoop, edges: tuple[Array, ...], noises: Sequence[Noise | None], near: float) -> Images:
        """Return the images of a closed loop, which look ``near`` deviations of the noise far."""
        d, cells = len(edges), tuple(len(axis) - 1 for axis in edges)
        ends, size = loop.ends.copy(), _sizes(loop.centre[d:], noises)
        for k, noise in enumerate(noises, d):
            if noise is not None and noise.is_even:
                ends[:, k] = np.where(ends[0, k] < 0.0, -ends[::-1, k], ends[:, k])
        slopes = np.abs(loop.slopes).max(axis=1)
        known = np.all(np.isfinite(ends), axis=(0, 1)) & np.all(np.isfinite(slopes + loop.bends), axis=(0, 1))
        rho, ends = with_vertices(ends, np.concatenate([loop.centre[:d], size]), loop.rho, edges)
        known &= np.all(np.isfinite(rho), axis=0)
        for k, axis in enumerate(edges):
            inside = ends[0, d + k] > 0.0 if noises[k] else (ends[0, k] > axis[0]) & (ends[1, k] < axis[-1])
            known &= inside
        ends = np.where(known, ends, 1.0)
        moved, off, first, last = list[list[list[Array]]](), list[list[Array]](), [], []
        for k, axis in enumerate(edges):
            # y and sigma of cells, and how both move in each direction
            moves = [
                [np.where(known, own[n, j], 0.0)[:, None] for own in (slopes, loop.bends) for j in (k, d + k)]
                for n in range(d)
            ]
            moved.append(moves)
            off.append([np.where(known, rho[j], 0.0)[:, None] for j in (k, d + k)])
            away = near * ends[1, d + k] * (noises[k] is not None)
            start, stop = _reached(ends[0, k] - away, ends[1, k] + away, axis)
            first.append(np.where(known, start, len(axis)).reshape(cells))
            last.append(np.where(known, stop, 0).reshape(cells))
        blocks, beyond = list[tuple[Whole, tuple[slice, ...], list[Weights]]](), np.zeros(len(known))
        for places, windows in blocks_of(np.stack(first), np.stack(last)):
            some, weights = places[known[places]], list[Weights]()
            for k, own in enumerate(windows):
                y, sigma = ends[:, k, some], ends[:, d + k, some]
                axis, noise = edges[k][own.start : own.stop + 1], noises[k]
                planes = Crossed.of(y, axis) if noise is None else Planes.of(y, sigma, axis, noise)
                moves = [[each[some] for each in direction] for direction in moved[k]]
                weights.append(Weights.of(planes, moves, [each[some] for each in off[k]]))
                if noise is not None and own.start > 0:
                    beyond[some] += noise.beyond(y[0] - axis[0], sigma[1], -1)
                if noise is not None and own.stop < cells[k]:
                    beyond[some] += noise.beyond(axis[-1] - y[1], sigma[1], 1)
            blocks.append((some, windows, weights))
        return cls(edges, Means.of(loop.centre, edges, noises, near), blocks, beyond, known)

    def cost(self, W: Array) -> tuple[Array, Array]:
        """Return what ``rho`` and what is far may cost on each cell (S,), and bounds on second derivatives (d, S)."""
        d, largest = W.ndim, float(np.abs(W).max())
        always, bends = np.zeros(len(self.known)), np.zeros((d, len(self.known)))
        for places, windows, weights in self.blocks:
            near = [axis[own.start : own.stop + 1] for axis, own in zip(self.edges, windows, strict=True)]
            always[places], bends[:, places] = _cost(_part(W, windows), near, weights, largest)
        return (always + largest * self.beyond) * ROUNDED, bends * ROUNDED


def _sizes(sizes: Array, noises: Sequence[Noise | None]) -> Array:
    """Return sizes (d, V), which may have either sign where noise is the same to both sides; else nan."""
    allowed = np.array([noise is None or noise.is_even for noise in noises])
    return np.where(allowed[:, None] | (sizes >= 0.0), np.abs(sizes), np.nan)


def _cost(
    W: Array,
    edges: Sequence[Array],
    weights: Sequence[Weights],
    largest: float,
) -> tuple[Array, Array]:
    """Return what ``off`` may cost (M,), and second derivatives along each axis (d, M), for the cells of a block."""
    # What each feature is rounded by, as a share of the largest number.
    grain = [
        np.repeat([4.0 / np.diff(axis).min(), 2.0, 2.0 / np.diff(axis).min()], [len(axis), len(axis), len(axis) - 1])
        for axis in edges
    ]
    d, n = W.ndim, len(weights[0].mass)
    always, bends = np.zeros(n), np.zeros((d, n))
    for i in range(d):
        signed, others = _features(W, i, edges[i]), [k for k in range(d) if k != i]
        size = np.abs(signed) + _along(64.0 * U * largest * grain[i], i, d)
        upward = np.maximum(np.take(signed, range(len(edges[i])), axis=i), 0.0)
        upward = upward + 64.0 * U * largest * grain[i][0]
        masses = [weights[k].mass for k in others]
        table = _rounded_up(np.moveaxis(_largest_ends(np.concatenate([upward, size], axis=i), others), i, -1))
        bends += contracted(table, masses, [(own,) for own in weights[i].seconds])
        always += contracted(table[..., len(edges[i]) :], masses, [(weights[i].off,)])[0]
        for j in range(i + 1, d):
            both = np.abs(_features(signed, j, edges[j]))
            both = both + 256.0 * U * largest * _along(grain[i], i, d) * _along(grain[j], j, d)
            rest = [k for k in others if k != j]
            table = _rounded_up(np.moveaxis(_largest_ends(both, rest), (i, j), (-2, -1)))
            pairs = [*zip(weights[i].firsts, weights[j].firsts, strict=True)]
            bends += 2.0 * contracted(table, [weights[k].mass for k in rest], pairs)
    # sums of numbers that are not negative, in single precision, and what is too small for it
    count = sum(own.seconds[0].shape[1] for own in weights) + 16
    return always * (1.0 + count * 2.0**-23) + TINY, bends * (1.0 + count * 2.0**-23) + TINY


def _rounded_up(table: Array) -> Singles:
    """Return numbers in single precision that are no smaller: 0, or at least LEAST, whose products stay normal.

    Products with subnormal numbers take a hundred times as long.
    """
    with np.errstate(over="ignore"):
        above = np.nextafter(table.astype(np.float32), np.float32(np.inf))
    return np.where(table == 0.0, np.float32(0.0), np.maximum(above, LEAST))


def _along(numbers: Array, k: int, d: int) -> Array:
    return numbers.reshape([-1 if axis == k else 1 for axis in range(d)])


def hats_at(points: Array, sizes: Array, axis: Array, noise: Noise | None) -> tuple[Array, float]:
    """Return means (V, 2 n) of both hats of all intervals around points (V,), and what a row lacks at most.

    Without noise they are the hats themselves. What is not known is taken for something else: its cells are given up.
    """
    points = np.where(np.isfinite(points), points, axis[0])
    if noise is not None:
        return noise.hats(points, np.where(np.isfinite(sizes) & (sizes > 0.0), sizes, 1.0), axis)
    place = np.clip(np.searchsorted(axis, points, side="right") - 1, 0, len(axis) - 2)
    share = np.clip((points - axis[place]) / np.diff(axis)[place], 0.0, 1.0)
    table = np.zeros((len(points), 2 * len(axis) - 2))
    table[np.arange(len(points)), 2 * place] = 1.0 - share
    table[np.arange(len(points)), 2 * place + 1] = share
    return table, 16.0 * U * (2.0 + float(np.abs(axis).max() / np.diff(axis).min()))


@dataclass(frozen=True, eq=False)
class Planes:
    """Planes of an axis as seen from images, for sizes of the noise of at least ``least`` (S, 1) (``noise``)."""

    seen: Seen
    least: Array
    mean_size: float

    @classmethod
    def of(cls, y: Array, sigma: Array, axis: Array, noise: Noise) -> Planes:
        """Return planes as seen from y and sigma between ends (2, S)."""
        low, high, least, most = y[0][:, None], y[1][:, None], sigma[0][:, None], sigma[1][:, None]
        return cls(noise.seen(down(axis - high), up(axis - low), least, most), least, noise.mean_size)

    @property
    def mass(self) -> Array:
        """Largest probabilities of intervals (S, n)."""
        return self.seen.mass

    def first(self, y: Array, sigma: Array) -> Array:
        """Return weights (S, 3 n + 2) of features in size, for first derivatives of y and sigma up to these (S, 1)."""
        mass, (dens, tau, _), _, rest, _ = self.seen
        return np.concatenate([rest * sigma, (dens * y + tau * sigma) / self.least, mass * y], axis=1)

    def second(self, y: Array, sigma: Array, bend: Array, bend_of_sigma: Array) -> Array:
        """Return weights (S, 4 n + 3) of kinks upward and of features in size, for derivatives up to these (S, 1)."""
        mass, (dens, tau, square), slope, rest, leaps = self.seen
        upward = (dens * y * y + 2.0 * tau * y * sigma + square * sigma * sigma) / self.least
        upward = np.minimum(upward, 2.0 * (y + bend + self.mean_size * (sigma + bend_of_sigma)))
        jumps = (slope[0] * y * y + 2.0 * slope[1] * y * sigma + slope[2] * sigma * sigma) / self.least
        jumps = (jumps + 2.0 * sigma * (dens * y + tau * sigma) / self.least + dens * bend + tau * bend_of_sigma) / (
            self.least
        )
        if leaps is not None:
            # Where f jumps S has a kink in tau, whose derivatives are these.
            leap, far = leaps
            once = (y + far * sigma) / self.least
            jumps = jumps + 2.0 * leap * (
                once + (bend + far * bend_of_sigma) / self.least + 2.0 * sigma / self.least * once
            )
        return np.concatenate([upward, rest * bend_of_sigma, jumps, mass * bend], axis=1)


@dataclass(frozen=True, eq=False)
class Crossed:
    """Planes of an axis without noise: intervals that images meet, as masses (S, n), and planes (S, n + 1)."""

    mass: Array
    met: Array

    @classmethod
    def of(cls, y: Array, axis: Array) -> Crossed:
        """Return what means between ends (2, S) meet."""
        met = (axis <= y[1][:, None]) & (axis >= y[0][:, None])
        return cls(((axis[:-1] <= y[1][:, None]) & (axis[1:] >= y[0][:, None])).astype(float), met.astype(float))

    def first(self, y: Array, sigma: Array) -> Array:
        """Return weights (S, 3 n + 2) of features in size; there are no jumps."""
        none = np.zeros_like(self.met)
        return np.concatenate([none, none, self.mass * y], axis=1)

    def second(self, y: Array, sigma: Array, bend: Array, bend_of_sigma: Array) -> Array:
        """Return weights (S, 4 n + 3): a kink costs a quarter of what y moves, as a bend of twice that does."""
        none = np.zeros_like(self.met)
        return np.concatenate([2.0 * self.met * (y + bend), none, none, self.mass * bend], axis=1)
