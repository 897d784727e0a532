"""One page about a certificate: numbers, pictures, verdict."""

from .gathering import report

__all__ = [
    "report",
]
