"""Needle: one robot passes three narrow gates, up and down, against noise that is wide beside them.

A gate is 1.8 wide and the noise of a step has a standard deviation of 0.25, so the robot has to be centred before each
gate, in few steps, and the next gate is four units aside. To touch a wall is the end.

**Versions**: v0: the first version.
"""

from __future__ import annotations

from ...systems.agents import LinearAgent
from ...tasks.problem import Problem, Specification
from ...tasks.regions import Proposition

GATES = ((-5.0, 2.0), (0.0, -2.0), (5.0, 2.0))
"""Middles of the gates; walls are 1 thick."""

HALF = 0.9
"""Half of a gate's width."""


def problem(horizon: int = 20) -> Problem:
    """Return the passage of the module docstring."""
    robot = LinearAgent(
        name="robot_0",
        A=[[1.0, 0.0], [0.0, 1.0]],
        B=[[1.0, 0.0], [0.0, 1.0]],
        noise_covariance=[[0.0625, 0.0], [0.0, 0.0625]],
        state_low=[-10.0, -6.0],
        state_high=[10.0, 6.0],
        input_low=[-1.5, -1.5],
        input_high=[1.5, 1.5],
        initial_state=[-8.5, 0.0],
    )
    walls = {}
    for k, (x, y) in enumerate(GATES):
        walls[f"below_{k}"] = Proposition("robot_0", [x - 0.5, -6.0], [x + 0.5, y - HALF])
        walls[f"above_{k}"] = Proposition("robot_0", [x - 0.5, y + HALF], [x + 0.5, 6.0])
    off = " & ".join(f"!{wall}" for wall in walls)
    return Problem(
        name="needle-v0",
        horizon=horizon,
        agents=[robot],
        propositions={**walls, "goal": Proposition("robot_0", [7.5, -1.0], [9.5, 1.0])},
        specification=Specification(f"({off}) U goal", "co-safe"),
    )
