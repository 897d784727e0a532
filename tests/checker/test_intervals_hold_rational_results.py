"""Interval operations of the checker hold the exact result for all points between their ends: rational numbers say it.

Ends are random, huge, denormal, next to one another, equal, 0, infinite, and nan. Where an operation is not defined for
all points, or an end is nan, the result has to be nan.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from fractions import Fraction
from itertools import product

import flint
import numpy as np
import pytest
from flint import arb

from certigym.synthesis.checker import intervals
from certigym.synthesis.checker.intervals import interval

COUNT = 1500
rng = np.random.default_rng(1)
pytestmark = pytest.mark.filterwarnings("ignore:overflow", "ignore:invalid value", "ignore:divide by zero")


def numbers(n: int) -> np.ndarray:
    """Numbers of nine kinds."""
    kind, x = rng.integers(0, 9, n), rng.normal(size=n)
    kinds = [
        0.0 * x,
        rng.integers(-5, 6, n).astype(float),
        x * 10.0 ** rng.integers(-308, 300, n),
        rng.integers(-20, 21, n) * 5e-324,
        np.clip(x, -1.7, 1.7) * 1e308,
        x * 2.0**-1022,
        np.nextafter(rng.integers(-3, 4, n).astype(float), np.inf),
        x,
        x * 1e5,
    ]
    return np.choose(kind, kinds)


def boxes(n: int) -> np.ndarray:
    """Intervals (2, n), some of them points, or with ends next to one another."""
    a, b = numbers(n), numbers(n)
    b = np.where(rng.random(n) < 0.25, a, np.where(rng.random(n) < 0.1, np.nextafter(a, np.inf), b))
    return np.stack([np.minimum(a, b), np.maximum(a, b)])


def picked(a: np.ndarray) -> np.ndarray:
    """A number of each interval: an end, the middle, 0 where it is inside, or any."""
    middle = np.clip(0.5 * a[0] + 0.5 * a[1], a[0], a[1])
    any_one = np.clip(a[0] + rng.random(a.shape[1]) * (a[1] - a[0]), a[0], a[1])
    kinds = [a[0], a[1], middle, np.clip(0.0 * a[0], a[0], a[1]), np.nan_to_num(any_one)]
    return np.clip(np.choose(rng.integers(0, 5, a.shape[1]), kinds), a[0], a[1])


def is_between(x: Fraction, low: float, high: float) -> bool:
    """Whether a rational number is between two ends, which may be infinite; nan says nothing."""
    if math.isnan(low) or math.isnan(high):
        return True
    above = low == -math.inf or (low < math.inf and Fraction(low) <= x)
    return above and (high == math.inf or (high > -math.inf and x <= Fraction(high)))


def holds(result: np.ndarray, exact: list[Fraction | None]) -> None:
    """Every number that is defined lies between its ends, and nothing is known where one is not."""
    known = 0
    for k, (low, high, x) in enumerate(zip(*result.tolist(), exact, strict=True)):
        known += not (math.isnan(low) or math.isnan(high))
        assert x is None or is_between(x, low, high), (k, low, high, float(x))
    assert known > 0.3 * len(exact)


BINARY: dict[str, tuple[Callable[..., np.ndarray], Callable[[Fraction, Fraction], Fraction]]] = {
    "add": (intervals.add, lambda x, y: x + y),
    "mul": (intervals.mul, lambda x, y: x * y),
    "subtract": (lambda a, b: intervals.add(a, intervals.neg(b)), lambda x, y: x - y),
}


@pytest.mark.parametrize("name", BINARY)
def test_sums_and_products_hold_rational_ones(name: str) -> None:
    function, exact = BINARY[name]
    for _ in range(3):
        a, b = boxes(COUNT), boxes(COUNT)
        x, y = ([Fraction(p) for p in picked(own).tolist()] for own in (a, b))
        holds(function(a, b), [exact(p, q) for p, q in zip(x, y, strict=True)])


@pytest.mark.parametrize("power", [0, 1, 2, 3, 4, 5, 7, 32, -1, -2, -3])
def test_powers_hold_rational_ones(power: int) -> None:
    a = boxes(COUNT)
    x = [Fraction(p) for p in picked(a).tolist()]
    if power == 32:
        a, x = a[:, :200], x[:200]
    result = intervals.power(a, float(power))
    through = (a[0] <= 0.0) & (a[1] >= 0.0)
    if power < 0:
        assert np.isnan(result[:, through]).all()
    holds(result, [None if power < 0 and gone else p**power for p, gone in zip(x, through.tolist(), strict=True)])
    if power >= 0 and power % 2 == 0:
        assert not np.any(result[0] < 0.0)


def test_squares_and_reciprocals_hold_rational_ones() -> None:
    a = boxes(2 * COUNT)
    x = [Fraction(p) for p in picked(a).tolist()]
    square, reciprocal = intervals.square(a), intervals.recip(a)
    assert not np.any(square[0] < 0.0)
    holds(square, [p * p for p in x])
    through = (a[0] <= 0.0) & (a[1] >= 0.0)
    assert np.isnan(reciprocal[:, through]).all()
    holds(reciprocal, [None if gone else 1 / p for p, gone in zip(x, through.tolist(), strict=True)])


def test_roots_hold_the_number_whose_square_it_is() -> None:
    a = boxes(2 * COUNT)
    low, high = intervals.root(a)
    negative = a[0] < 0.0
    assert np.isnan(low[negative]).all() and np.isnan(high[negative]).all()
    for x, below, above in zip(*(part[~negative].tolist() for part in (picked(a), low, high)), strict=True):
        assert below >= 0.0 and Fraction(below) ** 2 <= Fraction(x)
        assert above == math.inf or Fraction(x) <= Fraction(above) ** 2


def test_sums_of_many_hold_rational_ones() -> None:
    for n in (1, 2, 3, 17, 150):
        for scale in (1.0, 1e-300):
            a = boxes(n * 60).reshape(2, n, 60) * scale
            a[:, :, ::7] = 0.0
            points = np.where(rng.random((n, 60)) < 0.5, a[0], a[1])
            sums = [sum((Fraction(x) for x in column), Fraction(0)) for column in points.T.tolist()]
            found = intervals.total(a, 0)
            assert found.shape == (2, 60)
            holds(found, list(sums))
            assert np.all(found[:, ::7] == 0.0)
    # many numbers of one size, whose roundings add up
    a = interval(rng.uniform(-1.0, 1.0, (2000, 4)))
    exact = [sum(map(Fraction, column), Fraction(0)) for column in a[0].T.tolist()]
    holds(intervals.total(a, 0), list(exact))
    low, high = intervals.total(a, 0)
    assert np.all(high - low < 1e-9)


def test_what_is_exact_stays_exact() -> None:
    a = boxes(200)
    zero, one = interval(np.zeros(200)), interval(np.ones(200))
    assert np.array_equal(intervals.mul(a, one), a) and np.array_equal(intervals.mul(one, a), a)
    assert np.array_equal(intervals.add(a, zero), a) and np.array_equal(intervals.add(zero, a), a)
    assert not intervals.mul(a, zero).any()
    assert np.array_equal(intervals.neg(a), np.stack([-a[1], -a[0]]))


def test_unbounded_and_unknown_ends_are_never_forgotten() -> None:
    """Over all pairs of special ends: what holds a number that is not known, or too large, is not bounded by less."""
    ends = (-math.inf, -2.0, -0.0, 0.0, 5e-324, 1.0, 1e308, math.inf)
    special = [(a, b) for a, b in product(ends, ends) if a <= b]
    for (a, b), (c, d) in product(special, special):
        left, right = (interval(np.array([e]), np.array([f])) for e, f in ((a, b), (c, d)))
        for function, exact in BINARY.values():
            low, high = function(left, right)[:, 0].tolist()
            for x, y in product((a, b, 0.5), (c, d, 0.5)):
                inside = a <= x <= b and c <= y <= d
                if inside and math.isfinite(x) and math.isfinite(y):
                    assert is_between(exact(Fraction(x), Fraction(y)), low, high), (a, b, c, d)
    nan = np.full((2, 1), np.nan)
    half = np.array([[np.nan], [1.0]])
    two = interval(np.array([1.0]), np.array([2.0]))
    for unknown in (nan, half):
        for function in (intervals.add, intervals.mul):
            assert np.isnan(function(unknown, two)).any() and np.isnan(function(two, unknown)).any()
        for one in (
            intervals.square, intervals.root, intervals.recip, intervals.exp, intervals.log, intervals.sine,
            intervals.tangent, intervals.tanh, intervals.atan, lambda a: intervals.power(a, 3.0),
            lambda a: intervals.power(a, 0.5), lambda a: intervals.total(a[:, None], 0),
        ):  # fmt: skip
            assert np.isnan(one(unknown)).any(), one
        assert not intervals.known(unknown).any()


def inner(a: np.ndarray) -> list[list[float]]:
    """Points of intervals: both ends and some between them."""
    shares = (0.0, 1.0, 0.5, float(rng.random()), float(rng.random()))
    return [[float(min(max(low + s * (high - low), low), high)) for s in shares] for low, high in a.T]


@pytest.mark.parametrize("name", ["sine", "cosine", "tangent"])
def test_circular_functions_reach_their_tops_and_poles(name: str) -> None:
    """On boxes of all widths, also with ends next to tops; extrema between the ends are among the points."""
    before, flint.ctx.prec = flint.ctx.prec, 200
    n = 700
    centre = np.concatenate([rng.uniform(-20, 20, n), rng.integers(-200_000, 200_000, n) * (math.pi / 2)])
    width = 10.0 ** rng.uniform(-17, 1.2, 2 * n)
    a = np.stack([centre - width * rng.random(2 * n), centre + width])
    a = np.concatenate([a, np.array([[2e6, -3.0, -1e7], [2e6 + 1, 2e6, 1e7]])], axis=1)
    functions = {
        "sine": (intervals.sine, lambda x: x.sin()),
        "cosine": (lambda own: intervals.sine(own, 1), lambda x: x.cos()),
        "tangent": (intervals.tangent, lambda x: x.tan()),
    }
    function, exact = functions[name]
    low, high = function(a)
    if name != "tangent":
        assert not np.isnan(low).any() and np.all(low >= -1.0) and np.all(high <= 1.0)
    for k, points in enumerate(inner(a)):
        if math.isnan(low[k]) or math.isnan(high[k]):
            continue
        quarter = round(float(centre[k] if k < 2 * n else 0.0) / (math.pi / 2))
        balls = [arb(x) for x in points]
        top = arb(quarter) * arb.pi() / 2
        if arb(float(a[0, k])) < top < arb(float(a[1, k])):
            balls.append(top)
            # a pole between the ends is noticed
            assert not (name == "tangent" and quarter % 2)
        for ball in balls:
            value = exact(ball)
            assert not value < arb(float(low[k])) and not value > arb(float(high[k])), (a[:, k], low[k], high[k])
    assert (~np.isnan(low)).mean() > 0.5
    flint.ctx.prec = before


@pytest.mark.parametrize("name", ["exp", "log", "atan", "tanh", "half", "cube", "many"])
def test_other_functions_hold_all_between_their_ends(name: str) -> None:
    before, flint.ctx.prec = flint.ctx.prec, 200
    n = 600
    centre = np.where(rng.random(n) < 0.5, rng.normal(size=n) * 3.0, 10.0 ** rng.uniform(-30, 2.5, n))
    width = np.abs(centre) * 10.0 ** rng.uniform(-17, 0.5, n)
    a = np.stack([centre - width * rng.random(n), centre + width])
    functions = {
        "exp": (intervals.exp, lambda x: x.exp()),
        "log": (intervals.log, lambda x: x.log()),
        "atan": (intervals.atan, lambda x: x.atan()),
        "tanh": (intervals.tanh, lambda x: x.tanh()),
        "half": (lambda own: intervals.power(own, 1.5), lambda x: x ** arb(1.5)),
        "cube": (lambda own: intervals.power(own, -2.5), lambda x: x ** arb(-2.5)),
        "many": (lambda own: intervals.power(own, 33.0), lambda x: x**33),
    }
    function, exact = functions[name]
    low, high = function(a)
    positive = name in ("log", "half", "cube", "many")
    if positive:
        assert np.isnan(low[a[0] <= 0.0]).all() and np.isnan(high[a[0] <= 0.0]).all()
    seen = 0
    for k, points in enumerate(inner(a)):
        for x in points if not (math.isnan(low[k]) or math.isnan(high[k])) else ():
            value = exact(arb(x))
            seen += 1
            assert not (low[k] > -math.inf and value < arb(float(low[k]))), (a[:, k], x)
            assert not (high[k] < math.inf and value > arb(float(high[k]))), (a[:, k], x)
    assert seen > n
    flint.ctx.prec = before
