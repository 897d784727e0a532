"""Least expected values where the mean is not known: agents with expressions, whatever their disturbances do.

At a true state x, under an input u, the mean lies in a box: the expressions are enclosed at the point x, over all
disturbances, by the spans of the check. Let ``g(m) = E v(m + w)`` for a factor v with values from 0 to L and normal
noise. Along an axis on which the box is cut into steps of h deviations, a multilinear interpolant of g is above g by at
most ``0.48395 L h^2 / 8`` (docs/theory/boxes.md, "The charge"), so that the least of g at the points of the cuts, less
that for every axis, is below g on the whole box. Along an axis where the box is hardly wider than rounding, its middle
is read, and g changes by at most ``0.39895 L`` per deviation (docs/theory/shields.md, "Agents with expressions").
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

import numpy as np

from ...envs.agents import Agent
from ..cells import FloatArray
from ..checking import enclosed_means

SLOPE, BEND = 0.39895, 0.48395
"""Upper bounds on the integrals of the positive parts of the first and second derivatives of the normal density."""

THIN = 1e-9
"""Deviations up to which a side of a box is rounding."""

STEP = 0.1
"""Deviations between points at which values are read: the charge is then 6e-4 of the largest value, per axis."""

MOST_STEPS = {1: 24, 2: 8, 3: 3}
"""Most steps along each axis, by the number of axes that are not thin (1 beyond): their points multiply."""


@dataclass(frozen=True, eq=False)
class MeanBox:
    """Boxes that hold the means of M worlds, in grid coordinates.

    Parameters
    ----------
    low, high : (d, M) arrays
        Corners; no numbers where nothing is known.
    deviations : (d,) array
        Of the noise.
    """

    low: FloatArray
    high: FloatArray
    deviations: FloatArray

    @classmethod
    def of(
        cls,
        agent: Agent,
        coordinates: FloatArray,
        deviations: FloatArray,
        moving: tuple[FloatArray, FloatArray],
        beside: FloatArray | None,
    ) -> MeanBox:
        """Return the boxes of an agent in points (d, M) of its grid under inputs (m, M), ``moving``.

        ``beside`` (l, M) are the true states of others that the dynamics name.
        """
        points, inputs = moving
        low, high = enclosed_means(agent, points.T, points.T, inputs.T, coordinates, 1, beside)
        # Where an operation is not defined nothing is known: the proposal is refused.
        known = np.all(np.isfinite(low) & np.isfinite(high), axis=1) & np.all(np.isfinite(inputs), axis=0)
        low, high = (np.where(known[:, None], end, np.nan) for end in (low, high))
        return cls(low.T, high.T, deviations)

    @property
    def steps(self) -> tuple[int, ...]:
        """Steps into which the widest box is cut along each axis; 0 where all boxes are thin."""
        widths = np.nan_to_num((self.high - self.low) / self.deviations[:, None])
        sides: list[float] = widths.max(axis=1, initial=0.0).tolist()
        most = MOST_STEPS.get(sum(side > THIN for side in sides), 1)
        return tuple(min(most, math.ceil(side / STEP)) if side > THIN else 0 for side in sides)

    @property
    def points(self) -> Iterator[FloatArray]:
        """The means (d, M) at which values are read."""
        for place in product(*(range(n + 1) for n in self.steps)):
            share = np.array([0.5 if n == 0 else k / n for k, n in zip(place, self.steps, strict=True)])[:, None]
            # The last point is the upper end itself, whatever rounding does.
            yield np.where(share == 1.0, self.high, self.low + share * (self.high - self.low))

    @property
    def charge(self) -> FloatArray:
        """What g may be below its least value at the points (M,), for factors of at most 1; upper bounds."""
        sides = (self.high - self.low) / self.deviations[:, None]
        total = np.zeros(sides.shape[1])
        for side, n in zip(sides, self.steps, strict=True):
            total += SLOPE * side if n == 0 else BEND / 8.0 * (side / n) ** 2
        return np.asarray(total * (1.0 + 1e-9))
