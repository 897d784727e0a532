"""The errors around a trajectory as forms of the noise, and what else they may be.

At each step ``e' = F e + b + L w`` with known matrices F and L, and b in a box. For rows c at time t take any numbers
y_s (D,) with ``y_t = c``. By telescoping

    c e_t = y_0 e_0 + sum_s y_(s+1) L_s w_s + sum_s y_(s+1) b_s + sum_s (y_(s+1) F_s - y_s) e_s.

**Theorem** (``rows``). The second term is a form g of the noise, with the variance ``sum_s |L_s' y_(s+1)|^2``; the
others lie between the ends that are returned, while each e_s is within its reach.

*Proof.* The identity holds for any y: here those that are the products c P_s without any rounding, P_s being doubles.
What is computed differs by less than sizes ``|c| |P_s|`` times a unit, and the last sum charges what y misses. QED So g
is linear in c. A row ``c e_t + b e_(t-1)`` is the same with y_(t-1) moved by b.

**Theorem** (``Ellipsoid``). Let W be a matrix, V the covariance of W g in d dimensions, v at least its largest
eigenvalue, and y = R^2 / v. Then ``P(|W g| > R)`` is at most ``P(chi2_d > y)``, or, of sub-Gaussian noise, also where
its size depends on the past, ``(y / d)^(d/2) exp((d - y) / 2)`` for y > d. Where ``|W g| <= R`` every row c satisfies
``|c g| <= R |a| + |c - a W| |g|``, for any a. Eigenvalues are bounded by absolute sums of rows (Gershgorin); W is about
the inverse of a root of the covariance of g, so that v is 1 up to rounding, and a is c times that root.

**Theorem** (``Seen.forms``). Let e = g + d with |P g| <= r and |p_k d| <= b_k, p_k the rows of a matrix P, Q symmetric,
l any numbers, and l+ = max(l, 0). Then

    e Q e <= r^2 max_k l+_k + 2 r |(l+_k b_k)_k| + sum_k l+_k b_k^2 + |e| |Q - P' diag(l) P| |e|.

From below it is the same of -Q. Here l and V are about the eigenvalues and eigenvectors of L' Q L, L about the inverse
of W, and P = V' W. *Proofs.* docs/theory/paths.md, Theorem Paths.11 and Lemma Paths.15.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from . import rigorous
from .distributions import LIGHT, NORMAL
from .intervals import add, down, interval, up
from .jets import quadratic
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
        each = np.sum(size * size, axis=2)
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
    found, inner, outer = (np.tensordot(a, b, ((1, 2), (1, 2))) for a, b in (pairs[0], map(np.abs, pairs[0]), pairs[1]))
    return found, (outer - inner) + (t * first.moved.shape[2] + 16.0) * 4.0 * U * outer + 1e-290


@dataclass(frozen=True, eq=False)
class Ellipsoid:
    """``|W g| <= radius`` for the errors of one agent; ``root`` is about the inverse of W."""

    root: Array
    white: Array
    radius: float
    lost: float

    @classmethod
    def of(cls, errors: ErrorSystem, places: Whole, radius: float, kinds: Whole) -> Ellipsoid:
        """Return the ellipsoid of errors now, and the probability that they are outside; ``kinds`` of sources."""
        D = len(errors.spread)
        (_, now), d = errors.rows(np.eye(D)[places]), len(places)
        covariance = covariance_of(now, now)[0]
        # Any root will do: states that no noise has reached get a little of their own.
        scale = np.sqrt(np.maximum(np.diag(covariance), 1e-30))
        root = np.linalg.cholesky(covariance / np.outer(scale, scale) + 1e-10 * np.eye(d)) * scale[:, None]
        rows = np.zeros((d, D))
        rows[:, places] = np.linalg.inv(root)
        _, white = errors.rows(rows)
        found, off = covariance_of(white, white)
        largest = float(np.max(np.sum(np.abs(found) + off, axis=1))) * (1.0 + 4.0 * U * d)
        kind = int(np.where(white.sources, kinds, NORMAL).max(initial=NORMAL))
        return cls(root, rows[:, places], radius, length_tail(radius, d, largest, kind))

    @property
    def widths(self) -> Array:
        """Upper bounds (d,) on |g|."""
        # g = root h + (1 - root W) g: what the root misses is small, and g is hardly more than root h
        d, most = len(self.root), 1.01 * self.radius * np.sqrt(np.max(np.sum(self.root**2, axis=1)))
        off = np.abs(np.eye(d) - self.root @ self.white) + (d + 4.0) * U * np.abs(self.root) @ np.abs(self.white)
        known = np.max(off.sum(axis=1)) <= 1e-3
        return self.reach(np.eye(d), np.full(d, most)) if known else np.full(d, np.inf)

    def reach(self, rows: Array, most: Array) -> Array:
        """Return upper bounds (n,) on ``|c g|`` for rows (n, d), where ``|g| <= most`` (d,)."""
        a = rows @ self.root
        size, d = np.abs(a), len(most)
        missed = np.abs(rows - a @ self.white) + (d + 4.0) * U * (np.abs(rows) + size @ np.abs(self.white))
        length = np.sqrt(np.sum(a * a, axis=1)) * (1.0 + (d + 8.0) * U)
        return np.asarray(up(self.radius * length) + (missed @ most) * (1.0 + (d + 4.0) * U) + 1e-290)


@dataclass(frozen=True, eq=False)
class Seen:
    """Errors e of some states at a time: in a box with ends (2, d), and in an ellipsoid once there is noise.

    ``besides`` takes rows (n, d) to ends (2, n) of what they are besides g.
    """

    ends: Array
    ellipsoid: Ellipsoid | None
    besides: Callable[[Array], Array]

    @cached_property
    def far(self) -> Array:
        """Upper bounds (d,) on |e|."""
        return np.asarray(np.abs(self.ends).max(axis=0))

    @cached_property
    def most(self) -> Array:
        """Upper bounds (d,) on |g|."""
        return np.asarray(up(self.far + np.abs(self.besides(np.eye(len(self.far)))).max(axis=0)))

    def rows(self, C: Array) -> Array:
        """Return ends (2, n) of C e for rows C (n, d)."""
        spare = (len(self.far) + 4.0) * U * (np.abs(C) @ self.far) + 1e-290
        products = C * self.ends[:, None]
        box = np.stack([products.min(axis=0).sum(axis=1) - spare, products.max(axis=0).sum(axis=1) + spare])
        if self.ellipsoid is None:
            return box
        drift, most = self.besides(C), self.ellipsoid.reach(C, self.most)
        return np.stack([np.maximum(box[0], down(drift[0] - most)), np.minimum(box[1], up(drift[1] + most))])

    def forms(self, Q: Array) -> Array:
        """Return ends (2, n) of e' Q e for matrices Q (n, d, d)."""
        n, d, own = *Q.shape[:2], self.ellipsoid
        if not Q.any():
            return np.zeros((2, n))
        box = quadratic(interval(Q.transpose(1, 2, 0)), self.ends[..., None])
        half = 0.5 * (Q + Q.swapaxes(1, 2))
        if own is None or not np.all(np.isfinite(turned := own.root.T @ half @ own.root)):
            return box
        values, V = np.linalg.eigh(turned)
        P = V.swapaxes(1, 2) @ own.white
        # |P g| <= |V| |W g|, and what P is rounded by; V is about orthogonal
        size, far, most = np.abs(V).swapaxes(1, 2), self.far, self.most
        gram = np.abs(V.swapaxes(1, 2) @ V) + (d + 4.0) * U * size @ size.swapaxes(1, 2)
        lost = (d + 4.0) * U * size @ (np.abs(own.white) @ most)
        length = own.radius * np.sqrt(gram.sum(axis=2).max(axis=1)) + np.sqrt(np.sum(lost * lost, axis=1))
        beside = np.abs(self.besides(P.reshape(-1, d))).max(axis=0).reshape(n, d)
        # what P' diag(l) P is not, and rounds
        size = np.abs(P).swapaxes(1, 2) @ (np.abs(values)[:, :, None] * np.abs(P)) + np.abs(half)
        missed = np.abs(half - P.swapaxes(1, 2) @ (values[:, :, None] * P)) + (d + 8.0) * U * size
        ends, rounded = [], 1.0 + (d * d + 64.0) * U
        for sign in (-1.0, 1.0):
            up_to = np.maximum(sign * values, 0.0)
            total = length * (length * up_to.max(axis=1) + 2.0 * np.sqrt(np.sum((up_to * beside) ** 2, axis=1)))
            total += np.sum(up_to * beside**2, axis=1) + (missed @ far) @ far
            ends.append(sign * (total * rounded + 1e-290))
        return np.stack([np.maximum(box[0], ends[0]), np.minimum(box[1], ends[1])])

    def followed(self, which: Truth, transform: Array, off: Array, box: Array, free: list[int], bend: Array) -> Array:
        """Return ends (2, 1) of v' H v for variables in a box (2, v), all of which follow those that are free.

        They are ``transform @ z`` and no more than ``off`` (v,), z (k,) the free ones; ``which`` (d, k) of these are
        seen. H (v, v, 1) is the ``bend``.
        """
        far, seen, moves, H = np.abs(box).max(axis=0), which.any(axis=0), which.astype(float), bend[..., 0]
        moved, size, M = np.abs(transform) @ far[free], np.abs(H), transform.T @ H @ transform
        rest = quadratic(interval(np.where(np.outer(seen, seen), 0.0, M))[..., None], box[:, free, None])
        # v' H v differs from z' T'H T z by off' |H| (|v| + |T z|) <= off' |H| (2 |v| + off), and T'H T rounds
        spare = off @ size @ (2.0 * far + off) + (2.0 * len(far) + 8.0) * U * (moved @ size @ moved)
        spare = spare * (1.0 + 2.0**-30) + 1e-290
        return add(add(self.forms((moves @ M @ moves.T)[None]), rest), np.array([[-spare], [spare]]))


def length_tail(radius: float, d: int, largest: float, kind: int = NORMAL) -> float:
    """Return an upper bound on P(|W g| > radius) for noise of a kind of tails, by the theorems above.

    For normal noise, and x = radius^2 / (2 largest), it is ``exp(-x)`` times the sum of ``x^k / k!`` for k < d / 2 if d
    is even; else twice the normal tail at sqrt(2 x), and ``exp(-x)`` times the sum of ``x^(k + 1/2) / Gamma(k + 3/2)``.
    """
    if not (radius > 0.0 and 0.0 < largest < np.inf) or kind > LIGHT:
        return 1.0
    y = min(radius * radius / largest, 1360.0) * (1.0 - 8.0 * U)
    if kind != NORMAL:
        exponent = 0.5 * (d * (float(rigorous.log(np.full(1, up(y / d)))[1][0]) + 1.0) - y) + 16.0 * U * (d + y)
        return min(1.0, float(rigorous.exp(np.full(1, exponent))[1][0])) if y > d else 1.0
    # The first term, and what each is more than the one before: half-odd powers if d is odd; 1 / Gamma(3/2) = 1.128..
    x, half = 0.5 * y, 0.5 * (d % 2)
    term, total = float(rigorous.exp(np.full(1, -x))[1][0]), 0.0
    if half:
        term *= math.sqrt(x) * 1.1283791670955128
        total = 2.0 * float(rigorous.tail(min(math.sqrt(2.0 * x) * (1.0 - 4.0 * U), 37.0))[1])
    for k in range(d // 2):
        total += term
        term *= x / (k + 1.0 + half)
    return min(1.0, total * (1.0 + (4.0 * d + 64.0) * U))
