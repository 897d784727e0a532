"""Where cells of a grid lead, as planes and intervals see it: means of values at corners, and how far means bend.

The formulas are those of ``backups``, and second derivatives those of ``features``. Points and cells are cut into
blocks, which look at what is near their images only (``Images``: the lemma).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from ...checker.intervals import down, up
from ...checker.rigorous import Array, Truth, U, Whole
from .closed_loops import ClosedLoop
from .features import ROUNDED, Moves, Weights, contracted, second_derivatives
from .noise_bounds import Noise

SMALLEST = 1e-8  # noise that cells are looked through has at least, in units of about a cell (``features.LOST``)
BESIDE = 2e5  # products that a block of points costs beside its own


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


def with_vertices(loop: ClosedLoop, ends: Array, at: Array) -> tuple[Array, Array]:
    """Return what images of cells and of their corners may be off by (k, S), and ends (2, k, S), theirs among them.

    What is read at a corner, ``at`` (k, V), and where it may lead, belongs to the images of cells, too.
    """
    rho, off = loop.rho[: len(at)], loop.off[: len(at)]
    largest, least, most = (
        np.stack([loop.at_corners(own).max(axis=1) for own in table]) for table in (rho, rho - at, at + rho)
    )
    return up(largest + off), np.stack([np.minimum(ends[0], down(-least)), np.maximum(ends[1], up(most))])


def _part(W: Array, windows: tuple[slice, ...]) -> Array:
    return W[tuple(slice(2 * own.start, 2 * own.stop) for own in windows)]


class Vertices(Protocol):
    """Lower bounds on means at vertices."""

    @property
    def size(self) -> int:
        """How many numbers it holds."""

    @property
    def products(self) -> float:
        """How many products they take."""

    def below(self, W: Array) -> Array:
        """Return lower bounds (V,) for numbers at both ends of intervals."""


@dataclass(frozen=True, eq=False)
class Means:
    """Weights of means around points, by blocks of them: what is further away is left out.

    Attributes
    ----------
    blocks : list of (places, windows, d arrays (M, 2 n))
        Means of both hats of the intervals of each axis that are near, from below.
    lack, count : float, int
        What a row lacks at most along all axes, and how many numbers rows have.
    points : int
        How many points there are.
    """

    blocks: list[tuple[Whole, tuple[slice, ...], list[Array]]]
    lack: float
    count: int
    points: int

    @classmethod
    def of(cls, loop: ClosedLoop, edges: tuple[Array, ...], noises: Sequence[Noise | None], near: float) -> Means:
        """Return weights around the images of points of a closed loop; what is not known has none.

        They are numbers of a grid with these edges. Where there is noise what is more than ``near`` deviations away is
        left out.
        """
        centre, d, shape = loop.centre, len(edges), loop.points
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
        return cls(each, lack, count, centre.shape[1])

    @property
    def size(self) -> int:
        """How many numbers it holds."""
        return sum(table.size for _, _, weights in self.blocks for table in weights)

    @property
    def products(self) -> float:
        """How many products a mean around all points takes."""
        return sum(len(places) * math.prod(own.shape[1] for own in weights) for places, _, weights in self.blocks)

    def around(self, W: Array) -> Array:
        """Return means of W, which is not negative, around all points (V,)."""
        result = np.zeros(self.points)
        for places, windows, weights in self.blocks:
            result[places] = contracted(_part(W, windows), weights)
        return result

    def below(self, W: Array) -> Array:
        """Return means of W around the images of all points (V,), less what they may be above."""
        off = 1.01 * self.lack + 4.0 * U * (self.count + 8.0) * 2**W.ndim
        return self.around(W) - float(np.abs(W).max()) * off


@dataclass(frozen=True, eq=False)
class Images:
    """Where a closed loop leads: weights of means at vertices, and bounds on weights on the images of cells.

    **Lemma.** Let G be the mean of W where the next state is in a box, and else 0. F is at least G, and at most ``max W
    * P(outside)`` above it. So what is below F at corners, less that, is below G, and G bends by the features of W in
    the box, and by its jumps to 0 beyond: cells look at what is near. QED

    Attributes
    ----------
    edges : d arrays (n + 1,)
        Those of the grid, over a unit of each axis, as all other lengths: a power of 2, about as long as a cell.
    vertices : Vertices
        Means of W around the images of vertices.
    blocks : list of (places, windows, d of Weights)
        Cells of each block, intervals that are near their images, and what planes of each axis weigh from there.
    beyond : (S,)
        Upper bounds on the probability of what is not near.
    known : (S,) bool
        Cells whose images are known.
    ways : int
        Along how many axes cells lie.
    """

    edges: tuple[Array, ...]
    vertices: Vertices
    blocks: list[tuple[Whole, tuple[slice, ...], list[Weights]]]
    beyond: Array
    known: Truth
    ways: int

    @property
    def size(self) -> int:
        """How many numbers it holds."""
        return self.vertices.size + sum(own.size for _, _, weights in self.blocks for own in weights)

    def work(self) -> float:
        """Return about how many products means at vertices and bounds on cells take."""
        products = self.vertices.products
        for places, windows, weights in self.blocks:
            # of a cell with another one: what features of each axis weigh, and of pairs of them
            sized = [1.0 + own.is_sized for own in weights]
            each = sum(1.0 + own for own in sized) + sum(map(math.prod, itertools.combinations(sized, 2)))
            products += each * len(places) * math.prod(own.stop - own.start for own in windows)
        return products

    @classmethod
    def of(
        cls,
        loop: ClosedLoop,
        edges: tuple[Array, ...],
        noises: Sequence[Noise | None],
        near: float,
        vertices: Vertices | None = None,
    ) -> Images:
        """Return the images of a closed loop on a grid with these edges, ``near`` deviations of the noise far.

        Means at vertices are those around their images, unless others are given.
        """
        d, ways = len(edges), len(loop.slopes)
        # numbers in single precision that are very small count as more than they are, so none may be for its units
        units = np.exp2(np.round(np.log2([float(np.median(np.diff(axis))) for axis in edges])))
        edges, loop = tuple(axis / unit for axis, unit in zip(edges, units, strict=True)), loop.over(units)
        ends, size = loop.ends.copy(), _sizes(loop.centre[d:], noises)
        for k, noise in enumerate(noises, d):
            if noise is not None and noise.is_even:
                ends[:, k] = np.where(ends[0, k] < 0.0, -ends[::-1, k], ends[:, k])
        slopes = np.abs(loop.slopes).max(axis=1)
        known = np.all(np.isfinite(ends), axis=(0, 1)) & np.all(np.isfinite(slopes + loop.bends), axis=(0, 1))
        rho, ends = with_vertices(loop, ends, np.concatenate([loop.centre[:d], size]))
        known &= np.all(np.isfinite(rho), axis=0)
        for k, axis in enumerate(edges):
            inside = ends[0, d + k] > SMALLEST if noises[k] else (ends[0, k] > axis[0]) & (ends[1, k] < axis[-1])
            known &= inside
        ends = np.where(known, ends, 1.0)
        moved, off, first, last = list[list[Moves]](), list[tuple[Array, Array]](), [], []
        for k, axis in enumerate(edges):
            # y and sigma of cells, and how both move in each direction
            each = [
                [np.where(known, own[n, j], 0.0) for own in (slopes, loop.bends) for j in (k, d + k)]
                for n in range(ways)
            ]
            moved.append([Moves(*own) for own in each])
            off.append((np.where(known, rho[k], 0.0), np.where(known, rho[d + k], 0.0)))
            away = near * ends[1, d + k] * (noises[k] is not None)
            start, stop = _reached(ends[0, k] - away, ends[1, k] + away, axis)
            first.append(np.where(known, start, len(axis)).reshape(loop.cells))
            last.append(np.where(known, stop, 0).reshape(loop.cells))
        blocks, beyond = list[tuple[Whole, tuple[slice, ...], list[Weights]]](), np.zeros(len(known))
        for places, windows in blocks_of(np.stack(first), np.stack(last)):
            some, weights = places[known[places]], list[Weights]()
            for k, own in enumerate(windows):
                y, sigma = ends[:, k, some], ends[:, d + k, some]
                axis, noise = edges[k][own.start : own.stop + 1], noises[k]
                moves, (of_y, of_sigma) = [each.of(some) for each in moved[k]], off[k]
                rest = moves, (of_y[some], of_sigma[some])
                weights.append(
                    Weights.crossed(y, axis, *rest) if noise is None else Weights.noisy(y, sigma, axis, noise, *rest)
                )
                if noise is not None and own.start > 0:
                    beyond[some] += noise.beyond(y[0] - axis[0], sigma[1], -1)
                if noise is not None and own.stop < len(edges[k]) - 1:
                    beyond[some] += noise.beyond(axis[-1] - y[1], sigma[1], 1)
            blocks.append((some, windows, weights))
        return cls(edges, vertices or Means.of(loop, edges, noises, near), blocks, beyond, known, ways)

    def cost(self, W: Array) -> tuple[Array, Array]:
        """Return what ``rho`` and what is far may cost on each cell (S,), and bounds on second derivatives (n, S)."""
        largest = float(np.abs(W).max())
        always, bends = np.zeros(len(self.known)), np.zeros((self.ways, len(self.known)))
        for places, windows, weights in self.blocks:
            near = [axis[own.start : own.stop + 1] for axis, own in zip(self.edges, windows, strict=True)]
            always[places], bends[:, places] = second_derivatives(_part(W, windows), near, weights, largest)
        return (always + largest * self.beyond) * ROUNDED, bends * ROUNDED


def _sizes(sizes: Array, noises: Sequence[Noise | None]) -> Array:
    """Return sizes (d, V), which may have either sign where noise is the same to both sides; else nan."""
    allowed = np.array([noise is None or noise.is_even for noise in noises])
    return np.where(allowed[:, None] | (sizes >= 0.0), np.abs(sizes), np.nan)


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
