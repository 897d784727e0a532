"""Regions that move, enclosed at a time by intervals of the check's own.

A corner is the value of an expression in ``t``, rounded to twelve decimals. Its enclosure by ``step_intervals``, each
operation of which is moved outward by more than it is rounded, is widened by what the decimals leave out: it holds the
corner that simulations use, and the value of the expression.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ....envs.systems.agents import TIME
from ....envs.systems.expressions import Tree
from ....envs.tasks.regions import DECIMALS, Proposition
from ...relations.grids import FloatArray
from .step_intervals import Span, span

UNIT = 2.0**-52
"""Twice the relative rounding of one operation."""

HALF = 0.51 * 10.0**-DECIMALS
"""How far a corner is from the value of its expression, a little more than half a decimal."""


@dataclass(frozen=True, eq=False)
class RegionSpan:
    """Ends (2, p) of the lower corner of a region at a time, and of the upper one; infinite where nothing is known."""

    low: FloatArray
    high: FloatArray

    @classmethod
    def of(cls, region: Proposition, time: int) -> RegionSpan:
        """Enclose a region at a time; one that stands still is its own enclosure."""
        if not region.moves:
            return cls(np.stack([region.low, region.low]), np.stack([region.high, region.high]))
        low, high = (np.stack([_ends(tree, time) for tree in own], axis=1) for own in region.trees)
        return cls(low, high)

    @property
    def is_empty(self) -> bool:
        """Whether it surely holds no point."""
        return bool(np.any(self.high[1] <= self.low[0]))


def _ends(tree: Tree, time: int) -> FloatArray:
    """Return ends (2,) of an expression in the time."""
    leaves = {TIME: Span(np.full((2, 1), float(time)), np.zeros((2, 0, 1)))}
    with np.errstate(all="ignore"):
        ends = span(tree, leaves).ends[:, 0]
    if np.isnan(ends).any():
        return np.array([-np.inf, np.inf])
    spare = HALF + 4.0 * UNIT * np.abs(ends)
    return np.array([ends[0] - spare[0], ends[1] + spare[1]])
