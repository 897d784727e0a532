"""Park a car in the plane: reach the lower bay on the right edge, and never touch the upper one.

A classic problem of the field for a single agent.

**Versions**: v0: the first version.
"""

from __future__ import annotations

from ...systems.agents import LinearAgent
from ...tasks.problem import Problem, Specification
from ...tasks.regions import Proposition


def problem(horizon: int = 60) -> Problem:
    """Return the problem CarPark2 of the literature."""
    car = LinearAgent(
        name="car_0",
        A=[[0.9, 0.0], [0.0, 0.9]],
        B=[[0.7, 0.0], [0.0, 0.7]],
        noise_covariance=[[1.0, 0.0], [0.0, 1.0]],
        state_low=[-10.0, -10.0],
        state_high=[10.0, 10.0],
        input_low=[-1.0, -1.0],
        input_high=[1.0, 1.0],
        initial_state=[-4.0, -5.0],
    )
    return Problem(
        name="car-park-planar-v0",
        horizon=horizon,
        agents=[car],
        propositions={
            "p1": Proposition("car_0", [4.0, -4.0], [10.0, 0.0]),
            "p2": Proposition("car_0", [4.0, 0.0], [10.0, 4.0]),
        },
        specification=Specification("!p2 U p1", "co-safe"),
    )
