"""Invariance of 50 agents in the tighter setting: `invariance-v0` with `n_agents` = 50 and `setting` = "B".

**Versions**: v0: the first version.
"""

from __future__ import annotations

from ..problem import Problem
from . import invariance_v0
from .make import environments


def problem(horizon: int = 7) -> Problem:
    """Return the problem IV-50 (B)."""
    return invariance_v0.problem(n_agents=50, horizon=horizon, setting="B").replace(name="invariance-b-50-v0")


parallel_env, env, raw_env = environments("invariance-b-50-v0")
