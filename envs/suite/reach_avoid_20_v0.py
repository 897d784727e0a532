"""Reach-avoid of 20 agents: `reach-avoid-n-v0` with `n_agents` = 20.

**Versions**: v0: the first version.
"""

from __future__ import annotations

from ..problem import Problem
from . import reach_avoid_n_v0
from .make import environments


def problem(horizon: int = 6) -> Problem:
    """Return the problem RA-20."""
    return reach_avoid_n_v0.problem(n_agents=20, horizon=horizon)


parallel_env, env, raw_env = environments("reach-avoid-20-v0")
