"""Tasks about pairs of agents: the task without them, how likely pairs are near, and policies that keep apart."""

from .avoiding import Avoidance
from .base import relevant_pairs, usual_values, without_pairs
from .beside_paths import BesidePaths, Marginals
from .joint_agent import TEAM, joint_problem
from .mixed_task import agents_on_grids, part_of, task_on_grids, what_asks
from .near_mass import NearMass

__all__ = [
    "Avoidance",
    "BesidePaths",
    "Marginals",
    "NearMass",
    "TEAM",
    "agents_on_grids",
    "joint_problem",
    "part_of",
    "relevant_pairs",
    "task_on_grids",
    "usual_values",
    "what_asks",
    "without_pairs",
]
