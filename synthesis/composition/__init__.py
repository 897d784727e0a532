"""Composition of tasks: independent parts multiplied, and pairs of agents subtracted by a union bound."""

from .avoiding import Avoidance
from .base import relevant_pairs, usual_values, without_pairs
from .horizons import each_horizon, horizons_of, without_deadline
from .keeping_apart import less_nearness, nearness
from .near_mass import NearMass
from .parts import synthesize_parts
from .together import ways_together

__all__ = [
    "Avoidance",
    "NearMass",
    "each_horizon",
    "horizons_of",
    "less_nearness",
    "nearness",
    "relevant_pairs",
    "synthesize_parts",
    "usual_values",
    "ways_together",
    "without_deadline",
    "without_pairs",
]
