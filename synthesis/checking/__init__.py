"""The proof done again, by code that no search reaches."""

from .certificate_check import CheckReport, check
from .greedy import Greedy, greedy_disturbance
from .later_values import ValueInTime, claimed_values, value_in_time
from .regrown_tree import regrow
from .rigorous import RigorousReport, check_rigorous

__all__ = [
    "CheckReport",
    "Greedy",
    "RigorousReport",
    "ValueInTime",
    "check",
    "check_rigorous",
    "claimed_values",
    "greedy_disturbance",
    "regrow",
    "value_in_time",
]
