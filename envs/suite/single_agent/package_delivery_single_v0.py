"""Package delivery by one robot: pick up in p1, deliver in p3, and do not pass p2 on the way (else pick up again).

A classic problem of the field for a single agent.

**Versions**: v0: the first version.
"""

from __future__ import annotations

from ...systems.agents import LinearAgent
from ...tasks.problem import Problem, Specification
from ...tasks.regions import Proposition


def problem(horizon: int = 60) -> Problem:
    """Return the single-robot package delivery of the literature."""
    robot = LinearAgent(
        name="robot_0",
        A=[[0.9, 0.0], [0.0, 0.9]],
        B=[[1.0, 0.0], [0.0, 1.0]],
        noise_covariance=[[0.2, 0.0], [0.0, 0.2]],
        state_low=[-6.0, -6.0],
        state_high=[6.0, 6.0],
        input_low=[-1.0, -1.0],
        input_high=[1.0, 1.0],
        initial_state=[-5.0, -5.0],
    )
    return Problem(
        name="package-delivery-single-v0",
        horizon=horizon,
        agents=[robot],
        propositions={
            "p1": Proposition("robot_0", [5.0, -1.0], [6.0, 1.0]),
            "p2": Proposition("robot_0", [0.0, -5.0], [1.0, 1.0]),
            "p3": Proposition("robot_0", [-4.0, -4.0], [-2.0, -3.0]),
        },
        specification=Specification("F(p1 & (!p2 U p3))", "co-safe"),
    )
