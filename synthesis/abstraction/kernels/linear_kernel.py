"""Expected values of factors that are multilinear in every cell, from below.

The kernel maps the numbers of a factor at the corners of cells to ``g(z) = E l(z + w)`` at every lattice point z. It
is a product over axes as before: the table of an axis holds, for each cell, the masses of its two hats, ``E (b - y) /
(b - a)`` and ``E (y - a) / (b - a)`` over the cell [a, b).
"""

from __future__ import annotations

import math

import numpy as np
from scipy.special import ndtr

from ...certificates.value_functions import UNIT
from ...relations.grids import FloatArray
from .kernel import LATTICE_BLOCK, REACH_DEVIATIONS, AxisTable, gaussian_masses

HAT_SLACK = 64.0
"""Units in the last place by which a density may be off near the mean, several times over."""

SMALLEST_ERROR = 1e-30
"""Error that is allowed for where densities and tails are too small to have all their digits."""

BEYOND_REACH = 3e-19
"""Upper bound on the mass of a normal distribution beyond 9 standard deviations, 2.3e-19."""


def hat_masses(means: FloatArray, edges: FloatArray, std: float) -> tuple[FloatArray, float]:
    """Return masses (Z, 2 S) of hats, from below, and an upper bound on what a row of them misses.

    The masses are ``E (b - y) / (b - a)`` and ``E (y - a) / (b - a)`` over each cell [a, b), with ``y = z + w``.

    Parameters
    ----------
    means : (Z,) array
    edges : (S + 1,) array
    std : float
    """
    whole, missing = gaussian_masses(means, edges, std)
    x = (edges[None, :] - means[:, None]) / std
    density = np.exp(-0.5 * x * x) / math.sqrt(2.0 * math.pi)
    width = np.diff(edges) / std
    left, right = x[:, :-1], x[:, 1:]
    fall = density[:, :-1] - density[:, 1:]
    # E (y - a)^+ over the cell, in standard deviations: the first moment is a difference of densities.
    inside = np.where(left > 0, ndtr(-left) - ndtr(-right), ndtr(right) - ndtr(left))
    upper = (fall - left * inside) / width
    tail = ndtr(-np.abs(x))
    density_error = (HAT_SLACK + 8.0 * x * x) * density
    tail_error = (20.0 + 8.0 * (1.0 + x * x)) * tail
    slack = density_error[:, :-1] + density_error[:, 1:]
    slack += (1.0 + np.abs(left)) * (tail_error[:, :-1] + tail_error[:, 1:] + 4.0 * inside)
    slack = UNIT * (slack + SMALLEST_ERROR) / width
    upper = np.clip(upper - slack, 0.0, whole)
    lower = np.maximum(whole - upper - 2.0 * slack, 0.0)
    masses = np.stack([lower, upper], axis=-1).reshape(len(means), -1)
    return masses, missing + float(np.max(np.sum(6.0 * slack, axis=1)))


def hat_table(means: FloatArray, edges: FloatArray, std: float) -> tuple[AxisTable, float]:
    """Return a banded table of hat masses, from below, and what a row misses at most."""
    blocks, loss = [], 0.0
    for z0 in range(0, len(means), LATTICE_BLOCK):
        block_means = means[z0 : z0 + LATTICE_BLOCK]
        s0 = max(0, int(np.searchsorted(edges, block_means[0] - REACH_DEVIATIONS * std)) - 1)
        s1 = min(len(edges) - 1, int(np.searchsorted(edges, block_means[-1] + REACH_DEVIATIONS * std)))
        s0, s1 = min(s0, len(edges) - 2), max(s1, 1)
        masses, missing = hat_masses(block_means, edges[s0 : s1 + 1], std)
        blocks.append((z0, z0 + len(block_means), 2 * s0, 2 * s1, masses))
        loss = max(loss, missing)
    return AxisTable((len(means), 2 * (len(edges) - 1)), tuple(blocks)), loss + BEYOND_REACH
