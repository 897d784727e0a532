"""Masses of hats under normal noise, by code of the check's own.

What is computed is the same as in the search, to the last rounding, and in other words: unions from below take small
differences of factors, so that a stored factor can only be proved by what agrees with it (docs/theory/linear.md,
"Stored factors").
"""

from __future__ import annotations

import math

import numpy as np
from scipy.special import erfc

from ...relations.grids import FloatArray

UNIT = 2.0**-53

FAINT = 1e-280
"""What is taken off every mass: numbers near the smallest double have few digits, and relative errors miss that."""


AT_ONCE = 2**20
"""Numbers that are made at once: a dozen tables of them are needed meanwhile."""


def normal_hats(axis: FloatArray, edges: FloatArray, sigma: float | FloatArray) -> tuple[FloatArray, float]:
    """Masses (Z, 2 S) of both hats of every cell around every point, from below, and what rows lack at most.

    Deviations may be other ones for every point: (Z, 1).
    """
    sizes, count = np.broadcast_to(sigma, (len(axis), 1)), max(1, AT_ONCE // len(edges))
    masses, lost = np.empty((len(axis), 2 * (len(edges) - 1))), 0.0
    for first in range(0, len(axis), count):
        some = slice(first, first + count)
        masses[some], missing = _hats(axis[some], edges, sizes[some])
        lost = max(lost, missing)
    return masses, lost


def _hats(axis: FloatArray, edges: FloatArray, sigma: FloatArray) -> tuple[FloatArray, float]:
    """Return the masses of some points."""
    t = (edges - axis[:, None]) / sigma
    width = np.diff(edges) / sigma
    phi = np.exp(-0.5 * t**2) * (1.0 / math.sqrt(2.0 * math.pi))
    above = 0.5 * erfc(t / math.sqrt(2.0))  # P(y > edge)
    below = 0.5 * erfc(-t / math.sqrt(2.0))
    a, b = t[:, :-1], t[:, 1:]
    mass = np.where(a + b > 0, above[:, :-1] - above[:, 1:], below[:, 1:] - below[:, :-1])
    first = phi[:, :-1] - phi[:, 1:] - a * mass  # E (y - left end)^+ inside the cell, in deviations
    # Errors of densities and tails at both edges, each on the side where it is small; then of what is made of them.
    density, tail = (40.0 + 6.0 * t**2) * phi, (30.0 + 8.0 * t**2) * np.minimum(above, below)
    of_mass = tail[:, :-1] + tail[:, 1:] + 4.0 * mass
    of_first = density[:, :-1] + density[:, 1:] + (1.0 + np.abs(a)) * of_mass
    off_right = UNIT * (of_first / width + 4.0 * mass) + FAINT
    off_left = UNIT * (of_first / width + of_mass + 8.0 * mass) + FAINT
    right = np.maximum(first / width - off_right, 0.0)
    left = np.maximum(mass - first / width - off_left, 0.0)
    # Errors are on either side of the truth: a number may lack twice of what is taken off.
    lost = 2.0 * float(np.max(np.sum(off_left + off_right, axis=1)))
    return np.stack((left, right), axis=-1).reshape(len(axis), -1), lost


def applied(factors: FloatArray, tables: list[FloatArray]) -> FloatArray:
    """Factors (n, places) summed against one table per axis: (n, Z)."""
    tensor = factors.reshape(len(factors), *(table.shape[1] for table in tables))
    for k, table in enumerate(tables):
        tensor = np.moveaxis(np.tensordot(tensor, table, axes=(k + 1, 1)), -1, k + 1)
    return tensor.reshape(len(factors), -1)
