"""Least expected values where the mean is not known: agents with expressions, whatever their disturbances do.

At a true state x, under an input u, the mean lies in a box: the expressions are enclosed at the point x, over all
disturbances, by the spans of the check. Let ``g(m) = E v(m + w)`` for a factor v with values from 0 to L. Along an axis
on which the box is cut into steps of h deviations, a multilinear interpolant of g is above g by at most
``0.48395 L h^2 / 8`` for normal noise, and by what each other law says (docs/theory/boxes.md, "The charge"), so that
the least of g at the points of the cuts, less that for every axis, is below g on the whole box. Along an axis where the
box is hardly wider than rounding, its middle is read, and g changes by at most ``0.39895 L`` per deviation
(docs/theory/shields.md, "Agents with expressions"). Noise with a scale has one more axis, the logarithm of the scale,
and a state without noise the cells that its box touches.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np
from numpy.typing import NDArray

from ....envs.systems.agents import Agent
from ...relations.grids import FloatArray
from ..steps import enclosed_means, enclosed_scales
from .noise_probabilities import Axis, even_steps, evenly_between

MOST_STEPS = {1: 24, 2: 8, 3: 3}
"""Most steps along each axis, by the number of axes that are not thin (1 beyond): their points multiply."""


MOST_SCALES = 8
"""The same along the logarithm of a scale."""

SCALE_OFF = 1e-13
"""What logarithms of scales may be off by, far above their rounding."""


@dataclass(frozen=True, eq=False)
class MeanBox:
    """Boxes that hold the means of M worlds, and the scales of their noise.

    Parameters
    ----------
    low, high : (d, M) arrays
        Places of the corners along the axes; no numbers where nothing is known.
    axes : tuple of Axis
    scales : two (d, M) arrays, optional
        Ends of what the noise is multiplied with; by default 1.
    """

    low: FloatArray
    high: FloatArray
    axes: tuple[Axis, ...]
    scales: tuple[FloatArray, FloatArray] | None = None

    @classmethod
    def of(
        cls,
        agent: Agent,
        axes: tuple[Axis, ...],
        moving: tuple[FloatArray, FloatArray],
        beside: FloatArray | None,
    ) -> MeanBox:
        """Return the boxes of an agent in points (d, M) of its grid under inputs (m, M), ``moving``.

        ``beside`` (l, M) are the true states of others that the dynamics name.
        """
        points, inputs = moving
        low, high = enclosed_means(agent, points.T, points.T, inputs.T, 1, beside)
        known, scales = np.all(np.isfinite(inputs), axis=0), None
        if agent.noise_scale is not None:
            least, largest = (end.T for end in enclosed_scales(agent, points.T, points.T, inputs.T, 1))
            known &= np.all((least > 0.0) & np.isfinite(largest), axis=0)
            scales = np.where(known, least, np.nan), np.where(known, largest, np.nan)
        return cls.around(low.T, high.T, axes, known, scales)

    @classmethod
    def around(
        cls,
        low: FloatArray,
        high: FloatArray,
        axes: tuple[Axis, ...],
        known: NDArray[np.bool_],
        scales: tuple[FloatArray, FloatArray] | None = None,
    ) -> MeanBox:
        """Return boxes around means between corners (d, M), of the worlds of which something is known (M,)."""
        # Where an operation is not defined nothing is known: the proposal is refused.
        known = known & np.all(np.isfinite(low) & np.isfinite(high), axis=0)
        low, high = (np.where(known, end, np.nan) for end in (low, high))
        first, last = (np.array([axis.place(row) for axis, row in zip(axes, end, strict=True)]) for end in (low, high))
        return cls(first, last, axes, scales)

    @cached_property
    def steps(self) -> tuple[int, ...]:
        """Steps into which the widest box is cut along each axis; 0 where all boxes are thin."""
        most = MOST_STEPS.get(
            sum(bool(axis.steps(side, 1)) for axis, side in zip(self.axes, self._sides, strict=True)), 1
        )
        return tuple(axis.steps(side, most) for axis, side in zip(self.axes, self._sides, strict=True))

    @cached_property
    def _sides(self) -> FloatArray:
        """How wide boxes are (d, M)."""
        return self.high - self.low

    @cached_property
    def _log_scales(self) -> tuple[FloatArray, FloatArray]:
        """Ends (d, M) of the logarithms of the scales."""
        if self.scales is None:
            nothing = np.zeros(self.low.shape)
            return nothing, nothing
        return np.log(self.scales[0]), np.log(self.scales[1])

    @cached_property
    def _scale_steps(self) -> tuple[int, ...]:
        """The same as ``steps`` for the logarithms of the scales."""
        low, high = self._log_scales
        return tuple(even_steps(side, 1.0, MOST_SCALES) for side in high - low)

    @property
    def points(self) -> Iterator[tuple[FloatArray, FloatArray]]:
        """Places and scales (d, M) at which values are read."""
        low, high = self._log_scales
        places = [
            [axis.between(a, b, k, n) for k in range(n + 1)]
            for axis, a, b, n in zip(self.axes, self.low, self.high, self.steps, strict=True)
        ]
        scales = [
            [np.exp(evenly_between(a, b, k, n)) for k in range(n + 1)]
            for a, b, n in zip(low, high, self._scale_steps, strict=True)
        ]
        for rows in product(*places):
            for factors in product(*scales):
                yield np.array(rows), np.array(factors)

    @property
    def interpolation_error(self) -> FloatArray:
        """What g may be below its least value at the points (M,), for factors of at most 1; upper bounds."""
        least = np.ones(self.low.shape) if self.scales is None else self.scales[0]
        total = np.zeros(self.low.shape[1])
        rows = zip(self.axes, self._sides, self.steps, least, strict=True)
        for axis, side, n, scale in rows:
            total += axis.interpolation_error(side, n, scale)
        low, high = self._log_scales
        for axis, side, n in zip(self.axes, high - low, self._scale_steps, strict=True):
            # Logarithms, and what they are exponentials of, are off by a few units.
            total += axis.scale_charge(side + SCALE_OFF, n)
        return np.asarray(total * (1.0 + 1e-9))
