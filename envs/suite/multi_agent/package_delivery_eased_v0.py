"""Package delivery with less noise: `package-delivery-v0` with the variance .01.

**Versions**: v0: the first version.
"""

from __future__ import annotations

from ...tasks.problem import Problem
from .package_delivery_v0 import coordinate, delivery


def problem(horizon: int = 20) -> Problem:
    """Return the eased package delivery."""
    return delivery("package-delivery-eased-v0", horizon, coordinate(variance=0.01))
