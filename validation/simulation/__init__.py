"""Reproducible rollouts of the continuous system, on one core or many machines."""

from .chunks import ChunkResult, Frame, chunks_of, frames, paths
from .cluster import DaskExecutor, executor_for
from .loop import Batchable, BatchPolicy, Loop
from .mismatch import FAMILIES, Mismatch
from .rollouts import Rollouts, rollout, stream
from .spread import Executor, in_order
from .trials import Plan, TrialOptions, TrialPlan, collect, planned

__all__ = [
    "BatchPolicy",
    "Batchable",
    "ChunkResult",
    "DaskExecutor",
    "Executor",
    "FAMILIES",
    "Frame",
    "Loop",
    "Mismatch",
    "Plan",
    "Rollouts",
    "TrialOptions",
    "TrialPlan",
    "chunks_of",
    "collect",
    "executor_for",
    "frames",
    "in_order",
    "paths",
    "planned",
    "rollout",
    "stream",
]
