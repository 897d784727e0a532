"""Van der Pol: an oscillator with a weak input finds its way into a box off its limit cycle.

A classic nonlinear problem of the field, with one agent. The input moves the second state alone.

**Versions**: v0: the first version.
"""

from __future__ import annotations

from ...systems.agents import Agent
from ...tasks.problem import Problem, Specification
from ...tasks.regions import Proposition


def problem(horizon: int = 40) -> Problem:
    """Return the controlled Van der Pol oscillator of the literature."""
    oscillator = Agent(
        name="oscillator_0",
        states=["x", "y"],
        inputs=["u"],
        dynamics=["x + 0.1*y", "y + 0.1*(-x + (1 - x**2)*y) + u"],
        noise_covariance=[[0.2, 0.0], [0.0, 0.2]],
        state_low=[-3.0, -3.0],
        state_high=[3.0, 3.0],
        input_low=[-1.0],
        input_high=[1.0],
        initial_state=[-1.0, 1.0],
    )
    return Problem(
        name="van-der-pol-v0",
        horizon=horizon,
        agents=[oscillator],
        propositions={"goal": Proposition("oscillator_0", [-1.4, -2.9], [-0.7, -2.0])},
        specification=Specification("F goal", "co-safe"),
    )
