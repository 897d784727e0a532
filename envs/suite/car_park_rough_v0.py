"""Park a car on a rough line: `car-park-v0` with noise of 1.5 times the standard deviation.

**Versions**: v0: the first version.
"""

from __future__ import annotations

from ..problem import Problem
from . import car_park_v0
from .make import environments


def problem(horizon: int = 60) -> Problem:
    """Return the rough parking problem."""
    return car_park_v0.problem(horizon).replace(disturbance_scale=1.5, name="car-park-rough-v0")


parallel_env, env, raw_env = environments("car-park-rough-v0")
