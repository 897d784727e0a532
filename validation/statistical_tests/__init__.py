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
from .odds_scale import OddsScale
from .report_text import LABEL_WIDTH, Saved, html_table
from .rollouts import Rollouts, rollout
from .starts import corner_starts, random_starts, slice_axes, slice_starts, start_box, workspace_box
from .step_tests import audit
from .stress_test import LADDERS, StressReport, stress
from .success_rate import MEANINGS, NOT_CERTIFIED, ValidationReport, told_of, tried_lines, validate
from .sweeps import CHANGES, SweepRow, checked_changes, each_report, sweep
from .task_paths import task_tracks
from .trials import Plan, TrialOptions, TrialPlan, names_plan, planned
from .value_at import bound_by_steps_left
