"""Reproducible rollouts of the continuous system, on one core or many machines."""

from .chunks import ChunkResult, Frame, chunks_of, frames, paths
from .cluster import DaskExecutor, executor_for, processes
from .loop import CHUNK, Batchable, BatchPolicy, Loop
from .mismatch import FAMILIES, Mismatch
from .report_text import INTERRUPTED, LABEL_WIDTH, Rows, Saved, html_table, labelled_lines
from .rollouts import Rollouts, rollout, stream
from .spread import Executor, in_order
from .task_paths import task_tracks
from .trials import Plan, TrialOptions, TrialPlan, collect, planned

__all__ = [
    "BatchPolicy",
    "Batchable",
    "CHUNK",
    "ChunkResult",
    "DaskExecutor",
    "Executor",
    "FAMILIES",
    "Frame",
    "INTERRUPTED",
    "LABEL_WIDTH",
    "Loop",
    "Mismatch",
    "Plan",
    "Rollouts",
    "Rows",
    "Saved",
    "TrialOptions",
    "TrialPlan",
    "chunks_of",
    "collect",
    "executor_for",
    "frames",
    "html_table",
    "in_order",
    "labelled_lines",
    "paths",
    "planned",
    "processes",
    "rollout",
    "stream",
    "task_tracks",
]
