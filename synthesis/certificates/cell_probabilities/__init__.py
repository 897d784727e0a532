"""An agent's record, and its cell probabilities.

What a certificate holds of each agent, and its cell probabilities once more, for checks.
"""

from .agent_record import AgentRecord
from .checked_kernel import axis_tables, backup, kernel_key, lost_to_rounding
from .checked_laws import law_charge, law_error, law_height, probability_below, scale_charge
from .hat_tables import UNIT, applied, normal_hats
from .regrown_trains import BrokenTrainError, regrow_trains
from .stated import Statement, noted, state
