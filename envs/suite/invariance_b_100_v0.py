"""Invariance of 100 agents in the second setting: `invariance-v0` with `n_agents` = 100 and `setting` = "B".

**Versions**: v0: the first version.
"""

from __future__ import annotations

from ..problem import Problem
from . import invariance_v0
from .make import environments


def problem(horizon: int = 7) -> Problem:
    """Return the problem IV-100 (B)."""
    return invariance_v0.problem(n_agents=100, horizon=horizon, setting="B").replace(name="invariance-b-100-v0")


parallel_env, env, raw_env = environments("invariance-b-100-v0")
