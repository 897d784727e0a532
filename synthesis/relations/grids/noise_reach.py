"""Windows of cells around lattice points, out of which noise rarely carries: within them values may hardly vary.

What interpolation between lattice points adds to an expected value is a share of how much values vary, and far cells
count only as often as noise reaches them (docs/theory/boxes.md, Lemma Boxes.8). The lemma holds for any windows, so
that search and check may take the same ones.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ....envs.systems.distributions import Law
from .axes_of_lattices import LatticeAxis, MeanAxis, ScaleAxis
from .grid import FloatArray

REACHES = (2.57, 5.07, 6.11, 9.13, 13.17, 19.21)
"""How far windows reach, in deviations of the noise: no round numbers, so that their ends are on no edge of a cell."""

OFTEN, HARDLY = 1e-5, 1e-9
"""How often noise may leave a window that is worth it, and how often it leaves one beyond which none is wider."""


@dataclass(frozen=True, eq=False)
class NearWindow:
    """First and last cells of the windows of all points of one state: (L, Z) arrays, by level of the scale and mean.

    Many points have the same window: ``distinct`` (U, 2) are the first and last cells of all different ones, and
    ``number`` (L * Z,) says which of them a point has.
    """

    first: NDArray[np.int64]
    last: NDArray[np.int64]
    distinct: NDArray[np.int64]
    number: NDArray[np.int64]

    @classmethod
    def of(cls, first: NDArray[np.int64], last: NDArray[np.int64]) -> NearWindow:
        """Return windows from their first and last cells."""
        most = int(last.max(initial=0)) + 1
        keys, number = np.unique(first.ravel() * most + last.ravel(), return_inverse=True)
        return cls(first, last, np.stack(np.divmod(keys, most), axis=1), number.ravel())


def near_windows(
    edges: Sequence[FloatArray], points: Mapping[LatticeAxis, FloatArray], laws: Sequence[Law]
) -> list[list[NearWindow | None]]:
    """Return windows, each with an entry for every state; None for a state without noise, which is where its mean is.

    ``points`` are those of the axes of the lattice. There are none where a law has tails too heavy to be left out.
    """
    noisy = [k for k in range(len(laws)) if MeanAxis(k) in points]
    reaches = {k: _reaches(laws[k]) for k in noisy}
    if not all(reaches.values()):
        return []
    windows: list[list[NearWindow | None]] = []
    for number in range(max(map(len, reaches.values()), default=0)):
        window: list[NearWindow | None] = [None] * len(laws)
        for k in noisy:
            reach = reaches[k][min(number, len(reaches[k]) - 1)] * laws[k].std
            around = reach * np.exp(points.get(ScaleAxis(k), np.zeros(1)))[:, None]
            means, last = points[MeanAxis(k)][None], len(edges[k]) - 2
            ends = (np.searchsorted(edges[k], end, side="right") - 1 for end in (means - around, means + around))
            window[k] = NearWindow.of(*(np.clip(end, 0, last).astype(np.int64) for end in ends))
        windows.append(window)
    return windows


def _reaches(law: Law) -> tuple[float, ...]:
    """Return how far the windows of a law reach, in deviations."""
    kept = []
    for reach in REACHES:
        below, above = law.tails(np.array([-reach, reach]) * law.std)
        left = float(below[0] + above[1])
        if not math.isfinite(left):
            return ()
        if left <= OFTEN:
            kept.append(reach)
        if left <= HARDLY:
            break
    return tuple(kept)
