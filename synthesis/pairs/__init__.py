"""Tasks about pairs of agents: the task without them, how likely pairs are near, and policies that keep apart."""

from .avoiding import Avoidance
from .base import relevant_pairs, usual_values, without_pairs
from .joint_agent import TEAM, joint_problem
from .near_mass import NearMass

__all__ = ["Avoidance", "NearMass", "TEAM", "joint_problem", "relevant_pairs", "usual_values", "without_pairs"]
