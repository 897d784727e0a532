"""One page about a certificate: numbers, pictures, verdict."""

from .report import gather_report, write_report

__all__ = [
    "gather_report",
    "write_report",
]
