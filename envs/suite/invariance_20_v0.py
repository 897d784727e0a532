"""Invariance of 20 agents: `invariance-v0` with `n_agents` = 20.

**Versions**: v0: the first version.
"""

from __future__ import annotations

from ..problem import Problem
from . import invariance_v0
from .make import environments


def problem(horizon: int = 7, setting: str = "A") -> Problem:
    """Return the problem IV-20."""
    return invariance_v0.problem(n_agents=20, horizon=horizon, setting=setting)


parallel_env, env, raw_env = environments("invariance-20-v0")
