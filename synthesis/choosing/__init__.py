"""Which relation, which cells, and from which policies to start."""

from .cell_choice import Budget, refine
from .given_start import policies_from, settings_of
from .levels import GOOD, GUESSED_RANK, SOLVED, Run, finer_levels, first_cells, linear_levels, seconds_of
from .relation_choice import MOST_LINEAR_AGENTS, Tries, groups_of, has_linear_cells, least_above

__all__ = [
    "Budget",
    "GOOD",
    "GUESSED_RANK",
    "MOST_LINEAR_AGENTS",
    "Run",
    "SOLVED",
    "Tries",
    "finer_levels",
    "first_cells",
    "groups_of",
    "has_linear_cells",
    "least_above",
    "linear_levels",
    "policies_from",
    "settings_of",
    "refine",
    "seconds_of",
]
