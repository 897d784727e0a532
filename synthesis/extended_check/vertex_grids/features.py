"""Second derivatives of means on cells, feature by feature: kinks and jumps of W at planes, and slopes between them.

The formulas are those of ``backups``. Features are taken in size, and weights of planes and intervals are bounded on
the image of a cell. First derivatives of means weigh features of an axis by ``A y' + B sigma'``: A has the densities of
jumps, over sigma, and the masses of slopes; B the rests of kinks, and tau times the densities of jumps, over sigma. So
mixed derivatives along any direction are sums of four products, of A or B along one axis with A or B along the other.
Planes at which W does not jump anywhere have no such feature, and axes whose noise is of one size no B.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...checker.intervals import down, up
from ...checker.rigorous import Array, U, Whole
from .noise_bounds import Noise

LOST = 1e-20  # more than what sums of 2^22 products lose that are too small, 2^-150 each: weights are below 1e18
LEAST = np.float32(1e-18)  # of numbers in single precision that are not 0
ROUNDED = 1.0 + 2.0**-26  # more than sums of 2^22 products of numbers of one sign, and their factors, are rounded by
AT_ONCE = 2**22  # numbers that are formed at once
Singles = NDArray[np.float32]


class Moves(NamedTuple):
    """How far y and sigma of an axis move along the side of each cell, and how much they bend (S,), in size."""

    y: Array
    sigma: Array
    bend: Array
    bend_of_sigma: Array

    def of(self, some: Any) -> Moves:
        """Return those of some cells."""
        return Moves(*(own[some] for own in self))


@dataclass(frozen=True, eq=False)
class Weights:
    """What planes and intervals of one axis weigh at most as seen from cells, in single precision.

    Attributes
    ----------
    mass : (S, n)
        Probabilities of intervals.
    rest : (S, n + 1) or None
        Of |R| at planes; None where the noise is of one size: what it weighs is 0 then, but for ``off``.
    jumps : (k, S, n + 1)
        Where the noise is of one size f over sigma, f' over sigma^2, and by how much f jumps, over sigma, if it does;
        else f and tau f; f', tau f', tau^2 f'; jumps of f, and those times tau.
    upward : list of (S, n + 1)
        Of kinks upward for second derivatives along each side of the cell.
    moves, off : list of Moves, pair of (S,) arrays
        Along each side of the cell, and what y and sigma may be off by.
    least : (S,)
        Least sigma; 1 without noise.
    most : pair of floats
        Most of tau f and R.
    """

    mass: Singles
    rest: Singles | None
    jumps: Singles
    upward: list[Singles]
    moves: list[Moves]
    off: tuple[Array, Array]
    least: Array
    most: tuple[float, float]

    @classmethod
    def noisy(
        cls, y: Array, sigma: Array, axis: Array, noise: Noise, moves: list[Moves], off: tuple[Array, Array]
    ) -> Weights:
        """Return weights for y and sigma between ends (2, S) as seen through noise."""
        low, high, least, most = y[0][:, None], y[1][:, None], sigma[0][:, None], sigma[1][:, None]
        is_sized = any(bool(own.sigma.any() or own.bend_of_sigma.any()) for own in moves)
        seen = noise.seen(down(axis - high), up(axis - low), least, most, is_sized)
        dens, upward = seen.dens, []
        for own in moves:
            a, b = own.y[:, None], own.sigma[:, None]
            through = dens[0] * a * a / least
            if is_sized:
                through += (2.0 * dens[1] * a * b + dens[2] * b * b) / least
            pathwise = own.y + own.bend + noise.mean_size * (own.sigma + own.bend_of_sigma)
            upward.append(rounded_up(np.minimum(through, 2.0 * pathwise[:, None])))
        jumps = [*(own / least for own in dens[:2]), *(own / least**2 for own in seen.slope)]
        if seen.leaps is not None:
            leap, far = seen.leaps
            jumps += [leap / least, leap * far / least][: 1 + is_sized]
        rest = None if seen.rest is None else rounded_up(seen.rest)
        each = np.stack([rounded_up(own) for own in jumps])
        return cls(rounded_up(seen.mass), rest, each, upward, moves, off, sigma[0], noise.largest)

    @classmethod
    def crossed(cls, y: Array, axis: Array, moves: list[Moves], off: tuple[Array, Array]) -> Weights:
        """Return weights without noise: of planes and intervals that y between ends (2, S) meets; none jumps.

        A kink costs a quarter of what y moves, as a bend of twice that does.
        """
        low, high = y[0][:, None], y[1][:, None]
        met = ((axis <= high) & (axis >= low)).astype(float)
        mass = ((axis[:-1] <= high) & (axis[1:] >= low)).astype(np.float32)
        none = np.zeros((2, *met.shape), dtype=np.float32)
        upward = [rounded_up(2.0 * met * (own.y + own.bend)[:, None]) for own in moves]
        return cls(mass, None, none, upward, moves, off, np.ones(len(mass)), (0.0, 0.0))

    @property
    def size(self) -> int:
        """How many numbers of double precision would take as much room."""
        rest = 0 if self.rest is None else self.rest.size
        return (self.mass.size + rest + self.jumps.size + sum(own.size for own in self.upward)) // 2

    @property
    def is_sized(self) -> bool:
        """Whether the size of the noise varies on some cell."""
        return self.rest is not None

    def first(self, planes: Whole) -> list[Singles]:
        """Return A (S, a + n), and B (S, n + 1 + a) where sizes of noise vary; W jumps at ``planes`` (a,)."""
        A = np.concatenate([self.jumps[0][:, planes], self.mass], axis=1)
        return [A] if self.rest is None else [A, np.concatenate([self.rest, self.jumps[1][:, planes]], axis=1)]


@dataclass(frozen=True, eq=False)
class Features:
    """Kinks, jumps and slopes of W along an axis, one after the other.

    ``planes`` (a,) are where W jumps anywhere; ``grain`` is what each feature is rounded by, as a share of the largest
    number; ``start`` is the first one that counts for first derivatives.
    """

    axis: Array
    planes: Whole
    grain: Array
    start: int

    @classmethod
    def along(cls, W: Array, k: int, axis: Array, is_sized: bool) -> Features:
        """Return which features W (.., 2 n, ..) has along an axis, whose noise is of one size or not."""
        jumps = _jumps(np.moveaxis(W, k, -1))
        planes = np.flatnonzero(np.any(jumps, axis=tuple(range(W.ndim - 1))))
        narrow = np.diff(axis).min()
        grain = np.repeat([4.0 / narrow, 2.0, 2.0 / narrow], [len(axis), len(planes), len(axis) - 1])
        return cls(axis, planes, grain, 0 if is_sized else len(axis))

    @property
    def kinks(self) -> slice:
        """Where kinks are."""
        return slice(0, len(self.axis))

    @property
    def jumps(self) -> slice:
        """Where jumps are."""
        return slice(len(self.axis), len(self.axis) + len(self.planes))

    @property
    def slopes(self) -> slice:
        """Where slopes are."""
        return slice(len(self.axis) + len(self.planes), len(self.grain))

    @property
    def first(self) -> list[slice]:
        """What A and B weigh, of the features from ``start`` on."""
        ends = (self.jumps.start, self.slopes.stop), (0, self.jumps.stop)
        return [slice(max(a - self.start, 0), b - self.start) for a, b in ends]

    def of(self, W: Array, k: int) -> Array:
        """Return the features of numbers (.., 2 n, ..) along axis k."""
        ends = np.moveaxis(W, k, -1)
        slopes = (ends[..., 1::2] - ends[..., ::2]) / np.diff(self.axis)
        none = np.zeros((*ends.shape[:-1], 1))
        kinks = np.diff(np.concatenate([none, slopes, none], axis=-1), axis=-1)
        return np.moveaxis(np.concatenate([kinks, _jumps(ends)[..., self.planes], slopes], axis=-1), -1, k)


def _jumps(ends: Array) -> Array:
    """Return by how much numbers (.., 2 n) jump at planes (.., n + 1), also to nothing beyond the last ones."""
    none = np.zeros((*ends.shape[:-1], 1))
    return np.concatenate([ends[..., ::2], none], axis=-1) - np.concatenate([none, ends[..., 1::2]], axis=-1)


def second_derivatives(
    W: Array, edges: Sequence[Array], weights: Sequence[Weights], largest: float
) -> tuple[Array, Array]:
    """Return what ``off`` may cost (M,), and second derivatives along each side (n, M), for cells of a block."""
    d, n, ways = W.ndim, len(weights[0].mass), len(weights[0].moves)
    features = [Features.along(W, k, axis, weights[k].is_sized) for k, axis in enumerate(edges)]
    always, bends = np.zeros(n), np.zeros((ways, n))
    for i, (own, mine) in enumerate(zip(features, weights, strict=True)):
        signed, others = own.of(W, i), [k for k in range(d) if k != i]
        size = np.abs(signed) + _along(64.0 * U * largest * own.grain, i, d)
        cost, bent = _single(own, mine, signed, size, i, [weights[k].mass for k in others], largest)
        always, bends = always + cost, bends + bent
        for j in others[i:]:
            other = features[j]
            both = np.abs(_since(other.of(_since(signed, i, own), j), j, other))
            grains = (_along(each.grain[each.start :], k, d) for k, each in ((i, own), (j, other)))
            both = both + 256.0 * U * largest * math.prod(grains)
            masses = [weights[k].mass for k in others if k != j]
            table = np.moveaxis(_largest_ends(both, [k for k in others if k != j]), (i, j), (-2, -1))
            bends += _mixed(rounded_up(table), (own, other), (mine, weights[j]), masses)
    # sums of numbers that are not negative, in single precision
    count = sum(4 * len(axis) for axis in edges) + 16
    return always * (1.0 + count * 2.0**-23), bends * (1.0 + count * 2.0**-23)


def _single(
    own: Features, weights: Weights, signed: Array, size: Array, i: int, masses: Sequence[Singles], largest: float
) -> tuple[Array, Array]:
    """Return what ``off`` costs (M,) along axis i, and second derivatives (n, M) of features of that axis alone."""
    count, others = len(own.axis), [k for k in range(signed.ndim) if k != i]
    upward = np.maximum(np.take(signed, range(count), axis=i), 0.0) + 64.0 * U * largest * own.grain[0]
    table = np.concatenate([upward, _since(size, i, own)], axis=i)
    total = contracted(rounded_up(np.moveaxis(_largest_ends(table, others), i, -1)), masses)
    kinks, rest = total[:, :count], total[:, count:]
    slopes, jumps = rest[:, own.slopes.start - own.start :], rest[:, own.jumps.start - own.start :]
    each = [_rows(table[:, own.planes], jumps[:, : len(own.planes)]) for table in weights.jumps]
    A, least = each[0] + _rows(weights.mass, slopes), weights.least
    if weights.rest is None:
        # kinks and jumps in size weigh for ``off`` alone: their largest are enough
        most = size.max(axis=tuple(others))
        B = weights.most[1] * most[own.kinks].sum() + weights.most[0] * most[own.jumps].sum() / least
        bends = np.stack(
            [
                _rows(weights.upward[k], kinks)
                + each[1] * y * y
                + bend * A
                + sum(2.0 * leap * (y + bend) for leap in each[2:])
                for k, (y, _, bend, _) in enumerate(weights.moves)
            ]
        )
        return weights.off[0] * A + weights.off[1] * B, bends
    dens, tau, *slope = each
    B, bends = _rows(weights.rest, rest[:, own.kinks]) + tau, np.empty((len(weights.moves), len(A)))
    for k, (y, sigma, bend, bend_of_sigma) in enumerate(weights.moves):
        bends[k] = _rows(weights.upward[k], kinks) + bend * A + bend_of_sigma * B
        bends[k] += slope[0] * y * y + 2.0 * slope[1] * y * sigma + slope[2] * sigma * sigma
        bends[k] += 2.0 * sigma * (dens * y + tau * sigma) / least
        if len(slope) > 3:
            # Where f jumps S has a kink in tau, whose derivatives are these.
            leap, far = slope[3:]
            bends[k] += 2.0 * (leap * y + far * sigma) * (1.0 + 2.0 * sigma / least)
            bends[k] += 2.0 * (leap * bend + far * bend_of_sigma)
    return weights.off[0] * A + weights.off[1] * B, bends


def _mixed(
    table: Singles, features: Sequence[Features], weights: Sequence[Weights], masses: Sequence[Singles]
) -> Array:
    """Return what mixed derivatives add to second ones (n, M), from a table (.., features, features)."""
    left, right = (own.first(each.planes) for own, each in zip(weights, features, strict=True))
    n = len(weights[0].mass)
    result = np.zeros((len(left), len(right), n))
    for some in _parts(n, table[(0,) * len(masses)].size if masses else 0):
        total = contracted(table, [own[some] for own in masses]) if masses else table
        for row, a, here in zip(result, left, features[0].first, strict=False):
            each = _product(a[some], total[..., here, :])
            for numbers, b, there in zip(row, right, features[1].first, strict=False):
                numbers[some] = _rows(b[some], each[:, there])
    moves = [[np.stack(own[:2]) for own in each.moves] for each in weights]
    return np.stack(
        [2.0 * np.einsum("abn,an,bn->n", result, y[: len(left)], z[: len(right)]) for y, z in zip(*moves, strict=True)]
    )


def contracted(table: Any, weights: Sequence[Any]) -> Any:
    """Return sums (M, ..) over the first axes of a table, each number times a weight (M, .) along every one of them."""
    if not weights:
        return np.broadcast_to(table, (1, *table.shape))
    n, flat = len(weights[0]), table.reshape(len(table), -1)
    result = np.empty((n, *table.shape[len(weights) :]), dtype=table.dtype)
    for some in _parts(n, flat.shape[1]):
        total = (weights[0][some] @ flat).reshape(-1, *table.shape[1:])
        for weight in weights[1:]:
            total = np.einsum("na,na...->n...", weight[some], total)
        result[some] = total
    return result


def _parts(n: int, numbers: int) -> list[slice]:
    """Return parts of n rows of so many numbers that are formed at once."""
    ends = np.linspace(0, n, n * numbers // AT_ONCE + 2).astype(int).tolist()
    return [slice(a, b) for a, b in zip(ends, ends[1:], strict=False) if a < b]


def _product(weights: Singles, tables: Singles) -> Singles:
    """Return weights (M, a) times one table (a, b), or one for each row (M, a, b)."""
    return weights @ tables if tables.ndim == 2 else (weights[:, None] @ tables)[:, 0]


def _rows(weights: Singles, numbers: Singles) -> Array:
    """Return sums (M,) of rows, or of one for all, each number times its weight, and what they may lose at most."""
    # sums of nothing: ``einsum`` has been seen to leave in them what stood in memory
    if not weights.shape[1]:
        return np.full(len(weights), LOST)
    sums = np.einsum("na,na->n", weights, numbers) if len(numbers) == len(weights) else weights @ numbers[0]
    return sums.astype(float) + LOST


def _largest_ends(table: Array, axes: Sequence[int]) -> Array:
    """Return the larger number of both ends of every interval along some axes."""
    for k in axes:
        ends = np.moveaxis(table, k, 0)
        table = np.moveaxis(np.maximum(ends[::2], ends[1::2]), 0, k)
    return table


def rounded_up(table: Array) -> Singles:
    """Return numbers in single precision that are no smaller: 0, or at least LEAST, whose products stay normal.

    Products with subnormal numbers take a hundred times as long.
    """
    with np.errstate(over="ignore"):
        above = np.nextafter(table.astype(np.float32), np.float32(np.inf))
    return np.where(table == 0.0, np.float32(0.0), np.maximum(above, LEAST))


def _since(table: Array, k: int, features: Features) -> Array:
    """Return the features along axis k that count for first derivatives."""
    return table[(slice(None),) * k + (slice(features.start, None),)]


def _along(numbers: Array, k: int, d: int) -> Array:
    return numbers.reshape([-1 if axis == k else 1 for axis in range(d)])
