"""What interpolation adds on a lattice, from how much values vary within reach of the noise.

With W the window of a lattice point, v between its least and its largest value there varies by o. Then interpolation in
the small boxes around the point adds at most the charge of the laws times o, and twice the largest value times the
probability that noise leaves W from a corner of these boxes (docs/theory/boxes.md, Lemma Boxes.8).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ....envs.systems.distributions import Law
from ...relations.grids import FloatArray, LatticeAxis, MeanAxis, NearWindow, ScaleAxis, near_windows

RESERVE = 1e-12
"""What is added to probabilities of leaving a window: the check finds them as what masses of cells leave."""


@dataclass(frozen=True, eq=False, repr=False)
class ProximityError:
    """Windows of a lattice, and how often noise leaves them.

    Parameters
    ----------
    shape : tuple of int
        Cells per axis.
    points : tuple of int
        Lattice points per axis.
    windows : list of list
        See ``near_windows``.
    left : list of arrays
        For each window an upper bound on how often noise leaves it from the small boxes around a point: an array that
        broadcasts to the lattice, once for each state (S_k rows, with those of its scales).
    """

    shape: tuple[int, ...]
    points: tuple[int, ...]
    windows: list[list[NearWindow | None]]
    left: list[FloatArray]

    @classmethod
    def of(
        cls,
        edges: Sequence[FloatArray],
        points: Mapping[LatticeAxis, FloatArray],
        laws: Sequence[Law],
        missing: float,
    ) -> ProximityError | None:
        """Return the windows of a lattice; None where there are none. Masses of cells miss ``missing`` in all."""
        windows = near_windows(edges, points, laws)
        if not windows:
            return None
        left = []
        for window in windows:
            total = np.zeros((1,) * len(laws))
            for k, own in enumerate(window):
                if own is not None:
                    rows = _left(edges[k], points, laws[k], k, own) + missing + RESERVE
                    total = total + rows.reshape([-1 if j == k else 1 for j in range(len(laws))])
            left.append(total)
        shape = tuple(len(own) - 1 for own in edges)
        return cls(shape, tuple(len(axis) for axis in points.values()), windows, left)

    def of_values(self, values: FloatArray, most: float, interpolation_error: FloatArray) -> FloatArray:
        """Return what is taken off at all points (Z_1, ..) for values (S,) of at most ``most``.

        ``interpolation_error``, which broadcasts to the lattice, is what laws allow for values of at most 1.
        """
        least = np.broadcast_to(most * interpolation_error, self.points).copy()
        for window, left in zip(self.windows, self.left, strict=True):
            low = high = values.reshape(self.shape)
            for k, own in enumerate(window):
                low, high = over_windows(low, own, k, np.minimum), over_windows(high, own, k, np.maximum)
            asked = interpolation_error * _at_points(high - low, window).reshape(self.points)
            asked += np.broadcast_to(2.0 * most * left, self.rows).reshape(self.points)
            np.minimum(least, asked, out=least)
        return least

    @property
    def rows(self) -> tuple[int, ...]:
        """Points of each state, with those of its scales."""
        return tuple(self.shape[k] + 2 if own is None else own.first.size for k, own in enumerate(self.windows[0]))


def _left(
    edges: FloatArray, points: Mapping[LatticeAxis, FloatArray], law: Law, k: int, window: NearWindow
) -> FloatArray:
    """Return how often noise leaves windows (L, Z) from their point or a neighbour of it, whichever is most."""
    levels, means = points.get(ScaleAxis(k), np.zeros(1)), points[MeanAxis(k)]
    low, high = edges[window.first], edges[window.last + 1]
    most = np.zeros(low.shape)
    for number, level in enumerate(levels.tolist()):
        own = law.scaled(float(np.exp(level))) if ScaleAxis(k) in points else law
        rows = slice(max(0, number - 1), number + 2)
        for step in (-1, 0, 1):
            at = means[np.clip(np.arange(len(means)) + step, 0, len(means) - 1)]
            out = own.tails(low[rows] - at)[0] + own.tails(high[rows] - at)[1] + 2.0 * own.cdf_error
            np.maximum(most[rows], out, out=most[rows])
    return most.ravel()


def _at_points(values: FloatArray, window: Sequence[NearWindow | None]) -> FloatArray:
    """Return numbers of different windows at the points that have them."""
    for k, own in enumerate(window):
        values = values if own is None else values.take(own.number, axis=k)
    return values


def over_windows(
    values: FloatArray, window: NearWindow | None, axis: int, extreme: Callable[..., NDArray]
) -> FloatArray:
    """Return the extreme values along an axis over different windows: those of ranges twice as long each time."""
    along = np.moveaxis(values, axis, 0)
    if window is None:  # a state without noise is in the cell of its point, and beyond the first and the last in none
        padding = [(1, 1)] + [(0, 0)] * (along.ndim - 1)
        return np.moveaxis(np.pad(along, padding), 0, axis)
    first, last = window.distinct.T
    powers = np.frexp((last - first + 1).astype(float))[1] - 1
    result = np.empty((len(first), *along.shape[1:]))
    width = 1
    for power in range(int(powers.max()) + 1):
        rows = np.flatnonzero(powers == power)
        result[rows] = extreme(along[first[rows]], along[last[rows] - width + 1])
        if power < powers.max():
            along, width = extreme(along[:-width], along[width:]), 2 * width
    return np.moveaxis(result, 0, axis)
