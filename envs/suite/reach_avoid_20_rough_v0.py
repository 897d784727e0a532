"""Reach-avoid of twenty on rough ground: `reach-avoid-20-v0` with noise of 1.3 times the standard deviation.

**Versions**: v0: the first version.
"""

from __future__ import annotations

from ..problem import Problem
from . import reach_avoid_20_v0
from .make import environments


def problem(horizon: int = 6) -> Problem:
    """Return the rough problem of twenty agents."""
    return reach_avoid_20_v0.problem(horizon).replace(disturbance_scale=1.3, name="reach-avoid-20-rough-v0")


parallel_env, env, raw_env = environments("reach-avoid-20-rough-v0")
