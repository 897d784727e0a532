"""Chance constraints: constraint tightening by noise and linearization errors.

Chance constraints along a trajectory: constraint tightening by noise and linearization errors.
"""

from .feedback_bounds import Feedback, NominalPath, Spreads, worth_of
from .limit_rows import Worth, least_by_times
from .linearization_errors import LinearizationErrors
from .noise_free_runs import most_missed, satisfies
from .nonlinear_model import NonlinearModel
from .pair_costs import PairAim, PairLimits, pair_limits
from .pair_inequalities import PairRows, deviations_of, pair_rows
from .path_limits import Limits, corners_along, limits_along, sides_of
from .soft_limits import soft_costs
from .team_model import TeamModel, Tie, key_of
