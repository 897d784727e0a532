"""Patrol robot: a robot steered by speed and course looks at two places, one after the other, and comes home.

Its inputs are polar: where it goes is the speed times the direction of the course, so means are not linear in them. It
must not touch the pillar between the places.

**Versions**: v0: the first version.
"""

from __future__ import annotations

from ...systems.agents import Agent
from ...tasks.problem import Problem, Specification
from ...tasks.regions import Proposition


def problem(horizon: int = 16) -> Problem:
    """Return the patrol of the module docstring."""
    robot = Agent(
        name="robot_0",
        states=["x", "y"],
        inputs=["speed", "course"],
        dynamics=["x + 2*speed*cos(course)", "y + 2*speed*sin(course)"],
        noise=[{"law": "gaussian", "std": 0.4}, {"law": "gaussian", "std": 0.4}],
        state_low=[-6.0, -6.0],
        state_high=[6.0, 6.0],
        input_low=[0.0, -3.1415926],
        input_high=[1.0, 3.1415926],
        initial_state=[0.0, -4.0],
    )
    return Problem(
        name="patrol-robot-v0",
        horizon=horizon,
        agents=[robot],
        propositions={
            "pillar": Proposition("robot_0", [-1.0, -1.0], [1.0, 1.0]),
            "west": Proposition("robot_0", [-5.0, 1.0], [-2.0, 5.0]),
            "east": Proposition("robot_0", [2.0, 1.0], [5.0, 5.0]),
            "home": Proposition("robot_0", [-2.0, -5.0], [2.0, -2.0]),
        },
        specification=Specification("!pillar U (west & (!pillar U (east & (!pillar U home))))", "co-safe"),
    )
