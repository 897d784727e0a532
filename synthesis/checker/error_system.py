"""The errors around a trajectory as forms of the noise, and what else they may be.

At each step ``e' = F e + b + L w`` with known matrices F and L, and b in a box. For rows c at time t take any numbers
y_s (D,) with ``y_t = c``. By telescoping

    c e_t = y_0 e_0 + sum_s y_(s+1) L_s w_s + sum_s y_(s+1) b_s + sum_s (y_(s+1) F_s - y_s) e_s.

**Theorem** (``rows``). The second term is a form g of the noise, with the variance ``sum_s |L_s' y_(s+1)|^2``; the
others lie between the ends that are returned, while each e_s is within its reach.

*Proof.* The identity holds for any y: here those that are the products c P_s without any rounding, P_s being doubles.
What is computed differs by less than sizes ``|c| |P_s|`` times a unit, and the last sum charges what y misses. QED So g
is linear in c. A row ``c e_t + b e_(t-1)`` is the same with y_(t-1) moved by b.
"""

from __future__ import annotations

import numpy as np

from .constraints import Forms
from .rigorous import Array, Truth, U


class ErrorSystem:
    """What entered the errors at each step: F (D, D), boxes (2, D) of m + r, half widths (D,) of e, and the noise."""

    def __init__(self, spread: Array, n_sources: int) -> None:
        self.spread, self.n_sources = spread, n_sources
        self.products = self.before = np.eye(len(spread))[None]  # of all F from each time on: (t + 1, D, D)
        self.steps: list[tuple[Array, Array, Array, Array]] = []

    def step(self, matrix: Array, pushed: Array, reach: Array, noise: Array) -> None:
        """Add a step: ``e' = matrix e + pushed + noise w`` for all |e| <= reach."""
        self.steps.append((matrix, pushed, reach, noise))
        self.before = self.products
        # Products F_t-1 .. F_s of all earlier times, made longer by one factor.
        self.products = np.concatenate([np.matmul(matrix, self.products), np.eye(len(matrix))[None]])

    def rows(self, c: Array, earlier: Array | None = None) -> tuple[Array, Forms]:
        """Return ends (2, J) of what rows c (J, D) of e are besides g, and g.

        With ``earlier`` (J, D) the rows are ``c e_t + earlier e_(t-1)``. Forms are linear in c, to the last bit.
        """
        t, d = len(self.steps), c.shape[1]
        y, most = self._pulled(c, earlier)
        # sums of so many numbers of one sign are rounded by less
        counted = 1.0 + 4.0 * U * (len(y) * d + 64.0)
        spare = (np.abs(y[0]) + (d + 2.0) * U * most[0]) @ self.spread * counted
        if not t:
            still = np.zeros(len(c))
            return np.stack([-spare, spare]), Forms(still, still, np.zeros((len(c), self.n_sources), dtype=bool))
        before, after, size = y[:-1].copy(), y[1:], most[1:]
        if earlier is not None:
            before[-1] -= earlier
        matrices, pushed, reach = (np.array(own) for own in [*zip(*self.steps)][:3])
        # what y misses: the difference, its rounding, and underflow
        missed = np.abs(np.matmul(after, matrices) - before)
        missed += (2.0 * d + 8.0) * U * (np.matmul(size, np.abs(matrices)) + np.abs(before) + most[:-1]) + 1e-290
        spare = spare + np.einsum("sjd,sd->j", missed, reach) * counted
        # Boxes b: what their middles add up to is a shift, and their half widths add up.
        middle, half = 0.5 * (pushed[:, 0] + pushed[:, 1]), 0.5 * (pushed[:, 1] - pushed[:, 0])
        shift, shifted = np.einsum("sjd,sd->j", after, middle), np.einsum("sjd,sd->j", size, np.abs(middle))
        each = np.abs(after) + (d + 2.0) * U * size
        spare += np.einsum("sjd,sd->j", each, half + 2 * U * np.abs(middle)) * counted
        spare += (d * t + d + 8.0) * U * shifted + 1e-290
        moved, off = self._moved(after, size)
        moved = np.abs(moved) + off
        # What each step adds to the variance; the largest one matters for long tails.
        each = np.einsum("sjw,sjw->sj", moved, moved)
        more = counted + 4.0 * U * t * moved.shape[2]
        sources: Truth = np.any(moved > 0.0, axis=0)
        forms = Forms(each.sum(axis=0) * more, each.max(axis=0) * more, sources)
        return np.stack([shift - spare, shift + spare]), forms

    def covariance(self, c: Array) -> tuple[Array, Array]:
        """Return the covariance (J, J) of the forms of rows c, and what its entries are off by."""
        y, most = self._pulled(c, None)
        moved, off = self._moved(y[1:], most[1:])
        size, count = np.abs(moved) + off, moved.shape[0] * moved.shape[2]
        found, inner, outer = (np.einsum("siw,sjw->ij", part, part) for part in (moved, np.abs(moved), size))
        return found, (outer - inner) + (count + 16.0) * 4.0 * U * outer + 1e-290

    def _pulled(self, c: Array, earlier: Array | None) -> tuple[Array, Array]:
        """Return all ``y_s = c F_(t-1) .. F_s`` (t + 1, J, D) as they are rounded, and sizes of their roundings."""
        y, most = np.matmul(c[None], self.products), np.matmul(np.abs(c)[None], np.abs(self.products))
        if earlier is not None:
            y[:-1] += np.matmul(earlier[None], self.before)
            most[:-1] += np.matmul(np.abs(earlier)[None], np.abs(self.before))
        return y, most

    def _moved(self, after: Array, size: Array) -> tuple[Array, Array]:
        """Return ``y L`` (t, J, W) as it is rounded, and what it is off by; its square enters the variance."""
        noises, d = np.array([noise for *_, noise in self.steps]), after.shape[2]
        moved = np.matmul(after, noises)
        return moved, (2.0 * d + 6.0) * U * np.matmul(size, np.abs(noises)) + np.where(moved != 0.0, 1e-160, 0.0)
