"""Masses of the noise in every cell around any mean, lower bounds: the tables of kernels, without their lattice.

A kernel knows means on a lattice, because that is all that a policy commands. A learner's input puts the mean
anywhere, so the masses are computed where it is. Every kind of noise is an axis of its own: normal noise (of which only
cells near the mean are looked at, which keeps a lower bound), any other law, with a scale where noise is larger in some
places, and none at all, where only the cell of the mean counts.

An axis also says what an expected value of factors of at most 1 may be below the least of those that are read, if the
mean (and the scale) lies somewhere between the places that are read (docs/theory/boxes.md, "The charge").
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
from scipy.special import erfc

from ....envs.systems.agents import AnyAgent
from ....envs.systems.distributions import Law
from ...certificates.cell_probabilities import (
    AgentRecord,
    law_charge,
    law_error,
    probability_below,
    scale_charge,
)
from ...relations.grids import CellAxis, FloatArray, ScaleAxis, lattice_axes

REACH = 6.0
"""Standard deviations around a mean within which cells are looked at: 2e-9 of the mass lies beyond, which no budget
notices, and the time grows with the reach."""

UNIT = 2.0**-53

OFF = 40.0
"""Units by which a tail, a density and a sum of few of them may be off, several times over: tails and densities are at
most 1, the function for tails is right to few units, and what its argument is off by counts for less than one."""


SLOPE, BEND = 0.39895, 0.48395
"""Upper bounds on the integrals of the positive parts of the first and second derivatives of the normal density."""

THIN = 1e-9
"""Deviations up to which a side of a box is rounding."""

STEP = 0.1
"""Deviations between points at which values are read: the charge is then 6e-4 of the largest value, per axis."""

MOST_CELLS = 32
"""Cells of a state without noise that are looked at, at most; of wider boxes nothing is known."""


class Axis(Protocol):
    """The noise along one axis of a grid, and what can be read of factors there.

    Places are what means are read as: they themselves, or the numbers of their cells.
    """

    @property
    def size(self) -> int:
        """Numbers of a factor along the axis."""

    def place(self, means: FloatArray) -> FloatArray:
        """Return where means (M,), are read: as they are, or the numbers of their cells."""

    def steps(self, sides: FloatArray, most: int) -> int:
        """Return into how many steps the widest of sides (M,) between places is cut; 0 reads the middle alone."""

    def between(self, low: FloatArray, high: FloatArray, k: int, steps: int) -> FloatArray:
        """Return the k-th place (M,) of those that are read between two."""

    def interpolation_error(self, sides: FloatArray, steps: int, scales: FloatArray) -> FloatArray:
        """Return what values may be below the least that is read (M,), for noise with scales (M,) at least."""

    def scale_charge(self, sides: FloatArray, steps: int) -> FloatArray:
        """Return the same (M,) for logarithms of the scale that are so far apart."""

    def masses(self, places: FloatArray, scales: FloatArray) -> FloatArray:
        """Return lower bounds (M, size) on the mass of each number around places (M,); no numbers of what is none."""


class _Unscaled:
    """An axis whose noise is not multiplied with anything."""

    def scale_charge(self, sides: FloatArray, steps: int) -> FloatArray:
        return np.zeros(len(sides))


class _Spread:
    """What axes have in common along which there is noise: means are read as they are, and cut evenly."""

    def place(self, means: FloatArray) -> FloatArray:
        return means

    def between(self, low: FloatArray, high: FloatArray, k: int, steps: int) -> FloatArray:
        return evenly_between(low, high, k, steps)


def even_steps(sides: FloatArray, deviation: float, most: int) -> int:
    """Return into how many steps of a tenth of a deviation, at most so many, the widest of sides (M,) is cut."""
    widest = float(np.nan_to_num(sides / deviation).max(initial=0.0))
    return min(most, math.ceil(widest / STEP)) if widest > THIN else 0


def evenly_between(low: FloatArray, high: FloatArray, k: int, steps: int) -> FloatArray:
    """Return the k-th of ``steps + 1`` even places (M,), the last being the upper end itself; the middle of 0 steps."""
    if steps and k == steps:
        return high
    return low + (k / steps if steps else 0.5) * (high - low)


@dataclass(frozen=True, eq=False)
class NoiseAxis(_Unscaled, _Spread):
    """One axis of a grid, and the normal noise along it.

    Parameters
    ----------
    edges : (S + 1,) array
        Cell edges.
    deviation : float
        Standard deviation of the noise.
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

    def steps(self, sides: FloatArray, most: int) -> int:
        """Return into how many steps of a tenth of a deviation the widest of sides (M,) is cut."""
        return even_steps(sides, self.deviation, most)

    def interpolation_error(self, sides: FloatArray, steps: int, scales: FloatArray) -> FloatArray:
        """Return what values may be below the least that is read (M,)."""
        sides = sides / self.deviation
        return SLOPE * sides if steps == 0 else BEND / 8.0 * (sides / steps) ** 2

    def masses(self, means: FloatArray, scales: FloatArray | None = None) -> FloatArray:
        """Return lower bounds (M, size) on the mass of each number around means (M,).

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


@dataclass(frozen=True, eq=False)
class LawAxis(_Spread):
    """One axis of a grid, and noise of any law along it, which may be multiplied with a scale.

    Parameters
    ----------
    edges : (S + 1,) array
        Cell edges.
    law : Law
    is_scaled : bool
    """

    edges: FloatArray
    law: Law
    is_scaled: bool

    @property
    def size(self) -> int:
        """Number of cells."""
        return len(self.edges) - 1

    def steps(self, sides: FloatArray, most: int) -> int:
        """Return into how many steps of a tenth of a deviation the widest of sides (M,) is cut."""
        return even_steps(sides, self.law.std, most)

    def interpolation_error(self, sides: FloatArray, steps: int, scales: FloatArray) -> FloatArray:
        """Return what values may be below the least that is read (M,): that of the law, for its least scale."""
        sides = sides / scales
        if steps == 0:
            return self.law.height * sides
        return np.array([min(1.0, law_charge(self.law, side)) for side in (sides / steps).tolist()])

    def scale_charge(self, sides: FloatArray, steps: int) -> FloatArray:
        """Return the same (M,) along the logarithm of the scale."""
        if not self.is_scaled:
            return np.zeros(len(sides))
        return np.array([min(1.0, scale_charge(self.law, side)) for side in (sides / max(1, steps)).tolist()])

    def masses(self, means: FloatArray, scales: FloatArray) -> FloatArray:
        """Return lower bounds (M, S) on the masses of cells around means (M,) of noise with scales (M,)."""
        x = (self.edges - means[:, None]) / scales[:, None]
        mass = np.diff(probability_below(self.law, x), axis=1)
        # Arguments are off by a few units of their size, and the function by its error at either end.
        far = np.abs(x)
        mass -= 2.0 * law_error(self.law) + OFF * UNIT * (1.0 + self.law.height * np.maximum(far[:, 1:], far[:, :-1]))
        return np.maximum(mass, 0.0, out=mass)


@dataclass(frozen=True, eq=False)
class StillAxis(_Unscaled):
    """One axis of a grid along which there is no noise: the next state is the mean.

    Parameters
    ----------
    edges : (S + 1,) array
        Cell edges: places are numbers of cells, -1 and S being outside.
    """

    edges: FloatArray

    @property
    def size(self) -> int:
        """Number of cells."""
        return len(self.edges) - 1

    def place(self, means: FloatArray) -> FloatArray:
        """Return the numbers of the cells that hold means (M,); the uppermost one holds its upper edge."""
        cells = np.searchsorted(self.edges, means, side="right") - 1.0
        cells[means == self.edges[-1]] = self.size - 1.0
        return np.where(np.isnan(means), np.nan, cells)

    def steps(self, sides: FloatArray, most: int) -> int:
        """Return how many cells the widest of sides (M,) goes on: all are read, up to ``MOST_CELLS``."""
        return int(min(MOST_CELLS, np.nan_to_num(sides).max(initial=0.0)))

    def between(self, low: FloatArray, high: FloatArray, k: int, steps: int) -> FloatArray:
        """Return the k-th cell (M,) from the lowest one on, and no number where there are too many."""
        return np.where(high - low > MOST_CELLS, np.nan, np.minimum(low + k, high))

    def interpolation_error(self, sides: FloatArray, steps: int, scales: FloatArray) -> FloatArray:
        """Return 0 (M,): every cell is read."""
        return np.zeros(len(sides))

    def masses(self, cells: FloatArray, scales: FloatArray) -> FloatArray:
        """Return 1 (M, S) for the cell itself, which is exact."""
        table = (cells[:, None] == np.arange(self.size)).astype(float)
        table[np.isnan(cells)] = np.nan
        return table


def noise_axes(agent: AnyAgent, part: AgentRecord) -> tuple[Axis, ...]:
    """Return the axes of an agent's grid, each with its noise."""
    axes, edges = list[Axis](), part.grid.edges
    known = lattice_axes(agent)
    deviations = np.sqrt(np.diag(agent.noise_covariance)).tolist()
    for k, (along, deviation) in enumerate(zip(edges, deviations, strict=True)):
        law = None if agent.laws is None else agent.laws[k]
        if CellAxis(k) in known:
            axes.append(StillAxis(along))
        elif law is None or (law.name == "gaussian" and ScaleAxis(k) not in known):
            axes.append(NoiseAxis(along, deviation, part.is_linear))
        else:
            axes.append(LawAxis(along, law, ScaleAxis(k) in known))
    return tuple(axes)


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
