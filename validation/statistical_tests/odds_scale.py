"""A scale of probabilities by their odds: .9, .99, .999 and .9999 are as far from one another as .01 and .1."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

LEAST, MOST = -2.0, 6.0
"""Ends of the widest scale, in decimal logarithms of odds: .01, and a failure of a millionth."""

ROOM = 0.19
"""Share of a scale between two numbers beside it, at least."""

NARROWEST = 1.0
"""Least length of a scale: bounds that hardly differ have about one colour."""


@dataclass(frozen=True)
class OddsScale:
    """A scale between two decimal logarithms of odds p / (1 - p).

    Examples
    --------
    >>> scale = OddsScale.of([0.0, 0.5, 0.999])
    >>> [round(scale.at(p), 2) for p in (0.0, 0.5, 0.9, 0.99, 0.999)]
    [0.0, 0.0, 0.32, 0.67, 1.0]
    >>> scale.ticks
    [('.5', 0.5), ('.9', 0.9), ('.99', 0.99), ('.999', 0.999)]
    """

    low: float
    high: float

    @classmethod
    def of(cls, probabilities: Sequence[float] | NDArray[np.float64]) -> OddsScale:
        """Return the scale that holds what is above 0 of some probabilities."""
        known = [_log_odds(p) for p in np.ravel(np.asarray(probabilities, dtype=float)).tolist() if p > 0.0]
        high = min(MOST, max(known, default=0.0))
        low = min(max(LEAST, min(known, default=0.0)), high - NARROWEST)
        return cls(low, high)

    def at(self, probability: float) -> float:
        """Return where a probability is on the scale, in [0, 1]."""
        return min(1.0, max(0.0, (_log_odds(probability) - self.low) / (self.high - self.low)))

    @property
    def ticks(self) -> list[tuple[str, float]]:
        """Round probabilities on the scale, as they are written, and their values; numbers have room beside others."""
        nines = [(f".{'9' * k}", 1.0 - 10.0**-k) for k in range(1, round(MOST) + 1)]
        round_ones = [(".01", 0.01), (".1", 0.1), (".5", 0.5), *nines]
        off = 0.02 * (self.high - self.low)
        shown = list[tuple[str, float]]()
        for one in reversed([one for one in round_ones if self.low - off <= _log_odds(one[1]) <= self.high + off]):
            if not shown or self.at(shown[-1][1]) - self.at(one[1]) >= ROOM:
                shown.append(one)
        return shown[::-1]


def _log_odds(probability: float) -> float:
    if not 0.0 < probability < 1.0:
        return math.inf if probability >= 1.0 else -math.inf
    return math.log10(probability / (1.0 - probability))
