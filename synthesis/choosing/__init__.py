"""Which relation, which cells, and from which policies to start."""

from .cell_choice import Budget, refine
from .given_start import policies_from
from .relation_choice import Tries, groups_of

__all__ = [
    "Budget",
    "Tries",
    "groups_of",
    "policies_from",
    "refine",
]
