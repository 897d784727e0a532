"""Intervals around expressions on boxes, written a second time: the search's are not used (``expressions.enclosure``).

A ``Span`` holds, for each of n boxes, the least and the largest value of an expression and of its partial derivatives.
The rules of interval arithmetic and of derivatives are the operators of the class. Ends are moved outward by one unit
in the last place after each sum, product, quotient and root, and by 2^-48 of their size after other functions, which
numpy computes to less than 2^-50. Ends that are not numbers say that nothing is known.

``bounds`` intersects three enclosures, as the search does: that of the operations, that of the mean value theorem, and
that of the corners at which a monotone function is extreme (docs/theory/boxes.md, "Boxes of expressions").
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....envs.systems.expressions import Name, Number, Operation, Tree, whole_exponent
from ...certificates.cell_probabilities import state
from ...relations.grids import FloatArray

OFF = 2.0**-48
"""Relative error of elementary functions, with room to spare."""

TURN = 1e-12
"""Share of a turn within which an extreme of a sine counts as reached."""

LARGE = 1e6
"""Angles beyond are not reduced."""

Leaves = Mapping[str, "Span"]


def _down(x: FloatArray) -> FloatArray:
    return np.asarray(np.nextafter(x, -np.inf))


def _up(x: FloatArray) -> FloatArray:
    return np.asarray(np.nextafter(x, np.inf))


def _ends(low: FloatArray, high: FloatArray) -> FloatArray:
    """Both ends in one array: ``np.stack``, which takes longer than all else that is done with few boxes."""
    ends = np.empty((2, *low.shape))
    ends[0], ends[1] = low, high
    return ends


def products(a: FloatArray, b: FloatArray) -> FloatArray:
    """Least and largest products (2, ..) of numbers between the ends ``a`` and ``b``, (2, ..) each."""
    first, second, third, fourth = a[0] * b[0], a[0] * b[1], a[1] * b[0], a[1] * b[1]
    low = _down(np.minimum(np.minimum(first, second), np.minimum(third, fourth)))
    high = _up(np.maximum(np.maximum(first, second), np.maximum(third, fourth)))
    # Products of nonnegative numbers are nonnegative, whatever is rounded.
    return _ends(np.where((a[0] >= 0.0) & (b[0] >= 0.0), np.maximum(low, 0.0), low), high)


@dataclass(frozen=True, eq=False)
class Span:
    """Ends (2, n) of values, and ends (2, v, n) of the partial derivatives by v variables."""

    ends: FloatArray
    slopes: FloatArray

    @classmethod
    def of(cls, low: FloatArray, high: FloatArray, like: Span) -> Span:
        """A span of values with the slopes of a constant."""
        return cls(np.stack(np.broadcast_arrays(low, high)), np.zeros_like(like.slopes))

    def scaled(self, ends: FloatArray, factor: FloatArray) -> Span:
        """The span of a function with values ``ends`` (2, n) and derivative ``factor`` (2, n): the chain rule."""
        return Span(ends, _times(factor, self.slopes))

    def __add__(self, other: Span) -> Span:
        return Span(_sum(self.ends, other.ends), _sum(self.slopes, other.slopes))

    def __neg__(self) -> Span:
        return Span(-self.ends[::-1], -self.slopes[::-1])

    def __mul__(self, other: Span) -> Span:
        slopes = _sum(_times(other.ends, self.slopes), _times(self.ends, other.slopes))
        return Span(products(self.ends, other.ends), slopes)

    def __truediv__(self, other: Span) -> Span:
        below = _inverse(other.ends)
        ends = products(self.ends, below)
        # (f / g)' = f' / g - (f / g) g' / g
        slopes = _sum(_times(below, self.slopes), _times(-products(ends, below)[::-1], other.slopes))
        return Span(ends, slopes)


def _sum(a: FloatArray, b: FloatArray) -> FloatArray:
    if not a.size:  # slopes that nobody asked for
        return a
    low = np.where(b[0] == 0.0, a[0], np.where(a[0] == 0.0, b[0], _down(a[0] + b[0])))
    return _ends(low, np.where(b[1] == 0.0, a[1], np.where(a[1] == 0.0, b[1], _up(a[1] + b[1]))))


def _times(factor: FloatArray, slopes: FloatArray) -> FloatArray:
    """Products (2, v, n); slopes that are 0 stay 0, whatever the factor is."""
    if not slopes.size:
        return slopes
    zero = (slopes[0] == 0.0) & (slopes[1] == 0.0)
    return np.where(zero, 0.0, products(factor[:, None], slopes))


def _inverse(ends: FloatArray) -> FloatArray:
    known = (ends[0] > 0.0) | (ends[1] < 0.0)
    return np.stack([_down(1.0 / np.where(known, ends[1], np.nan)), _up(1.0 / np.where(known, ends[0], np.nan))])


def _power(ends: FloatArray, n: int) -> FloatArray:
    """Ends (2, n) of a whole power."""
    if n < 0:
        return _inverse(_power(ends, -n))
    size = np.stack([np.where(ends[0] * ends[1] <= 0.0, 0.0, np.abs(ends).min(axis=0)), np.abs(ends).max(axis=0)])
    size = size + 0.0 * (ends[0] + ends[1])  # not a number stays so
    if n % 2:
        corners = []
        for end, move in zip(ends, (_down, _up), strict=True):
            least, most = np.abs(end), np.abs(end)
            low, high = np.ones_like(end), np.ones_like(end)
            for _ in range(n):
                low, high = np.maximum(_down(low * least), 0.0), _up(high * most)
            corners.append(np.where(end < 0, -(high if move is _down else low), low if move is _down else high))
        return np.stack(corners)
    low, high = np.ones_like(size[0]), np.ones_like(size[1])
    for _ in range(n):
        low, high = np.maximum(_down(low * size[0]), 0.0), _up(high * size[1])
    return np.stack([low, high])


def _through(name: str, function: Any, ends: FloatArray, *numbers: float) -> FloatArray:
    """Ends that went through an elementary function that rises, moved outward."""
    at = function(ends, *numbers)
    off = OFF * np.abs(at) + np.finfo(float).tiny
    low, high = at - off, at + off
    state("function", name, numbers, ends, low, high)
    return np.stack([low[0], high[1]])


def _sine(ends: FloatArray, quarter: float) -> FloatArray:
    """Ends of ``sin(x + quarter turns)``, for the sine (0) and the cosine (1)."""
    function = np.sin if quarter == 0.0 else np.cos
    at = function(ends)
    state("function", function.__name__, (), ends, at - OFF, at + OFF)
    low, high = at.min(axis=0) - OFF, at.max(axis=0) + OFF
    turns = ends / (2.0 * np.pi) + 0.25 * quarter
    # The sine is 1 a quarter into each turn, and -1 three quarters into it.
    reaches = [np.floor(turns[1] - place + TURN) >= turns[0] - place - TURN for place in (0.25, 0.75)]
    far = np.abs(ends).max(axis=0) >= LARGE
    high = np.where(reaches[0] | far, 1.0, np.minimum(high, 1.0))
    low = np.where(reaches[1] | far, -1.0, np.maximum(low, -1.0))
    unknown = np.isnan(ends).any(axis=0)
    return np.where(unknown, np.nan, np.stack([low, high]))


def _sin(f: Span) -> Span:
    return f.scaled(_sine(f.ends, 0.0), _sine(f.ends, 1.0))


def _cos(f: Span) -> Span:
    return f.scaled(_sine(f.ends, 1.0), -_sine(f.ends, 0.0)[::-1])


def _tan(f: Span) -> Span:
    halves = f.ends / np.pi - 0.5
    known = np.floor(halves[1] + TURN) < halves[0] - TURN
    inside = np.where(known & (np.abs(f.ends).max(axis=0) < LARGE), f.ends, np.nan)
    ends = _through("tan", np.tan, inside)
    return f.scaled(ends, _sum(np.ones_like(ends), _power(ends, 2)))


def _exp(f: Span) -> Span:
    ends = np.maximum(_through("exp", np.exp, f.ends), 0.0)
    return f.scaled(ends, ends)


def _log(f: Span) -> Span:
    return f.scaled(_through("log", np.log, np.where(f.ends[0] > 0.0, f.ends, np.nan)), _inverse(f.ends))


def _sqrt(f: Span) -> Span:
    root = np.sqrt(np.where(f.ends[0] >= 0.0, f.ends, np.nan))
    ends = np.stack([np.maximum(_down(root[0]), 0.0), _up(root[1])])
    return f.scaled(ends, _inverse(_sum(ends, ends)))


def _atan(f: Span) -> Span:
    square = _power(f.ends, 2)
    return f.scaled(_through("atan", np.arctan, f.ends), _inverse(_sum(np.ones_like(square), square)))


def _tanh(f: Span) -> Span:
    ends = np.clip(_through("tanh", np.tanh, f.ends), -1.0, 1.0)
    return f.scaled(ends, np.maximum(_sum(np.ones_like(ends), -_power(ends, 2)[::-1]), 0.0))


def _abs(f: Span) -> Span:
    low, high = f.ends
    ends = np.stack([np.maximum(np.maximum(low, -high), 0.0), np.maximum(-low, high)])
    return f.scaled(ends, np.stack([np.where(low >= 0.0, 1.0, -1.0), np.where(high <= 0.0, -1.0, 1.0)]) + 0.0 * ends)


def _larger(f: Span, g: Span) -> Span:
    """The larger one of two; where either may be, its derivative is between theirs, and 0 counts as one of them."""
    share = np.stack([np.where(g.ends[1] < f.ends[0], 1.0, 0.0), np.where(f.ends[1] < g.ends[0], 0.0, 1.0)])
    share = share + 0.0 * (f.ends.sum(axis=0) + g.ends.sum(axis=0))
    slopes = _sum(_times(share, f.slopes), _times((1.0 - share)[::-1], g.slopes))
    return Span(np.maximum(f.ends, g.ends), slopes)


_FUNCTIONS: dict[str, Any] = {
    "+": lambda f, g: f + g,
    "-": lambda f, g: f + (-g),
    "*": lambda f, g: f * g,
    "/": lambda f, g: f / g,
    "negative": lambda f: -f,
    "abs": _abs,
    "max": _larger,
    "min": lambda f, g: -_larger(-f, -g),
    "sin": _sin,
    "cos": _cos,
    "tan": _tan,
    "exp": _exp,
    "log": _log,
    "sqrt": _sqrt,
    "atan": _atan,
    "tanh": _tanh,
}


def span(tree: Tree, leaves: Leaves) -> Span:
    """Values and derivatives of an expression, from those of its names."""
    if isinstance(tree, Name):
        return leaves[tree.name]
    if isinstance(tree, Number):
        number = np.full(next(iter(leaves.values())).ends.shape[1], tree.value)
        return Span.of(number, number, next(iter(leaves.values())))
    if tree.name == "**" or (tree.name == "*" and tree.arguments[0] == tree.arguments[1]):
        return _raised(tree.arguments[0], tree.arguments[1] if tree.name == "**" else Number(2.0), leaves)
    return _FUNCTIONS[tree.name](*(span(argument, leaves) for argument in tree.arguments))


def _raised(base: Tree, exponent: Tree, leaves: Leaves) -> Span:
    """A power; bases of powers that are not whole must be positive, or nonnegative under a number."""
    f, n = span(base, leaves), whole_exponent(exponent)
    if n is not None:
        times = np.full_like(f.ends, float(n))
        return f.scaled(_power(f.ends, n), products(times, _power(f.ends, n - 1)) if n else np.zeros_like(f.ends))
    if not isinstance(exponent, Number):
        return _exp(span(exponent, leaves) * _log(f))
    p = exponent.value
    inside = np.where(f.ends[0] >= 0.0, f.ends, np.nan)
    ends = np.maximum(_through("power", np.power, inside, abs(p)), 0.0)
    ends = ends if p > 0.0 else _inverse(ends)
    return f.scaled(ends, products(products(np.full_like(ends, p), ends), _inverse(f.ends)))


ROUNDED = 2.0**-52
"""Share of its size by which a sum, product, quotient or root is rounded, twice over."""

EXACT = ("negative", "abs", "min", "max")
"""Operations that round nothing."""


def computed_off(tree: Tree, leaves: Leaves) -> tuple[FloatArray, FloatArray]:
    """Ends (2, n) of all that an expression may be computed as, and how far (n,) that is off its value at most.

    Each operation is read as a function of its arguments, on intervals that hold what these are computed as: its slopes
    pass on their errors, and it adds its own. Names and numbers are exact. Not numbers, or infinite, where nothing is
    known.
    """
    some = next(iter(leaves.values()))
    n = some.ends.shape[1]
    if isinstance(tree, Name | Number):
        return span(tree, leaves).ends, np.zeros(n)
    found = [computed_off(argument, leaves) for argument in tree.arguments]
    # Equal arguments get one name, as a square is no product of two different numbers; numbers stay exponents.
    names = [str(tree.arguments.index(argument)) for argument in tree.arguments]
    arguments = tuple(
        own if isinstance(own, Number) else Name(name) for own, name in zip(tree.arguments, names, strict=True)
    )
    local = {}
    for k, (name, (ends, _)) in enumerate(zip(names, found, strict=True)):
        if name not in local:
            unit = np.zeros((2, len(found), n))
            unit[:, k] = 1.0
            local[name] = Span(ends, unit)
    result = span(Operation(tree.name, arguments), local)
    size = np.abs(result.ends).max(axis=0)
    share = ROUNDED if tree.name in ("+", "-", "*", "/", "sqrt") else OFF
    own_off = np.zeros(n) if tree.name in EXACT else share * size + np.finfo(float).tiny
    for slope, (_, off) in zip(np.abs(result.slopes).max(axis=0), found, strict=True):
        own_off = own_off + np.where((off == 0.0) | (slope == 0.0), 0.0, slope * off)
    ends = np.stack([_down(result.ends[0] - own_off), _up(result.ends[1] + own_off)])
    # what is exact stays where it is: a root of what is moved below 0 would be unknown
    return np.where(own_off == 0.0, result.ends, ends), own_off


def bounds(outputs: Callable[..., list[Span]], box: NDArray[Any]) -> list[FloatArray]:
    """Ends (2, n) of outputs on boxes (v, 2, n) of variables: what the three enclosures have in common.

    ``outputs(box, with_slopes)`` gives their spans.
    """
    middle = np.repeat((0.5 * (box[:, 0] + box[:, 1]))[:, None], 2, axis=1)
    values, centres, result = outputs(box, True), outputs(middle), []
    for k, value in enumerate(values):
        least, most = value.ends
        # The mean value theorem: f(c) and the slopes times the way from c.
        about = centres[k].ends
        for slope, side, centre in zip(np.moveaxis(value.slopes, 1, 0), box, middle, strict=True):
            way = np.stack([_down(side[0] - centre[1]), _up(side[1] - centre[0])])
            about = _sum(about, np.where((slope == 0.0).all(axis=0), 0.0, products(slope, way)))
        # Corners: along an axis with a slope of one sign, only the end at which f is least, or largest.
        rises, falls = value.slopes[0] >= 0.0, value.slopes[1] <= 0.0
        at_least = np.stack([np.where(falls & ~rises, box[:, 1], box[:, 0]), np.where(rises, box[:, 0], box[:, 1])], 1)
        at_most = np.stack([np.where(rises & ~falls, box[:, 1], box[:, 0]), np.where(falls, box[:, 0], box[:, 1])], 1)
        low = np.fmax(np.fmax(least, about[0]), outputs(at_least)[k].ends[0])
        high = np.fmin(np.fmin(most, about[1]), outputs(at_most)[k].ends[1])
        unknown = np.isnan(value.ends).any(axis=0)
        result.append(np.where(unknown, np.nan, np.stack([low, high])))
    return result
