"""That the shares of a start box in turned cells are no larger than they are, in rational numbers."""

from __future__ import annotations

from fractions import Fraction
from itertools import pairwise

import numpy as np
from flint import fmpq, fmpq_mat

from certigym.synthesis.cells import FloatArray
from certigym.synthesis.masses import AgentPart

from .ball_memory import Memory, Proof

Point = tuple[Fraction, ...]


def turned(memory: Memory, part: AgentPart, low: FloatArray, high: FloatArray, shares: FloatArray) -> Proof:
    """Shares (n_1, .., n_d) of a start box are at most those that polygons in rational numbers have."""
    inverse, wide = _inverse(part.coordinates), np.flatnonzero(low < high)
    start = [sum((m * Fraction(float(x)) for m, x in zip(row, low, strict=True)), Fraction(0)) for row in inverse]
    numbers, claimed = np.argwhere(shares > 0.0), shares[shares > 0.0]
    for cell, share in zip(numbers.tolist(), claimed.tolist(), strict=True):
        box = [(Fraction(float(e[k])), Fraction(float(e[k + 1]))) for e, k in zip(part.grid.edges, cell, strict=True)]
        exact = Fraction(1)
        for group in _groups(inverse, wide.tolist()):
            axes = [k for k, row in enumerate(inverse) if any(row[j] != 0 for j in group)]
            sides = [[inverse[k][j] * Fraction(float(high[j] - low[j])) for j in group] for k in axes]
            exact *= _part([start[k] for k in axes], sides, [box[k] for k in axes])
        if not Fraction(share) <= exact:
            return len(claimed), ["a share of a start box was not proved"]
    return len(claimed), []


def _inverse(matrix: FloatArray) -> list[list[Fraction]]:
    """The inverse of a matrix of doubles, exactly."""
    exact = [[Fraction(float(x)) for x in row] for row in matrix]
    flat = fmpq_mat(len(exact), len(exact), [fmpq(x.numerator, x.denominator) for row in exact for x in row])
    found = flat.inv()
    return [[Fraction(int(x.p), int(x.q)) for x in row] for row in found.tolist()]


def _groups(inverse: list[list[Fraction]], wide: list[int]) -> list[list[int]]:
    """Wide sides in groups that share no axis of the grid."""
    groups: list[list[int]] = []
    for j in wide:
        met = [g for g in groups if any(row[j] != 0 and any(row[i] != 0 for i in g) for row in inverse)]
        groups = [g for g in groups if g not in met] + [[j, *(i for g in met for i in g)]]
    return groups


def _part(start: list[Fraction], sides: list[list[Fraction]], box: list[tuple[Fraction, Fraction]]) -> Fraction:
    """Share of the weights of one or two sides, each from 0 to 1, for which a point lies in a box."""
    n = len(sides[0])
    corners: list[Point] = [(Fraction(0),), (Fraction(1),)] if n == 1 else []
    if n == 2:
        corners = [tuple(map(Fraction, corner)) for corner in ((0, 0), (1, 0), (1, 1), (0, 1))]
    if n > 2:
        return Fraction(0)
    for a, row, (low, high) in zip(start, sides, box, strict=True):
        for sign, limit in ((1, low), (-1, high)):
            corners = _cut(corners, [sign * (a + sum(r * w for r, w in zip(row, c)) - limit) for c in corners])
    if n == 1:
        return max(c[0] for c in corners) - min(c[0] for c in corners) if corners else Fraction(0)
    ring = [*corners, *corners[:1]]
    return abs(sum((p[0] * q[1] - p[1] * q[0] for p, q in pairwise(ring)), Fraction(0))) / 2


def _cut(corners: list[Point], gaps: list[Fraction]) -> list[Point]:
    """The part of a convex polygon, or of a segment, where the gaps of its corners are not negative."""
    kept = []
    for k, (here, gap) in enumerate(zip(corners, gaps, strict=True)):
        before, last = corners[k - 1], gaps[k - 1]
        if (gap >= 0) != (last >= 0):
            part = last / (last - gap)
            kept.append(tuple(p + part * (h - p) for p, h in zip(before, here, strict=True)))
        if gap >= 0:
            kept.append(here)
    return kept
