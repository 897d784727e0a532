"""Rendezvous of four: `rendezvous-v0` with `n_followers` = 3.

**Versions**: v0: the first version.
"""

from __future__ import annotations

from ..problem import Problem
from . import rendezvous_v0
from .make import environments


def problem(horizon: int = 20) -> Problem:
    """Return the rendezvous of a leader and three followers."""
    return rendezvous_v0.problem(n_followers=3, horizon=horizon)


parallel_env, env, raw_env = environments("rendezvous-3-v0")
