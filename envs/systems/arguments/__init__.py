"""Arguments checked, records printed, files written.

Arguments checked, records printed shortly, and files written completely or not at all.
"""

from .checks import (
    MOST_AGENTS,
    OTHER_NAMES,
    UnknownArgument,
    checked_count,
    checked_states,
    float_array,
    for_all_axes,
    names_arguments,
    near,
    read_only,
    shown,
    slices_of,
    unknown_argument,
)
from .printing import box_text, counted, matrix_text, names_text, shortened, tree_text, vector_text
from .saving import write_bytes, write_json, write_text

__all__ = [
    "OTHER_NAMES",
    "MOST_AGENTS",
    "UnknownArgument",
    "box_text",
    "checked_count",
    "checked_states",
    "counted",
    "float_array",
    "for_all_axes",
    "matrix_text",
    "names_text",
    "read_only",
    "shortened",
    "shown",
    "slices_of",
    "tree_text",
    "names_arguments",
    "near",
    "unknown_argument",
    "vector_text",
    "write_bytes",
    "write_json",
    "write_text",
]
