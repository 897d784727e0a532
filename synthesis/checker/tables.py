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
from .intervals import add, interval, mul, neg
from .rigorous import Array, Truth, U

# Beyond ten deviations a tail is between 0 and 1e-23, and a density between 0 and 1e-21.
FAR, FAR_TAIL, FAR_DENSITY = 10.0, 1e-23, 1e-21


def normal_table(points: Array, edges: Array, deviation: float | Array, hats: bool) -> tuple[Array, float]:
    """Return probabilities (Z, S) of cells, or means (Z, 2 S) of their hats, and what a row lacks at most."""
    if not (np.all(np.greater(deviation, 0) & np.less(deviation, np.inf)) and np.all(np.diff(edges) > 0)):
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
    complement = add(interval(np.ones(x.shape)), neg(tail))
    right, left = np.where(x >= 0, tail, complement), np.where(x <= 0, tail, complement)
    # the difference of the smaller tails: of those to the right where the cell lies on the right
    on_right = x[:, :-1] + x[:, 1:] > 0
    from_right, from_left = add(right[..., :-1], neg(right[..., 1:])), add(left[..., 1:], neg(left[..., :-1]))
    mass = np.maximum(np.where(on_right, from_right, from_left), 0.0)
    if hats:
        mass = _hats(x, near, mass, np.diff(edges) / deviation)
    return mass[0], float(np.max(np.sum(mass[1] - mass[0], axis=1))) * 1.001


def _hats(x: Array, near: Truth, mass: Array, width: Array) -> Array:
    """Return ends (2, Z, 2 S) of the means of both hats of every cell."""
    density = np.zeros((2, *x.shape))
    density[1] = FAR_DENSITY
    density[:, near] = rigorous.density_at(x[near], 4.0)  # x is off by 2 U of itself
    # E (y + w - a)^+ on the cell, in deviations, divided by its width.
    a = x[:, :-1]
    first = add(density[..., :-1], neg(density[..., 1:]))
    first = add(first, neg(mul(np.stack([a - 4 * U * np.abs(a), a + 4 * U * np.abs(a)]), mass)))
    rising = np.clip(np.stack([first[0] / (width * (1 + 8 * U)), first[1] / (width * (1 - 8 * U))]), 0.0, None)
    falling = np.clip(add(mass, neg(rising)), 0.0, None)
    return np.stack([falling, rising], axis=-1).reshape(2, len(x), -1)
