"""One page about a certificate.

One page about a certificate: numbers, pictures, verdict.
"""

from .gathering import report
from .page_style import PATTERNS, STYLE

__all__ = [
    "PATTERNS",
    "STYLE",
    "report",
]
