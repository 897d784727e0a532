"""Rows of errors hold what exact recursions say: variances from above, everything else between the ends.

The recursion ``e' = F e + b + L w`` is carried out in rational numbers, forward and from scratch: the coefficients of
every noise, of every box and of the start in a row ``c e_t + b e_(t-1)``. Systems are random, with tiny, huge and
cancelling entries; F and L change with the time.
"""

from __future__ import annotations

import itertools
from fractions import Fraction

import numpy as np
import pytest

from certigym.synthesis.checker.constraints import Constraints
from certigym.synthesis.checker.distributions import LIGHT, LONG, NORMAL, STOPPED
from certigym.synthesis.checker.error_system import ErrorSystem, Forms

Exact = list[list[Fraction]]


def rational(matrix: np.ndarray) -> Exact:
    return [[Fraction(x) for x in row] for row in matrix.tolist()]


def times(a: Exact, b: Exact) -> Exact:
    columns = list(zip(*b, strict=True))
    return [[sum((x * y for x, y in zip(row, column, strict=True)), Fraction(0)) for column in columns] for row in a]


class Random:
    """A random system: the checker's, and its matrices as rational numbers."""

    def __init__(self, rng: np.random.Generator, D: int, W: int, T: int) -> None:
        self.D, self.W, self.T = D, W, T
        scale = 10.0 ** rng.choice([0, 0, -3, 2], D) if rng.random() < 0.3 else np.ones(D)
        self.scale = scale.tolist()
        self.spread = rng.choice([0.0, 1.0], D) * rng.uniform(0.0, 1.0, D)
        self.system = ErrorSystem(self.spread, W)
        self.F: list[np.ndarray] = []
        self.L: list[np.ndarray] = []
        self.pushed: list[np.ndarray] = []
        self.reach: list[np.ndarray] = []
        for _ in range(T):
            F = np.where(rng.random((D, D)) < 0.6, rng.normal(size=(D, D)), 0.0) * scale[:, None] / scale
            L = np.where(rng.random((D, W)) < 0.6, rng.normal(size=(D, W)), 0.0) * scale[:, None]
            middle, half = rng.normal(size=D) * scale, rng.uniform(0.0, 0.3, D) * scale * rng.choice([0.0, 1.0])
            self.F.append(F)
            self.L.append(L)
            self.pushed.append(np.stack([middle - half, middle + half]))
            self.reach.append(np.abs(rng.normal(size=D)) * scale)
            self.system.step(F, self.pushed[-1], self.reach[-1], L)

    def row(
        self, c: list[Fraction], earlier: list[Fraction]
    ) -> tuple[Fraction, Fraction, Fraction, Fraction, set[int]]:
        """Ends, variance, the largest share of a step, and sources of ``c e_T + earlier e_(T-1)``."""
        low = high = variance = largest = Fraction(0)
        sources, scale = set(), max(abs(x) for x in (*c, *earlier)) * Fraction(min(self.scale))
        y = [c]
        for s in reversed(range(self.T)):
            # what e_(s+1) is multiplied by acts on the step s
            coefficients = times(y, rational(self.L[s]))[0]
            own = sum((x * x for x in coefficients), Fraction(0))
            variance, largest = variance + own, max(largest, own)
            # what y is rounded by is charged as an error, and is no form of the noise
            sources |= {k for k, x in enumerate(coefficients) if abs(x) > Fraction(1, 10**12) * scale}
            for x, a, b in zip(y[0], *self.pushed[s].tolist(), strict=True):
                low, high = low + min(x * Fraction(a), x * Fraction(b)), high + max(x * Fraction(a), x * Fraction(b))
            y = times(y, rational(self.F[s]))
            if s == self.T - 1:
                y = [[x + z for x, z in zip(y[0], earlier, strict=True)]]
        size = sum((abs(x) * Fraction(a) for x, a in zip(y[0], self.spread.tolist(), strict=True)), Fraction(0))
        return low - size, high + size, variance, largest, sources


@pytest.mark.parametrize("with_earlier", [False, True])
def test_rows_hold_what_rational_numbers_say(with_earlier: bool) -> None:
    rng, rows, excess = np.random.default_rng(int(with_earlier)), 0, []
    for _ in range(70):
        D, W, T = int(rng.integers(1, 5)), int(rng.integers(1, 4)), int(rng.integers(1, 6))
        own = Random(rng, D, W, T)
        c = np.where(rng.random((4, D)) < 0.7, rng.normal(size=(4, D)), 0.0)
        c[0] = np.eye(D)[0]
        earlier = np.where(rng.random((4, D)) < 0.7, rng.normal(size=(4, D)), 0.0) if with_earlier else None
        if with_earlier and rng.random() < 0.3:
            earlier = -c @ own.F[-1]  # what one step adds, and nothing else
        (low, high), forms = own.system.rows(c, earlier)
        for j in range(4):
            before = rational(earlier)[j] if earlier is not None else [Fraction(0)] * D
            a, b, variance, largest, sources = own.row(rational(c)[j], before)
            assert Fraction(low[j]) <= a <= b <= Fraction(high[j])
            assert Fraction(forms.variance[j]) >= variance and Fraction(forms.largest[j]) >= largest
            assert sources <= {*np.flatnonzero(forms.sources[j]).tolist()}
            rows += 1
            if variance > Fraction(1, 10**6):
                excess.append(float(Fraction(forms.variance[j]) / variance) - 1.0)
    assert rows == 280
    assert np.median(excess) < 1e-11


def test_rows_hold_runs_of_every_noise_start_and_disturbance() -> None:
    """The identity itself, forward: without noise c e_t + b e_(t-1) is between the ends at corners of all boxes."""
    rng = np.random.default_rng(2)
    for _ in range(12):
        D, W, T = 2, 2, 3
        own = Random(rng, D, W, T)
        c, earlier = rng.normal(size=(1, D)), rng.normal(size=(1, D))
        (low, high), _ = own.system.rows(c, earlier)
        for _ in range(40):
            e = [[Fraction(x)] for x in (own.spread * rng.choice([-1.0, 1.0], D)).tolist()]
            before = e
            for s in range(T):
                b = np.where(rng.random(D) < 0.5, own.pushed[s][0], own.pushed[s][1])
                before, e = (
                    e,
                    [[x + Fraction(y)] for (x,), y in zip(times(rational(own.F[s]), e), b.tolist(), strict=True)],
                )
            value = times(rational(c), e)[0][0] + times(rational(earlier), before)[0][0]
            assert Fraction(low[0]) <= value <= Fraction(high[0])


def test_what_matrices_of_products_miss_is_charged() -> None:
    """Products that are another matrix cost what the reach of errors says: nothing rests on how they were computed."""
    rng = np.random.default_rng(3)
    own = Random(rng, 2, 2, 4)
    c = rng.normal(size=(3, 2))
    own.system.products = own.system.products + 1e-3 * rng.normal(size=own.system.products.shape)
    own.system.products[-1] = np.eye(2)
    (low, high), forms = own.system.rows(c)
    exact = rational(c)
    for j in range(3):
        # telescoping with the numbers that are there: every e is anywhere in its reach
        ys = [times([exact[j]], rational(product))[0] for product in own.system.products]
        most = sum((abs(x) * Fraction(a) for x, a in zip(ys[0], own.spread.tolist(), strict=True)), Fraction(0))
        least, variance = -most, Fraction(0)
        for s in range(4):
            after = [ys[s + 1]]
            variance += sum((x * x for x in times(after, rational(own.L[s]))[0]), Fraction(0))
            for x, a, b in zip(after[0], *own.pushed[s].tolist(), strict=True):
                least, most = (
                    least + min(x * Fraction(a), x * Fraction(b)),
                    most + max(x * Fraction(a), x * Fraction(b)),
                )
            for x, y, r in zip(times(after, rational(own.F[s]))[0], ys[s], own.reach[s].tolist(), strict=True):
                least, most = least - abs(x - y) * Fraction(r), most + abs(x - y) * Fraction(r)
        # the numbers y are those that were rounded: off by less than this
        spare = Fraction(1, 10**12)
        assert Fraction(low[j]) <= least + spare and most - spare <= Fraction(high[j])
        assert Fraction(forms.variance[j]) >= variance * (1 - spare)


def test_rows_before_any_step_are_those_of_the_start() -> None:
    system = ErrorSystem(np.array([0.5, 0.0]), 3)
    (low, high), forms = system.rows(np.array([[2.0, 1.0], [0.0, 1.0]]))
    assert low[0] <= -1.0 < 1.0 <= high[0] <= 1.0 + 1e-12 and low[1] == high[1] == 0.0
    assert not forms.variance.any() and not forms.sources.any()


def test_small_noise_is_not_taken_for_none() -> None:
    """Squares of numbers below 1e-162 are 0: a form has a variance above 0 wherever its noise is not 0."""
    for size in (1e-170, 1e-200, 1e-308, 5e-324):
        system = ErrorSystem(np.zeros(1), 1)
        system.step(np.eye(1), np.zeros((2, 1)), np.ones(1), np.array([[size]]))
        _, forms = system.rows(np.eye(1))
        assert forms.variance[0] > 0.0 and forms.largest[0] > 0.0 and forms.sources[0, 0]


# From rows to a probability.


def forms_of(sources: list[list[bool]], variance: list[float], largest: list[float] | None = None) -> Forms:
    unknown = np.zeros((len(variance), 0, len(sources[0])))
    return Forms(np.array(variance), np.array(largest or variance), np.array(sources), unknown, unknown)


def failure(kinds: list[int], low: list[float], high: list[float], width: list[float], forms: Forms) -> float:
    constraints = Constraints(np.array(kinds))
    constraints.add(np.array(low), np.array(high), np.array(width), forms, [str(k) for k in range(len(low))])
    return constraints.failure()


def test_a_constraint_fails_on_either_side() -> None:
    """One form: against the exact probability that it leaves its limits or its width."""
    from scipy.special import ndtr

    rng, inf = np.random.default_rng(4), np.inf
    for _ in range(200):
        s = 10.0 ** rng.uniform(-1, 1)
        low, high, width = (float(rng.choice([inf, s * rng.uniform(0.5, 5.0)])) for _ in range(3))
        below, above = min(low, width) / s, min(high, width) / s
        exact = float(ndtr(-below) + ndtr(-above))
        got = failure([NORMAL], [low], [high], [width], forms_of([[True]], [s * s]))
        assert exact <= got <= 2.0 * max(ndtr(-below), ndtr(-above)) * (1 + 1e-9) + 1e-290
    assert failure([NORMAL], [-0.1], [1.0], [inf], forms_of([[True]], [1.0])) >= float(ndtr(0.1))
    assert failure([NORMAL], [1.0], [0.0], [inf], forms_of([[False]], [0.0])) == 1.0
    assert failure([NORMAL], [1.0], [1e-300], [inf], forms_of([[False]], [0.0])) == 0.0
    for nothing in ([np.nan], [-inf]):
        assert failure([NORMAL], nothing, [1.0], [inf], forms_of([[True]], [1.0])) == 1.0
        assert failure([NORMAL], [1.0], [1.0], nothing, forms_of([[True]], [1.0])) == 1.0
    assert failure([NORMAL], [1.0], [1.0], [inf], forms_of([[True]], [np.nan])) == 1.0


def test_many_constraints_fail_no_more_often_than_is_said() -> None:
    """Random correlated forms against 200,000 draws, with false alarm 1e-6: normal noise, strips and tails."""
    rng, n = np.random.default_rng(5), 200_000
    margin = np.sqrt(np.log(40 / 1e-6) / (2 * n))
    seen = []
    for _ in range(40):
        J, W = int(rng.integers(1, 6)), int(rng.integers(1, 4))
        rows = rng.normal(size=(J, W)) * rng.choice([0.0, 1.0], (J, W), p=[0.3, 0.7])
        deviation = np.sqrt((rows**2).sum(axis=1))
        ends = [np.where(rng.random(J) < 0.3, np.inf, (deviation + 1e-9) * rng.uniform(0.8, 4.0, J)) for _ in range(3)]
        g = rows @ rng.normal(size=(W, n))
        low, high, width = (end[:, None] for end in ends)
        fails = np.any((g < -low) | (g > high) | (np.abs(g) > width), axis=0).mean()
        forms = forms_of((rows != 0.0).tolist(), (deviation**2 * (1 + 1e-12)).tolist())
        got = failure([NORMAL] * W, ends[0].tolist(), ends[1].tolist(), ends[2].tolist(), forms)
        assert got >= fails - margin
        seen.append((got - fails) / max(got, 1e-3))
    assert np.median(seen) < 0.5


def test_components_that_share_no_noise_are_independent_and_others_are_not() -> None:
    """The bound is that of independent components; of one that is joined by a third form it is Sidak's, or the sum."""
    apart = forms_of([[True, False], [False, True]], [1.0, 1.0])
    z, inf = [1.0, 1.5], [np.inf] * 2
    one, two = (failure([NORMAL], [x], [np.inf], [np.inf], forms_of([[True]], [1.0])) for x in z)
    both = failure([NORMAL] * 2, z, inf, inf, apart)
    assert abs(both - (one + two - one * two)) < 1e-9
    for kinds in itertools.product((NORMAL, STOPPED, LIGHT, LONG), repeat=2):
        each = [failure([kind], [x], [np.inf], [np.inf], forms_of([[True]], [1.0])) for kind, x in zip(kinds, z)]
        assert abs(failure([*kinds], z, inf, inf, apart) - (each[0] + each[1] - each[0] * each[1])) < 1e-9
    # opposite halves of one number: the sum, not the product
    same = forms_of([[True], [True]], [1.0, 1.0])
    assert failure([NORMAL], [1.0, np.inf], [np.inf, 1.0], inf, same) >= 2 * one * (1 - 1e-12)
    chain = forms_of([[True, False], [True, True], [False, True]], [1.0, 2.0, 1.0])
    limits = [1.0, np.inf, np.inf], [np.inf, np.inf, 1.0], [np.inf] * 3
    assert failure([NORMAL] * 2, *limits, chain) >= 2 * one * (1 - 1e-12)


def test_forms_with_a_source_of_another_kind_are_of_that_kind() -> None:
    mixed = forms_of([[True, True]], [1.0])
    only = forms_of([[True]], [1.0])
    for kind in (STOPPED, LIGHT, LONG):
        got = failure([NORMAL, kind], [2.0], [np.inf], [np.inf], mixed)
        assert (
            got == failure([kind], [2.0], [np.inf], [np.inf], only) > failure([NORMAL], [2.0], [np.inf], [np.inf], only)
        )
    # both tails of one number count
    two = failure([LIGHT], [2.0], [2.0], [np.inf], only)
    assert two == pytest.approx(2 * failure([LIGHT], [2.0], [np.inf], [np.inf], only), rel=1e-9)
    assert failure([LIGHT], [np.inf], [np.inf], [2.0], only) == pytest.approx(two, rel=1e-9)
    # many small steps have lighter tails than one large one
    assert failure([LONG], [5.0], [9.0], [9.0], forms_of([[True]], [1.0], [0.01])) < 0.1 * failure(
        [LONG], [5.0], [9.0], [9.0], only
    )


def test_noise_that_is_given_up_is_added() -> None:
    constraints = Constraints(np.array([NORMAL]))
    far = np.array([9.0])
    constraints.add(far, far, far, forms_of([[True]], [1.0]), ["`goal` at time 3"])
    constraints.lost = 0.25
    assert 0.25 <= constraints.failure() < 0.2501


def test_the_nearest_end_of_each_time_is_told() -> None:
    constraints, forms = Constraints(np.array([NORMAL])), forms_of([[True]] * 3, [4.0, 1.0, 0.0])
    far = np.full(3, np.inf)
    labels = ["`goal` at time 3", "input `u` of `a` at time 3", "state 0 at time 2"]
    constraints.add([3.0, 2.0, 1.0], [9.0, 5.0, 1.0], far, forms, labels)
    constraints.add(far, far, [1.0, 9.0, 9.0], forms, ["state 0 at time 4", "state 1 at time 4", "state 0 at time 5"])
    found = constraints.nearest()
    assert {t: label for t, (_, label) in found.items()} == {
        3: labels[0], 2: labels[2], 4: "state 0 at time 4", 5: "state 0 at time 5"
    }  # fmt: skip
    assert 1.5 * (1 - 1e-12) < found[3][0] <= 1.5 and 0.5 * (1 - 1e-12) < found[4][0] <= 0.5
    assert found[2][0] == found[5][0] == np.inf


def test_many_constraints_do_not_lose_what_their_sum_is_rounded_by() -> None:
    """Ten thousand events of probability p: against a sum in rational numbers."""
    J = 10_000
    low = np.full(J, 4.0)
    inf = np.full(J, np.inf)
    forms = forms_of([[True]] * J, [1.0] * J)
    one = failure([NORMAL], [4.0], [np.inf], [np.inf], forms_of([[True]], [1.0]))
    constraints = Constraints(np.array([NORMAL]))
    constraints.add(low, inf, inf, forms, [""] * J)
    assert Fraction(constraints.failure()) >= Fraction(one) * J * (1 - Fraction(1, 10**10))
    assert constraints.failure() <= one * J * 1.0001
