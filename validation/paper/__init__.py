"""The paper's figures and tables, recomputed by the paper's own method."""

from .judged_lines import RECORDED, lines_text, summary_text
from .refutation import refute_published
from .reproduce import silent
from .targets import TARGETS, reproduced

__all__ = [
    "RECORDED",
    "TARGETS",
    "lines_text",
    "refute_published",
    "reproduced",
    "silent",
    "summary_text",
]
