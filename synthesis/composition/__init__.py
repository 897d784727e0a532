"""Independent tasks multiplied, pairs by a union bound.

Composition of tasks: independent parts multiplied, and pairs of agents subtracted by a union bound.
"""

from .base import relevant_pairs, usual_values, without_pairs
from .collision_avoidance import less_proximity, proximity
from .collision_probability import CollisionProbability
from .horizons import each_horizon, horizons_of, without_deadline
from .independent_tasks import synthesize_parts
from .joint_tasks import joint_strategies
