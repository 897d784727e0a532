"""Agents, their boxes, and which propositions hold at a point."""

from .agent import LinearAgent, checked_name
from .box import Box
from .checks import checked_count, float_array, read_only, shown
from .labeling import Labeling, Proposition, contains, inside, linear, row_times
from .saving import write_bytes, write_json, write_text

__all__ = [
    "Box",
    "Labeling",
    "LinearAgent",
    "Proposition",
    "checked_count",
    "checked_name",
    "contains",
    "float_array",
    "inside",
    "linear",
    "read_only",
    "row_times",
    "shown",
    "write_bytes",
    "write_json",
    "write_text",
]
