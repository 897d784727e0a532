"""What the checks of paths allow for rounding."""

UNIT = 2.0**-52
"""Twice the relative rounding of one operation."""

SMALLEST = 1e-300
"""What is added to tails, because smaller ones come out as 0."""

TAIL = 1.0 + 1e-11
"""Factor on tails and sums of them, far above what the complementary error function is off by."""
