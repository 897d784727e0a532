"""A local page where a task is drawn and certified.

A local page on which a task is drawn, written and certified.
"""

from .server import Studio, open_studio

__all__ = [
    "Studio",
    "open_studio",
]
