"""What interpolation may add on a lattice, once more, from how much values vary within windows around its points.

Within a window around a lattice point v lies between its least value and that plus o, and noise leaves the window from
any point of the small boxes around it with a probability of at most twice the largest one at their corners: what leaves
it on one side does so most often from a corner. So an interpolant of ``g(z) = E v(z + w)`` is above g there by at most
o times what the laws allow for values up to 1, and twice the largest value times that probability on each axis
(docs/theory/boxes.md, Lemma Boxes.8). Any windows will do; how often noise leaves them is what masses of cells leave.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ....envs.systems.agents import AnyAgent
from ...certificates.cell_probabilities import AgentRecord
from ...relations.grids import FloatArray, NearWindow, near_windows, points_by_axis

SUMS = 4.0 * 2.0**-53
"""What a sum of masses is off by, for each of them."""


@dataclass(frozen=True, eq=False)
class ProximitySlack:
    """Windows around lattice points, how often noise leaves them, and what laws allow interpolation to add.

    Parameters
    ----------
    charge : array
        For values up to 1; it broadcasts to the lattice.
    cells, points : tuple of int
        Cells and lattice points per axis.
    windows : list
        Of all states, several.
    left : list
        For each window and each state with noise: (L * Z,) probabilities, from above.
    """

    interpolation_error: FloatArray
    cells: tuple[int, ...]
    points: tuple[int, ...]
    windows: list[list[NearWindow | None]]
    left: list[list[FloatArray | None]]

    @classmethod
    def of(
        cls, agent: AnyAgent, part: AgentRecord, interpolation_error: FloatArray, masses: Sequence[FloatArray]
    ) -> ProximitySlack | None:
        """Windows of an agent with laws; None where there are none, or states wrap."""
        assert agent.laws is not None
        points = points_by_axis(agent, part.lattice)
        windows = [] if np.any(agent.wrapped_axes) else near_windows(part.grid.edges, points, agent.laws)
        if not windows:
            return None
        left = [
            [None if own is None else _left(table, own) for own, table in zip(window, masses, strict=True)]
            for window in windows
        ]
        return cls(interpolation_error, part.grid.shape, tuple(len(axis) for axis in part.lattice), windows, left)

    def around(self, factor: FloatArray, most: float) -> FloatArray:
        """What is taken off at every lattice point for a factor (S,) of at most ``most``."""
        slack = np.broadcast_to(most * self.interpolation_error, self.points)
        for window, left in zip(self.windows, self.left, strict=True):
            least = largest = factor.reshape(self.cells)
            beyond = np.zeros((1,) * len(self.cells))
            for k, (own, out) in enumerate(zip(window, left, strict=True)):
                least, largest = _ends(least, own, k, False), _ends(largest, own, k, True)
                if out is not None:
                    beyond = beyond + 2.0 * out.reshape([-1 if j == k else 1 for j in range(len(self.cells))])
            vary = largest - least
            for k, own in enumerate(window):
                vary = vary if own is None else np.take(vary, own.number, axis=k)
            far = np.broadcast_to(most * beyond, vary.shape).reshape(self.points)
            slack = np.minimum(slack, self.interpolation_error * vary.reshape(self.points) + far)
        return slack


def _left(masses: FloatArray, window: NearWindow) -> FloatArray:
    """Largest probability (L * Z,) that noise leaves the window of a point from there or from a neighbour."""
    n_levels, n_means = window.first.shape
    by_level, most = masses.reshape(n_levels, n_means, -1), np.zeros((n_levels, n_means))
    for level, own in enumerate(by_level):
        # All that lies in the first cells, one more each time.
        up_to = np.concatenate([np.zeros((n_means, 1)), np.cumsum(own, axis=1)], axis=1)
        for here in range(max(0, level - 1), min(n_levels, level + 2)):
            first, last = window.first[here], window.last[here] + 1
            for shift in (-1, 0, 1):
                at = np.clip(np.arange(n_means) + shift, 0, n_means - 1)
                inside = up_to[at, last] - up_to[at, first]
                most[here] = np.maximum(most[here], 1.0 - inside + SUMS * own.shape[1])
    return most.ravel()


def _ends(values: FloatArray, window: NearWindow | None, axis: int, is_largest: bool) -> FloatArray:
    """Least or largest values along an axis over its different windows; without noise, of the cell of each point."""
    values = np.swapaxes(values, 0, axis)
    if window is None:
        outside = np.zeros((1, *values.shape[1:]))
        return np.swapaxes(np.concatenate([outside, values, outside]), 0, axis)
    first, end = window.distinct[:, 0], window.distinct[:, 1] + 1
    # Two runs of equal length, the longest power of two, cover a window from both its ends.
    runs: dict[int, NDArray] = {1: values}
    while 2 * max(runs) <= int((end - first).max()):
        size = max(runs)
        pair = runs[size][:-size], runs[size][size:]
        runs[2 * size] = np.maximum(*pair) if is_largest else np.minimum(*pair)
    found = np.empty((len(first), *values.shape[1:]))
    for size, run in runs.items():
        some = np.flatnonzero((size <= end - first) & (end - first < 2 * size))
        pair = run[first[some]], run[end[some] - size]
        found[some] = np.maximum(*pair) if is_largest else np.minimum(*pair)
    return np.swapaxes(found, 0, axis)
