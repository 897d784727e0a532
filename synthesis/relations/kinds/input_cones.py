"""Which vectors the two inputs of a turn reach, and the inputs that give a vector.

The proofs are in docs/theory/relations.md, "Sectors". Sizes in [a, b] with angles in an interval reach a sector of a
disk or of a ring. A negative size goes the other way: its vectors are a second sector, opposite to the first. What is
reached is the union, and where angles go over half a turn or more both sectors together hold a disk around 0.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ....envs.systems.agents import Agent
from ..grids import FloatArray
from .input_forms import Turn

ALL_ROUND = np.pi * (1.0 - 1e-15)
"""Half a turn up to the rounding of pi, which the spare for angles covers: angles this far off the middle are all."""

Ends = tuple[FloatArray | float, FloatArray | float]


@dataclass(frozen=True)
class InputCone:
    """Vectors whose length is from ``least`` to ``most``, and whose angle is off ``middle`` by ``half`` at most.

    ``half`` is below half a turn, or infinite where all angles are allowed.
    """

    least: float
    most: float
    middle: float
    half: float

    def holds(self, east: Ends, north: Ends, spare: float) -> NDArray[np.bool_]:
        """Return whether all vectors of boxes lie in the sector, and all others within ``spare`` of them."""
        sides = (east, north)
        farthest = np.hypot(*(np.maximum(np.abs(low), np.abs(high)) for low, high in sides))
        inside = np.asarray(farthest <= self.most - spare)
        if self.least > 0.0:
            nearest = np.hypot(*(np.maximum(np.maximum(low, -np.asarray(high)), 0.0) for low, high in sides))
            inside = inside & (nearest >= self.least + spare)
        if np.isinf(self.half):
            return inside
        # Both half planes of a narrow sector; of a wide one, a half plane that keeps off the wedge that is missing.
        halves = [_least_along(normal, east, north) >= spare for normal in self._normals()]
        between = np.logical_and if self.half <= 0.5 * np.pi else np.logical_or
        return inside & between.reduce(halves)

    def _normals(self) -> list[tuple[float, float]]:
        """Return directions across the two edges, towards the inside, and those that decide beside them.

        A box and an open wedge are convex: they are apart if a line through the apex has the box on its far side. The
        least of a box along a direction is linear in each quadrant of directions, so the edges of the wedge and the
        axes between them decide.
        """
        first, last = self.middle - self.half, self.middle + self.half
        normals = [(-float(np.sin(first)), float(np.cos(first))), (float(np.sin(last)), -float(np.cos(last)))]
        if self.half > 0.5 * np.pi:
            away = [_turned(0.5 * np.pi * k - self.middle) for k in range(4)]
            axes = [(1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0)]
            normals += [axis for axis, off in zip(axes, away, strict=True) if abs(off) < self.half - 0.5 * np.pi]
        return normals


def _least_along(normal: tuple[float, float], east: Ends, north: Ends) -> FloatArray:
    """Return the least product of a direction with the vectors of boxes."""
    ends = zip(normal, (east, north), strict=True)
    # Ends may be infinite, so parts that are 0 are left out.
    return np.asarray(sum(part * (low if part > 0.0 else high) for part, (low, high) in ends if part != 0.0))


def _turned(angle: FloatArray | float) -> FloatArray:
    """Return angles less as many turns as bring them between half a turn back and forth."""
    return np.asarray(angle - 2.0 * np.pi * np.rint(np.divide(angle, 2.0 * np.pi)))


def input_cones_of(agent: Agent, turn: Turn) -> tuple[InputCone, ...]:
    """Return sectors that the two inputs of a turn reach; a box lies in their union if it lies in one of them."""
    low, high, middle, half = _ranges(agent, turn)
    cones = []
    if high > 0.0:
        cones.append(InputCone(max(low, 0.0), high, middle, half))
    if low < 0.0:
        cones.append(InputCone(max(-high, 0.0), -low, middle + np.pi, half))
    if low < 0.0 < high and 0.5 * np.pi <= half < np.inf:
        # Every direction or its opposite is among the angles.
        cones.append(InputCone(0.0, min(-low, high), middle, np.inf))
    return tuple(cones)


def polar_inputs(agent: Agent, turn: Turn, east: FloatArray, north: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return sizes and angles that give vectors, up to rounding; as near as may be for vectors that none give.

    A vector that both signs of the size give, such as 0, is given by the positive one.
    """
    low, high, middle, half = _ranges(agent, turn)
    length, towards = np.hypot(east, north), np.arctan2(north, east)
    # Nearest to the middle: rounding then never moves an angle from one end of its interval to the other.
    off = _turned(towards - middle)
    size = length
    if low < 0.0:
        backward = (np.abs(off) > half) | (length > high)
        size, off = np.where(backward, -length, length), np.where(backward, _turned(off + np.pi), off)
    return size, middle + off


def is_whole(agent: Agent, turn: Turn) -> bool:
    """Return whether the angle goes all the way round."""
    return bool(np.isinf(_ranges(agent, turn)[3]))


def reached(agent: Agent, turn: Turn) -> tuple[FloatArray, FloatArray]:
    """Return the ends (2,) of each component of what is reached, up to rounding."""
    low, high = float(agent.input_low[turn.angle]), float(agent.input_high[turn.angle])
    quarters = 0.5 * np.pi * np.arange(np.ceil(low / (0.5 * np.pi)), np.floor(high / (0.5 * np.pi)) + 1.0)[:4]
    sizes = np.array([agent.input_low[turn.size], agent.input_high[turn.size]])[:, None]
    angles = np.array([low, high, *quarters])
    components = (sizes * np.cos(angles), sizes * np.sin(angles))
    east, north = (np.array([np.min(component), np.max(component)]) for component in components)
    return east, north


def largest_angle(agent: Agent, turn: Turn) -> float:
    """Return an upper bound on what angles, and the turns added to them, are in size: their rounding goes with it."""
    return max(abs(float(agent.input_low[turn.angle])), abs(float(agent.input_high[turn.angle]))) + 2.0 * np.pi


def _ranges(agent: Agent, turn: Turn) -> tuple[float, float, float, float]:
    """Return least and largest size, middle and half width of the angle, which is infinite where it is half a turn."""
    low, high = float(agent.input_low[turn.size]), float(agent.input_high[turn.size])
    first, last = float(agent.input_low[turn.angle]), float(agent.input_high[turn.angle])
    half = 0.5 * last - 0.5 * first
    return low, high, 0.5 * first + 0.5 * last, np.inf if half >= ALL_ROUND else half
