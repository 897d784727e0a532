"""Expressions between the ends of intervals, in ball arithmetic: what the check encloses in doubles is proved with it.

Ends are balls of radius 0 (python-flint), moved outward after every operation by its radius; 106 bits make that far
less than any rounding of doubles. Radii themselves have thirty bits, so that balls as wide as cells would not do.
``unproved`` counts the boxes that were not shown to hold all values of expressions on cells: by the operations, the
mean value theorem and, where a slope has one sign, the corners; cells that this does not settle are cut. Maps of
matrices are extreme at corners.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from flint import arb

from certigym.envs.systems.agents import with_matrices
from certigym.envs.systems.expressions import Name, Number, Tree, whole_exponent
from certigym.synthesis.extended_check.steps import Enclosed

Ends = tuple[Any, Any]
"""Least and largest value: balls of radius 0, not numbers where nothing is known."""

NOTHING: Ends = (arb.nan(), arb.nan())
INFINITE = arb.pos_inf()
ZERO: Ends = (arb(0), arb(0))

CUTS = 5
"""Times that a cell is halved along each axis before its box counts as not proved."""


class Span(NamedTuple):
    """Ends of a value, and of its partial derivatives by the variables, or None where they are not asked for."""

    ends: Ends
    slopes: tuple[Ends, ...]


def _hull(*balls: Any) -> Ends:
    """Ends around some balls; not numbers if one of them is none."""
    if any(ball.is_nan() for ball in balls):
        return NOTHING
    lows, highs = [ball.lower() for ball in balls], [ball.upper() for ball in balls]
    return min(lows), max(highs)


def _plus(a: Ends, b: Ends) -> Ends:
    return (a[0] + b[0]).lower(), (a[1] + b[1]).upper()


def _minus(a: Ends) -> Ends:
    return -a[1], -a[0]


def _times(a: Ends, b: Ends) -> Ends:
    if (a[0] == 0 and a[1] == 0) or (b[0] == 0 and b[1] == 0):
        return ZERO
    return _hull(a[0] * b[0], a[0] * b[1], a[1] * b[0], a[1] * b[1])


def _inverse(a: Ends) -> Ends:
    return _hull(1 / a[0], 1 / a[1]) if a[0] > 0 or a[1] < 0 else NOTHING


def _rising(function: Callable[[Any], Any], known: Callable[[Ends], bool] = lambda _: True) -> Callable[[Ends], Ends]:
    return lambda a: _hull(function(a[0]), function(a[1])) if known(a) else NOTHING


def _power(a: Ends, n: int) -> Ends:
    if n < 0:
        return _inverse(_power(a, -n))
    if n % 2 or not a[0] < 0 or not a[1] > 0:
        return _hull(a[0] ** n, a[1] ** n)
    return _hull(arb(0), a[0] ** n, a[1] ** n)


def _wave(a: Ends, shift: int) -> Ends:
    """The sine of a and as many quarter turns; an extreme that may be inside counts."""
    low, high = _hull((a[0] + shift * arb.pi() / 2).sin(), (a[1] + shift * arb.pi() / 2).sin())

    def reached(place: Any) -> bool:
        begin, end = (x / (2 * arb.pi()) + arb(shift) / 4 - place for x in a)
        return not end.upper().floor() < begin.lower()

    return (arb(-1) if reached(arb(3) / 4) else low, arb(1) if reached(arb(1) / 4) else high)


def _absolute(a: Ends) -> Ends:
    inside = arb(0) if a[0] <= 0 and a[1] >= 0 else min(abs(a[0]), abs(a[1]))
    return inside, max(abs(a[0]), abs(a[1]))


def _sign(a: Ends) -> Ends:
    return arb(1 if a[0] >= 0 else -1), arb(-1 if a[1] <= 0 else 1)


ONE: Ends = (arb(1), arb(1))

_CURVES: dict[str, tuple[Callable[[Ends], Ends], Callable[[Ends, Ends], Ends]]] = {
    "sin": (lambda a: _wave(a, 0), lambda a, f: _wave(a, 1)),
    "cos": (lambda a: _wave(a, 1), lambda a, f: _wave(a, 2)),
    "tan": (
        _rising(arb.tan, lambda a: (a[0] / arb.pi() + 0.5).lower().floor() == (a[1] / arb.pi() + 0.5).upper().floor()),
        lambda a, f: _plus(ONE, _power(f, 2)),
    ),
    "exp": (_rising(arb.exp), lambda a, f: f),
    "log": (_rising(arb.log, lambda a: bool(a[0] > 0)), lambda a, f: _inverse(a)),
    "sqrt": (_rising(arb.sqrt, lambda a: bool(a[0] >= 0)), lambda a, f: _inverse(_plus(f, f))),
    "atan": (_rising(arb.atan), lambda a, f: _inverse(_plus(ONE, _power(a, 2)))),
    "tanh": (_rising(arb.tanh), lambda a, f: _plus(ONE, _minus(_power(f, 2)))),
    "abs": (_absolute, lambda a, f: _sign(a)),
}
"""Functions of one argument on an interval, and their slopes there, given their values."""


def span(tree: Tree, leaves: Mapping[str, Span]) -> Span:
    """Values and partial derivatives of an expression, from those of its names."""
    if isinstance(tree, Name):
        return leaves[tree.name]
    if isinstance(tree, Number):
        return Span((arb(tree.value), arb(tree.value)), tuple(ZERO for _ in next(iter(leaves.values())).slopes))
    first, *rest = (span(argument, leaves) for argument in tree.arguments)
    if tree.name in _CURVES:
        value, slope = _CURVES[tree.name]
        ends = value(first.ends) if not any(end.is_nan() for end in first.ends) else NOTHING
        return _scaled(ends, first, slope(first.ends, ends))
    if tree.name == "negative":
        return Span(_minus(first.ends), tuple(map(_minus, first.slopes)))
    if tree.name == "**":
        return _raised(first, rest[0], tree.arguments[1])
    (second,) = rest
    if tree.name == "-":
        second = Span(_minus(second.ends), tuple(map(_minus, second.slopes)))
    if tree.name in ("+", "-"):
        return Span(_plus(first.ends, second.ends), tuple(map(_plus, first.slopes, second.slopes)))
    if tree.name == "*" and tree.arguments[0] == tree.arguments[1]:
        return _scaled(_power(first.ends, 2), first, _plus(first.ends, first.ends))
    if tree.name == "*":
        return _weighed(_times(first.ends, second.ends), first, second.ends, second, first.ends)
    if tree.name == "/":
        below = _inverse(second.ends)
        ends = _times(first.ends, below)
        return _weighed(ends, first, below, second, _minus(_times(ends, below)))
    assert tree.name in ("min", "max")
    return _larger(first, second) if tree.name == "max" else _turned(_larger(_turned(first), _turned(second)))


def _turned(f: Span) -> Span:
    return Span(_minus(f.ends), tuple(map(_minus, f.slopes)))


def _scaled(ends: Ends, f: Span, factor: Ends) -> Span:
    """The chain rule; slopes that are 0 stay 0."""
    return Span(ends, tuple(_times(factor, slope) for slope in f.slopes))


def _weighed(ends: Ends, f: Span, by: Ends, g: Span, other: Ends) -> Span:
    """A value, and the slopes of f times ``by`` and of g times ``other``."""
    return Span(ends, tuple(_plus(_times(by, a), _times(other, b)) for a, b in zip(f.slopes, g.slopes, strict=True)))


def _larger(f: Span, g: Span) -> Span:
    a, b = f.ends, g.ends
    ends = max(a[0], b[0]), max(a[1], b[1])
    share = arb(1 if b[1] < a[0] else 0), arb(0 if a[1] < b[0] else 1)
    return _weighed(ends, f, share, g, (1 - share[1], 1 - share[0]))


def _raised(base: Span, exponent: Span, tree: Tree) -> Span:
    n = whole_exponent(tree)
    if n is not None:
        return _scaled(_power(base.ends, n), base, _times((arb(n), arb(n)), _power(base.ends, n - 1)) if n else ZERO)
    a, p = base.ends, exponent.ends
    if not isinstance(tree, Number):
        log = _CURVES["log"][0](a)
        product = _weighed(_times(p, log), exponent, log, base, _times(p, _inverse(a)))
        ends = _rising(arb.exp)(product.ends)
        return _scaled(ends, product, ends)
    if not a[0] >= 0:
        return Span(NOTHING, base.slopes)
    ends = _hull(a[0] ** abs(p[0]), a[1] ** abs(p[0]))
    ends = ends if p[0] > 0 else _inverse(ends)
    return _scaled(ends, base, _times(_times(p, ends), _inverse(a)))


class _Outputs:
    """What is enclosed, as functions of boxes of variables: states in the cell, then what is unknown."""

    def __init__(self, enclosed: Enclosed) -> None:
        self.enclosed, self.moving = enclosed, enclosed.agent
        assert enclosed.trees is not None  # those of matrices are maps
        self.trees = enclosed.trees

    def at(self, i: int, middle: Sequence[Any]) -> Callable[[Sequence[Ends], bool], list[Span]]:
        """The functions on parts of cell i, whose middle is given."""
        e, m = self.enclosed, self.moving
        d = len(middle)
        given = {name: arb(float(row[i])) for name, row in e.constants.items()}
        inputs = [arb(x) for x in e.inputs[i].tolist()]

        def outputs(box: Sequence[Ends], with_slopes: bool) -> list[Span]:
            count = len(box) if with_slopes else 0
            variables = [Span(ends, tuple(ONE if j == k else ZERO for j in range(count))) for k, ends in enumerate(box)]
            nothing = tuple(ZERO for _ in range(count))
            leaves = {name: Span((x, x), nothing) for name, x in given.items()}
            leaves |= dict(zip(m.states, variables, strict=False))
            leaves |= {name: Span((u, u), nothing) for name, u in zip(m.inputs, inputs, strict=False)}
            leaves |= dict(zip(m.unknowns, variables[d:], strict=False))
            values = [span(tree, leaves) for tree in self.trees]
            if e.less is not None:
                z, gain = (own[i].tolist() for own in e.less)
                moved = [_combined([(arb(1), v), (arb(-1), Span((c, c), nothing))], nothing)
                         for v, c in zip(variables[:d], middle, strict=True)]  # fmt: skip
                for k, value in enumerate(values):
                    left = [(arb(1), value), (arb(-1), Span((arb(z[k]), arb(z[k])), nothing))]
                    left += [(arb(-x), v) for x, v in zip(gain[k], moved, strict=True) if x != 0.0]
                    values[k] = _combined(left, nothing)
            return values

        return outputs


def _combined(terms: Sequence[tuple[Any, Span]], nothing: tuple[Ends, ...]) -> Span:
    """A sum of factors, balls, times spans."""
    ends, slopes = ZERO, nothing
    for factor, f in terms:
        by = (factor.lower(), factor.upper())
        ends = _plus(ends, f.ends if factor == 1 else _times(by, f.ends))
        slopes = tuple(_plus(a, _times(by, b)) for a, b in zip(slopes, f.slopes, strict=True))
    return Span(ends, slopes)


def _bounds(outputs: Callable[[Sequence[Ends], bool], list[Span]], box: Sequence[Ends]) -> list[Ends]:
    """Ends of outputs on a box: what the operations, the mean value theorem and the corners have in common."""
    middle = [((a + b) / 2).mid() for a, b in box]
    centres, values, result = outputs([(c, c) for c in middle], False), outputs(box, True), []
    for k, value in enumerate(values):
        low, high = value.ends
        if low.is_nan() or high.is_nan():
            result.append(NOTHING)
            continue
        about = centres[k].ends
        for slope, side, c in zip(value.slopes, box, middle, strict=True):
            about = _plus(about, _times(slope, ((side[0] - c).lower(), (side[1] - c).upper())))
        corners = []
        for sign in (1, -1):
            corner = []
            for (least, most), side in zip(value.slopes, box, strict=True):
                rises, falls = least >= 0, most <= 0
                end = side[0 if sign > 0 else 1] if rises else side[1 if sign > 0 else 0]
                corner.append((end, end) if rises or falls else side)
            corners.append(outputs(corner, False)[k].ends)
        lows, highs = [low, about[0], corners[0][0]], [high, about[1], corners[1][1]]
        result.append((max(x for x in lows if not x.is_nan()), min(x for x in highs if not x.is_nan())))
    return result


def unproved(
    enclosed: Enclosed, cells: tuple[Any, Any], unknown: Sequence[Any], ends: tuple[Any, Any]
) -> tuple[int, int]:
    """Return how many boxes with corners ``ends`` there are, and how many were not shown to hold what is enclosed.

    ``cells`` are corners (n, d) of closed cells, ``unknown`` the ends of everything else. Corners that are not numbers,
    or infinite, say nothing.
    """
    low, high = (np.asarray(corner) for corner in cells)
    first, last = (np.asarray(corner) for corner in ends)
    if enclosed.trees is None:
        return len(low), _unproved_maps(enclosed, low, high, first, last)
    outputs, wrong, seen = _Outputs(enclosed), 0, set()
    for i in range(len(low)):
        inputs = enclosed.inputs[i] if len(enclosed.inputs) else ()
        key = (*low[i], *high[i], *inputs, *first[i], *last[i], *(row[i] for row in enclosed.constants.values()))
        key += tuple(x for a, b in unknown for x in (a[i], b[i]))
        key += tuple(x for own in enclosed.less or () for x in np.ravel(own[i]))
        if key in seen or np.isnan(first[i]).any():
            continue
        seen.add(key)
        sides = [*zip(low[i].tolist(), high[i].tolist()), *((float(a[i]), float(b[i])) for a, b in unknown)]
        # The middle is that of doubles: maps are about this very number.
        middle = [arb(x) for x in (0.5 * (low[i] + high[i])).tolist()]
        box = [(arb(a), arb(b)) for a, b in sides]
        goal = [(arb(a), arb(b)) for a, b in zip(first[i].tolist(), last[i].tolist(), strict=True)]
        wrong += not _holds(outputs.at(i, middle), box, goal, CUTS)
    return len(seen), wrong


def _unproved_maps(enclosed: Enclosed, low: Any, high: Any, first: Any, last: Any) -> int:
    """How many boxes were not shown to hold the means of matrices, which are extreme at corners of cells."""
    agent = with_matrices(enclosed.agent)
    A, B, c = balls(agent.A), balls(agent.B), balls(agent.offset)
    middle = balls(0.5 * (low + high))
    half = np.maximum(balls(high) - middle, middle - balls(low))
    at, slope = middle @ A.T + balls(enclosed.inputs) @ B.T + c, np.broadcast_to(A, (len(low), *A.shape))
    if enclosed.less is not None:
        z, gain = map(balls, enclosed.less)
        at, slope = at - z, slope - gain
    reach = np.array([abs(own) @ h for own, h in zip(slope, half, strict=True)] or at)
    return int(np.sum(~np.all((balls(first) <= at - reach) & (at + reach <= balls(last)), axis=1)))


def balls(values: Any) -> Any:
    """Return balls that are doubles, in the same shape: an array that numpy adds, multiplies and compares."""
    array = np.asarray(values, dtype=float)
    return np.array([*map(arb, array.ravel().tolist()), None], dtype=object)[:-1].reshape(array.shape)


def _holds(outputs: Any, box: list[Ends], goal: list[Ends], cuts: int) -> bool:
    """Whether outputs on a box lie between the ends of the goal, the box cut as often as it takes."""
    if _is_inside([value.ends for value in outputs(box, False)], goal) or _is_inside(_bounds(outputs, box), goal):
        return True
    if cuts == 0:
        return False
    halves = [[(a, b)] if a == b else [(a, c := ((a + b) / 2).mid()), (c, b)] for a, b in box]
    return all(_holds(outputs, list(piece), goal, cuts - 1) for piece in itertools.product(*halves))


def _is_inside(found: Sequence[Ends], goal: Sequence[Ends]) -> bool:
    """Whether ends lie between those of the goal, of which infinite ones say nothing."""
    pairs = zip(found, goal, strict=True)
    return all((-g[0] == INFINITE or g[0] <= f[0]) and (g[1] == INFINITE or f[1] <= g[1]) for f, g in pairs)
