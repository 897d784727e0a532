"""Uniform noise along one axis, for linear cells, by code of the check's own: hat masses, and what lies between points.

With noise uniform on [a, b), g changes its slope from a lattice point to the next by what the factor, smoothed along
all other axes, changes at both ends of the noise, over b - a; where that makes g bend upward, the interpolant is above
g by at most a quarter of a lattice step times it (docs/theory/linear.md, "One reading for all").
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ...relations.grids import FloatArray

UNIT = 2.0**-53

OPERATIONS = 40.0
"""Roundings of a mass, several times over."""


@dataclass(frozen=True, eq=False)
class Ends:
    """The axis with uniform noise: its number, edges of cells, lattice, and the interval of the noise."""

    axis: int
    edges: FloatArray
    lattice: FloatArray
    low: float
    high: float

    @property
    def share(self) -> float:
        """Lattice step in widths of the noise."""
        return float(self.lattice[-1] - self.lattice[0]) / (len(self.lattice) - 1) / (self.high - self.low)

    def added(self, masses: list[FloatArray], factors: FloatArray) -> FloatArray:
        """What interpolants of factors (n, places) may be too large behind every lattice point (n, Z_1, ..)."""
        tensor = factors.reshape(len(factors), *(table.shape[1] for table in masses))
        for k, table in enumerate(masses):
            if k != self.axis:
                tensor = np.moveaxis(np.tensordot(tensor, table, axes=(k + 1, 1)), -1, k + 1)
        h = np.moveaxis(tensor, self.axis + 1, 0)  # two numbers for each cell, one after the other
        rises, falls = _moves(h, self.edges, self.lattice + self.high), _moves(h, self.edges, self.lattice + self.low)
        total = sum(np.maximum(r, 0.0) + np.maximum(-f, 0.0) for r, f in zip(rises, falls, strict=True))
        added = np.zeros((len(self.lattice), *h.shape[1:]))
        added[:-1] = total * (0.25 * self.share)
        return np.moveaxis(added, 0, self.axis + 1)


def _moves(h: FloatArray, edges: FloatArray, points: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """How h (2 S, ..) moves in each interval of points: up to the edge inside, across it, and from there on."""
    # A cell of zeros on either side stands for the outside.
    nothing = np.zeros((2, *h.shape[1:]))
    padded = np.concatenate([nothing, h, nothing])
    ends = np.concatenate([[edges[0] - 1.0], edges, [edges[-1] + 1.0]])
    count = len(edges) + 1
    left = np.minimum(np.sum(edges[:, None] <= points[:-1], axis=0), count - 1)
    right = np.sum(edges[:, None] < points[1:], axis=0)
    at_edge = edges[np.minimum(left, len(edges) - 1)]
    crosses = right > left

    def at(cell: FloatArray, x: FloatArray) -> FloatArray:
        share = np.clip((x - ends[cell]) / (ends[cell + 1] - ends[cell]), 0.0, 1.0)
        share = share.reshape(-1, *[1] * (h.ndim - 1))
        return (1.0 - share) * padded[2 * cell] + share * padded[2 * cell + 1]

    begin, end = at(left, points[:-1]), at(np.maximum(right, left), points[1:])
    before, after = at(left, np.where(crosses, at_edge, points[:-1])), at(np.maximum(right, left), at_edge)
    after = np.where(crosses.reshape(-1, *[1] * (h.ndim - 1)), after, begin)
    return before - begin, after - before, end - after


def uniform_ends(k: int, edges: FloatArray, axis: FloatArray, law: dict[str, Any]) -> tuple[FloatArray, float, Ends]:
    """Hat masses (Z, 2 S) from below, what rows of them lack at most, and the ends of the noise.

    Raises
    ------
    ValueError
        If an interval of the lattice may meet two edges of cells.
    """
    low, high = float(law["low"]), float(law["high"])
    if float(np.max(np.diff(axis))) > float(np.min(np.diff(edges))) * (1.0 + 1e-9):
        raise ValueError("lattice steps are wider than cells along the axis of uniform noise")
    a, b = edges[:-1], edges[1:]
    # Of each cell what lies in the noise around a lattice point, from its lower end on.
    begin = np.clip(axis[:, None] + low, a, b)
    end = np.clip(axis[:, None] + high, begin, b)
    whole = (end - begin) / (high - low)
    right = whole * (0.5 * ((begin - a) + (end - a)) / (b - a))
    sizes = np.abs(edges).max() + np.abs(axis).max() + max(abs(low), abs(high))
    off = OPERATIONS * UNIT * (sizes / (high - low) + sizes / np.diff(edges).min() + 1.0)
    masses = np.stack([np.maximum(whole - right - off, 0.0), np.maximum(right - off, 0.0)], axis=-1)
    masses[~(whole > 0.0)] = 0.0
    lost = 4.0 * off * (2.0 + float((whole > 0.0).sum(axis=1).max()))
    return masses.reshape(len(axis), -1), lost, Ends(k, edges, axis, low, high)
