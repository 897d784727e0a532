"""Which relation, which cells, and from which policies to start."""

from .cell_choice import Budget, refine
from .given_start import policies_from
from .levels import (
    CHEAP_SECONDS,
    FINER,
    FIRST_WIDTH,
    GOOD,
    GUESSED_RANK,
    LEAST_GAIN,
    MOST_GUESSED_RANK,
    MOST_LEVELS,
    MOST_SECONDS,
    SOLVED,
    carried_over,
    level_cells,
    seconds_of,
)
from .relation_choice import Tries, groups_of

__all__ = [
    "Budget",
    "CHEAP_SECONDS",
    "FINER",
    "FIRST_WIDTH",
    "GOOD",
    "GUESSED_RANK",
    "LEAST_GAIN",
    "MOST_GUESSED_RANK",
    "MOST_LEVELS",
    "MOST_SECONDS",
    "SOLVED",
    "Tries",
    "carried_over",
    "groups_of",
    "level_cells",
    "policies_from",
    "refine",
    "seconds_of",
]
