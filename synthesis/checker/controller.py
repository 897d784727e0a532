"""The controller that a certificate along a trajectory is about: ``u_t = clip(ubar_t + K_t (x - xbar_t))``.

The claim holds for *every* controller whose inputs differ from this law, computed in real numbers and clipped to the
input box, by at most ``rounding``: in whatever order it adds, on whatever device that computes in double precision.
"""

from __future__ import annotations

import numpy as np

from .problem import Agent
from .rigorous import Array, U
from .trajectories import Trajectory


def law(agent: Agent, own: Trajectory, t: int, x: Array) -> Array:
    """Return inputs (m,) of an agent at a time t < S, from its state (d,)."""
    u = own.inputs[t] + own.gains[t] @ (x - own.states[t])
    return np.clip(u, agent.input_box[0], agent.input_box[1])


def rounding(own: Trajectory, t: int, x: Array) -> Array:
    """Return by how much inputs (m,) may differ from the law in real numbers: what the check charges at least."""
    d = own.gains.shape[2]
    size = np.abs(own.inputs[t]) + np.abs(own.gains[t]) @ (np.abs(x - own.states[t]) + U * np.abs(own.states[t]))
    return np.asarray(2.0 * (d + 3.0) * U * size)
