"""Probabilities of cells under normal noise around the points of a lattice, and means of both hat functions of cells.

For a mean y on a lattice, noise w with the deviation s, and cells [a, b) of an axis, with u = (a - y)/s, v = (b - y)/s:

    P(y + w in [a, b)) = Phi(v) - Phi(u),
    E (y + w - a) / (b - a) on it = (phi(u) - phi(v) - u (Phi(v) - Phi(u))) / (v - u).

The second number is the mean of the *hat* that rises from a to b; the other hat has the rest of the first. A function
that is linear on cells is a sum of hats, so its mean is a sum of these numbers.

**Theorem.** Each entry is at most the true number, and entries of a row lack at most ``lack`` of it all together.
"""

from __future__ import annotations

import numpy as np

from . import rigorous
from .fields import Refused
from .intervals import add, down, mul, up
from .rigorous import PHI_0, Array, Truth, U

# Beyond ten deviations a tail is between 0 and 1e-23, and a density between 0 and 1e-21.
FAR, FAR_TAIL, FAR_DENSITY = 10.0, 1e-23, 1e-21


def normal_table(points: Array, edges: Array, deviation: float, hats: bool) -> tuple[Array, float]:
    """Return probabilities (Z, S) of cells, or means (Z, 2 S) of their hats, and what a row lacks at most."""
    if not (0.0 < deviation < np.inf and np.all(np.diff(edges) > 0)):
        raise Refused("cells need noise along every axis, and edges that increase")
    # Faces of cells as seen from the lattice points, in deviations.
    x = (edges - points[:, None]) / deviation
    near = np.abs(x) < FAR
    tail = np.zeros((2, *x.shape))
    tail[1] = FAR_TAIL
    low, high = rigorous.tail(np.abs(x[near]))
    # x is rounded twice, by 2 U of itself, which moves a tail by at most 2 U x phi(x) < U / 2
    tail[0][near], tail[1][near] = np.maximum(low - U, 0.0), high + U
    # Tails on either side; that of the far side is 1 less the near one.
    complement = np.stack([down(1.0 - tail[1]), up(1.0 - tail[0])])
    right, left = np.where(x >= 0, tail, complement), np.where(x <= 0, tail, complement)
    # the difference of the smaller tails: of those to the right where the cell lies on the right
    on_right = x[:, :-1] + x[:, 1:] > 0
    from_right = np.stack([right[0][:, :-1] - right[1][:, 1:], right[1][:, :-1] - right[0][:, 1:]])
    from_left = np.stack([left[0][:, 1:] - left[1][:, :-1], left[1][:, 1:] - left[0][:, :-1]])
    mass = np.where(on_right, from_right, from_left)
    mass = np.maximum(np.stack([down(mass[0]), up(mass[1])]), 0.0)
    if hats:
        mass = _hats(x, near, mass, np.diff(edges) / deviation)
    return mass[0], float(np.max(np.sum(mass[1] - mass[0], axis=1))) * 1.001


def _hats(x: Array, near: Truth, mass: Array, width: Array) -> Array:
    """Return ends (2, Z, 2 S) of the means of both hats of every cell."""
    density = np.zeros((2, *x.shape))
    density[1] = FAR_DENSITY
    square = x[near] ** 2
    # x is off by 2 U of itself, and its square by twice that and a rounding
    spare, ends = (5.0 * square + 8.0) * U, rigorous.exp(-0.5 * square)
    density[0][near] = np.maximum(ends[0] * (1 - spare) * PHI_0[0], 0.0)
    density[1][near] = ends[1] * (1 + spare) * PHI_0[1]
    # E (y + w - a)^+ on the cell, in deviations, divided by its width.
    a = x[:, :-1]
    first = np.stack([down(density[0][:, :-1] - density[1][:, 1:]), up(density[1][:, :-1] - density[0][:, 1:])])
    first = add(first, -mul(np.stack([a - 4 * U * np.abs(a), a + 4 * U * np.abs(a)]), mass)[::-1])
    rising = np.clip(np.stack([first[0] / (width * (1 + 8 * U)), first[1] / (width * (1 - 8 * U))]), 0.0, None)
    falling = np.clip(add(mass, -rising[::-1]), 0.0, None)
    return np.stack([falling, rising], axis=-1).reshape(2, len(x), -1)
