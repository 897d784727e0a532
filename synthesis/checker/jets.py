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
3. the same with the middle of H apart, whose form is bounded by who asks, who may know more of e than W.

The narrowest one that is known is returned. Form 1 needs no second derivatives, so it holds at kinks, too.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from . import intervals
from .expressions import Tree, plain_sum
from .fields import Refused
from .intervals import add, interval, known, mul, neg, power, recip, sine, square, total
from .rigorous import Array

Places = dict[str, int]
Around = tuple[Array, Array, Array]
Bounded = Callable[[Array], Array] | None  # from H (v, v, n) to ends (2, n) of e' H e, for all possible e


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

    def of(self, some: slice) -> Jet:
        """Return the jet on some of the boxes."""
        return Jet(self.value[:, some], self.slope[..., some], self.bend[..., some])

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


def _abs(a: Array) -> Array:
    return np.stack([np.maximum(np.maximum(a[0], -a[1]), 0.0), np.maximum(-a[0], a[1])])


def _sign(a: Array) -> Array:
    # one slope on each side, and both at a kink; at 0 itself both count
    right, left = a[0] >= 0, a[1] <= 0
    return np.stack([np.where(right & ~left, 1.0, -1.0), np.where(left & ~right, -1.0, 1.0)]) + 0 * a


ONE, TWO = _number(1.0), _number(2.0)

CALCULUS: dict[str, tuple[Callable[[Array], Array], Callable[..., Array], Callable[..., Array]]] = {
    "sin": (sine, lambda a, f: sine(a, 1), lambda a, f, d: neg(f)),
    "cos": (lambda a: sine(a, 1), lambda a, f: neg(sine(a)), lambda a, f, d: neg(f)),
    "tan": (intervals.tangent, lambda a, f: add(ONE, square(f)), lambda a, f, d: mul(mul(TWO, f), d)),
    "exp": (intervals.exp, lambda a, f: f, lambda a, f, d: f),
    "tanh": (intervals.tanh, lambda a, f: add(ONE, neg(square(f))), lambda a, f, d: mul(mul(-TWO, f), d)),
    "log": (intervals.log, lambda a, f: recip(np.where(a[0] > 0, a, np.nan)), lambda a, f, d: neg(square(d))),
    "sqrt": (intervals.root, lambda a, f: recip(add(f, f)), lambda a, f, d: neg(mul(d, recip(add(a, a))))),
    "atan": (intervals.atan, lambda a, f: recip(add(ONE, square(a))), lambda a, f, d: mul(mul(-TWO, a), square(d))),
    "recip": (recip, lambda a, f: neg(square(f)), lambda a, f, d: mul(TWO, power(f, 3.0))),
    "abs": (_abs, lambda a, f: _sign(a), lambda a, f, d: np.where(d[0] == d[1], 0.0, np.nan) + 0 * a),
}
"""Functions f of one argument a: value, first derivative d, and second derivative, on intervals (2, n)."""


def _function(name: str, a: Array) -> tuple[Array, Array, Array]:
    """Return a function and its first two derivatives on intervals."""
    value, first, second = CALCULUS[name]
    f = value(a)
    d = first(a, f)
    return f, d, second(a, f, d)


def _maximum(a: Jet, b: Jet) -> Jet:
    """Return the larger one of two: where either may be, slopes are between theirs, and bends are not known."""
    first, second = a.value[0] >= b.value[1], b.value[0] >= a.value[1]
    # at a tie of two points either may be the larger one on the box around them
    first, second = first & ~second, second & ~first
    hull = np.stack([np.minimum(a.slope[0], b.slope[0]), np.maximum(a.slope[1], b.slope[1])])
    slope = np.where(first, a.slope, np.where(second, b.slope, hull))
    bend = np.where(first, a.bend, np.where(second, b.bend, np.nan))
    return Jet(np.maximum(a.value, b.value) + 0 * (a.value + b.value), slope, bend)


Memory = dict[Tree, Jet]  # jets of subtrees that were computed; for one set of leaves


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
        return a * b.through(*_function("recip", b.value))  # not known where b may be 0
    assert name in ("min", "max")
    return _maximum(a, b) if name == "max" else -_maximum(-a, -b)


def off_linear(centre: Jet, around: Jet, box: Array, matrix: Array, bounded: Bounded = None) -> Array:
    """Return intervals (2, n) around f(e) - f(0) - matrix e for e in a box (2, v, n), by the theorem above.

    Jets are those at e = 0, and on the box; ``bounded`` are forms of e.
    """
    # Taylor at the centre, the mean value theorem on the box, and Taylor with forms that are bounded as such.
    row, half = interval(matrix), _number(0.5)
    at_centre = total(mul(add(centre.slope, neg(row)), box), 0)
    mean_value = total(mul(add(around.slope, neg(row)), box), 0)
    forms = [mean_value, add(at_centre, mul(half, quadratic(around.bend, box)))]
    if bounded is not None:
        middle = 0.5 * (around.bend[0] + around.bend[1])
        curve = add(bounded(middle), quadratic(add(around.bend, -interval(middle)), box))
        forms.append(add(at_centre, mul(half, curve)))
    # where f is not defined on all of the box nothing is known
    candidates = np.array([np.where(known(around.value), form, np.nan) for form in forms])
    widths = np.where(np.isnan(candidates).any(axis=1), np.inf, candidates[:, 1] - candidates[:, 0])
    return np.take_along_axis(candidates, widths.argmin(axis=0)[None, None], axis=0)[0]


def quadratic(bend: Array, box: Array) -> Array:
    """Return intervals (2, n) around e' H e for e in a box (2, v, n)."""
    v = box.shape[1]
    products = mul(box[:, :, None], box[:, None])
    products[:, np.arange(v), np.arange(v)] = square(box)
    return total(mul(bend, products).reshape(2, v * v, -1), 0)


def value_on(tree: Tree, names: Mapping[str, Array]) -> Array:
    """Return intervals (2, n) around a tree where its names lie between ends (2, n): values alone."""
    return jet(tree, {name: Jet.variable(own, np.zeros((0, own.shape[1]))) for name, own in names.items()}, {}).value


def expanded(
    trees: Sequence[Tree], point: Array, places: Places, box: Array, t: int, free: int, bounded: Bounded = None
) -> tuple[Array, Array]:
    """Return a matrix (p, v), and ends (2, p) of what trees are besides it, for deviations in a box (2, v) of a point.

    ``places`` says which of the v variables a name is, ``t`` the time, unless a variable is called so. The matrix has
    zeros beyond the first ``free`` variables; forms of them may be ``bounded`` (``off_linear``).
    ``Refused`` if an expression is not defined on the box.
    """
    matrix, ends = np.zeros((len(trees), len(point))), np.zeros((2, len(trees)))
    sums = [plain_sum(tree) for tree in trees]
    bent = [p for p, terms in enumerate(sums) if terms is None]
    for p, terms in enumerate(sums):
        if terms is not None:
            matrix[p], ends[:, p] = _of_sum(terms, point, places, box, t, free)
    if bent:
        some, still = [trees[p] for p in bent], {"t": interval(np.full(1, float(t)))}
        ranges = add(interval(point), box)[..., None]
        found = on_boxes(some, places, still, (point[:, None], box[..., None], ranges), free, bounded)
        matrix[bent], ends[:, bent] = found[0][..., 0], found[1][..., 0]
    for tree, row, own in zip(trees, matrix, ends.T):
        if not np.all(np.isfinite(row)) or not np.all(np.isfinite(own)):
            raise Refused(f"an expression has no slope, or is not known on the tube, at time {t}: {str(tree)[:60]}")
    return matrix, ends


def _of_sum(
    terms: Sequence[tuple[float, str]], point: Array, places: Places, box: Array, t: int, free: int
) -> tuple[Array, Array]:
    """Return the row of a sum of multiples of names, which leaves out nothing but what is not among the free ones."""
    row, ends = np.zeros(len(point)), np.zeros(2)
    for factor, name in terms:
        k = places.get(name)
        value = interval(float(t) if name else 1.0) if k is None else interval(point[k])
        if k is not None and k >= free:
            value = add(value, box[:, k])
        elif k is not None:
            row[k] = factor
        ends = add(ends, mul(interval(factor), value))
    return row, ends


def on_boxes(
    trees: Sequence[Tree], places: Places, still: dict[str, Array], around: Around, free: int, bounded: Bounded = None
) -> tuple[Array, Array]:
    """Return matrices (p, v, n) and ends (2, p, n) of any expressions on n boxes, by their jets at points and on boxes.

    ``around`` are points (v, n), boxes (2, v, n) of deviations from them, and ends (2, v, n) of what moves; ``still``
    are ends (2, n) of names that do not. What is not defined on a box is nan.
    """
    point, box, ranges = around
    v, n = point.shape
    # At points and on boxes at once: a jet of 2 n boxes, the first ones points.
    both = np.concatenate([interval(point), ranges], axis=2)
    leaves = {name: Jet.variable(np.tile(ends, 2), np.zeros((v, 2 * n))) for name, ends in still.items()}
    for name, k in places.items():
        leaves[name] = Jet.variable(both[:, k], np.repeat(np.eye(v)[k][:, None], 2 * n, axis=1))
    matrix, rest = np.zeros((len(trees), v, n)), np.zeros((2, len(trees), n))
    memory: Memory = {}
    for p, tree in enumerate(trees):
        found = jet(tree, leaves, memory)
        centre, on_box = (found.of(part) for part in (slice(n), slice(n, None)))
        matrix[p] = 0.5 * (centre.slope[0] + centre.slope[1])
        matrix[p, free:] = 0.0
        rest[:, p] = add(centre.value, off_linear(centre, on_box, box, matrix[p], bounded))
    return matrix, rest
