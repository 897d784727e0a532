"""Invariance of 20 agents in the second setting: `invariance-v0` with `n_agents` = 20 and `setting` = "B".

**Versions**: v0: the first version.
"""

from __future__ import annotations

from ..problem import Problem
from . import invariance_v0
from .make import environments


def problem(horizon: int = 7) -> Problem:
    """Return the problem IV-20 (B)."""
    return invariance_v0.problem(n_agents=20, horizon=horizon, setting="B").replace(name="invariance-b-20-v0")


parallel_env, env, raw_env = environments("invariance-b-20-v0")
