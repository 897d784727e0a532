"""What the checker prints is no more than what it proves, to the last bit."""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
import pytest

from certigym.synthesis.checker.verdict import bound_of, shown


@pytest.mark.parametrize("exponent", [7, 8, 12, 300])
@pytest.mark.parametrize("towards", [0.0, 1.0])
def test_failures_next_to_what_can_be_printed_are_rounded_up(exponent: int, towards: float) -> None:
    # Four digits print these failures but for one bit: quotients of floats lose it.
    for digits in np.random.default_rng(0).integers(1000, 10000, 500):
        failure = math.nextafter(float(f"{digits}e-{exponent}"), towards)
        printed = Fraction(shown(failure).removeprefix("1 - "))
        assert Fraction(failure) <= printed <= Fraction(failure) * Fraction(1002, 1000)


def test_bounds_are_rounded_down() -> None:
    for failure in np.random.default_rng(1).uniform(1e-3, 1.0, 2000):
        proved = Fraction(bound_of(failure))
        assert proved - Fraction(1, 10**6) < Fraction(shown(failure)) <= proved
