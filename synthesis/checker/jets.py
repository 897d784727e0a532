"""Values, first and second derivatives of expressions on boxes, and how far a function is from a linear one.

A *jet* holds, on n boxes at once and for v directions, an interval around the value (2, n), one around each partial
derivative (2, v, n), and one around each second derivative (2, v, v, n).

**Theorem** (derivatives). Let leaves enclose variables that depend on e in a convex set, with their derivatives in e.
Then ``jet`` encloses value and derivatives of the tree for every e there. Where a function is continuous and piecewise
smooth (abs, min, max at a kink), first derivatives enclose all *difference quotients*, and second ones are nan: not
known.

*Proof.* Sum, product and chain rule in interval arithmetic, operation by operation. At a kink the slope of the chord
lies in the hull of the slopes on both sides, which is what is returned there.

**Theorem** (``off_linear``). For e in a box W that holds 0, f(e) - f(0) - M e lies in each of

1. sum_i (S_i(W) - M_i) W_i, S(W) the slopes on W (mean value theorem),
2. sum_i (S_i(0) - M_i) W_i + 1/2 sum_ij H_ij(W) W_i W_j (Taylor's theorem; squares are squares),
3. the same with W replaced by T z + offset, |offset| <= off: products of what follows one z are squares of z.

The narrowest one that is known is returned. Form 1 needs no second derivatives, so it holds at kinks, too.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from .expressions import Tree
from .intervals import (
    add,
    atan,
    exp,
    interval,
    known,
    log,
    mul,
    neg,
    power,
    recip,
    root,
    sine,
    square,
    tangent,
    tanh,
    total,
)  # fmt: skip
from .rigorous import Array

Follow = tuple[Array, list[int], Array]
"""T (v, k), the places (k,) of z among the directions, and bounds (v,) on the offsets."""


@dataclass(eq=False)
class Jet:
    """Intervals around value (2, n), slopes (2, v, n) and second derivatives (2, v, v, n)."""

    value: Array
    slope: Array
    bend: Array

    @classmethod
    def variable(cls, value: Array, slope: Array) -> Jet:
        """Return a variable with values (2, n) that moves with v directions by numbers (v, n)."""
        v, n = slope.shape
        return cls(value, interval(slope), np.zeros((2, v, v, n)))

    @property
    def moves(self) -> bool:
        """Whether a derivative may be other than 0."""
        return bool(self.slope.any() or self.bend.any())

    def through(self, value: Array, first: Array, second: Array) -> Jet:
        """Return the jet of a function of this one, from intervals (2, n) around it and its two derivatives."""
        # undefined inside, undefined outside, whatever the function makes of nan
        value = np.where(known(self.value), value, np.nan)
        if not self.moves:
            return Jet(value, self.slope, self.bend)
        # Chain rule: f' H + f'' s s'.
        outer = mul(self.slope[:, :, None], self.slope[:, None])
        bend = add(mul(first[:, None, None], self.bend), mul(second[:, None, None], outer))
        return Jet(value, mul(first[:, None], self.slope), bend)

    def __add__(self, other: Jet) -> Jet:
        return Jet(add(self.value, other.value), add(self.slope, other.slope), add(self.bend, other.bend))

    def __neg__(self) -> Jet:
        return Jet(neg(self.value), neg(self.slope), neg(self.bend))

    def __mul__(self, other: Jet) -> Jet:
        a, b = self.value, other.value
        # 0 times what is undefined is undefined
        value = np.where(known(a) & known(b), mul(a, b), np.nan)
        slope = add(mul(a[:, None], other.slope), mul(b[:, None], self.slope))
        bend = add(mul(a[:, None, None], other.bend), mul(b[:, None, None], self.bend))
        if self.slope.any() and other.slope.any():
            outer = mul(self.slope[:, :, None], other.slope[:, None])
            bend = add(bend, add(outer, outer.swapaxes(1, 2)))
        return Jet(value, slope, bend)


def _number(x: float) -> Array:
    return interval(np.full(1, x))


def _power(a: Array, p: float) -> tuple[Array, Array, Array]:
    """Return x^p and its first two derivatives on intervals."""
    unknown = np.full_like(a, np.nan)

    def raised(q: float) -> Array:
        return power(a, q) if q else interval(np.ones_like(a[0]))

    first = mul(_number(p), raised(p - 1.0)) if p else 0.0 * a
    second = mul(mul(_number(p), _number(p - 1.0)), raised(p - 2.0)) if p not in (0.0, 1.0) else 0.0 * a
    # exponents p - 1 and p - 2 that are rounded are other exponents
    return raised(p), first if (p - 1.0) + 1.0 == p else unknown, second if (p - 2.0) + 2.0 == p else unknown


def _function(name: str, a: Array) -> tuple[Array, Array, Array]:
    """Return a function of one argument and its first two derivatives on intervals (2, n)."""
    if name == "sin":
        s = sine(a)
        return s, sine(a, 1), neg(s)
    if name == "cos":
        c = sine(a, 1)
        return c, neg(sine(a)), neg(c)
    if name == "exp":
        e = exp(a)
        return e, e, e
    if name == "tan":
        t = tangent(a)
        first = add(_number(1.0), square(t))
        return t, first, mul(mul(_number(2.0), t), first)
    if name == "tanh":
        t = tanh(a)
        first = add(_number(1.0), neg(square(t)))
        return t, first, mul(mul(_number(-2.0), t), first)
    if name == "log":
        r = recip(np.where(a[0] > 0, a, np.nan))
        return log(a), r, neg(square(r))
    if name == "sqrt":
        r = root(a)
        first = recip(add(r, r))
        return r, first, neg(mul(first, recip(add(a, a))))
    if name == "atan":
        r = recip(add(_number(1.0), square(a)))
        return atan(a), r, mul(mul(_number(-2.0), a), square(r))
    if name == "recip":
        r = recip(a)
        return r, neg(square(r)), mul(_number(2.0), power(r, 3.0))
    assert name == "abs"
    # abs: one slope on each side, and both at a kink.
    right, left = a[0] >= 0, a[1] <= 0
    value = np.stack([np.maximum(np.maximum(a[0], -a[1]), 0.0), np.maximum(-a[0], a[1])])
    # at 0 itself both slopes count
    slope = np.stack([np.where(right & ~left, 1.0, -1.0), np.where(left & ~right, -1.0, 1.0)]) + 0 * a
    return value, slope, np.where(right ^ left, 0.0, np.nan) + 0 * a


def _maximum(a: Jet, b: Jet) -> Jet:
    """Return the larger one of two: where either may be, slopes are between theirs, and bends are not known."""
    first, second = a.value[0] >= b.value[1], b.value[0] >= a.value[1]
    # at a tie of two points either may be the larger one on the box around them
    first, second = first & ~second, second & ~first
    hull = np.stack([np.minimum(a.slope[0], b.slope[0]), np.maximum(a.slope[1], b.slope[1])])
    slope = np.where(first, a.slope, np.where(second, b.slope, hull))
    bend = np.where(first, a.bend, np.where(second, b.bend, np.nan))
    return Jet(np.maximum(a.value, b.value) + 0 * (a.value + b.value), slope, bend)


Memory = dict[Tree, Jet]
"""Jets of subtrees that were computed; for one set of leaves."""


def jet(tree: Tree, leaves: Mapping[str, Jet], memory: Memory) -> Jet:
    """Return the jet of a tree, from those of its names; ``memory`` holds subtrees that repeat themselves."""
    if isinstance(tree, str):
        return leaves[tree]
    if isinstance(tree, float):
        like = next(iter(leaves.values()))
        return Jet(interval(np.full(like.value.shape[1], tree)), 0.0 * like.slope, 0.0 * like.bend)
    if tree not in memory:
        memory[tree] = _operation(tree, leaves, memory)
    return memory[tree]


def _operation(tree: tuple[Tree, ...], leaves: Mapping[str, Jet], memory: Memory) -> Jet:
    name, *arguments = tree
    if name == "*" and arguments[0] == arguments[1]:
        name, arguments = "**", [arguments[0], 2.0]  # a square is no product of two different numbers
    if name == "**":
        base, exponent = arguments
        if isinstance(exponent, float):
            inner = jet(base, leaves, memory)
            return inner.through(*_power(inner.value, exponent))
        return jet(("exp", ("*", exponent, ("log", base))), leaves, memory)
    a = jet(arguments[0], leaves, memory)
    if len(arguments) == 1:
        return -a if name == "negative" else a.through(*_function(str(name), a.value))
    b = jet(arguments[1], leaves, memory)
    if name == "+":
        return a + b
    if name == "-":
        return a + (-b)
    if name == "*":
        return a * b
    if name == "/":
        return a * b.through(*_function("recip", b.value))
    assert name in ("min", "max")
    return _maximum(a, b) if name == "max" else -_maximum(-a, -b)


def off_linear(centre: Jet, around: Jet, box: Array, matrix: Array, follow: Follow | None = None) -> Array:
    """Return intervals (2, n) around f(e) - f(0) - matrix e for e in a box (2, v, n), by the theorem above.

    Parameters
    ----------
    centre, around : Jet
        At e = 0, and on the box.
    matrix : (v, n) array
    follow : (T, places, off), optional
        e is ``T @ z`` up to ``off`` (v,), z its own entries at ``places``.
    """
    # Taylor at the centre, the mean value theorem on the box, and Taylor along what directions follow.
    row = interval(matrix)
    at_centre = total(mul(add(centre.slope, neg(row)), box), 0)
    forms = [
        total(mul(add(around.slope, neg(row)), box), 0),
        add(at_centre, mul(_number(0.5), _quadratic(around.bend, box))),
    ]
    if follow is not None:
        transform, places, off = interval(follow[0])[..., None], follow[1], follow[2][:, None]
        # T' H T, in two steps.
        half = total(mul(around.bend[:, :, :, None], transform[:, None]), 1)  # (v, k)
        bend = total(mul(transform[:, :, :, None], half[:, :, None]), 0)  # (k, k)
        # e' H e differs from z' T'H T z by at most off' |H| (|e| + |T z|) <= off' |H| (2 |e| + off)
        size, far = np.abs(around.bend).max(axis=0), np.abs(box).max(axis=0)
        spare = np.einsum("in,ijn,jn->n", off, size, far + 0.5 * off) * (1.0 + 2.0**-30) + 1e-300
        taylor = add(at_centre, mul(_number(0.5), _quadratic(bend, box[:, places])))
        forms.append(add(taylor, np.stack([-spare, spare])))
    # where f is not defined on all of the box nothing is known
    candidates = np.array([np.where(known(around.value), form, np.nan) for form in forms])
    widths = np.where(np.isnan(candidates).any(axis=1), np.inf, candidates[:, 1] - candidates[:, 0])
    return np.take_along_axis(candidates, widths.argmin(axis=0)[None, None], axis=0)[0]


def _quadratic(bend: Array, box: Array) -> Array:
    """Return intervals (2, n) around e' H e for e in a box (2, v, n)."""
    v = box.shape[1]
    products = mul(box[:, :, None], box[:, None])
    products[:, np.arange(v), np.arange(v)] = square(box)
    return total(mul(bend, products).reshape(2, v * v, -1), 0)


def value_on(tree: Tree, names: Mapping[str, Array]) -> Array:
    """Return intervals (2, n) around a tree where its names lie between ends (2, n): values alone."""
    leaves = {name: Jet.variable(ends, np.zeros((0, ends.shape[1]))) for name, ends in names.items()}
    return jet(tree, leaves, {}).value
