"""Which relation, which cells, and from which policies to start."""

from .cell_choice import Budget, refine
from .given_start import policies_from
from .levels import GOOD, SOLVED, Run, finer_levels, first_cells, is_quick, linear_levels
from .relation_choice import MOST_LINEAR_AGENTS, Tries, groups_of, has_linear_cells, least_above

__all__ = [
    "Budget",
    "GOOD",
    "MOST_LINEAR_AGENTS",
    "Run",
    "SOLVED",
    "Tries",
    "finer_levels",
    "first_cells",
    "groups_of",
    "has_linear_cells",
    "is_quick",
    "least_above",
    "linear_levels",
    "policies_from",
    "refine",
]
