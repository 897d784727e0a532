"""The paper's figures and tables, recomputed by the paper's own method."""

from .refutation import refute_published

__all__ = [
    "refute_published",
]
