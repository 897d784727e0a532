"""Car slalom: a car with a steering wheel passes two obstacles on its way to a goal, one on each side.

Place, heading, speed and steering angle are five states, all of them noisy: no grid holds them. The inputs push the car
and turn its wheel.

**Versions**: v0: the first version.
"""

from __future__ import annotations

from ...systems.agents import Agent
from ...tasks.problem import Problem, Specification
from ...tasks.regions import Proposition


def problem(horizon: int = 48) -> Problem:
    """Return the car of the module docstring."""
    deviations = (0.01, 0.01, 0.005, 0.01, 0.005)
    car = Agent(
        name="car_0",
        states=["x", "y", "heading", "speed", "steering"],
        inputs=["push", "turn"],
        dynamics=[
            "x + 0.2*speed*cos(heading)",
            "y + 0.2*speed*sin(heading)",
            "heading + 0.4*speed*tan(steering)",
            "speed + 0.2*push",
            "steering + 0.2*turn",
        ],
        outputs=["x", "y"],
        noise=[{"law": "gaussian", "std": std} for std in deviations],
        state_low=[-1.0, -3.0, -3.0, -1.0, -0.7],
        state_high=[10.0, 3.0, 3.0, 2.5, 0.7],
        input_low=[-2.0, -2.0],
        input_high=[2.0, 2.0],
        initial_state=[0.0, 0.0, 0.0, 0.0, 0.0],
    )
    return Problem(
        name="car-slalom-v0",
        horizon=horizon,
        agents=[car],
        propositions={
            "goal": Proposition("car_0", [8.0, -1.0], [9.5, 1.0]),
            "first": Proposition("car_0", [2.0, -1.0], [3.0, 1.5]),
            "second": Proposition("car_0", [5.0, -1.5], [6.0, 1.0]),
        },
        specification=Specification("(!first & !second) U goal", "co-safe"),
    )
