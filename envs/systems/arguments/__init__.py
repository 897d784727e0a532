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
