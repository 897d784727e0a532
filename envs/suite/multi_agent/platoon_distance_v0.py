"""Platoon with distances: any number of vehicles keep their places in a line, and none comes near the one ahead.

The state of a vehicle is its distance from its place in the line; places are 4 apart. The cruise control pulls each
vehicle towards its place, and the input adds to that. At the start all vehicles are out of place, every other one
forwards and the others backwards. Neighbours are near each other if less than 2 is left between them.

**Versions**: v0: the first version.
"""

from __future__ import annotations

from ...systems.agents import LinearAgent
from ...systems.arguments import MOST_AGENTS, checked_count
from ...tasks.problem import Problem, Specification
from ...tasks.regions import Pair, Proposition

SPACING, LEAST = 4.0, 2.0
"""Distance of two places, and the distance below which neighbours are near each other."""

_BEYOND = 20.0
"""More than any vehicle can be behind the one ahead: the box of ``near`` has no other end."""


def problem(n_agents: int = 4, horizon: int = 10) -> Problem:
    """Return the platoon of the module docstring."""
    n_agents = checked_count(n_agents, "n_agents", least=2, most=MOST_AGENTS)
    return Problem(
        name=f"platoon-distance-{n_agents}-v0",
        horizon=horizon,
        agents=[_vehicle(i) for i in range(n_agents)],
        propositions={
            "placed": Proposition("vehicle_*", [-2.0], [2.0]),
            # The vehicle ahead drops back against the one behind by more than there is room for.
            "near": Pair("vehicle_*", [-_BEYOND], [LEAST - SPACING], pairs="neighbours"),
        },
        specification=Specification("G (all(placed) & !any(near))", "finite-trace"),
    )


def _vehicle(i: int) -> LinearAgent:
    """Return vehicle i, counted from the first one."""
    return LinearAgent(
        name=f"vehicle_{i}",
        A=[[0.9]],
        B=[[1.0]],
        noise_covariance=[[0.09]],
        state_low=[-3.0],
        state_high=[3.0],
        input_low=[-1.5],
        input_high=[1.5],
        initial_state=[-1.0 if i % 2 == 0 else 1.0],
    )
