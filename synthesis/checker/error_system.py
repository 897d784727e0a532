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

from typing import NamedTuple

import numpy as np

from .rigorous import Array, Truth, U, Whole


class Forms(NamedTuple):
    """Linear forms of noise, of mean 0: upper bounds on their variances (J,) and on what one step adds to them (J,).

    They are made of ``sources`` (J, W), step by step ``moved`` (J, t, W) of them up to rounding; of no steps, where
    that is not known. ``size`` is above what is moved and what that is off by.
    """

    variance: Array
    largest: Array
    sources: Truth
    moved: Array
    size: Array

    def at(self, places: Truth | Whole) -> Forms:
        """Return some of these forms."""
        return Forms._make(own[places] for own in self)


class ErrorSystem:
    """What entered the errors at each step: F (D, D), boxes (2, D) of m + r, half widths (D,) of e, and the noise.

    Of the noise there are factors (D, W), and what they may be off by.
    """

    def __init__(self, spread: Array, n_sources: int) -> None:
        self.spread, self.n_sources = spread, n_sources
        self.products = self.before = np.eye(len(spread))[None]  # of all F from each time on: (t + 1, D, D)
        self.steps: list[tuple[Array, ...]] = []

    def step(self, matrix: Array, pushed: Array, reach: Array, noise: Array, off: Array | float = 0.0) -> None:
        """Add a step: ``e' = matrix e + pushed + noise w`` for all |e| <= reach."""
        self.steps.append((matrix, pushed, reach, noise, off + 0.0 * noise))
        self.before = self.products
        # Products F_t-1 .. F_s of all earlier times, made longer by one factor.
        self.products = np.concatenate([np.matmul(matrix, self.products), np.eye(len(matrix))[None]])

    def rows(self, c: Array, earlier: Array | None = None) -> tuple[Array, Forms]:
        """Return ends (2, J) of what rows c (J, D) of e are besides g, and g.

        With ``earlier`` (J, D) the rows are ``c e_t + earlier e_(t-1)``. Forms are linear in c, to the last bit.
        """
        t, pulled = len(self.steps), self._pulled(c, earlier)
        ends, (y, most) = self.besides(c, earlier, pulled), pulled
        if not t:
            still, nothing = np.zeros(len(c)), np.zeros((len(c), 0, self.n_sources))
            return ends, Forms(still, still, np.zeros(nothing.shape[::2], bool), nothing, nothing)
        moved, off = self._moved(y[1:], most[1:])
        size = np.abs(moved) + off
        # What each step adds to the variance; the largest one matters for long tails.
        each = np.einsum("sjw,sjw->sj", size, size)
        more = 1.0 + 4.0 * U * (len(y) * c.shape[1] + 64.0) + 4.0 * U * t * moved.shape[2]
        sources: Truth = np.any(size > 0.0, axis=0)
        variances = each.sum(axis=0) * more, each.max(axis=0) * more
        return ends, Forms(*variances, sources, moved.swapaxes(0, 1), size.swapaxes(0, 1))

    def besides(self, c: Array, earlier: Array | None = None, pulled: tuple[Array, Array] | None = None) -> Array:
        """Return the ends (2, J) alone of what such rows are besides g; they may have been ``pulled`` back already."""
        t, d, (y, most) = len(self.steps), c.shape[1], pulled or self._pulled(c, earlier)
        # sums of so many numbers of one sign are rounded by less
        counted = 1.0 + 4.0 * U * (len(y) * d + 64.0)
        spare = (np.abs(y[0]) + (d + 2.0) * U * most[0]) @ self.spread * counted
        if not t:
            return np.stack([-spare, spare])
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
        return np.stack([shift - spare, shift + spare])

    def _pulled(self, c: Array, earlier: Array | None) -> tuple[Array, Array]:
        """Return all ``y_s = c F_(t-1) .. F_s`` (t + 1, J, D) as they are rounded, and sizes of their roundings."""
        y, most = np.matmul(c[None], self.products), np.matmul(np.abs(c)[None], np.abs(self.products))
        if earlier is not None:
            y[:-1] += np.matmul(earlier[None], self.before)
            most[:-1] += np.matmul(np.abs(earlier)[None], np.abs(self.before))
        return y, most

    def _moved(self, after: Array, size: Array) -> tuple[Array, Array]:
        """Return ``y L`` (t, J, W) as it is rounded, and what it is off by; its square enters the variance."""
        noises, offs, d = *(np.array(own) for own in [*zip(*self.steps)][3:]), after.shape[2]
        moved, unit = np.matmul(after, noises), (2.0 * d + 6.0) * U
        return moved, np.matmul(size, unit * np.abs(noises) + offs) + np.where(moved != 0.0, 1e-160, 0.0)


def covariance_of(first: Forms, second: Forms) -> tuple[Array, Array]:
    """Return covariances (J, K) of forms, the noise of whose common steps is known, and what they are off by."""
    t = min(first.moved.shape[1], second.moved.shape[1])
    pairs = [(getattr(first, key)[:, :t], getattr(second, key)[:, :t]) for key in ("moved", "size")]
    found, inner, outer = (np.einsum("isw,jsw->ij", *pair) for pair in (pairs[0], map(np.abs, pairs[0]), pairs[1]))
    return found, (outer - inner) + (t * first.moved.shape[2] + 16.0) * 4.0 * U * outer + 1e-290
