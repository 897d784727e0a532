"""Which relation, which cells, and from which policies to start."""

from .cell_choice import Budget, refine
from .given_start import policies_from
from .levels import GOOD, SOLVED, Run, finer_levels, first_cells, linear_levels
from .relation_choice import Tries, groups_of

__all__ = [
    "Budget",
    "GOOD",
    "Run",
    "SOLVED",
    "Tries",
    "finer_levels",
    "first_cells",
    "groups_of",
    "linear_levels",
    "policies_from",
    "refine",
]
