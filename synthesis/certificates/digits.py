"""Certified numbers in print: lower bounds are rounded down and upper bounds up, so that what is printed holds too."""

from __future__ import annotations

import math
from decimal import ROUND_CEILING, ROUND_FLOOR, Context, Decimal

from .certificate import EXACT_GAP


def rounded_down(value: float, digits: int = 6) -> str:
    """The largest number with that many digits after the point which is not above the value.

    Examples
    --------
    >>> rounded_down(0.125, 2), rounded_down(0.9999996)
    ('0.12', '0.999999')
    """
    return _to_places(value, digits, ROUND_FLOOR)


def rounded_up(value: float, digits: int = 6) -> str:
    """The smallest number with that many digits after the point which is not below the value.

    Examples
    --------
    >>> rounded_up(0.1234561)
    '0.123457'
    """
    return _to_places(value, digits, ROUND_CEILING)


def significant_down(value: float, digits: int) -> str:
    """The largest number with that many significant digits which is not above the value.

    Examples
    --------
    >>> significant_down(0.0029999, 3), significant_down(1.99e-20, 2)
    ('0.00299', '1.9e-20')
    """
    return _to_digits(value, digits, ROUND_FLOOR)


def significant_up(value: float, digits: int) -> str:
    """The smallest number with that many significant digits which is not below the value.

    Examples
    --------
    >>> significant_up(2.91e-10, 2)
    '3.0e-10'
    """
    return _to_digits(value, digits, ROUND_CEILING)


def _to_places(value: float, digits: int, rounding: str) -> str:
    return f"{Decimal(float(value)).quantize(Decimal(1).scaleb(-digits), rounding):f}"


def _to_digits(value: float, digits: int, rounding: str) -> str:
    exact = Context(prec=digits, rounding=rounding).create_decimal_from_float(float(value))
    return f"{exact:f}" if exact.adjusted() >= -4 else f"{exact:.{digits - 1}e}"


def shown_bound(lower: float, gap: float | None) -> str:
    """A claim in words, its digits rounded away from what is claimed so that what is printed holds too."""
    if lower <= 1e-12:
        claim = significant_down(lower, 3)
    else:
        digits = 3 - math.floor(math.log10(min(lower, 1.0 - lower))) if lower < 1.0 - 1e-12 else 12
        if gap is not None and gap <= EXACT_GAP:  # what is exact is worth more digits
            digits = max(digits, -math.floor(math.log10(max(gap, 1e-15))))
        claim = rounded_down(lower, max(6, digits))
    if gap is None or (gap > EXACT_GAP and lower + gap >= 1.0):
        return f"P >= {claim}"
    if gap > EXACT_GAP:
        return f"P >= {claim}, P <= {rounded_up(lower + gap)}"
    return f"P >= {claim} (exact to {significant_up(lower + gap - float(claim), 2)})"
