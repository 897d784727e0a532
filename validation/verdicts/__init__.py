"""Tests of claims by rollouts: at a start, over fields of starts, under mismatch, over horizons."""

from .fields import FieldReport, find_weakest, validate_field
from .starts import corner_starts, random_starts, slice_axes, slice_starts, start_box, workspace_box
from .stress_test import LADDERS, StressReport, stress
from .success_rate import MEANINGS, NOT_CERTIFIED, ValidationReport, told_of, tried_lines, validate
from .sweeps import each_report, synthesize_best

__all__ = [
    "MEANINGS",
    "NOT_CERTIFIED",
    "FieldReport",
    "LADDERS",
    "StressReport",
    "ValidationReport",
    "corner_starts",
    "each_report",
    "find_weakest",
    "random_starts",
    "slice_axes",
    "slice_starts",
    "start_box",
    "stress",
    "synthesize_best",
    "told_of",
    "tried_lines",
    "validate",
    "validate_field",
    "workspace_box",
]
