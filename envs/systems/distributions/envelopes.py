"""Laws whose exponential moments are above those of noise: what paths need to know of it (docs/theory/paths.md)."""

from __future__ import annotations

import math
from enum import IntEnum
from typing import NamedTuple

RARE = 1e-7
"""Probability of noise, per component and step, that is given up where a law has no exponential moments."""

CUT_MOMENTS = 40
"""Moments of a law that is cut which are compared one by one; the last stands for all beyond it."""


class Tail(IntEnum):
    """Below which law the tails of noise are: the normal one itself, one with its moments, or Laplace's."""

    NORMAL = 0
    LIGHT = 1
    LONG = 2


class Envelope(NamedTuple):
    """Mean and standard deviation of a law whose exponential moments are above those of noise (rounded).

    It is above the noise but for the rarest, which has the probability ``lost``.
    """

    mean: float
    deviation: float
    tail: Tail
    lost: float = 0.0


def cut_envelope(std: float, most: float, lost: float) -> Envelope:
    """Return the Laplace law above even noise of a deviation that is at most ``most``, but for a probability.

    Moments of order 2 j are at most ``std^2 most^(2 j - 2)``; those of Laplace's law are ``(2 j)! (s^2 / 2)^j``.
    """
    share = 2.0 * math.log(std / most)
    logs = [(share - math.lgamma(2.0 * j + 1.0)) / j for j in range(1, CUT_MOMENTS)]
    logs.append(-math.lgamma(2.0 * CUT_MOMENTS + 1.0) / CUT_MOMENTS)  # above that of every further moment
    return Envelope(0.0, most * math.sqrt(2.0 * math.exp(max(logs))), Tail.LONG, lost)
