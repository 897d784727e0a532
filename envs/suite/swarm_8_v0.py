"""Swarm of eight: `swarm-v0` with `n_agents` = 8.

**Versions**: v0: the first version.
"""

from __future__ import annotations

from ..problem import Problem
from . import swarm_v0
from .make import environments


def problem(horizon: int = 15) -> Problem:
    """Return the swarm of eight robots."""
    return swarm_v0.problem(n_agents=8, horizon=horizon)


parallel_env, env, raw_env = environments("swarm-8-v0")
