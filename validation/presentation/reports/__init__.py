"""One page about a certificate.

One page about a certificate: numbers, pictures, verdict.
"""

from .explorer import bounds_of_starts, coordinates_of
from .gathering import report
from .page_style import PATTERNS, STYLE

__all__ = [
    "PATTERNS",
    "STYLE",
    "bounds_of_starts",
    "coordinates_of",
    "report",
]
