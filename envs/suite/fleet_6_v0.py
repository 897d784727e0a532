"""Fleet of six: `fleet-v0` with `n_agents` = 6.

**Versions**: v0: the first version.
"""

from __future__ import annotations

from ..problem import Problem
from . import fleet_v0
from .make import environments


def problem(horizon: int = 30) -> Problem:
    """Return the fleet of six vehicles."""
    return fleet_v0.problem(n_agents=6, horizon=horizon)


parallel_env, env, raw_env = environments("fleet-6-v0")
