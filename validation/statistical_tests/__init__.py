"""Rollouts, and statistical tests of claims by them.

Monte Carlo rollouts of the continuous system, and statistical tests of certified claims.
"""

from .audit_report import AuditReport
from .binomial import (
    CONFIRMED,
    REFUTED,
    VACUOUS,
    clopper_pearson,
    holm,
    mean_limits,
    p_at_least,
    paired_difference,
    verdict,
)
from .chunks import chunks_of, frames, paths
from .cluster import DaskExecutor, executor_for, processes
from .fields import FieldReport, find_weakest, validate_field
from .loop import CHUNK, Batchable, BatchPolicy, Loop
from .mismatch import Mismatch
from .report_text import LABEL_WIDTH, Saved, html_table
from .rollouts import Rollouts, rollout
from .spread import Executor
from .starts import corner_starts, random_starts, slice_axes, slice_starts, start_box, workspace_box
from .step_tests import audit
from .stress_test import LADDERS, StressReport, stress
from .success_rate import MEANINGS, NOT_CERTIFIED, ValidationReport, told_of, tried_lines, validate
from .sweeps import each_report
from .task_paths import task_tracks
from .trials import Plan, TrialOptions, TrialPlan, names_plan, planned
from .value_at import bound_by_steps_left

__all__ = [
    "AuditReport",
    "BatchPolicy",
    "Batchable",
    "CHUNK",
    "CONFIRMED",
    "DaskExecutor",
    "Executor",
    "FieldReport",
    "LABEL_WIDTH",
    "LADDERS",
    "Loop",
    "MEANINGS",
    "Mismatch",
    "NOT_CERTIFIED",
    "Plan",
    "REFUTED",
    "Rollouts",
    "Saved",
    "StressReport",
    "TrialOptions",
    "names_plan",
    "TrialPlan",
    "VACUOUS",
    "ValidationReport",
    "audit",
    "bound_by_steps_left",
    "chunks_of",
    "clopper_pearson",
    "corner_starts",
    "each_report",
    "executor_for",
    "find_weakest",
    "frames",
    "holm",
    "html_table",
    "mean_limits",
    "p_at_least",
    "paired_difference",
    "paths",
    "planned",
    "processes",
    "random_starts",
    "rollout",
    "slice_axes",
    "slice_starts",
    "start_box",
    "stress",
    "task_tracks",
    "told_of",
    "tried_lines",
    "validate",
    "validate_field",
    "verdict",
    "workspace_box",
]
