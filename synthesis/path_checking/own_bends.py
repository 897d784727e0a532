"""How far expressions are from linear functions on a box: intervals around their second derivatives, for the check.

With z in a box around a point c, and a matrix row m,

    f(z) - f(c) - m (z - c) = (f'(c) - m) (z - c) + 1/2 (z - c)' f''(.) (z - c)        (Taylor, on the segment)
    f(z) - f(c) - m (z - c) = (f'(.) - m) (z - c)                                      (mean value theorem)

so that intervals around the first and second derivatives on the whole box bound it. Bends have signs: with H in the
middle of f'' a diagonal entry of H adds numbers of one sign. Inputs are ``K e`` up to rounding, e being what states are
off, so that ``(e, K e)' H (e, K e) = e' Q e`` with ``Q = (I, K') H (I, K')'`` is a form of states alone: the product of
an input and the state that it follows is a square. So f(z) lies around ``f(c) + middle + m (z - c)``.

Second derivatives go through the operations by the chain rule, as first ones do in ``own_intervals``; those of an
operation by itself are expressions, which are enclosed there. Where an operation has none (``abs`` across 0, ``min``
where either may be the smaller one), they are not numbers, and the mean value theorem stands alone.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ...envs.expressions import Name, Number, Operation, Tree, read_expression, whole_exponent
from ..cells import FloatArray
from .own_intervals import Span, products, span
from .roundings import UNIT

UP = 1.0 + 2.0**-40
"""Factor on sums of a few thousand nonnegative numbers, far above their rounding."""


def _tree(text: str) -> Tree:
    return read_expression(text, ("x", "y"), {})


SECOND = {
    "sin": "-sin(x)",
    "cos": "-cos(x)",
    "tan": "2*tan(x)*(1 + tan(x)**2)",
    "exp": "exp(x)",
    "log": "-1/x**2",
    "sqrt": "-1/(4*x*sqrt(x))",
    "atan": "-2*x/(1 + x**2)**2",
    "tanh": "-2*tanh(x)*(1 - tanh(x)**2)",
}
"""Second derivatives of functions of one argument."""

_SECOND = {name: _tree(text) for name, text in SECOND.items()}
_QUOTIENT = {(0, 1): _tree("-1/y**2"), (1, 1): _tree("2*x/(y*y**2)")}


@dataclass(frozen=True, eq=False)
class Bend:
    """Ends of a value (2,), of its partial derivatives (2, v) and of its second ones (2, v, v), by v variables."""

    ends: FloatArray
    slopes: FloatArray
    bends: FloatArray


def bend(tree: Tree, box: Mapping[str, FloatArray], known: dict[Tree, Bend] | None = None) -> Bend:
    """Return intervals around an expression and its derivatives on a box: name -> ends (2,), in order of variables.

    What was computed on this box before is in ``known``: expressions repeat themselves.
    """
    known = {} if known is None else known
    if tree not in known:
        known[tree] = _bend(tree, box, known)
    return known[tree]


def _bend(tree: Tree, box: Mapping[str, FloatArray], known: dict[Tree, Bend]) -> Bend:
    v = len(box)
    if isinstance(tree, Number):
        return Bend(np.full(2, tree.value), np.zeros((2, v)), np.zeros((2, v, v)))
    if isinstance(tree, Name):
        slopes = np.zeros((2, v))
        slopes[:, list(box).index(tree.name)] = 1.0
        return Bend(box[tree.name], slopes, np.zeros((2, v, v)))
    arguments = tree.arguments
    if tree.name == "**" and whole_exponent(arguments[1]) is None and not isinstance(arguments[1], Number):
        power = Operation("*", (arguments[1], Operation("log", (arguments[0],))))
        return bend(Operation("exp", (power,)), box, known)
    # Equal arguments are one: a square is no product of two different numbers.
    if tree.name == "*" and arguments[0] == arguments[1]:
        tree = Operation("**", (arguments[0], Number(2.0)))
    inner = [bend(argument, box, known) for argument in tree.arguments]
    own, first = _by_itself(tree, [each.ends for each in inner])
    slopes, bends = np.zeros((2, v)), np.zeros((2, v, v))
    # (f o g)' = sum_a f_a g_a',   (f o g)'' = sum_a f_a g_a'' + sum_ab f_ab g_a' g_b'
    for factor, each in zip(first, inner, strict=True):
        slopes = _sum(slopes, _scaled(factor, each.slopes))
        bends = _sum(bends, _scaled(factor, each.bends))
    for (a, b), factor in _second(tree, [each.ends for each in inner]).items():
        if not (inner[a].slopes.any() and inner[b].slopes.any()):
            continue
        outer = _outer(inner[a].slopes, inner[b].slopes)
        bends = _sum(bends, _scaled(factor, outer if a == b else _sum(outer, outer.swapaxes(1, 2))))
    return Bend(own, slopes, bends)


def _by_itself(tree: Operation, ends: Sequence[FloatArray]) -> tuple[FloatArray, list[FloatArray]]:
    """Return ends of an operation, and those of its partial derivatives, on intervals of its arguments."""
    n = len(ends)
    places = [argument if isinstance(argument, Number) else Name(f"{k}") for k, argument in enumerate(tree.arguments)]
    unit = np.eye(n)
    leaves = {f"{k}": Span(own[:, None], np.stack([unit[k], unit[k]])[:, :, None]) for k, own in enumerate(ends)}
    result = span(Operation(tree.name, tuple(places)), leaves)
    return result.ends[:, 0], [result.slopes[:, k, 0] for k in range(n)]


def _second(tree: Operation, ends: Sequence[FloatArray]) -> dict[tuple[int, int], FloatArray]:
    """Return ends of the second partial derivatives of an operation by its arguments; those that are left out are 0."""
    nothing = np.full(2, np.nan)
    if tree.name in ("+", "-", "negative"):
        return {}
    if tree.name == "*":
        return {(0, 1): np.ones(2)}
    if tree.name == "/":
        return {places: _enclosed(text, ends) for places, text in _QUOTIENT.items()}
    if tree.name == "abs":
        return {} if ends[0][0] > 0.0 or ends[0][1] < 0.0 else {(0, 0): nothing}
    if tree.name in ("min", "max"):
        apart = ends[0][1] < ends[1][0] or ends[1][1] < ends[0][0]
        return {} if apart else {(0, 0): nothing, (0, 1): nothing, (1, 1): nothing}
    if tree.name == "**":
        exponent = tree.arguments[1]
        assert isinstance(exponent, Number)
        n = exponent.value
        if n in (0.0, 1.0):
            return {}
        power = Operation("**", (Name("x"), Number(n - 2.0))) if n != 2.0 else Number(1.0)
        factor = Operation("*", (Number(n), Operation("-", (Number(n), Number(1.0)))))
        # Rounded exponents n - 2 would be others: such powers have none.
        is_exact = (n - 2.0) + 2.0 == n
        return {(0, 0): _enclosed(Operation("*", (factor, power)), ends) if is_exact else nothing}
    return {(0, 0): _enclosed(_SECOND[tree.name], ends)}


def _enclosed(tree: Tree, ends: Sequence[FloatArray]) -> FloatArray:
    leaves = {name: Span(own[:, None], np.zeros((2, 0, 1))) for name, own in zip(("x", "y"), ends, strict=False)}
    return span(tree, leaves).ends[:, 0]


def _sum(a: FloatArray, b: FloatArray) -> FloatArray:
    """Sums of ends, moved outward unless one of them is 0."""
    total, down = a + b, np.array([-np.inf, np.inf]).reshape(2, *[1] * (a.ndim - 1))
    moved = np.nextafter(total, np.broadcast_to(down, total.shape))
    return np.where((a == 0.0) | (b == 0.0), total, moved)


def _scaled(factor: FloatArray, ends: FloatArray) -> FloatArray:
    """Products with a factor; what is 0 stays 0, whatever the factor is."""
    if not ends.any():
        return ends
    zero = (ends[0] == 0.0) & (ends[1] == 0.0)
    wide = np.broadcast_to(factor.reshape(2, *[1] * (ends.ndim - 1)), ends.shape)
    return np.where(zero, 0.0, products(wide, ends))


def _outer(a: FloatArray, b: FloatArray) -> FloatArray:
    """Products (2, v, v) of slopes (2, v) and (2, v); what is 0 stays 0."""
    zero = ((a == 0.0).all(axis=0))[:, None] | ((b == 0.0).all(axis=0))[None]
    shape = (2, a.shape[1], b.shape[1])
    each = products(np.broadcast_to(a[:, :, None], shape), np.broadcast_to(b[:, None], shape))
    return np.where(zero, 0.0, each)


@dataclass(frozen=True, eq=False)
class Feedback:
    """Inputs that follow states: ``K e`` with gains (m, d), up to what they are rounded by (m,)."""

    gain: FloatArray
    rounding: FloatArray


@dataclass(frozen=True, eq=False)
class Expansion:
    """Expressions around the point c in a box.

    Parameters
    ----------
    values : (2, p) array
        Ends of the values at c, moved to the middle of what they are off a linear function in the box.
    matrix : (p, v) array
        Any matrix: partial derivatives at c, rounded.
    off : (p,) array
        Upper bounds on how far ``f(z) - matrix (z - c)`` is from these values for z in the box; infinite where nothing
        is known.
    """

    values: FloatArray
    matrix: FloatArray
    off: FloatArray


def expansion(
    trees: Sequence[Tree],
    names: Sequence[str],
    at: FloatArray,
    box: FloatArray,
    expanded: int,
    feedback: Feedback | None = None,
) -> Expansion:
    """Expand expressions around a point ``at`` (v,) in a box (2, v) that holds it.

    The matrix has columns for the first ``expanded`` variables, and zeros for the others, disturbances. With feedback
    the last ones that are expanded are inputs.
    """
    with np.errstate(all="ignore"):
        return _expansion(trees, names, at, box, expanded, feedback)


def _expansion(
    trees: Sequence[Tree],
    names: Sequence[str],
    at: FloatArray,
    box: FloatArray,
    expanded: int,
    feedback: Feedback | None,
) -> Expansion:
    point = {name: np.array([x, x]) for name, x in zip(names, at, strict=True)}
    inside = dict(zip(names, box.T, strict=True))
    below, above = np.nextafter(at - box[0], np.inf), np.nextafter(box[1] - at, np.inf)
    is_still = (box[0] == at) & (box[1] == at)
    below, above = np.where(is_still, 0.0, np.maximum(below, 0.0)), np.where(is_still, 0.0, np.maximum(above, 0.0))
    reach = np.maximum(below, above)
    values, matrix, off = np.empty((2, len(trees))), np.zeros((len(trees), len(at))), np.empty(len(trees))
    at_point, on_box = dict[Tree, Bend](), dict[Tree, Bend]()
    for k, tree in enumerate(trees):
        centre, around = bend(tree, point, at_point), bend(tree, inside, on_box)
        row = 0.5 * (centre.slopes[0] + centre.slopes[1])
        matrix[k, :expanded] = np.where(np.isfinite(row), row, 0.0)[:expanded]
        middle, half = _curved(around.bends, below, above, expanded, feedback)
        first = _weighed(_apart(centre.slopes, matrix[k]), reach) + half
        second = _weighed(_apart(around.slopes, matrix[k]), reach)
        if not first <= second:
            middle = 0.0
        # What is not a number bounds nothing.
        both = [bound * UP for bound in (first, second) if np.isfinite(bound)]
        is_known = bool(np.all(np.isfinite(around.ends)) and np.all(np.isfinite(centre.ends)))
        off[k] = min(both) if both and is_known else np.inf
        moved = centre.ends + middle
        values[:, k] = np.array([np.nextafter(moved[0], -np.inf), np.nextafter(moved[1], np.inf)])
        values[:, k] = centre.ends if middle == 0.0 else values[:, k]
    return Expansion(values, matrix, off)


def _curved(
    bends: FloatArray, below: FloatArray, above: FloatArray, expanded: int, feedback: Feedback | None
) -> tuple[float, float]:
    """Return the middle of half the quadratic forms between ends (2, v, v) on a box around 0, and how far they go.

    The box reaches ``below`` and ``above`` (v,). Infinite where nothing is known.
    """
    far = np.maximum(below, above)
    counts = np.multiply.outer(far != 0.0, far != 0.0) & np.any(bends != 0.0, axis=0)
    low, high = np.where(counts, bends[0], 0.0), np.where(counts, bends[1], 0.0)
    if not (np.all(np.isfinite(low)) and np.all(np.isfinite(high))):
        return 0.0, np.inf
    both = np.multiply.outer(far, far)
    inside = np.zeros(len(far), dtype=bool)
    inside[:expanded] = True
    signed = np.multiply.outer(inside, inside)
    middle = np.where(signed, 0.5 * low + 0.5 * high, 0.0)
    apart = np.nextafter(np.maximum(high - middle, middle - low), np.inf) * counts
    spare = float(np.sum(apart * both))
    # Only states are left: what inputs add is a form of these.
    H, d = middle[:expanded, :expanded], expanded
    if feedback is not None:
        d = expanded - len(feedback.gain)
        follow = np.concatenate([np.eye(d), feedback.gain])
        rounded = np.concatenate([np.zeros(d), feedback.rounding])
        size, n = np.abs(H), float(expanded)
        spare += 2.0 * float(rounded @ size @ (far[:expanded] + rounded)) * UP
        computed = (2.0 * n + 8.0) * UNIT * (np.abs(follow).T @ size @ np.abs(follow))
        spare += float(np.sum(computed * both[:d, :d])) * UP
        H = follow.T @ H @ follow
    # Products of two numbers of a box are between those of its corners; squares are not below 0.
    outer = np.maximum(np.multiply.outer(below, below), np.multiply.outer(above, above))[:d, :d]
    inner = np.maximum(np.multiply.outer(below, above), np.multiply.outer(above, below))[:d, :d]
    np.fill_diagonal(inner, 0.0)
    most = float(np.sum(np.where(H > 0.0, H * outer, -H * inner)))
    least = float(np.sum(np.where(H > 0.0, H * inner, -H * outer)))
    spare += (d * d + 8.0) * 2.0 * UNIT * (most + least)
    # The form is between -least and most, up to what is spare.
    centre = 0.25 * (most - least)
    return centre, (0.25 * (most + least) + 0.5 * spare + 4.0 * UNIT * (most + least)) * UP


def _apart(slopes: FloatArray, row: FloatArray) -> FloatArray:
    """Largest distances (v,) of slopes between ends (2, v) from a row, from above."""
    return np.nextafter(np.maximum(np.abs(slopes[0] - row), np.abs(slopes[1] - row)), np.inf) * (
        np.any(slopes != row, axis=0)
    )


def _weighed(size: FloatArray, reach: FloatArray) -> float:
    """Sum of sizes times reaches; what has no reach, or no size, does not count, whatever the other is."""
    counts = (reach != 0.0) & (size != 0.0)
    return float(np.sum(size[counts] * reach[counts]) * UP)
