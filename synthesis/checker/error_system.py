"""The errors around a trajectory as forms of the noise, and what else they may be.

At each step ``e' = F e + b + L w`` with known matrices F and L, and b in a box. For rows c at time t take any numbers
y_s (D,) with ``y_t = c``. By telescoping

    c e_t = y_0 e_0 + sum_s y_(s+1) L_s w_s + sum_s y_(s+1) b_s + sum_s (y_(s+1) F_s - y_s) e_s.

**Theorem** (``rows``). The second term is a form g of the noise, with the variance ``sum_s |L_s' y_(s+1)|^2``; the
others lie between the ends that are returned, while each e_s is within its reach.

*Proof.* The identity holds for any y. Whatever y was rounded by is charged by the last sum, so that nothing has to be
known of how it was computed. QED A row ``c e_t + b e_(t-1)`` is the same with y_(t-1) moved by b.
"""

from __future__ import annotations

import numpy as np

from .constraints import Forms
from .rigorous import Array, U


class ErrorSystem:
    """What entered the errors at each step: F (D, D), boxes (2, D) of m + r, half widths (D,) of e, and the noise."""

    def __init__(self, spread: Array, n_sources: int) -> None:
        self.spread, self.n_sources = spread, n_sources
        self.products = np.eye(len(spread))[None]  # of all F from each time on: (t + 1, D, D)
        self.matrices: list[Array] = []
        self.pushed: list[Array] = []
        self.reach: list[Array] = []
        self.noises: list[Array] = []
        self.before = self.products

    def step(self, matrix: Array, pushed: Array, reach: Array, noise: Array) -> None:
        """Add a step: ``e' = matrix e + pushed + noise w`` for all |e| <= reach."""
        self.before = self.products
        # Products F_t-1 .. F_s of all earlier times, made longer by one factor.
        self.products = np.concatenate([np.matmul(matrix, self.products), np.eye(len(matrix))[None]])
        self.matrices.append(matrix)
        self.pushed.append(pushed)
        self.reach.append(reach)
        self.noises.append(noise)

    def rows(self, c: Array, earlier: Array | None = None) -> tuple[Array, Forms]:
        """Return ends (2, J) of what rows c (J, D) of e are besides g, and g.

        With ``earlier`` (J, D) the rows are ``c e_t + earlier e_(t-1)``.
        """
        t, d = len(self.matrices), c.shape[1]
        # y_s = c F_(t-1) .. F_s as floating point computes it: what it lacks is charged below.
        y = np.matmul(c[None], self.products)  # (t + 1, J, D)
        if earlier is not None:
            y[:t] += np.matmul(earlier[None], self.before)
        # sums of so many numbers of one sign are rounded by less
        counted = 1.0 + 4.0 * U * (y.shape[0] * d + 64.0)
        spare = np.abs(y[0]) @ self.spread * counted
        if not t:
            still = np.zeros(len(c))
            return np.stack([-spare, spare]), Forms(still, still, np.zeros((len(c), self.n_sources), dtype=bool))
        before, after, size = y[:-1].copy(), y[1:], np.abs(y[1:])
        if earlier is not None:
            before[-1] -= earlier
        matrices, pushed, noises = np.array(self.matrices), np.array(self.pushed), np.array(self.noises)
        # what y misses: the difference, its rounding, and underflow
        missed = np.abs(np.matmul(after, matrices) - before)
        missed += (d + 6.0) * U * (np.matmul(size, np.abs(matrices)) + np.abs(before) + np.abs(y[:-1])) + 1e-290
        spare = spare + np.einsum("sjd,sd->j", missed, np.array(self.reach)) * counted
        # Boxes b: what their middles add up to is a shift, and their half widths add up.
        middle, half = 0.5 * (pushed[:, 0] + pushed[:, 1]), 0.5 * (pushed[:, 1] - pushed[:, 0])
        shift, shifted = np.einsum("sjd,sd->j", after, middle), np.einsum("sjd,sd->j", size, np.abs(middle))
        spare += np.einsum("sjd,sd->j", size, half + 2 * U * np.abs(middle)) * counted
        spare += (d * t + 8.0) * U * shifted + 1e-290
        # every product y L is off by less than this, and its square enters the variance
        moved = np.abs(np.matmul(after, noises))
        moved += (d + 4.0) * U * np.matmul(size, np.abs(noises)) + np.where(moved > 0.0, 1e-160, 0.0)
        # What each step adds to the variance; the largest one matters for long tails.
        each = np.einsum("sjw,sjw->sj", moved, moved)
        more = counted + 4.0 * U * t * moved.shape[2]
        forms = Forms(each.sum(axis=0) * more, each.max(axis=0) * more, (moved > 0.0).any(axis=0))
        return np.stack([shift - spare, shift + spare]), forms
