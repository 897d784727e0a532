"""Expected values of factors that are multilinear in every cell, from below, and how much they bend.

The kernel maps the numbers of a factor at the corners of cells to ``g(z) = E l(z + w)`` at every lattice point z. It
is a product over axes as before: the table of an axis holds, for each cell, the masses of its two hats, ``E (b - y) /
(b - a)`` and ``E (y - a) / (b - a)`` over the cell [a, b).

Beside each value stands a *bend*: an upper bound, at this lattice point, on how far g may be below its interpolation
between neighbouring points that are read,

    sum_k |u_k|^2 / 8 * sup (second derivative of g along u_k)^+ ,

over the steps u_k between points of the image that are read (and the steps of the lattice, where the points that are
read do not lie on it). Each direction has its supremum at a point of its own, so that the largest *sum* at any one
point would be too little. With shares a_k that sum to 1, the largest of ``s_k / a_k`` over points and directions is
enough; shares by the squares of the steps lose nothing where g bends alike in all directions.

Second derivatives come from tables, too. Between the points where they are read, they are bounded by fourth
derivatives: ``sup |d_e^2 d_u^2 g| <= max l * |e|^2 |u|^2 * (half the L1 norm of that derivative of the normal
density)``, since it integrates to 0 (docs/theory/linear.md, "The loss").
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property
from itertools import combinations_with_replacement

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from ..cells import FloatArray
from ..values import UNIT
from .kernel import LATTICE_BLOCK, REACH_DEVIATIONS, AxisTable, Kernel, gaussian_masses

FOURTH, MIXED, SQUARED = 1.40031, 0.60241, 0.4684
"""Half the L1 norms of ``phi''''``, of ``phi''' phi'`` and of ``phi'' phi''``, rounded up."""

ROUNDING_OF_BENDS = 1e-11
"""Share of the largest value that is added to a bend: far above the rounding of sums and second derivatives. Points
count as lattice points within as many lattice steps, too."""

ROUNDING_ACROSS = 1e-14
"""Share of a step by which its part across another one is rounded up."""

HAT_SLACK = 64.0
"""Units in the last place by which a density may be off near the mean, several times over."""

SMALLEST_ERROR = 1e-30
"""Error that is allowed for where densities and tails are too small to have all their digits."""

BEYOND_REACH = 3e-19
"""Upper bound on the mass of a normal distribution beyond 9 standard deviations, 2.3e-19."""


def hat_masses(means: FloatArray, edges: FloatArray, std: float) -> tuple[FloatArray, FloatArray, FloatArray, float]:
    """Return masses (Z, 2 S) of hats, from below, and their first and second derivatives by the mean.

    Parameters
    ----------
    means : (Z,) array
    edges : (S + 1,) array
    std : float

    Returns
    -------
    masses : (Z, 2 S) array
        Lower bounds on ``E (b - y) / (b - a)`` and ``E (y - a) / (b - a)`` over each cell [a, b), ``y = z + w``.
    slopes, curvatures : (Z, 2 S) arrays
        Derivatives by z, up to rounding.
    loss : float
        Upper bound on what a row of masses misses altogether.
    """
    whole, missing = gaussian_masses(means, edges, std)
    x = (edges[None, :] - means[:, None]) / std
    density = np.exp(-0.5 * x * x) / math.sqrt(2.0 * math.pi)
    width = np.diff(edges) / std
    left, right = x[:, :-1], x[:, 1:]
    fall = density[:, :-1] - density[:, 1:]
    # E (y - a)^+ over the cell, in standard deviations: the first moment is a difference of densities.
    inside = np.where(left > 0, ndtr(-left) - ndtr(-right), ndtr(right) - ndtr(left))
    upper = (fall - left * inside) / width
    tail = ndtr(-np.abs(x))
    density_error = (HAT_SLACK + 8.0 * x * x) * density
    tail_error = (20.0 + 8.0 * (1.0 + x * x)) * tail
    slack = density_error[:, :-1] + density_error[:, 1:]
    slack += (1.0 + np.abs(left)) * (tail_error[:, :-1] + tail_error[:, 1:] + 4.0 * inside)
    slack = UNIT * (slack + SMALLEST_ERROR) / width
    upper = np.clip(upper - slack, 0.0, whole)
    lower = np.maximum(whole - upper - 2.0 * slack, 0.0)
    masses = np.stack([lower, upper], axis=-1).reshape(len(means), -1)
    loss = missing + float(np.max(np.sum(6.0 * slack, axis=1)))
    # Derivatives by the mean: those of the density, with the sign turned, over the same cells.
    slope = np.stack([density[:, :-1] - inside / width, inside / width - density[:, 1:]], axis=-1) / std
    step = -fall / width
    bend = np.stack([left * density[:, :-1] + step, -right * density[:, 1:] - step], axis=-1) / std**2
    return masses, slope.reshape(masses.shape), bend.reshape(masses.shape), loss


def hat_tables(
    means: FloatArray, edges: FloatArray, std: float
) -> tuple[tuple[AxisTable, AxisTable, AxisTable], float]:
    """Return banded tables of hat masses, from below, and of their two derivatives, and what a row misses at most."""
    blocks: tuple[list, list, list] = ([], [], [])
    loss = 0.0
    for z0 in range(0, len(means), LATTICE_BLOCK):
        block_means = means[z0 : z0 + LATTICE_BLOCK]
        s0 = max(0, int(np.searchsorted(edges, block_means[0] - REACH_DEVIATIONS * std)) - 1)
        s1 = min(len(edges) - 1, int(np.searchsorted(edges, block_means[-1] + REACH_DEVIATIONS * std)))
        s0, s1 = min(s0, len(edges) - 2), max(s1, 1)
        *tables, missing = hat_masses(block_means, edges[s0 : s1 + 1], std)
        for stack, table in zip(blocks, tables, strict=True):
            stack.append((z0, z0 + len(block_means), 2 * s0, 2 * s1, table))
        loss = max(loss, missing)
    shape = (len(means), 2 * (len(edges) - 1))
    masses, slopes, curvatures = (AxisTable(shape, tuple(stack)) for stack in blocks)
    return (masses, slopes, curvatures), loss + BEYOND_REACH


@dataclass(frozen=True, eq=False, repr=False)
class LinearKernel(Kernel):
    """Kernel from lattice points to corners of cells; ``smooth`` gives values and, beside them, bends.

    Parameters
    ----------
    tables : tuple of AxisTable
        Hat masses, from below.
    loss : float
        Upper bound on the mass that one application loses to rounding, per row.
    slopes, curvatures : tuples of AxisTable
        First and second derivatives of the hat masses by the mean.
    deviations : (d,) array
        Standard deviations of the noise along the axes.
    steps : (K, d) array
        Steps u_k between points that are read.
    lattice_steps : (L, d) array
        Steps of the lattice, where points are read between its points; else empty.
    rounding : float
        Share of the largest value that is added to bends.
    """

    slopes: tuple[AxisTable, ...] = ()
    curvatures: tuple[AxisTable, ...] = ()
    deviations: FloatArray = field(default_factory=lambda: np.ones(1))
    steps: FloatArray = field(default_factory=lambda: np.zeros((0, 1)))
    lattice_steps: FloatArray = field(default_factory=lambda: np.zeros((0, 1)))
    rounding: float = 3 * ROUNDING_OF_BENDS

    @property
    def n_points(self) -> int:
        """Number of lattice points Z."""
        return math.prod(self.lattice_shape)

    def rough(self, factors: NDArray) -> NDArray:
        """Return the same without second derivatives: about right, for choosing policies and for nothing else."""
        values = super().smooth(factors)
        return np.concatenate([values, np.zeros_like(values)], axis=1)

    def smooth(self, factors: NDArray) -> NDArray:
        """Return values and bends (n, 2 Z) at every lattice point of factors (n, 2^d S), nonnegative."""
        values = super().smooth(factors)
        n, points = values.shape
        result = np.empty((n, 2 * points))
        result[:, :points] = values
        bends = result[:, points:]
        bends[...] = 0.0
        second = {pair: self._derivative(factors, pair) for pair in self._pairs}
        every = np.concatenate([self.steps, self.lattice_steps])
        for step, share in zip(every, shares_of(every / self.deviations), strict=True):
            if share == 0.0:
                continue
            weights = {(i, j): step[i] * step[j] * (0.125 if i == j else 0.25) / share for i, j in second}
            used = [(second[pair], weight) for pair, weight in weights.items() if weight]
            along = used[0][0] * used[0][1]
            for derivative, weight in used[1:]:
                along += weight * derivative
            np.maximum(bends, along, out=bends)
        bends += (self.slack + self.rounding) * factors.max(axis=1, initial=0.0)[:, None]
        return result

    @cached_property
    def slack(self) -> float:
        """What bends may be larger between the points where they are read, for factors of at most 1."""
        return slack_of(self.steps, self.lattice_steps, self.deviations)

    @cached_property
    def _pairs(self) -> list[tuple[int, int]]:
        """Pairs of axes whose second derivatives are needed."""
        every = np.concatenate([self.steps, self.lattice_steps])
        d = len(self.tables)
        return [(i, j) for i, j in combinations_with_replacement(range(d), 2) if np.any(every[:, i] * every[:, j])]

    def _derivative(self, factors: NDArray, pair: tuple[int, int]) -> NDArray:
        """Return a second derivative (n, Z) of smoothed factors, up to rounding."""
        tables = []
        for k in range(len(self.tables)):
            order = pair.count(k)
            tables.append((self.tables, self.slopes, self.curvatures)[order][k])
        return Kernel(tuple(tables)).smooth(factors)


def rounding_of_bends(pitch: FloatArray) -> float:
    """Return what is added to bends for rounding; ``pitch`` (d,) are lattice steps in standard deviations."""
    return ROUNDING_OF_BENDS * (2.0 + float(np.sum(pitch)))


def shares_of(steps: FloatArray) -> FloatArray:
    """Return the share of each step, in standard deviations (K, d), in what images bend: they sum to 1."""
    squares = np.sum(steps**2, axis=1)
    return np.asarray(squares / squares.sum())


def slack_of(steps: FloatArray, lattice_steps: FloatArray, deviations: FloatArray) -> float:
    """Return an upper bound on how much larger bends are between the points where they are read (largest value 1)."""
    every = np.concatenate([steps, lattice_steps]) / deviations
    return float(sum(_fourth(u, e) for u in every for e in every)) / 64.0


def _fourth(u: FloatArray, e: FloatArray) -> float:
    """Return a bound on ``sup |d_e^2 d_u^2 g|`` for factors of at most 1, in standard deviations."""
    length = float(e @ e)
    if length == 0.0:
        return 0.0
    # Split u into its part along e and the rest: the density is the same in every direction.
    along = abs(float(u @ e)) / math.sqrt(length)
    # Lagrange's identity: the root of a difference of squares would turn rounding into errors far above it.
    across = math.sqrt(0.5 * float(np.sum((np.outer(u, e) - np.outer(e, u)) ** 2)) / length)
    across += ROUNDING_ACROSS * math.sqrt(float(u @ u))
    return length * (FOURTH * along**2 + 2.0 * MIXED * along * across + SQUARED * across**2)


def uniform_axis(low: float, high: float, cells: int, per_cell: int, first: float, last: float) -> FloatArray:
    """Return lattice points ``low + (i + 1/2) pitch`` from about ``first`` to ``last``, ``per_cell`` to a mean cell."""
    pitch = (high - low) / (cells * per_cell)
    below, above = math.floor((first - low) / pitch), math.ceil((last - low) / pitch)
    return np.asarray(low + (np.arange(below, above) + 0.5) * pitch)
