"""Package delivery by robots with velocities (PD-kin): the task of `package-delivery-v0` on positions.

Every coordinate has a position and a velocity, and the input is an acceleration. The noise is that of the eased
variant. The horizon is longer, because robots with a velocity need time to stop.

**Versions**: v0: the first version.
"""

from __future__ import annotations

from ...systems.agents import LinearAgent
from ...tasks.problem import Problem
from .package_delivery_v0 import delivery


def problem(horizon: int = 40) -> Problem:
    """Return the kinematic package delivery."""
    agent = LinearAgent(
        name="robot",
        A=[[1.0, 0.5], [0.0, 1.0]],
        B=[[0.0], [0.5]],
        noise_covariance=[[0.01, 0.0], [0.0, 0.01]],
        state_low=[-20.0, -5.0],
        state_high=[5.0, 5.0],
        input_low=[-2.0],
        input_high=[2.0],
    )
    return delivery("package-delivery-kinematic-v0", horizon, agent)
