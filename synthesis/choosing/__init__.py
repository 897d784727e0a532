"""Which relation, which cells, and from which policies to start."""

from .cell_choice import refine
from .given_start import laws_from
from .relation_choice import Tries, groups_of

__all__ = [
    "Tries",
    "groups_of",
    "laws_from",
    "refine",
]
