"""Tasks about pairs of agents: the task without them, how likely pairs are near, and policies that keep apart."""

from .avoiding import Avoidance
from .base import relevant_pairs, usual_values, without_pairs
from .near_mass import NearMass

__all__ = [
    "Avoidance",
    "NearMass",
    "relevant_pairs",
    "usual_values",
    "without_pairs",
]
