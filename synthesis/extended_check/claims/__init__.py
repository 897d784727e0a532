"""The proof done again: cells, guards, trees, teams, and the claim."""

from .certificate_check import check
from .checked_first import checked_once, claim_text, standing
from .greedy import Greedy, greedy_disturbance
from .lasting_safety import SHORTEST, SafetyRate, is_safety, safety_rate
from .later_values import ValueInTime, claimed_values, value_in_time
from .opposite_task import other_controllers, wrong_opposite
from .regrown_tree import BrokenTreeError, regrow, tree_start_value, vertices_of
from .timed_check import wrong_in_time

__all__ = [
    "BrokenTreeError",
    "check",
    "checked_once",
    "claim_text",
    "claimed_values",
    "Greedy",
    "greedy_disturbance",
    "is_safety",
    "other_controllers",
    "regrow",
    "safety_rate",
    "SafetyRate",
    "SHORTEST",
    "standing",
    "tree_start_value",
    "value_in_time",
    "ValueInTime",
    "vertices_of",
    "wrong_in_time",
    "wrong_opposite",
]
