"""Rollouts, and statistical tests of claims by them.

Monte Carlo rollouts of the continuous system, and statistical tests of certified claims.
"""

from .audit_report import AuditReport
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
from .chunks import ChunkResult, Frame, chunks_of, frames, paths
from .cluster import DaskExecutor, executor_for, processes
from .fields import FieldReport, find_weakest, validate_field
from .loop import CHUNK, Batchable, BatchPolicy, Loop
from .mismatch import FAMILIES, Mismatch
from .report_text import INTERRUPTED, LABEL_WIDTH, Rows, Saved, html_table, labelled_lines
from .rollouts import Rollouts, rollout, stream
from .sequential import SequentialState, confidence_sequence
from .spread import Executor, in_order
from .starts import corner_starts, random_starts, slice_axes, slice_starts, start_box, workspace_box
from .step_tests import audit
from .stress_test import LADDERS, StressReport, stress
from .success_rate import MEANINGS, NOT_CERTIFIED, ValidationReport, told_of, tried_lines, validate
from .sweeps import each_report, synthesize_best
from .task_paths import task_tracks
from .trials import Plan, TrialOptions, TrialPlan, collect, names_plan, planned
from .value_at import bound_by_steps_left, standing_cells

__all__ = [
    "AuditReport",
    "BatchPolicy",
    "Batchable",
    "CHUNK",
    "CONFIRMED",
    "CONSISTENT",
    "ChunkResult",
    "DaskExecutor",
    "Executor",
    "FAMILIES",
    "FieldReport",
    "Frame",
    "INTERRUPTED",
    "LABEL_WIDTH",
    "LADDERS",
    "Loop",
    "MEANINGS",
    "Mismatch",
    "NOT_CERTIFIED",
    "Plan",
    "REFUTED",
    "Rollouts",
    "Rows",
    "Saved",
    "SequentialState",
    "StressReport",
    "TrialOptions",
    "names_plan",
    "TrialPlan",
    "VACUOUS",
    "ValidationReport",
    "audit",
    "bound_by_steps_left",
    "check_confidence",
    "chunks_of",
    "clopper_pearson",
    "collect",
    "confidence_sequence",
    "corner_starts",
    "each_report",
    "executor_for",
    "find_weakest",
    "frames",
    "holm",
    "html_table",
    "in_order",
    "labelled_lines",
    "mean_limits",
    "p_at_least",
    "p_at_most",
    "paired_difference",
    "paths",
    "planned",
    "processes",
    "random_starts",
    "rollout",
    "slice_axes",
    "slice_starts",
    "standing_cells",
    "start_box",
    "stream",
    "stress",
    "synthesize_best",
    "task_tracks",
    "told_of",
    "tried_lines",
    "validate",
    "validate_field",
    "verdict",
    "workspace_box",
]
