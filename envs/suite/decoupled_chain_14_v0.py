"""Autonomous decoupled chain of 14 agents: `decoupled-chain-v0` with `n_agents` = 14.

**Versions**: v0: the first version.
"""

from __future__ import annotations

from ..problem import Problem
from . import decoupled_chain_v0
from .make import environments


def problem(horizon: int = 6) -> Problem:
    """Return the chain of 14 agents."""
    return decoupled_chain_v0.problem(n_agents=14, horizon=horizon)


parallel_env, env, raw_env = environments("decoupled-chain-14-v0")
