"""What constraints add to the failure of those before them: against integrals, exact chains, rational covariances."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.special import ndtr

from certigym.synthesis.checker.constraints import Constraints, beyond
from certigym.synthesis.checker.distributions import LIGHT, LONG, NORMAL, STOPPED
from certigym.synthesis.checker.error_system import ErrorSystem, Forms, covariance_of
from kinds import mostly_thorough


def exactly_beyond(a: float, b: float, rho: float) -> float:
    """P(X > a, Y <= b), by an integral over X given Y."""
    r = np.sqrt((1.0 - rho) * (1.0 + rho))

    def density(y: float) -> float:
        return float(np.exp(-0.5 * y * y) / np.sqrt(2.0 * np.pi) * ndtr(-(a - rho * y) / r))

    kinks = sorted({float(np.clip(point, -12.0, b)) for point in (a / rho, b - 8 * r / rho, b - r / rho, 0.0)})
    ends = sorted({-12.0, *kinks, b})
    return sum(quad(density, low, high, epsabs=1e-15, epsrel=1e-11, limit=500)[0] for low, high in zip(ends, ends[1:]))


def test_two_normal_numbers_are_bounded_closely_from_above() -> None:
    """Also where ends differ, or are on the other side of 0, and where the correlation is larger than is known."""
    rng = np.random.default_rng(5)
    for _ in range(300):
        a, b = rng.uniform(-2.0, 6.0, 2)
        rho = rng.choice([rng.uniform(0.1, 1.0), 1.0 - 10.0 ** rng.uniform(-8, -1)])
        bound = float(beyond(*np.array([a, b, rho]).reshape(3, 1, 1))[0])
        exact = exactly_beyond(a, b, rho)
        assert bound >= exact * (1.0 - 1e-8) - 1e-14, (a, b, rho)
        larger = rho + (1.0 - rho) * rng.uniform(0.0, 1.0)
        assert bound >= exactly_beyond(a, b, larger) * (1.0 - 1e-8) - 1e-14, (a, b, rho, larger)
        if a > b > 0.0:
            assert bound <= (1.02 if rho > 0.7 else 1.2) * exact + 1e-9, (a, b, rho)


def test_all_that_is_beyond_one_end_is_no_less_than_the_tail_allows() -> None:
    """Where the earlier number is kept anyway it is the tail itself, in closed form."""
    a = np.array([[1.0], [2.5], [4.0]])
    bound = beyond(a, np.full((3, 1), 30.0), np.full((3, 1), 0.5))
    assert np.all(bound >= ndtr(-a[:, 0]))


@pytest.mark.parametrize("seed", range(6))
def test_covariances_of_two_times_are_those_of_rational_numbers(seed: int) -> None:
    rng = np.random.default_rng(seed)
    D, W, T = (int(rng.integers(low, high)) for low, high in ((1, 4), (1, 4), (2, 6)))
    system, loops, noises = ErrorSystem(np.zeros(D), W), [], []
    earlier: Forms | None = None
    for _ in range(T):
        loops.append(rng.normal(size=(D, D)))
        noises.append(np.where(rng.random((D, W)) < 0.7, rng.normal(size=(D, W)), 0.0))
        earlier = system.rows(np.eye(D))[1]
        system.step(loops[-1], np.zeros((2, D)), np.zeros(D), noises[-1])
    now = system.rows(np.eye(D))[1]
    assert earlier is not None
    found, off = covariance_of(now, earlier)

    def exact(matrix: np.ndarray) -> list[list[Fraction]]:
        return [[Fraction(x) for x in row] for row in matrix.tolist()]

    def product(a: list[list[Fraction]], b: list[list[Fraction]]) -> list[list[Fraction]]:
        return [[sum((x * y for x, y in zip(row, column)), Fraction(0)) for column in zip(*b)] for row in a]

    def shares(steps: int) -> list[list[list[Fraction]]]:
        """What each number of noise adds to each state after some steps: (steps, D, W)."""
        result: list[list[list[Fraction]]] = []
        for F, L in zip(loops[:steps], noises[:steps]):
            result = [product(exact(F), own) for own in result] + [exact(L)]
        return result

    first, second = shares(T), shares(T - 1)
    for i in range(D):
        for j in range(D):
            true = sum(
                (a * b for t in range(T - 1) for a, b in zip(first[t][i], second[t][j], strict=True)), Fraction(0)
            )
            assert abs(true - Fraction(found[i, j])) <= Fraction(off[i, j])
    assert np.all(off <= 1e-10 * (1.0 + np.sqrt(np.outer(now.variance, earlier.variance))))


def kept_by_a_chain(f: float, s: float, low: float, high: float, steps: int) -> float:
    """P(-low <= x_t <= high at times 1 .. steps) of x' = f x + s w from 0, by Gauss's quadrature."""
    points, weights = np.polynomial.legendre.leggauss(400)
    x = 0.5 * (high - low) + 0.5 * (high + low) * points
    weights = 0.5 * (high + low) * weights

    def density(to: np.ndarray, at: np.ndarray) -> np.ndarray:
        return np.asarray(np.exp(-0.5 * ((to - f * at) / s) ** 2) / (s * np.sqrt(2.0 * np.pi)))

    mass = density(x, np.zeros(1))
    for _ in range(steps - 1):
        mass = density(x[:, None], x[None]) @ (weights * mass)
    return float(weights @ mass)


def failure_of_a_chain(kind: int, f: float, s: float, low: float, high: float, steps: int) -> float:
    system, constraints = ErrorSystem(np.zeros(1), 1), Constraints(np.array([kind]))
    for t in range(1, steps + 1):
        system.step(np.array([[f]]), np.zeros((2, 1)), np.zeros(1), np.array([[s]]))
        _, forms = system.rows(np.eye(1))
        constraints.add(np.array([low]), np.array([high]), np.inf, forms, [f"x at time {t}"])
    return constraints.failure()


@mostly_thorough(
    ("f", "s", "low", "high"),
    [(1.0, 0.1, 1.0, 1.2), (-0.95, 0.2, 1.5, 1.6), (0.7, 0.5, 1.9, 2.2), (0.97, 0.2, 2.0, 1.4), (1.05, 0.05, 1.0, 0.9)],
    first=2,
)
def test_chains_fail_no_more_often_than_is_said(f: float, s: float, low: float, high: float) -> None:
    """Constraints of one state at all times, against the exact probability; slow chains come near to it."""
    for steps in (2, 7, 20):
        exact = 1.0 - kept_by_a_chain(f, s, low, high, steps)
        bound = failure_of_a_chain(NORMAL, f, s, low, high, steps)
        assert bound >= exact * (1.0 - 1e-9) - 1e-13
        if abs(f) > 0.9 and steps == 20:
            assert bound <= 1.45 * exact
        # Other noise is no normal number, of which two have a correlation and nothing else.
        apart = failure_of_a_chain(STOPPED, f, s, low, high, steps)
        assert apart >= bound and failure_of_a_chain(LIGHT, f, s, low, high, steps) >= bound


def test_a_limit_that_says_little_does_not_take_the_place_of_the_one_that_fails_together() -> None:
    """Beside a slow chain a state that shares little of its noise, far from its ends: the chain fails as if alone."""
    f, s, end, steps = 0.97, 0.2, 2.0, 20
    system, constraints = ErrorSystem(np.zeros(2), 2), Constraints(np.array([NORMAL, NORMAL]))
    for t in range(1, steps + 1):
        system.step(np.diag([f, f]), np.zeros((2, 2)), np.zeros(2), s * np.array([[1.0, 0.0], [0.2, 0.98]]))
        _, forms = system.rows(np.eye(2))
        ends = np.array([end, 3.0 * end])
        constraints.add(ends, ends, np.inf, forms, [f"x at time {t}", f"z at time {t}"])
    alone = failure_of_a_chain(NORMAL, f, s, end, end, steps)
    assert 1.0 - kept_by_a_chain(f, s, end, end, steps) <= constraints.failure() <= 1.001 * alone


def test_only_normal_forms_are_looked_at_together() -> None:
    """A form that holds a source of other noise says nothing of later ones, nor do others say something of it."""
    for kind in (STOPPED, LIGHT, LONG):
        system, constraints = ErrorSystem(np.zeros(1), 2), Constraints(np.array([NORMAL, kind]))
        alone = Constraints(np.array([NORMAL, kind]))
        for t in range(1, 4):
            system.step(np.eye(1), np.zeros((2, 1)), np.zeros(1), np.array([[1.0, 1e-3 * (t == 1)]]))
            _, forms = system.rows(np.eye(1))
            constraints.add(np.array([4.0]), np.array([4.0]), np.inf, forms, [f"x at time {t}"])
            unknown = forms._replace(moved=forms.moved[:, :0], size=forms.size[:, :0])
            alone.add(np.array([4.0]), np.array([4.0]), np.inf, unknown, [f"x at time {t}"])
        assert constraints.failure() == alone.failure()
        assert all(np.array_equal(a, b) for a, b in zip(constraints.first, alone.first, strict=True))


def test_what_is_mixed_once_says_nothing_of_normal_forms_that_follow() -> None:
    """A form of a normal and another source, and then one of the normal source alone."""
    for kind in (STOPPED, LIGHT, LONG):
        system, constraints = ErrorSystem(np.zeros(3), 3), Constraints(np.array([NORMAL, kind, NORMAL]))
        noise = np.array([[1.0, 1e-3, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
        system.step(np.eye(3), np.zeros((2, 3)), np.zeros(3), noise)
        _, forms = system.rows(np.eye(3))
        for places in (np.array([0, 1]), np.array([2])):
            ends = np.full(len(places), 3.0)
            constraints.add(ends, ends, np.inf, forms.at(places), ["x at time 1"] * len(places))
        assert constraints.first[1][0] >= 2.0 * ndtr(-3.0)


def test_forms_that_share_no_noise_add_all_of_their_tails() -> None:
    """Two independent sources: the exact probability that one of them is beyond its ends."""
    system, constraints = ErrorSystem(np.zeros(2), 2), Constraints(np.array([NORMAL, NORMAL]))
    system.step(np.eye(2), np.zeros((2, 2)), np.zeros(2), np.eye(2))
    _, forms = system.rows(np.eye(2))
    for k in (0, 1):
        constraints.add(np.array([3.0]), np.array([3.0]), np.inf, forms.at(np.array([k])), ["x at time 1"])
    each = 2.0 * ndtr(-3.0)
    assert each + each * (1.0 - each) <= constraints.failure() <= 2.0 * each * 1.0001


def test_ends_on_the_other_side_of_0_are_passed_for_sure() -> None:
    """A larger variance makes what is beyond them less probable, and variances are upper bounds."""
    system = ErrorSystem(np.zeros(1), 1)
    system.step(np.eye(1), np.zeros((2, 1)), np.zeros(1), np.eye(1))
    _, forms = system.rows(np.eye(1))
    wide = forms._replace(variance=4.0 * forms.variance)
    for below, above in ((-0.5, 3.0), (3.0, -0.5)):
        constraints = Constraints(np.array([NORMAL]))
        constraints.add(np.array([below]), np.array([above]), np.inf, wide, ["x at time 1"])
        assert constraints.first[0][0] >= 1.0 and constraints.failure() == 1.0
    # As an earlier one it says nothing: both of its ends are negative here.
    constraints = Constraints(np.array([NORMAL]))
    for ends in (np.array([-0.1]), np.array([3.0])):
        constraints.add(ends, ends, np.inf, forms, ["x at time 1"])
    assert constraints.first[1][0] >= 2.0 * ndtr(-3.0)


def test_random_systems_of_constraints_fail_no_more_often_than_is_said() -> None:
    """Several states, rows of states and of differences, uneven ends: against 200,000 runs each, at 1e-7 in all."""
    rng = np.random.default_rng(11)
    for _ in range(12):
        D, W, T = int(rng.integers(1, 4)), int(rng.integers(1, 4)), int(rng.integers(2, 9))
        system, constraints = ErrorSystem(np.zeros(D), W), Constraints(np.zeros(W, dtype=np.int64))
        loop = np.linalg.qr(rng.normal(size=(D, D)))[0] * rng.uniform(0.8, 1.0)
        noise, runs = rng.normal(size=(D, W)) * 0.3, 200_000
        x, failed = np.zeros((runs, D)), np.zeros(runs, dtype=bool)
        for t in range(1, T + 1):
            system.step(loop, np.zeros((2, D)), np.zeros(D), noise)
            x = x @ loop.T + rng.normal(size=(runs, W)) @ noise.T
            rows = np.concatenate([np.eye(D), rng.normal(size=(1, D))])
            _, forms = system.rows(rows)
            sizes = np.sqrt(forms.variance)
            low, high = (sizes * rng.uniform(1.2, 3.5, len(rows)) for _ in range(2))
            constraints.add(low, high, np.inf, forms, [f"row {k} at time {t}" for k in range(len(rows))])
            g = x @ rows.T
            failed |= np.any((g < -low) | (g > high), axis=1)
        # Hoeffding: off by more than this with a probability below 1e-8 each
        assert constraints.failure() >= failed.mean() - np.sqrt(np.log(1e8) / (2.0 * runs))
