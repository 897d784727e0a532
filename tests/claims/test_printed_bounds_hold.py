"""What is printed of a certified number is certified too: lower bounds are rounded down, upper bounds up."""

from __future__ import annotations

import re
from fractions import Fraction

from hypothesis import given
from hypothesis import strategies as st

from certigym.synthesis.certificates.proofs.digits import (
    rounded_down,
    rounded_up,
    shown_bound,
    significant_down,
    significant_up,
)

probability = st.floats(0.0, 1.0)


@given(probability, st.integers(0, 15))
def test_digits_are_on_the_safe_side(value: float, digits: int) -> None:
    exactly, unit = Fraction(value), Fraction(1, 10**digits)
    assert exactly - unit < Fraction(rounded_down(value, digits)) <= exactly
    assert exactly <= Fraction(rounded_up(value, digits)) < exactly + unit
    assert Fraction(significant_down(value, 3)) <= exactly <= Fraction(significant_up(value, 3))


@given(probability, st.one_of(st.none(), st.floats(0.0, 1.0), st.floats(1e-12, 1e-6)))
def test_claims_hold_as_they_are_printed(lower: float, gap: float | None) -> None:
    gap = None if gap is None else min(gap, 1.0 - lower)
    claim = shown_bound(lower, gap)
    numbers = [Fraction(found) for found in re.findall(r"\d+(?:\.\d+)?(?:e-?\d+)?", claim)]
    assert numbers[0] <= Fraction(lower)
    if gap is None:
        assert len(numbers) == 1
    elif "exact to" in claim:
        assert numbers[0] + numbers[1] >= Fraction(lower + gap) - Fraction(1, 2**52)
        assert numbers[1] <= Fraction(gap) * 20 + Fraction(1, 10**14) or lower <= 1e-9
    elif len(numbers) == 2:
        assert numbers[1] >= Fraction(lower + gap)
