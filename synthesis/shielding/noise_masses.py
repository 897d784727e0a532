"""Masses of the noise in every cell around any mean, lower bounds: the tables of kernels, without their lattice.

A kernel knows means on a lattice, because that is all that a policy commands. A learner's input puts the mean anywhere,
so the masses are computed where it is. Only cells near the mean are looked at: what lies farther away is left out,
which keeps a lower bound.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.special import erfc

from ..cells import FloatArray

REACH = 6.0
"""Standard deviations around a mean within which cells are looked at: 2e-9 of the mass lies beyond, which no budget
notices, and the time grows with the reach."""

UNIT = 2.0**-53

OFF = 40.0
"""Units by which a tail, a density and a sum of few of them may be off, several times over: tails and densities are at
most 1, the function for tails is right to few units, and what its argument is off by counts for less than one."""


@dataclass(frozen=True, eq=False)
class NoiseAxis:
    """One axis of a grid, and the normal noise along it.

    Parameters
    ----------
    edges : (S + 1,) array
        Cell edges, in grid coordinates.
    deviation : float
        Standard deviation of the noise, in grid coordinates.
    hats : bool
        Whether factors are linear in cells, with a number at either end, or constant.
    """

    edges: FloatArray
    deviation: float
    hats: bool

    @property
    def size(self) -> int:
        """Numbers of a factor along the axis: S, or 2 S with hats."""
        return (len(self.edges) - 1) * (2 if self.hats else 1)

    def masses(self, means: FloatArray) -> FloatArray:
        """Return lower bounds (M, size) on the mass of each number around means (M,), in grid coordinates.

        Of a mean that is no number they are no numbers.
        """
        count, span = len(self.edges) - 1, self._span
        # The window of each mean: `span` cells, moved into the grid at its ends.
        first = np.searchsorted(self.edges, means - REACH * self.deviation, side="right") - 1
        first = np.clip(first, 0, count - span)
        places = first[:, None] + np.arange(span)
        t = self.edges[first[:, None] + np.arange(span + 1)]
        t -= means[:, None]
        t *= 1.0 / self.deviation
        window = hats_from_below(t, self._wide[places]) if self.hats else cells_from_below(t)
        if span == count:
            return window
        per_cell = 2 if self.hats else 1
        masses = np.zeros((len(means), self.size))
        np.put_along_axis(masses, per_cell * first[:, None] + np.arange(per_cell * span), window, axis=1)
        return masses

    @cached_property
    def _wide(self) -> FloatArray:
        """One over the width of every cell (S,), in deviations."""
        return np.asarray(self.deviation / np.diff(self.edges))

    @cached_property
    def _span(self) -> int:
        """Most cells that a window can meet."""
        last = np.searchsorted(self.edges, self.edges[1:] + 2.0 * REACH * self.deviation, side="left")
        return int(min(len(self.edges) - 1, np.max(last - np.arange(len(self.edges) - 1))))


def cells_from_below(t: FloatArray) -> FloatArray:
    """Return lower bounds (M, K) on the masses of cells with edges t (M, K + 1), in deviations from the mean."""
    above = 0.5 * erfc(t * math.sqrt(0.5))
    mass = above[:, :-1] - above[:, 1:]
    mass -= OFF * UNIT
    return np.maximum(mass, 0.0, out=mass)


def hats_from_below(t: FloatArray, wide: FloatArray) -> FloatArray:
    """Return lower bounds (M, 2 K) on the masses of both hats of cells with edges t (M, K + 1), in deviations.

    With ``c(t) = P(y > t)`` and ``g(t) = E (y - t)^+ = phi(t) - t c(t)``, the share of a cell [a, b] that a point of it
    has come is worth ``(g(a) - g(b)) / (b - a) - c(b)`` on average; the rest of ``c(a) - c(b)`` is the lower hat's.
    ``wide`` (M, K) are the numbers ``1 / (b - a)``.
    """
    above = 0.5 * erfc(t * math.sqrt(0.5))
    beyond = np.exp(-0.5 * t * t)
    beyond *= 1.0 / math.sqrt(2.0 * math.pi)
    # Numbers t are large at the ends of the window alone; what is no number concerns its own row only.
    largest = float(np.fmax.reduce(np.abs(t[:, [0, -1]]), axis=None, initial=0.0))
    beyond -= t * above
    come = beyond[:, :-1] - beyond[:, 1:]
    come *= wide
    # Differences of g lose digits in narrow cells.
    off = wide * (OFF * UNIT * (1.0 + largest))
    off += OFF * UNIT
    hats = np.empty((*come.shape, 2))
    np.subtract(above[:, :-1], come, out=hats[..., 0])
    np.subtract(come, above[:, 1:], out=hats[..., 1])
    hats -= off[..., None]
    np.maximum(hats, 0.0, out=hats)
    return hats.reshape(len(t), -1)
