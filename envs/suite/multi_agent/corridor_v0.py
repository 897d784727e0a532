"""Corridor: two robots change rooms through a corridor that is too narrow for both, so one of them has to wait.

Walls above and below leave a corridor of width 2, and the robots must never come nearer than 1.5 to each other. Each
robot sees only itself: who waits, where and for how long is agreed beforehand.

**Versions**: v0: the first version.
"""

from __future__ import annotations

from ...systems.agents import LinearAgent
from ...tasks.problem import Problem, Specification
from ...tasks.regions import Pair, Proposition


def problem(horizon: int = 24) -> Problem:
    """Return the corridor of the module docstring."""
    first, second = LinearAgent(
        name="robot",
        A=[[1.0, 0.0], [0.0, 1.0]],
        B=[[1.0, 0.0], [0.0, 1.0]],
        noise_covariance=[[0.0225, 0.0], [0.0, 0.0225]],
        state_low=[-8.0, -4.0],
        state_high=[8.0, 4.0],
        input_low=[-1.0, -1.0],
        input_high=[1.0, 1.0],
    ).copies(2)
    return Problem(
        name="corridor-v0",
        horizon=horizon,
        agents=[first.replace(initial_state=[-5.0, 0.0]), second.replace(initial_state=[5.0, 0.0])],
        propositions={
            "upper": Proposition("robot_*", [-2.0, 1.0], [2.0, 4.0]),
            "lower": Proposition("robot_*", [-2.0, -4.0], [2.0, -1.0]),
            "right": Proposition("robot_0", [4.0, -4.0], [8.0, 4.0]),
            "left": Proposition("robot_1", [-8.0, -4.0], [-4.0, 4.0]),
            "near": Pair("robot_*", [-1.5, -1.5], [1.5, 1.5]),
        },
        specification=Specification("G (!any(near) & !any(upper) & !any(lower)) & F G (right & left)", "finite-trace"),
    )
