"""Exact limits and e-processes for success rates. Imports nothing of ours."""

from .binomial import (
    CONFIRMED,
    CONSISTENT,
    REFUTED,
    VACUOUS,
    check_confidence,
    clopper_pearson,
    holm,
    mean_limits,
    p_at_least,
    p_at_most,
    paired_difference,
    verdict,
)
from .sequential import SequentialState, confidence_sequence

__all__ = [
    "CONFIRMED",
    "CONSISTENT",
    "REFUTED",
    "VACUOUS",
    "SequentialState",
    "check_confidence",
    "clopper_pearson",
    "confidence_sequence",
    "holm",
    "mean_limits",
    "p_at_least",
    "p_at_most",
    "paired_difference",
    "verdict",
]
