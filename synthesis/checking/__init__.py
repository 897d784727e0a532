"""The proof done again, by code that no search reaches."""

from .certificate_check import CheckReport, check, wrong_base
from .checked_first import standing
from .execution import execution_of
from .geometry import cell_boxes
from .greedy import Greedy, greedy_disturbance
from .lasting_safety import SHORTEST, SafetyRate, is_safety, safety_rate
from .later_values import ValueInTime, claimed_values, value_in_time
from .linear_check import by_cell, masks_of, places_of
from .mean_spans import Enclosed, enclosed_means, enclosed_scales
from .opposite_task import other_controllers, wrong_opposite
from .readings import Reading, reading_of
from .regrown_tree import BrokenTreeError, regrow, tree_start_value, vertices_of
from .relation_check import MOST_TERMS, verify_relation
from .team_check import wrong_team

__all__ = [
    "BrokenTreeError",
    "by_cell",
    "cell_boxes",
    "check",
    "CheckReport",
    "claimed_values",
    "Enclosed",
    "enclosed_means",
    "enclosed_scales",
    "execution_of",
    "Greedy",
    "greedy_disturbance",
    "is_safety",
    "masks_of",
    "MOST_TERMS",
    "other_controllers",
    "places_of",
    "Reading",
    "reading_of",
    "regrow",
    "safety_rate",
    "SafetyRate",
    "SHORTEST",
    "standing",
    "tree_start_value",
    "value_in_time",
    "ValueInTime",
    "verify_relation",
    "vertices_of",
    "wrong_base",
    "wrong_opposite",
    "wrong_team",
]
