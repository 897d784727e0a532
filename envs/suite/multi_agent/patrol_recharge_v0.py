"""Patrol with recharging: two robots guard a post so that it is never empty, and recharge in time, again and again.

The docks are one step away from the post, on opposite sides of it. A robot that was away from its dock for five steps
in a row has run dry. While one robot charges, the other must stand guard, so they relieve each other in a rhythm that
they agree on beforehand. At the start, both robots are at the post with full batteries.

**Versions**: v0: the first version.
"""

from __future__ import annotations

from ...systems.agents import LinearAgent
from ...tasks.problem import Problem, Specification
from ...tasks.regions import Proposition

_ENDURANCE = 5  # steps in a row away from the dock that drain a battery


def _dry(dock: str) -> str:
    """Return `!dock & X (!dock & X (...))`: as many steps without the dock as the battery lasts, from now on."""
    formula = f"!{dock}"
    for _ in range(_ENDURANCE - 1):
        formula = f"!{dock} & X ({formula})"
    return f"({formula})"


def problem(horizon: int = 16) -> Problem:
    """Return the patrol of the module docstring."""
    robots = LinearAgent(
        name="robot",
        A=[[1.0]],
        B=[[1.0]],
        noise_covariance=[[0.1]],
        state_low=[-8.0],
        state_high=[8.0],
        input_low=[-4.0],
        input_high=[4.0],
    ).copies(2)
    return Problem(
        name="patrol-recharge-v0",
        horizon=horizon,
        agents=[robot.replace(initial_state=[0.0]) for robot in robots],
        propositions={
            "post": Proposition("robot_*", [-1.0], [1.0]),
            "dock_0": Proposition("robot_0", [-6.0], [-3.0]),
            "dock_1": Proposition("robot_1", [3.0], [6.0]),
        },
        specification=Specification(f"G (any(post) & !{_dry('dock_0')} & !{_dry('dock_1')})", "finite-trace"),
    )
