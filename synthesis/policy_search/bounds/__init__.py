"""Certified numbers from computed values.

From computed values to certified numbers, from below and from above.
"""

from .above import evaluate_above
from .certified import (
    Bound,
    a_posteriori_bound,
    deadlocked_mass,
    nominal_bound,
    plain_loss,
    relative_rounding,
    robust_bound,
    robust_loss,
    rounding_loss,
    train_bound,
    undecided_steps,
)
from .continuous import continuous_upper_bound
from .optimum import abstract_bound
