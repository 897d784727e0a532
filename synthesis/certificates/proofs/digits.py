"""Certified numbers in print: lower bounds are rounded down and upper bounds up, so that what is printed holds too."""

from __future__ import annotations

import math
from decimal import ROUND_CEILING, ROUND_FLOOR, Context, Decimal

EXACT_GAP = 1e-6
"""A value is called exact when lower bound and upper bound of the closed loop are closer than this."""

NEXT_TO_AN_END = 1e-12
"""Bounds nearer to 0 or 1 than this have no leading digits to count: they get a fixed number."""

IN_FAILURES = 0.99
"""Bound from which words count failures."""

LEAST_DIGITS = 6
"""Digits after the point that are always printed."""


def rounded_down(value: float, digits: int = 6) -> str:
    """Return the largest number with that many digits after the point which is not above the value.

    Examples
    --------
    >>> rounded_down(0.125, 2), rounded_down(0.9999996)
    ('0.12', '0.999999')
    """
    return _to_places(value, digits, ROUND_FLOOR)


def rounded_up(value: float, digits: int = 6) -> str:
    """Return the smallest number with that many digits after the point which is not below the value.

    Examples
    --------
    >>> rounded_up(0.1234561)
    '0.123457'
    """
    return _to_places(value, digits, ROUND_CEILING)


def significant_down(value: float, digits: int) -> str:
    """Return the largest number with that many significant digits which is not above the value.

    Examples
    --------
    >>> significant_down(0.0029999, 3), significant_down(1.99e-20, 2)
    ('0.00299', '1.9e-20')
    """
    return _to_digits(value, digits, ROUND_FLOOR)


def significant_up(value: float, digits: int) -> str:
    """Return the smallest number with that many significant digits which is not below the value.

    Examples
    --------
    >>> significant_up(2.91e-10, 2)
    '3.0e-10'
    """
    return _to_digits(value, digits, ROUND_CEILING)


def _to_places(value: float, digits: int, rounding: str) -> str:
    """Return a value with that many digits after the point; decimals round the binary number exactly."""
    return f"{Decimal(float(value)).quantize(Decimal(1).scaleb(-digits), rounding):f}"


def _to_digits(value: float, digits: int, rounding: str) -> str:
    """Return a value with that many significant digits, in scientific notation if it is small."""
    exact = Context(prec=digits, rounding=rounding).create_decimal_from_float(float(value))
    return f"{exact:f}" if exact.adjusted() >= -4 else f"{exact:.{digits - 1}e}"


def in_runs(lower: float) -> str:
    """Return a lower bound in words, rounded to the safe side; nothing for a bound of 0.

    Examples
    --------
    >>> in_runs(0.857), in_runs(1.0 - 1.51e-5), in_runs(0.0)
    ('at least 85 of 100 runs succeed', 'at most 1 run in 66,000 fails', '')
    """
    if lower < IN_FAILURES:
        share = math.floor(100.0 * lower)
        return f"at least {share} of 100 runs succeed" if share > 0 else ""
    runs = math.floor(1.0 / (1.0 - lower)) if lower < 1.0 - NEXT_TO_AN_END else round(1.0 / NEXT_TO_AN_END)
    tens = 10 ** max(0, len(str(runs)) - 2)
    return f"at most 1 run in {runs // tens * tens:,} fails"


def shown_bound(lower: float, gap: float | None) -> str:
    """Return a claim in words, its digits rounded to the safe side so that what is printed holds too."""
    if lower <= NEXT_TO_AN_END:
        claim = significant_down(lower, 3)
    else:
        # Three significant digits of the bound, or of its distance from 1 if that is smaller.
        digits = 3 - math.floor(math.log10(min(lower, 1.0 - lower))) if lower < 1.0 - NEXT_TO_AN_END else 12
        # What is exact is worth more digits: as many as the gap leaves.
        if gap is not None and gap <= EXACT_GAP:
            digits = max(digits, -math.floor(math.log10(max(gap, 1e-15))))
        claim = rounded_down(lower, max(LEAST_DIGITS, digits))
    if gap is None or (gap > EXACT_GAP and lower + gap >= 1.0):
        return f"P >= {claim}"
    if gap > EXACT_GAP:
        return f"P >= {claim}, P <= {rounded_up(lower + gap)}"
    return f"P >= {claim} (exact to {significant_up(lower + gap - float(claim), 2)})"
