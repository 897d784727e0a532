"""The paper's figures and tables, recomputed.

The paper's figures and tables, recomputed by the paper's own method.
"""

from .judged_lines import RECORDED, lines_text, summary_text
from .refutation import refute_published
from .reproduction import Reproduction, computed
from .targets import TARGETS, lines_of, target_of

__all__ = [
    "RECORDED",
    "Reproduction",
    "TARGETS",
    "computed",
    "lines_of",
    "lines_text",
    "refute_published",
    "target_of",
    "summary_text",
]
