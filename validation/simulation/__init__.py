"""Reproducible rollouts of the continuous system, on one core or many machines."""

from .chunks import Frame, chunks_of, frames, paths
from .cluster import DaskExecutor, executor_for
from .loop import CHUNK, Batchable, BatchPolicy, Loop, arranged
from .mismatch import FAMILIES, Mismatch
from .rollouts import Rollouts, rollout, stream
from .spread import Executor, in_order, interrupts_at_checkpoints

__all__ = [
    "BatchPolicy",
    "Batchable",
    "CHUNK",
    "DaskExecutor",
    "Executor",
    "FAMILIES",
    "Frame",
    "Loop",
    "Mismatch",
    "Rollouts",
    "arranged",
    "chunks_of",
    "executor_for",
    "frames",
    "in_order",
    "interrupts_at_checkpoints",
    "paths",
    "rollout",
    "stream",
]
