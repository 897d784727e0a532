"""How far smoothed factors may be below the interpolation of their values at a few points.

Values of ``g(z) = E l(z + w)`` are read at points of the image of a cell, steps u_k apart. Between them g may be below
the interpolation by at most

    sum_k |u_k|^2 / 8 * sup (second derivative of g along u_k)^+ .

Each direction has its supremum at a point of its own, so that the largest *sum* at any one point would be too little.
With shares a_k that sum to 1, the largest of ``s_k / a_k`` over points and directions is enough; shares by the squares
of the steps lose nothing where g bends alike in all directions.

Second derivatives are differences of values at neighbouring lattice points. What these miss, and what happens between
lattice points, is a matter of fourth derivatives. Where all steps lie along the axes, these are differences again, and
what is still missing is a matter of sixth derivatives. The last ones are bounded by the density alone: they integrate
to 0, so ``(max l - min l)`` times half their L1 norm is enough. Largest and smallest value are those within `WINDOW`
deviations; what lies beyond has a small share of its own (docs/theory/linear.md, "The loss").
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations, combinations_with_replacement

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d

from ...relations.grids import FloatArray

SECOND = 0.48395
"""Half the L1 norm of ``phi''``, rounded up."""

FOURTH, MIXED, SQUARED = 1.40031, 0.60241, 0.4684
"""Half the L1 norms of ``phi''''``, of ``phi''' phi'`` and of ``phi'' phi''``, rounded up."""

SIXTH = {1: 6.9078, 2: 1.35533, 3: 0.45336}
"""Half the L1 norms of the sixth derivatives ``d_i^2 d_j^2 d_k^2`` of the normal density, by how many of the three axes
differ, rounded up."""

WINDOW = 4.5
"""Standard deviations around a mean within which a factor may vary before high derivatives count in full."""

FOURTH_BEYOND, SIXTH_BEYOND = 2.49e-3, 3.21e-2
"""Upper bounds on the L1 norms of fourth and of sixth derivatives of the normal density beyond `WINDOW` on one axis:
those of the straight ones are twice the derivative below them at 4.5, and mixed ones have less."""

WINDOW_MARGIN = 1e-6
"""Deviations by which windows are wider than they need be: an edge just where they end must not decide what the check,
which computes them again, sees of a factor."""

GROUP = 4
"""Neighbouring lattice points of an axis that share a window."""

ROUNDING_OF_BENDS = 4e-9
"""Share of the largest value that is added to a bend: far above the rounding of sums. Points count as lattice points
within as many lattice steps, too."""

LOST_PER_SUM = 1e-13
"""Share of the largest value by which sums of many products may be off."""

LONGEST = 1e6
"""Standard deviations at which steps are cut: nothing can be known of images that large, and squares stay numbers."""

ROUNDING_ACROSS = 1e-14
"""Share of a step by which its part across another one is rounded up."""

NUMBERS_AT_ONCE = 200_000
"""Numbers of a table that are formed at once: several tables fit into the cache of a core beside each other."""


@dataclass(frozen=True, eq=False, repr=False)
class SecondDerivativeBounds:
    """Bends of smoothed factors on a lattice: upper bounds, given values from below.

    Parameters
    ----------
    steps : (K, d) array
        Steps u_k between points that are read, those of the lattice among them if points lie between its own.
    lattice, edges : tuples of arrays
        Evenly spaced lattice points, and edges of the cells, of each axis.
    deviations : (d,) array
        Standard deviations of the noise along the axes.
    loss : float
        Upper bound on how far values are below those of the factors, for factors of at most 1.
    """

    steps: FloatArray
    lattice: tuple[FloatArray, ...]
    edges: tuple[FloatArray, ...]
    deviations: FloatArray
    loss: float

    def add_to(self, second_derivatives: NDArray, values: NDArray, factors: NDArray) -> None:
        """Write bends (n, Z) of values (n, Z) of factors (n, 2^d S)."""
        shape = tuple(len(axis) for axis in self.lattice)
        rows_at_once = max(1, NUMBERS_AT_ONCE // math.prod(shape))
        for first in range(0, len(values), rows_at_once):
            rows = slice(first, first + rows_at_once)
            tensor = values[rows].reshape(-1, *shape)
            second_derivatives[rows] = self._of(tensor, factors[rows]).reshape(len(tensor), -1)

    def _of(self, values: NDArray, factors: NDArray) -> NDArray:
        """Return bends (n, Z_1, ...) of values of that shape."""
        most = factors.max(axis=1, initial=0.0).reshape(-1, *(1,) * len(self.lattice))
        vary, always = self.slack
        second_derivatives = np.empty_like(values)
        # At the border of the lattice there are no neighbours to compare with.
        second_derivatives[...] = self.largest * most
        inner = (slice(None), *(slice(2, -2) for _ in self.lattice))
        seconds = {(i, j): _second_difference(values, i, j) for i, j in self._pairs}
        second_derivatives[inner] = self._along_steps(seconds)[inner]
        if self.is_aligned:
            for (i, j), weight in self._fourth_weights.items():
                second_derivatives += weight * self._fourths(seconds[i, i], most, i, j)
        second_derivatives += vary * self._variation(factors)
        return second_derivatives + (always + self._error) * most

    def _along_steps(self, seconds: dict[tuple[int, int], NDArray]) -> NDArray:
        """Return the largest ``s_k / a_k`` of all steps, from second differences, and at least 0."""
        largest = np.zeros_like(next(iter(seconds.values())))
        for weights in self._weights:
            used = [(seconds[pair], weight) for pair, weight in weights.items() if weight]
            along = used[0][0] * used[0][1]
            for difference, weight in used[1:]:
                along += weight * difference
            np.maximum(largest, along, out=largest)
        return largest

    def _fourths(self, second: NDArray, most: NDArray, i: int, j: int) -> NDArray:
        """Return bounds on how negative second differences along axis j, of those along i, are near lattice points."""
        lattice_spacing = self._in_deviations(self.lattice_spacing)
        norm = FOURTH if i == j else SQUARED
        result = np.empty_like(second)
        result[...] = norm * float(lattice_spacing[i] * lattice_spacing[j]) ** 2 * most
        inner = (slice(None), *(slice(2, -2) for _ in self.lattice))
        np.negative(_second_difference(second, j, j)[inner], out=result[inner])
        np.maximum(result, 0.0, out=result)
        for axis, reach in enumerate(self._reach_in_points.tolist()):
            result = maximum_filter1d(result, 2 * reach + 1, axis=axis + 1, mode="nearest")
        return result

    @cached_property
    def lattice_spacing(self) -> FloatArray:
        """Steps (d,) of the lattice."""
        return np.array([(axis[-1] - axis[0]) / max(len(axis) - 1, 1) for axis in self.lattice])

    def _in_deviations(self, lengths: FloatArray) -> FloatArray:
        """Return lengths in standard deviations, very long ones cut: images bend by far more than 1 all the same."""
        return np.asarray(np.clip(lengths / self.deviations, -LONGEST, LONGEST))

    @cached_property
    def is_aligned(self) -> bool:
        """Whether every step lies along one axis."""
        return bool(np.all(np.count_nonzero(self.steps, axis=1) <= 1))

    @cached_property
    def slack(self) -> tuple[float, float]:
        """What bends may be larger than differences say: see ``slack_of_steps`` and ``slack_of_axes``."""
        steps, lattice_spacing = self._in_deviations(self.steps), self._in_deviations(self.lattice_spacing)
        if not self.is_aligned:
            return slack_of_steps(steps, lattice_spacing)
        return slack_of_axes(self._fourth_weights, lattice_spacing)

    @cached_property
    def _pairs(self) -> list[tuple[int, int]]:
        """Pairs of axes whose second derivatives are needed."""
        d, steps = len(self.lattice), self.steps
        return [(i, j) for i, j in combinations_with_replacement(range(d), 2) if np.any(steps[:, i] * steps[:, j])]

    @cached_property
    def _weights(self) -> list[dict[tuple[int, int], float]]:
        """For each step what differences count for in ``s_k / a_k``."""
        moves, shares = self.steps / self.lattice_spacing, shares_of(self._in_deviations(self.steps))
        return [
            {(i, j): float(move[i] * move[j]) * (0.125 if i == j else 0.25) / float(share) for i, j in self._pairs}
            for move, share in zip(moves, shares, strict=True)
            if share > 0.0
        ]

    @cached_property
    def _fourth_weights(self) -> dict[tuple[int, int], float]:
        """What fourth differences along each pair of axes count for, if all steps lie along axes."""
        # Lattice steps (d,), squared and summed over the steps along each axis.
        squares = np.sum((self.steps / self.lattice_spacing) ** 2, axis=0)
        d = len(squares)
        pairs = combinations_with_replacement(range(d), 2)
        weights = {(i, j): float(squares[i] * squares[j]) / (64.0 if i == j else 32.0) for i, j in pairs}
        # A second difference is the mean of second derivatives around it, and may be below the one in the middle.
        for i in range(d):
            weights[i, i] += float(squares[i]) / 96.0
        return {pair: weight for pair, weight in weights.items() if weight > 0.0}

    @cached_property
    def largest(self) -> float:
        """What images can bend at most, for factors of at most 1: see `SECOND`."""
        return SECOND * float(np.sum(self._in_deviations(self.steps) ** 2)) / 8.0

    @cached_property
    def _error(self) -> float:
        """What rounding, and the loss of the values in a difference, may take off bends, for factors of at most 1."""
        sizes = 4.0 * sum(abs(weight) for weights in self._weights for weight in weights.values())
        sizes += 16.0 * sum(self._fourth_weights.values()) if self.is_aligned else 0.0
        return rounding_of_second_derivatives(self._in_deviations(self.lattice_spacing)) + sizes * (
            self.loss + LOST_PER_SUM
        )

    @cached_property
    def _reach_in_points(self) -> NDArray[np.int64]:
        """Lattice steps (d,) from a point that is read to any other of the same part, and one for differences."""
        extent = np.abs(self.steps).sum(axis=0)
        return np.ceil(extent / self.lattice_spacing - 1e-6).astype(np.int64) + 1

    @cached_property
    def _windows(self) -> list[Windows]:
        """Cells of each axis that lie within the window of lattice points."""
        # Fourth differences look two lattice steps further.
        extent = (self._reach_in_points + 2) * self.lattice_spacing
        reach = extent + (WINDOW + WINDOW_MARGIN) * self.deviations
        return [windows_of(*axis) for axis in zip(self.lattice, self.edges, reach.tolist(), strict=True)]

    def _variation(self, factors: NDArray) -> NDArray:
        """Return largest less smallest value (n, Z_1, ...) of factors (n, 2^d S) in the window of lattice points."""
        high = low = factors.reshape(len(factors), *(2 * (len(edges) - 1) for edges in self.edges))
        for k, windows in enumerate(self._windows):
            high, low = windows.largest(high, k + 1), windows.smallest(low, k + 1)
        varies = high - low
        for k, windows in enumerate(self._windows):
            varies = np.take(varies, windows.group, axis=k + 1)
        return varies


@dataclass(frozen=True, eq=False)
class Windows:
    """Runs of columns of an axis (two per cell) that the windows of groups of lattice points meet.

    Parameters
    ----------
    first, stop : (G,) int arrays
        First column of each run, and the one after its last.
    leaves : (G,) bool array
        Whether the window leaves the grid: outside factors are 0.
    group : (Z,) int array
        Group of each lattice point.
    """

    first: NDArray[np.int64]
    stop: NDArray[np.int64]
    leaves: NDArray[np.bool_]
    group: NDArray[np.int64]

    def largest(self, values: NDArray, axis: int) -> NDArray:
        """Return the largest nonnegative values in each run: the axis has one entry per group afterwards."""
        return self._reduced(np.maximum, values, axis)

    def smallest(self, values: NDArray, axis: int) -> NDArray:
        """Return the smallest nonnegative values in each run, 0 where the window leaves the grid."""
        least = self._reduced(np.minimum, values, axis)
        inside = np.where(self.leaves, 0.0, 1.0)
        return least * np.expand_dims(inside, [k for k in range(least.ndim) if k != axis])

    def _reduced(self, operation: np.ufunc, values: NDArray, axis: int) -> NDArray:
        """Return the operation over each run; one more column, never used, lets runs end at the last one."""
        padded = np.concatenate([values, np.take(values, [-1], axis=axis)], axis=axis)
        ends = np.stack([self.first, self.stop], axis=1).ravel()
        every_second = [slice(None)] * values.ndim
        every_second[axis] = slice(None, None, 2)
        return np.asarray(operation.reduceat(padded, ends, axis=axis)[tuple(every_second)])


def windows_of(lattice: FloatArray, edges: FloatArray, reach: float) -> Windows:
    """Return the runs that intervals of ``reach`` around lattice points meet, for groups of neighbouring points."""
    group = np.arange(len(lattice)) // GROUP
    begins = np.arange(0, len(lattice), GROUP)
    low, high = lattice[begins] - reach, lattice[np.minimum(begins + GROUP, len(lattice)) - 1] + reach
    last = len(edges) - 2
    first = np.clip(np.searchsorted(edges, low, "right") - 1, 0, last)
    stop = np.clip(np.searchsorted(edges, high, "left"), first + 1, last + 1)
    return Windows(2 * first, 2 * stop, (low < edges[0]) | (high > edges[-1]), group)


def _second_difference(values: NDArray, i: int, j: int) -> NDArray:
    """Return second differences of values (n, ...) along axes i and j of the lattice; 0 at the border."""
    result, d = np.zeros_like(values), values.ndim - 1

    def moved(*steps: tuple[int, int]) -> NDArray:
        start = [1] * d
        for axis, step in steps:
            start[axis] += step
        sizes = zip(start, values.shape[1:], strict=True)
        return values[(slice(None), *(slice(first, max(first, first + n - 2)) for first, n in sizes))]

    inner = result[(slice(None), *(slice(1, -1),) * d)]
    if i == j:
        np.add(moved((i, 1)), moved((i, -1)), out=inner)
        inner -= 2.0 * moved()
    else:
        np.add(moved((i, 1), (j, 1)), moved((i, -1), (j, -1)), out=inner)
        inner -= moved((i, 1), (j, -1))
        inner -= moved((i, -1), (j, 1))
        inner *= 0.25
    return result


def rounding_of_second_derivatives(lattice_spacing: FloatArray) -> float:
    """Return what is added to bends for rounding; ``lattice_spacing`` (d,) are lattice steps in standard deviations."""
    return ROUNDING_OF_BENDS * (2.0 + float(np.sum(lattice_spacing)))


def shares_of(steps: FloatArray) -> FloatArray:
    """Return the share of each step, in standard deviations (K, d), in what images bend: they sum to 1."""
    squares = np.sum(steps**2, axis=1)
    return np.asarray(squares / squares.sum())


def slack_of_axes(weights: dict[tuple[int, int], float], lattice_spacing: FloatArray) -> tuple[float, float]:
    """Return upper bounds on what bends may be larger than second and fourth differences along axes say.

    The first one times the variation of a factor within the window, plus the second one times its largest value.

    Parameters
    ----------
    weights : dict
        What fourth derivatives along each pair of axes count for, in lattice steps.
    pitch : (d,) array
        Steps of the lattice in standard deviations.
    """
    inside = beyond = 0.0
    for (i, j), weight in weights.items():
        size = weight * float(lattice_spacing[i] * lattice_spacing[j]) ** 2
        # A fourth difference is a mean around its point: off by 1/12 of a derivative for every second difference in it.
        # Between lattice points fourth derivatives are larger by 1/8 of one for every axis.
        shares = [((k == i) + (k == j)) / 12.0 + 1.0 / 8.0 for k in range(len(lattice_spacing))]
        for k, share in enumerate(shares):
            inside += size * share * float(lattice_spacing[k]) ** 2 * SIXTH[len({i, j, k})]
            beyond += size * share * float(lattice_spacing[k]) ** 2 * SIXTH_BEYOND
    return inside, len(lattice_spacing) * beyond


def slack_of_steps(steps: FloatArray, lattice_spacing: FloatArray) -> tuple[float, float]:
    """Return the same for steps (K, d) in any direction, from second differences alone, all in standard deviations."""
    inside = sum(_fourth(u, e) for u in steps for e in steps) / 64.0
    inside += sum(_of_differences(u, lattice_spacing, FOURTH, MIXED) for u in steps) / 8.0
    # Beyond the window on any axis: the coefficients of a fourth derivative are at most those of |e|_1^2 |u|_1^2.
    beyond = float(np.sum(np.sum(np.abs(steps), axis=1) ** 2)) ** 2 / 64.0 * FOURTH_BEYOND
    beyond += sum(_of_differences(u, lattice_spacing, FOURTH_BEYOND, FOURTH_BEYOND) for u in steps) / 8.0
    return float(inside), len(lattice_spacing) * float(beyond)


def _of_differences(u: FloatArray, lattice_spacing: FloatArray, straight: float, mixed: float) -> float:
    """Return how far a second derivative along u may be from differences, given bounds on fourth derivatives.

    Along one axis these are off by ``p^2 / 12`` times the straight one, with lattice spacing p, along two by
    ``(p_i^2 + p_j^2) / 6`` times the mixed ones, three times along one axis and once along the other.
    """
    squares = lattice_spacing**2
    total = straight * float(np.sum(u**2 * squares)) / 12.0
    for i, j in combinations(range(len(u)), 2):
        total += 2.0 * mixed * float(abs(u[i] * u[j]) * (squares[i] + squares[j])) / 6.0
    return total


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
