"""The proof done again, by code that no search reaches."""

from .certificate_check import CheckReport, check
from .checked_first import standing
from .execution import execution_of
from .greedy import Greedy, greedy_disturbance
from .lasting_safety import SHORTEST, SafetyRate, is_safety, safety_rate
from .later_values import ValueInTime, claimed_values, value_in_time
from .linear_check import masks_of
from .mean_spans import enclosed_means, enclosed_scales
from .opposite_task import other_controllers, wrong_opposite
from .readings import Reading, reading_of
from .regrown_tree import BrokenTreeError, regrow, tree_start_value, vertices_of
from .relation_check import verify_relation
from .rigorous import RigorousReport, check_rigorous
from .team_check import wrong_team

__all__ = [
    "BrokenTreeError",
    "Reading",
    "CheckReport",
    "Greedy",
    "RigorousReport",
    "SHORTEST",
    "SafetyRate",
    "is_safety",
    "ValueInTime",
    "check",
    "check_rigorous",
    "claimed_values",
    "execution_of",
    "masks_of",
    "enclosed_means",
    "enclosed_scales",
    "greedy_disturbance",
    "reading_of",
    "regrow",
    "safety_rate",
    "standing",
    "tree_start_value",
    "value_in_time",
    "verify_relation",
    "vertices_of",
    "other_controllers",
    "wrong_opposite",
    "wrong_team",
]
