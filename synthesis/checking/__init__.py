"""The proof done again, by code that no search reaches."""

from .certificate_check import CheckReport, check
from .later_values import ValueInTime, claimed_values, value_in_time
from .linear_check import masks_of
from .regrown_tree import regrow, vertices_of
from .rigorous import RigorousReport, check_rigorous

__all__ = [
    "CheckReport",
    "RigorousReport",
    "ValueInTime",
    "check",
    "check_rigorous",
    "claimed_values",
    "masks_of",
    "regrow",
    "value_in_time",
    "vertices_of",
]
