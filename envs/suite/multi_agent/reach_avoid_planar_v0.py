"""Reach-avoid in the plane: two agents on spiralling dynamics reach their goals at the same time, around obstacles.

The dynamics turn the state a little in every step, so even standing still takes input. p1 and p2 are the goal and the
obstacle of agent_0, p3 and p4 those of agent_1. Each agent has to avoid its obstacle only, not that of the other.

**Versions**: v0: the first version.
"""

from __future__ import annotations

from ...systems.agents import LinearAgent
from ...tasks.problem import Problem, Specification
from ...tasks.regions import Proposition


def problem(horizon: int = 11) -> Problem:
    """Return the problem of the module docstring."""
    first, second = LinearAgent(
        name="agent",
        A=[[0.95, 0.1], [-0.1, 0.95]],
        B=[[0.5, 0.0], [0.0, 0.5]],
        noise_covariance=[[0.25, 0.0], [0.0, 0.25]],
        state_low=[-10.0, -10.0],
        state_high=[10.0, 10.0],
        input_low=[-2.0, -2.0],
        input_high=[2.0, 2.0],
    ).copies(2)
    return Problem(
        name="reach-avoid-planar-v0",
        horizon=horizon,
        agents=[first.replace(initial_state=[-4.0, -4.0]), second.replace(initial_state=[4.0, 5.0])],
        propositions={
            "p1": Proposition("agent_0", [3.0, 3.0], [5.0, 5.0]),
            "p2": Proposition("agent_0", [-2.0, -2.0], [2.0, 2.0]),
            "p3": Proposition("agent_1", [-5.0, -5.0], [-3.0, -3.0]),
            "p4": Proposition("agent_1", [0.0, 5.0], [2.0, 7.0]),
        },
        specification=Specification("(!p2 & !p4) U (p1 & p3)", "co-safe"),
    )
