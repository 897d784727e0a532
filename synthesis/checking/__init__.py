"""The proof done again, by code that no search reaches."""

from .certificate_check import CheckReport, check
from .regrown_tree import regrow

__all__ = [
    "CheckReport",
    "check",
    "regrow",
]
