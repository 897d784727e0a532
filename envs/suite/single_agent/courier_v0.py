"""Courier: one robot visits four customers in an order that it chooses, keeps off a pond, and is home at the end.

A customer who has been visited counts for good, so the mission has sixteen stages, and at every step the robot has to
know who is left and whom to go to first. A robot that touches the pond beside home has failed, however late.

**Versions**: v0: the first version.
"""

from __future__ import annotations

from ...systems.agents import LinearAgent
from ...tasks.problem import Problem, Specification
from ...tasks.regions import Proposition

CUSTOMERS = {"bakery": (-3.5, 2.5), "school": (4.0, 3.0), "tower": (3.0, -2.5), "farm": (-3.0, -3.0)}
"""Middles of the customers' squares, whose sides are 1.6."""


def problem(horizon: int = 30) -> Problem:
    """Return the errands of the module docstring."""
    robot = LinearAgent(
        name="robot_0",
        A=[[1.0, 0.0], [0.0, 1.0]],
        B=[[1.0, 0.0], [0.0, 1.0]],
        noise_covariance=[[0.0625, 0.0], [0.0, 0.0625]],
        state_low=[-6.0, -5.0],
        state_high=[6.0, 5.0],
        input_low=[-1.0, -1.0],
        input_high=[1.0, 1.0],
        initial_state=[0.0, 0.0],
    )
    squares = {
        name: Proposition("robot_0", [x - 0.8, y - 0.8], [x + 0.8, y + 0.8]) for name, (x, y) in CUSTOMERS.items()
    }
    visits = " & ".join(f"F {name}" for name in CUSTOMERS)
    return Problem(
        name="courier-v0",
        horizon=horizon,
        agents=[robot],
        propositions={
            **squares,
            "home": Proposition("robot_0", [-1.0, -1.0], [1.0, 1.0]),
            "pond": Proposition("robot_0", [1.4, -1.2], [2.4, 1.6]),
        },
        specification=Specification(f"G !pond & {visits} & F G home", "finite-trace"),
    )
