"""Package delivery with less noise: `package_delivery_v0`, whose page describes it, with the variance .01.

**Arguments**: `horizon` (20).

**Versions**: v0, first.
"""

from __future__ import annotations

from .package_delivery_v0 import make
from .problem import Problem
from .suite import environments


def problem(horizon: int = 20) -> Problem:
    """Return the eased package delivery."""
    return make("package-delivery-eased-v0", horizon, variance=0.01)


parallel_env, env, raw_env = environments("package-delivery-eased-v0")
