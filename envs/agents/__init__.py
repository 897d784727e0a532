"""Agents, their boxes, and which propositions hold at a point."""

from .agent import LinearAgent, with_matrices
from .angles import TURN, wrapped
from .any_agent import AnyAgent, checked_name
from .box import Box
from .checks import (
    MOST_AGENTS,
    UnknownArgument,
    checked_count,
    float_array,
    for_all_axes,
    read_only,
    shown,
    slices_of,
    unknown_argument,
)
from .declared_names import MOST_OUTPUTS, MOST_STATES, TIME
from .expression_agent import Agent, with_expressions
from .headings import heading_of
from .labeling import MOVING_REFUSAL, Labeling, contains, inside, of_hint
from .laws import Gaussian, Law, Uniform
from .majorants import Majorant, Tail
from .neighbours import Place, neighbour, place_of, states_of_others, tied
from .noise import is_own_law, laws_by_author
from .pair import FLAT, REFUSAL, Pair, PairRegion, ball_box, holds
from .pieces import Combined, Form, Frame, Limit, Piece
from .printing import box_text, counted, matrix_text, names_text, shortened, tree_text, vector_text
from .products import linear, row_times
from .proposition import Proposition
from .saving import write_bytes, write_json, write_text
from .shapes import SHAPES
from .timed_corners import DECIMALS, values_over

__all__ = [
    "Agent",
    "AnyAgent",
    "Box",
    "Combined",
    "DECIMALS",
    "FLAT",
    "Form",
    "Frame",
    "Gaussian",
    "Labeling",
    "Law",
    "Limit",
    "LinearAgent",
    "MOST_AGENTS",
    "MOST_OUTPUTS",
    "Majorant",
    "MOST_STATES",
    "MOVING_REFUSAL",
    "Pair",
    "PairRegion",
    "Piece",
    "Place",
    "Proposition",
    "REFUSAL",
    "SHAPES",
    "TIME",
    "TURN",
    "Tail",
    "Uniform",
    "UnknownArgument",
    "ball_box",
    "box_text",
    "checked_count",
    "checked_name",
    "contains",
    "counted",
    "float_array",
    "for_all_axes",
    "heading_of",
    "holds",
    "inside",
    "is_own_law",
    "laws_by_author",
    "linear",
    "matrix_text",
    "names_text",
    "neighbour",
    "of_hint",
    "place_of",
    "read_only",
    "row_times",
    "shortened",
    "shown",
    "slices_of",
    "states_of_others",
    "tied",
    "tree_text",
    "unknown_argument",
    "values_over",
    "vector_text",
    "with_expressions",
    "wrapped",
    "with_matrices",
    "write_bytes",
    "write_json",
    "write_text",
]
