"""The proof done again, by code that no search reaches."""

from .certificate_check import CheckReport, check
from .regrown_tree import regrow
from .rigorous import RigorousReport, check_rigorous

__all__ = [
    "CheckReport",
    "RigorousReport",
    "check",
    "check_rigorous",
    "regrow",
]
