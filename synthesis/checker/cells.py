"""Backups on cells: values one step earlier, from below, for one agent and one factor of the value function.

Factors are constant on cells, or linear along each axis of a cell, with a number at each of its 2^d corners. With
V(y) = E l(y + w) for a factor l and normal noise w that is independent along the axes, a choice that maps a cell by
``z + G (x - c) + r`` (``motions``) is worth V there. V is known at the points of a lattice (``distributions``).

**Theorem** (interpolation). Let I interpolate V on an even lattice with the spacing h_k, and r_k = h_k / s_k. Then

    V >= I - 1/8 sum_k D_k - L sum_k [1.40031 r_k^4 / 96 + sum_e c_ke r_k^2 r_e^2 / 64],   L the largest number of l,

D_k the largest second difference around (0 if negative), c_kk = 1.40031 and c_ke = .4684, half the L1 norms of phi''''
and of phi'' phi''. *Proof.* docs/theory/boxes.md, Lemma Boxes.7 and Lemma Boxes.3. QED

**Theorem** (images). Read I at the points of a cell that cut its sides into ``parts``, n_ki lattice steps apart along
axis i. Between them ``I(z + G (x - c) + r)`` is below its interpolation by at most

    sum_i rho_i d_i + sum_k [ sum_i b(n_ki) D_i + sum_(i<j) n_ki n_kj M_ij / 4 ],   b(n) = n/4 or (n^2 + 1)/8 for n > 1,

d_i the largest first and M_ij the largest mixed differences around. *Proof.* docs/theory/linear.md, "One reading for
all". QED So a function that is multilinear in the cell and at most I less all this at the points that are read, is a
lower bound in the cell (``_multilinear_below``).
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .motions import Maps
from .rigorous import Array, Truth, U, Whole

# Half the L1 norms of phi'''' and of phi'' phi'', and phi(0), rounded up.
FOURTH, CROSSED, DENSITY = 1.40031, 0.46840, 0.39895
# Differences are looked up at the position plus LOOK, rounded down: at most BESIDE from it, next lattice point
# included. With a half it would be left to rounding which point that is.
LOOK, BESIDE = 0.37, 1.63
NOTHING = 1e-50  # smaller values count as 0: their digits are not to be trusted
AT_ONCE = 3_000_000  # numbers that are formed at once


@dataclass(frozen=True, eq=False)
class Grid:
    """Cells of one agent by the edges along each axis, and lattice points; factors have numbers at cells or corners."""

    edges: tuple[Array, ...]
    lattice: tuple[Array, ...]
    corners: bool
    parts: int

    @property
    def shape(self) -> tuple[int, ...]:
        """Numbers of cells along the axes."""
        return tuple(len(axis) - 1 for axis in self.edges)

    @property
    def places(self) -> int:
        """Number of places at which factors have numbers: cells, or their corners."""
        return int(np.prod(self.shape)) * (2 ** len(self.shape) if self.corners else 1)


@dataclass(frozen=True, eq=False)
class Kernel(Grid):
    """How one agent moves on its cells: tables along each axis, maps of its inputs, and what targets are off.

    Choices below ``inputs`` are inputs, further ones are points of the lattice, which are targets.
    """

    deviations: Array
    tables: tuple[Array, ...]
    lack: float
    inputs: int
    maps: Maps
    target_rest: Array

    @cached_property
    def spacing(self) -> Array:
        """Lattice spacing (d,)."""
        return np.array([(axis[-1] - axis[0]) / max(1, len(axis) - 1) for axis in self.lattice])

    @cached_property
    def reach(self) -> list[int]:
        """Lattice steps around an image within which differences are looked at: as far as the largest one reaches."""
        # Half sides of cells times G, in lattice steps: how far images reach.
        half = self._half(self.maps.numbers // max(1, self.inputs))
        extent = np.einsum("nkj,nj->nk", np.abs(self.maps.G), half) + self.maps.rho
        known = np.all(np.isfinite(extent), axis=1)
        steps = (extent[known] / self.spacing).max(axis=0, initial=0.0)
        return [int(np.ceil(min(step, len(axis)) + BESIDE + 1e-9)) for step, axis in zip(steps, self.lattice)]

    @cached_property
    def slack(self) -> float:
        """What is taken off for what differences miss, uneven lattices, and rounding, as a share of L."""
        d, ratios = len(self.shape), self.spacing / self.deviations
        crossed = np.where(np.eye(d), FOURTH, CROSSED) * np.outer(ratios, ratios) ** 2 / 64.0
        missed = float(np.sum(FOURTH * ratios**4 / 96.0) + np.sum(crossed))
        # Values belong to points that are off an even lattice by so many steps, and positions are rounded; a shift by
        # one step changes V by at most DENSITY r L. Uneven values enter the interpolant and, four times, each eighth.
        shift = 0.0
        for axis, step, r in zip(self.lattice, self.spacing, ratios):
            uneven = np.abs(axis - (axis[0] + step * np.arange(len(axis)))).max() / step
            rounded = 8.0 * U * (len(axis) + np.abs(axis).max() / step)
            shift += DENSITY * r * ((1.0 + 0.5 * d) * (uneven + rounded) + rounded)
        # interpolation adds 2^d products of d factors, and forms add a few numbers of at most L
        return float(missed + 2.0 * shift + self.lack * (1.0 + 0.25 * d) + 64.0 * 2**d * U)

    def _half(self, cells: Whole) -> Array:
        """Half widths (n, d) of cells."""
        places = np.unravel_index(cells, self.shape)
        return 0.5 * np.stack([np.diff(edges)[k] for edges, k in zip(self.edges, places)], axis=1)

    def means(self, functions: Array) -> Array:
        """Return means (n, Z_1, ..) of functions (n, places) around lattice points, as they are rounded."""
        # Noise is independent along the axes: one table after the other.
        tensor = functions.reshape(len(functions), *(table.shape[1] for table in self.tables))
        for k, table in enumerate(self.tables, start=1):
            tensor = np.moveaxis(np.tensordot(tensor, table, axes=(k, 1)), -1, k)
        return tensor

    def values(self, factors: Array) -> Array:
        """Return V (n, Z_1, ..) of factors (n, places) at the lattice, from below."""
        tensor, count = self.means(factors), sum(table.shape[1] for table in self.tables)
        return np.asarray(np.where(tensor < NOTHING, 0.0, tensor * (1.0 - 2.0 * (count + 4.0) * U)))

    def backup(self, values: Array, largest: Array, policy: Whole) -> Array:
        """Return factors (n, places) one step earlier, at most the truth on every cell; 0 where nothing is chosen.

        ``values`` (n, Z_1, ..) and ``largest`` (n,) are V and the largest numbers of the factors one step later.
        """
        result = np.zeros((len(values), len(policy), 2 ** len(self.shape) if self.corners else 1))
        if not len(values):
            return result.reshape(0, self.places)
        aimed, moving = np.flatnonzero(policy >= self.inputs), np.flatnonzero((policy >= 0) & (policy < self.inputs))
        # A target is one lattice point, up to a rest that changes V by at most the largest density.
        off = float(np.sum(self.target_rest * DENSITY / self.deviations)) * (1.0 + 8.0 * U)
        at = values.reshape(len(values), -1)[:, policy[aimed] - self.inputs] - off * largest[:, None]
        result[:, aimed] = np.maximum(at, 0.0)[:, :, None]
        # Under inputs means move with the state: V is read at the corners of ``parts`` pieces of every side.
        d, around = len(self.shape), _differences(values, self.reach) if len(moving) else []
        share = np.array(list(itertools.product(np.linspace(0.0, 1.0, self.parts + 1), repeat=d)))
        corners = np.array(list(itertools.product((0.0, 1.0), repeat=d)))
        blend = np.prod(np.where(corners[:, None] == 1.0, share, 1.0 - share), axis=2)
        pieces = len(moving) * len(largest) * len(share) // AT_ONCE + 1
        for some in np.array_split(moving, pieces) if len(moving) else ():
            at, lacking, inside = self._images(values, around, largest, some, policy[some], share)
            if self.corners:
                below = _multilinear_below(at, lacking, blend, share)
            else:
                below = np.maximum(at.min(axis=2) - lacking, 0.0)[:, :, None]
            result[:, some] = below * inside[:, None]
        return _by_place(result, self.shape) if self.corners else result[:, :, 0]

    def _images(
        self, values: Array, around: list[Array], largest: Array, cells: Whole, choices: Whole, share: Array
    ) -> tuple[Array, Array, Truth]:
        """Return I (n, C, K) at images of points ``share`` (K, d), what it may lack (n, C), and which are known."""
        d, shape = len(self.shape), np.array(values.shape[1:])
        # Every choice in the policy has a map: they were made from it.
        at = np.searchsorted(self.maps.numbers, cells * self.inputs + choices)
        z, G, rho = self.maps.z[at], self.maps.G[at], self.maps.rho[at]
        first = np.array([axis[0] for axis in self.lattice])
        position, rest = (z - first) / self.spacing, rho / self.spacing * (1.0 + 4.0 * U)
        moved = G * self._half(cells)[:, None, :] / self.spacing[:, None]  # lattice steps along axis i for side k
        extent = np.abs(moved).sum(axis=2) + rest
        with np.errstate(invalid="ignore"):
            inside = np.all((position - extent >= 1.0) & (position + extent <= shape - 2.0), axis=1)
            inside &= np.all(extent + BESIDE <= np.array(self.reach), axis=1)
        position, rest = (np.where(inside[:, None], x, 1.0) for x in (position, rest))
        moved = np.where(inside[:, None, None], moved, 0.0)
        # Where all of the image lies on the lattice, I is read; elsewhere the value is 0.
        found = _interpolated(values, position[:, None] + np.einsum("cik,qk->cqi", moved, 2.0 * share - 1.0))
        # Between the points that are read: second differences by how often lattice planes are crossed,
        steps = 2.0 * np.abs(moved) / self.parts
        bends = np.where(steps < 1.0, steps / 4.0, (steps * steps + 1.0) / 8.0).sum(axis=2)
        weights = [bends[:, k] + 0.125 for k in range(d)]
        # mixed differences within squares of the lattice, and first ones by how far the mean may be off.
        weights += [(steps[:, i] * steps[:, j]).sum(axis=1) / 4.0 for i, j in itertools.combinations(range(d), 2)]
        weights += [rest[:, k] for k in range(d)]
        blocks = np.array(_blocks(self.reach))
        looked = tuple((np.floor(position + LOOK).astype(np.int64) // blocks).T)
        # And for V itself, which is not I: an eighth of second differences, in weights, and the constant.
        lacking = np.repeat(self.slack * largest[:, None], len(cells), axis=1)
        for weight, table in zip(weights, around, strict=True):
            lacking += weight * table[(slice(None), *looked)]
        return found, lacking * (1.0 + 16.0 * U), inside


def _by_place(numbers: NDArray[Any], shape: tuple[int, ...]) -> NDArray[Any]:
    """Return numbers (n, S, 2^d) of cells and corners as (n, places): axis by axis, both ends of each interval."""
    d = len(shape)
    order = [0, *(axis for k in range(d) for axis in (1 + k, 1 + d + k))]
    table = numbers.reshape(len(numbers), *shape, *(2,) * d).transpose(order)
    return table.reshape(len(numbers), int(np.prod(table.shape[1:])))


def _differences(values: Array, reach: list[int]) -> list[Array]:
    """Return the largest positive second, mixed and first differences (these without sign) around blocks of points."""
    d, tables = values.ndim - 1, []
    for k in range(1, d + 1):
        tables.append(_placed(np.maximum(np.diff(values, 2, axis=k), 0.0), values.shape, (k,), 1))
    for i, j in itertools.combinations(range(1, d + 1), 2):
        tables.append(_placed(np.abs(np.diff(np.diff(values, axis=i), axis=j)), values.shape, (i, j), 0))
    for k in range(1, d + 1):
        tables.append(_placed(np.abs(np.diff(values, axis=k)), values.shape, (k,), 0))
    return [_largest(table, reach) for table in tables]


def _placed(table: Array, shape: tuple[int, ...], axes: tuple[int, ...], first: int) -> Array:
    """Return differences along some axes at the number of their lattice point, 0 where neighbours are missing."""
    result = np.zeros(shape)
    result[tuple(slice(first, first + n) if k in axes else slice(None) for k, n in enumerate(table.shape))] = table
    return result


def _blocks(reach: list[int]) -> list[int]:
    """Return how many lattice points a block has along each axis: any numbers will do."""
    return [max(1, steps // 3) for steps in reach]


def _largest(table: Array, reach: list[int]) -> Array:
    """Return the largest numbers of every block and of all blocks within reach of it."""
    for axis, (steps, size) in enumerate(zip(reach, _blocks(reach), strict=True), start=1):
        wide = np.moveaxis(table, axis, 0)
        wide = np.concatenate([wide, np.zeros((-len(wide) % size, *wide.shape[1:]))])
        wide = wide.reshape(-1, size, *wide.shape[1:]).max(axis=1)
        best = wide.copy()
        for k in range(1, min(-(-steps // size), len(wide) - 1) + 1):
            np.maximum(best[:-k], wide[k:], out=best[:-k])
            np.maximum(best[k:], wide[:-k], out=best[k:])
        table = np.moveaxis(best, 0, axis)
    return table


def _interpolated(values: Array, position: Array) -> Array:
    """Return the multilinear interpolant (n, C, K) of numbers (n, Z_1, ..) at positions (C, K, d) in lattice steps."""
    shape = values.shape[1:]
    base = np.clip(np.floor(position).astype(np.int64), 0, np.array(shape) - 2)
    share, flat = position - base, values.reshape(len(values), -1)
    result = np.zeros((len(values), *position.shape[:2]))
    for corner in itertools.product((0, 1), repeat=len(shape)):
        weight = np.prod(np.where(np.array(corner) == 1, share, 1.0 - share), axis=2)
        result += weight * flat[:, np.ravel_multi_index(tuple(np.moveaxis(base + np.array(corner), 2, 0)), shape)]
    return result


BETTER = 1.0 - 1e-6  # share of a mean by which a later form has to be better than an earlier one


def _multilinear_below(at: Array, lacking: Array, blend: Array, share: Array) -> Array:
    """Return corners (n, C, 2^d) of a multilinear function that is at most ``at - lacking``, or 0, at all points read.

    Three forms are such functions: the corners moved down if none becomes negative, the corners scaled down, and a
    constant; the one with the largest mean is taken (docs/theory/linear.md, "The loss").
    """
    # Corner values, and what they interpolate at the points that are read.
    corners = at[:, :, np.flatnonzero(np.all((share == 0.0) | (share == 1.0), axis=1))]
    between = corners @ blend
    sure = np.maximum(at - lacking[:, :, None], 0.0)
    constant, shift = sure.min(axis=2), np.maximum(between - at, 0.0).max(axis=2) + lacking
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.where(between > 0.0, sure / between, np.where(at >= lacking[:, :, None], 1.0, 0.0))
    scale = np.minimum(1.0, ratio.min(axis=2)) * (1.0 - 8.0 * U)
    moved, scaled, mean = corners - shift[:, :, None], scale[:, :, None] * corners, corners.mean(axis=2)
    # The first form wins unless another one is better by more than rounding.
    result = np.where((scale * mean >= BETTER * constant)[:, :, None], scaled, constant[:, :, None])
    take = np.all(moved >= 0.0, axis=2) & (mean - shift >= BETTER * np.maximum(scale * mean, constant))
    return np.asarray(np.where(take[:, :, None], moved, result))


@dataclass(frozen=True, eq=False)
class Cells:
    """Cells of one agent: kernel, sets (K, S), policy (T or 1, Q, S); weights of starts in each set, from below."""

    kernel: Kernel
    sets: Truth
    policy: Whole
    start: Array

    def sets_at(self, t: int) -> Truth:
        """Return the sets (K, S) of cells: at all times the same."""
        return self.sets

    def policy_at(self, t: int, q: int) -> Whole:
        """Return the choice (S,) of each cell, -1 for none."""
        return self.policy[min(t, len(self.policy) - 1), q]


def spread(sets: Truth, kernel: Kernel) -> Truth:
    """Return sets (n, S) of cells at the places of factors."""
    if not kernel.corners:
        return sets
    return _by_place(np.repeat(sets[:, :, None], 2 ** len(kernel.shape), axis=2), kernel.shape)


def start_weights(start: Array, edges: Sequence[Array], corners: bool) -> Array:
    """Return lower bounds (places,) on the weights of cells, or of their corners, for a uniform start in a box."""
    weights = np.ones(1)
    for axis, a, b in zip(edges, *start.tolist(), strict=True):
        left, right = axis[:-1], axis[1:]
        if a == b:  # a point lies in one cell, the last one with its upper face
            mass = ((left <= a) & (a < right)).astype(float)
            mass[-1] = float(left[-1] <= a <= right[-1])
            middle = np.full(len(left), a)
        else:
            first, last = np.maximum(left, a), np.minimum(right, b)
            mass = np.maximum(last - first, 0.0) / (b - a) * (1.0 - 4.0 * U)
            middle = 0.5 * first + 0.5 * last
        if corners:
            # the mean of the rising hat over a part of a cell is its value in the middle of the part
            off = 8.0 * U * (np.abs(middle) + np.abs(left)) / (right - left) + 4.0 * U
            rising = np.clip((middle - left) / (right - left), 0.0, 1.0)
            if a == b:  # a point on a face is all of one corner; middles of boxes are rounded
                off = np.where((left == a) | (right == a), 0.0, off)
            low, rest = np.maximum(rising - off, 0.0), np.maximum(1.0 - rising - off, 0.0)
            mass = np.stack([mass * rest, mass * low], axis=1).ravel()
        weights = (weights[:, None] * mass).ravel() * (1.0 - 4.0 * U * (len(weights) > 1))
    return weights
