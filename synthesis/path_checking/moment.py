"""An agent at one time of a nonlinear path, and the step by which it arrived there."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ...envs.agents import AnyAgent
from ..cells import FloatArray
from .linear_deviations import Chain
from .moving import Moving
from .own_angles import ROUNDED, TURN, copy_of, gap_of
from .own_bends import Expansion, expansion
from .roundings import TAIL


@dataclass(frozen=True, eq=False)
class Moment:
    """An agent at one time of its path: nominal state (d,), the box (2, d) that holds the true one, and the past.

    ``arrival`` is the step by which it arrived; None at time 0.
    """

    t: int
    moving: Moving
    agent: AnyAgent
    at: FloatArray
    box: FloatArray
    slab: FloatArray
    chain: Chain
    arrival: Arrival | None = None

    @cached_property
    def reach(self) -> FloatArray:
        """Upper bounds (d,) on how far the true state is from the nominal one."""
        return np.asarray(np.maximum(self.box[1] - self.at, self.at - self.box[0]) * TAIL)

    @cached_property
    def outputs(self) -> Expansion:
        """Outputs around the nominal state."""
        return expansion(self.moving.outputs, self.moving.states, self.at, self.box, len(self.at))


@dataclass(frozen=True, eq=False)
class Arrival:
    """A step by which an agent arrived at a time: where it was, and ``e' = closed e + r + w``.

    ``chain`` is that of the time before; r is within ``remainder`` (d,) of ``middle`` (d,), and w has the covariance
    ``noise`` (d, d).
    """

    was: Moment
    chain: Chain
    closed: FloatArray
    middle: FloatArray
    remainder: FloatArray
    noise: FloatArray


def of_copies(now: Moment, k: int, low: float, high: float, holds: bool) -> tuple[int, float, float]:
    """Return limits of an output; those of angles are the ends of a copy of a region, or of the gap between two."""
    if k not in now.agent.angle_outputs:
        return k, low, high
    value = float(now.outputs.values[0, k])
    if holds and high - low >= TURN:
        return k, -np.inf, np.inf  # all of the circle
    least, most = copy_of(low, high, value) if holds else gap_of(low, high, value)
    return k, least + ROUNDED, most - ROUNDED
