"""Reach-avoid of two agents with position and velocity (RA4): the task of `reach-avoid-v0` on positions.

An input acts on the velocity, and one step later on the position. The input matrix has more rows than columns, so no
input can put the mean of the next state at an arbitrary point. Both components carry noise.

**Versions**: v0: the first version.
"""

from __future__ import annotations

from ...systems.agents import LinearAgent
from ...tasks.problem import Problem, Specification
from ...tasks.regions import Proposition


def problem(horizon: int = 12) -> Problem:
    """Return the problem RA4 of the module docstring."""
    first, second = LinearAgent(
        name="agent",
        A=[[1.0, 0.5], [0.0, 1.0]],
        B=[[0.0], [0.5]],
        noise_covariance=[[0.25, 0.0], [0.0, 0.25]],
        state_low=[-20.0, -5.0],
        state_high=[5.0, 5.0],
        input_low=[-2.0],
        input_high=[2.0],
    ).copies(2)
    return Problem(
        name="reach-avoid-kinematic-v0",
        horizon=horizon,
        agents=[first.replace(initial_state=[-10.0, 0.0]), second.replace(initial_state=[-4.0, 0.0])],
        propositions={
            "p1": Proposition("agent_0", [0.0, -5.0], [5.0, 5.0]),
            "p2": Proposition("agent_0", [-5.0, -5.0], [0.0, 5.0]),
            "p3": Proposition("agent_1", [-20.0, -5.0], [-15.0, 5.0]),
        },
        specification=Specification("(!p2 | !p3) U p1", "co-safe"),
    )
