"""Elementary functions, tails, and tables of cells of the checker hold the true number between their ends.

The true number is that of ball arithmetic with 300 bits (python-flint), or of mpmath with 40 digits. Points are random,
special, denormal, and those where an argument is reduced to nearly nothing.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import flint
import mpmath
import numpy as np
import pytest
from flint import arb

from certigym.synthesis.checker import constraints, distributions, rigorous
from certigym.synthesis.checker.distributions import LIGHT, LONG, NORMAL, STOPPED
from certigym.synthesis.checker.fields import Refused

COUNT = 1500
rng = np.random.default_rng(0)


@pytest.fixture(autouse=True)
def precision() -> Any:
    """300 bits in this file, whatever others ask for."""
    before, flint.ctx.prec = flint.ctx.prec, 300
    with np.errstate(all="ignore"):
        yield
    flint.ctx.prec = before


def around(points: Any) -> np.ndarray:
    """Points and the doubles next to them."""
    points = np.asarray(points, dtype=float)
    return np.concatenate([np.nextafter(points, -np.inf), points, np.nextafter(points, np.inf)])


def tiny() -> np.ndarray:
    """Numbers down to the smallest denormal one, of either sign."""
    sizes = 10.0 ** rng.uniform(-323, 0, 300)
    return np.concatenate([sizes * rng.choice([-1.0, 1.0], 300), around([0.0]), np.arange(-8, 9) * 5e-324])


QUARTERS = around(np.concatenate([np.arange(-200, 200), rng.integers(0, 1_270_000, 600)]) * (math.pi / 4.0))
WIDE = 10.0 ** rng.uniform(-307, 308, COUNT)

EXPONENTS = np.concatenate(
    [
        rng.uniform(-760, 720, COUNT),
        rng.normal(size=COUNT),
        around(np.arange(-1074, 1024, 3) * math.log(2.0)),
        around((np.arange(-100, 100) + 0.5) * math.log(2.0)),
        around([-1000.0, -745.13, -708.4, 709.0, 709.78]),
        [-1e308, -1e5],
    ]
)
ANGLES = np.concatenate([rng.uniform(-1e6, 1e6, COUNT), rng.normal(size=COUNT), QUARTERS, around([1e6, -1e6])])
POSITIVE = np.concatenate(
    [
        WIDE,
        around(2.0 ** np.arange(-1000, 1000, 7)),
        around([1.0]),
        1.0 + 1e-10 * rng.normal(size=300),
        [5e-324, 1e-310],
    ]
)
REAL = np.concatenate([rng.standard_cauchy(COUNT), WIDE, -WIDE, around([1e6, -1e6, 1.0]), [1.7e308]])
SLOPED = np.concatenate([5.0 * rng.normal(size=COUNT), WIDE, -WIDE, around([300.0, -300.0])])
FAR = np.concatenate(
    [
        rng.uniform(0.0, 10.0, COUNT),
        rng.uniform(10.0, 40.0, 300),
        around([1.5, 3.0, 6.0, 37.0]),
        10.0 ** rng.uniform(-323, 2, 300),
        [0.0, 999.0, 1e3],
    ]
)


def cosine(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Ends of cos x, which is the sine a quarter of a turn further on."""
    return rigorous.sin(x, 1)


def normal_tail(x: arb) -> arb:
    """P(N > x)."""
    return (x / arb(2).sqrt()).erfc() / 2


FUNCTIONS = {
    "exp": (rigorous.exp, lambda x: x.exp(), np.concatenate([EXPONENTS, tiny()])),
    "sin": (rigorous.sin, lambda x: x.sin(), np.concatenate([ANGLES, tiny()])),
    "cos": (cosine, lambda x: x.cos(), np.concatenate([ANGLES, tiny()])),
    "log": (rigorous.log, lambda x: x.log(), POSITIVE),
    "atan": (rigorous.atan, lambda x: x.atan(), np.concatenate([REAL, tiny()])),
    "tanh": (rigorous.tanh, lambda x: x.tanh(), np.concatenate([SLOPED, tiny()])),
    "tail": (rigorous.tail, normal_tail, FAR),
}


def outside(low: np.ndarray, high: np.ndarray, truths: list[arb]) -> list[int]:
    """Places where a number is for sure not between its ends; ends that are nan say nothing."""
    wrong = []
    for k, (a, b, truth) in enumerate(zip(low.tolist(), high.tolist(), truths, strict=True)):
        if math.isnan(a) or math.isnan(b):
            continue
        if a == math.inf or (a > -math.inf and truth < arb(a)) or (b < math.inf and truth > arb(b)):
            wrong.append(k)
    return wrong


@pytest.mark.parametrize("name", FUNCTIONS)
def test_a_function_is_between_its_ends(name: str) -> None:
    function, exact, points = FUNCTIONS[name]
    low, high = function(points)
    wrong = outside(low, high, [exact(arb(x)) for x in points.tolist()])
    assert [(points[k], low[k], high[k]) for k in wrong] == []
    known = ~np.isnan(low) & ~np.isnan(high)
    assert known.mean() > 0.97


def test_enclosures_are_narrow_where_they_are_used() -> None:
    points = np.linspace(0.0, 30.0, 4001)
    for function, share in ((rigorous.exp, 2e-14), (rigorous.tail, 5e-12), (rigorous.atan, 1e-12)):
        low, high = function(points)
        assert np.all(high - low <= share * np.maximum(high, 1e-290) + 2e-13 * (function is rigorous.atan))
    for function in (rigorous.sin, cosine, rigorous.tanh):
        low, high = function(points)
        assert np.all(high - low <= 1e-14)


def test_what_is_no_number_or_has_no_value_is_not_known() -> None:
    for function, *_ in FUNCTIONS.values():
        assert np.isnan(np.stack(function(np.array([np.nan])))).all(), function
    assert np.isnan(np.stack(rigorous.log(np.array([0.0, -0.0, -1.0, -np.inf])))).any(axis=0).all()
    for low, high in (rigorous.sin(np.array([np.inf, 1e300])), cosine(np.array([-np.inf, 2e6]))):
        assert np.all(np.isnan(low) | (low <= -1.0)) and np.all(np.isnan(high) | (high >= 1.0))


# Tails of constraints.


def test_tails_of_constraints_are_above_those_of_normal_numbers() -> None:
    distance = np.concatenate([rng.normal(size=400) * 10.0 ** rng.uniform(-3, 2, 400), [0.0, 1e-320, -1e-320, 1e100]])
    variance = 10.0 ** rng.uniform(-300, 2, len(distance))
    variance[::2] = distance[::2] ** 2 / rng.uniform(0.01, 60.0, len(variance[::2]))
    got = constraints.tails(distance, variance)
    for d, v, tail in zip(distance.tolist(), variance.tolist(), got.tolist(), strict=True):
        z = arb(d) / arb(v).sqrt() if v > 0 else None
        if z is not None:
            assert not arb(tail) < normal_tail(z), (d, v, tail)
            if abs(float(z.mid())) < 30:
                assert arb(tail) <= normal_tail(z) * (1 + arb(1e-9)) + arb(1e-15), (d, v, tail)


def test_what_is_not_known_of_a_constraint_fails_for_sure() -> None:
    nan, inf = np.nan, np.inf
    for tail in (constraints.tails, lambda d, v: constraints._light_tail(constraints._in_deviations(d, v))):
        assert tail(np.array([nan, 1.0, -inf, 0.0, -1.0]), np.array([1.0, nan, 1.0, 0.0, 0.0])).tolist() == [1.0] * 5
        assert tail(np.array([1e-300, inf]), np.array([0.0, 0.0])).tolist() == [0.0, 0.0]
    assert constraints.tails(np.array([1.0]), np.array([inf]))[0] >= 0.5


def test_light_tails_are_above_those_of_sub_gaussian_numbers() -> None:
    z = np.concatenate([rng.uniform(0.0, 38.0, 500), 10.0 ** rng.uniform(-300, 1.5, 100)])
    for x, tail in zip(z.tolist(), constraints._light_tail(z).tolist(), strict=True):
        assert not arb(tail) < (-arb(x) * arb(x) / 2).exp(), x
        assert arb(tail) <= (-arb(x) * arb(x) / 2).exp() * (1 + arb(1e-12)) + arb(1e-300)
    assert constraints._light_tail(np.array([0.0, -1.0, -np.inf, np.inf])).tolist() == [1.0, 1.0, 1.0, 0.0]


def chernoff(z: float, variance: float, largest: float) -> mpmath.mpf:
    """The smallest bound E exp(a (g - d)), where each of n = variance / largest steps is sub-exponential, on a mesh."""
    n, v = mpmath.mpf(variance) / mpmath.mpf(largest), mpmath.mpf(largest)
    d = mpmath.mpf(z) * mpmath.sqrt(mpmath.mpf(variance))
    limit = mpmath.sqrt(2 / v)
    return min(mpmath.exp(-a * d) / (1 - a * a * v / 2) ** n for a in (limit * k / 400 for k in range(1, 400)))


@pytest.mark.thorough
def test_long_tails_are_the_best_bound_by_exponential_moments() -> None:
    """From above by any choice of the exponent, next to the best one; and above the tails of Laplace's own law."""
    with mpmath.workdps(40):
        for _ in range(150):
            largest = 10.0 ** rng.uniform(-4, 4)
            variance, z = largest * rng.choice([1.0, 1.5, 4.0, 30.0, 1000.0]), float(rng.uniform(0.01, 30.0))
            tail = float(constraints._long_tail(np.array([z]), np.array([variance]), np.array([largest]))[0])
            n = mpmath.mpf(variance) / mpmath.mpf(largest)
            r = mpmath.sqrt(1 + 2 * mpmath.mpf(z) ** 2 / n)
            exact = ((1 + r) / 2 * mpmath.exp(1 - r)) ** n
            assert tail >= exact, (z, variance, largest)
            assert tail <= exact * (1 + 1e-9) + mpmath.mpf(10) ** -300
            best = chernoff(z, variance, largest)
            assert exact <= best <= exact * 1.5 or exact < 1e-3 * best < 1e-40
        for z in np.linspace(0.1, 20.0, 50):  # Laplace's law with the deviation 1
            tail = constraints._long_tail(np.array([z]), np.array([1.0]), np.array([1.0]))[0]
            assert tail >= 0.5 * mpmath.exp(-mpmath.sqrt(2) * z)
    edge = constraints._long_tail(np.array([0.0, -1.0, -np.inf, np.inf]), np.ones(4), np.ones(4))
    assert edge.tolist() == [1.0, 1.0, 1.0, 0.0]
    # any number of steps that is smaller is a bound, too: what one step adds may be too large, never too small
    assert constraints._long_tail(np.array([3.0]), np.array([1.0]), np.array([5.0])) >= np.exp(-3.0 * np.sqrt(2.0)) / 2


def test_tails_belong_to_the_kind_of_their_noise() -> None:
    distance, variance = np.full(4, 2.0), np.full(4, 0.49)
    kinds = np.array([NORMAL, STOPPED, LIGHT, LONG])
    normal, stopped, light, long = constraints._tails_by_kind(distance, variance, variance, kinds)
    z = 2.0 / 0.7
    one = float(normal_tail(arb(z)).mid())
    assert one <= normal <= one * (1 + 1e-9)
    assert 2 * one <= stopped <= 2 * one * (1 + 1e-9)
    assert math.exp(-z * z / 2) <= light <= math.exp(-z * z / 2) * (1 + 1e-9)
    assert long > light


# Tables of cells.


def masses(y: float, edges: np.ndarray, s: float) -> list[tuple[mpmath.mpf, mpmath.mpf, mpmath.mpf]]:
    """P(y + w in [a, b)), and means of the falling and of the rising hat on it, for the exact numbers of a cell."""
    found = []
    for a, b in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
        u, v = ((mpmath.mpf(e) - mpmath.mpf(y)) / mpmath.mpf(s) for e in (a, b))
        # the smaller tails
        sign = -1 if u + v > 0 else 1
        mass = abs(mpmath.ncdf(sign * v) - mpmath.ncdf(sign * u))
        rising = (mpmath.npdf(u) - mpmath.npdf(v) - u * mass) / (v - u)
        found.append((mass, mass - rising, rising))
    return found


def axes() -> list[tuple[np.ndarray, np.ndarray, float]]:
    """Lattices, edges and deviations: even and uneven cells, wide and narrow ones, far from 0."""
    cases = []
    for _ in range(9):
        shift, width = float(rng.choice([0.0, 1e3, -1e6])), 10.0 ** rng.uniform(-2, 2)
        edges = np.unique(np.concatenate([[0.0, 1.0], rng.random(4), np.linspace(0.0, 1.0, 4)]))
        edges = shift + width * (edges - 0.5)
        lattice = shift + width * np.linspace(-0.7, 0.7, 6)
        cases.append((lattice, edges, width * 10.0 ** rng.uniform(-1.7, 0.5)))
    cases.append((np.array([0.0, 1.0]), np.array([-1e-9, 0.0, 1e-9, 9.99, 10.0, 10.1, 40.0]), 1.0))
    return cases


@pytest.mark.parametrize("hats", [False, True], ids=["cells", "hats"])
def test_tables_are_below_masses_and_lack_no_more_than_they_say(hats: bool) -> None:
    with mpmath.workdps(50):
        for lattice, edges, s in axes():
            table, lack = distributions.normal_table(lattice, edges, s, hats)
            assert lack < 1e-4  # hats of cells that are narrow among deviations lose digits
            for row, y in zip(table, lattice.tolist(), strict=True):
                truths = [part for cell in masses(y, edges, s) for part in (cell[1:] if hats else cell[:1])]
                assert all(0.0 <= got <= true for got, true in zip(row.tolist(), truths, strict=True)), (y, edges, s)
                assert sum(true - got for got, true in zip(row.tolist(), truths, strict=True)) <= lack


def test_hats_are_what_an_integral_says() -> None:
    """The closed form of ``masses`` itself, by quadrature."""

    def mean(y: float, s: float, a: float, b: float, of: Callable[[mpmath.mpf], mpmath.mpf]) -> mpmath.mpf:
        return mpmath.quad(lambda x: mpmath.npdf(x, y, s) * of((x - mpmath.mpf(a)) / (mpmath.mpf(b) - a)), [a, b])

    with mpmath.workdps(25):
        for y, a, b, s in ((0.3, -0.2, 0.9, 0.4), (-2.0, 0.5, 0.75, 1.1), (5.0, 1.0, 2.0, 0.7)):
            (_, falling, rising), *_ = masses(y, np.array([a, b]), s)
            assert abs(mean(y, s, a, b, lambda share: share) - rising) < 1e-18
            assert abs(mean(y, s, a, b, lambda share: 1 - share) - falling) < 1e-18


def test_tables_refuse_cells_without_noise_or_width() -> None:
    bad: list[tuple[list[float], float]] = [([0.0, 1.0], 0.0), ([0.0, 1.0], -1.0), ([0.0, 1.0], math.inf)]
    bad += [([0.0, 1.0], math.nan), ([0.0, 0.0, 1.0], 1.0), ([1.0, 0.0], 1.0)]
    for edges, deviation in bad:
        with pytest.raises(Refused):
            distributions.normal_table(np.array([0.0]), np.array(edges), deviation, False)


def test_inverses_are_proved_on_both_sides() -> None:
    """A guess that is off proves one side alone; the other one is not known."""
    x = np.array([0.1, 1.0, 7.0])
    for off, known in ((-1e-3, (True, False)), (0.0, (True, True)), (1e-3, (False, True))):
        ends = rigorous._proved_inverse(np.log(x) + off, rigorous.exp, x, np.full(3, 1e-9))
        assert tuple(bool(np.all(np.isfinite(end))) for end in ends) == known
        assert all(np.all(np.isnan(end)) for end, is_known in zip(ends, known, strict=True) if not is_known)


@pytest.mark.parametrize("hats", [False, True])
def test_tables_are_formed_in_blocks_of_rows(monkeypatch: pytest.MonkeyPatch, hats: bool) -> None:
    """What a block holds is bounded, and entries and what a row lacks are those of the whole table."""
    points, edges = np.linspace(-3.0, 3.0, 41), np.linspace(-2.0, 2.0, 18)
    table, lack = distributions.normal_table(points, edges, 0.4, hats)
    for most in (1, 100, 300):
        monkeypatch.setattr(distributions, "AT_ONCE", most)
        again, most_lack = distributions.normal_table(points, edges, 0.4, hats)
        assert np.array_equal(table, again) and lack == most_lack
