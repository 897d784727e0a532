"""Proofs along paths done again: intervals of its own, linear deviations, what they must keep, and time 0."""

from .hull_check import wrong_hull
from .moving import Moving
from .own_angles import wrong_angles
from .own_intervals import Span, bounds, computed_off, products, span
from .own_regions import RegionSpan
from .path_check import wrong_paths

__all__ = [
    "Moving",
    "RegionSpan",
    "Span",
    "bounds",
    "computed_off",
    "products",
    "span",
    "wrong_angles",
    "wrong_hull",
    "wrong_paths",
]
