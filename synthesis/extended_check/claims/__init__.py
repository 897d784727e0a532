"""Guards, trees, teams and the claim, proved again.

The proof done again: cells, guards, trees, teams, and the claim.
"""

from .certificate_check import check
from .checked_first import checked_once, claim_text, standing
from .complement_task import wrong_complement
from .greedy import greedy_disturbance
from .grid_values import VertexValues
from .invariance_rate import SHORTEST, is_safety, safety_rate
from .regrown_tree import regrow, vertices_of
from .timed_check import wrong_in_time
from .values_in_time import ValueInTime, VertexValueInTime, claimed_values, value_in_time
