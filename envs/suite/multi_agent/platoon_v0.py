"""Platoon: any number of vehicles keep their places in a line while each is pulled by the one ahead.

States are a vehicle's distance from its place in the line, and its speed against that of the line. The cruise control
of each vehicle pulls it towards the one ahead; the input adds to that. A vehicle is told the state of the one ahead.
At the start, the first vehicle is out of place.

**Versions**: v0: the first version.
"""

from __future__ import annotations

from ...systems.agents import Agent
from ...systems.arguments import MOST_AGENTS, checked_count
from ...tasks.problem import Problem, Specification
from ...tasks.regions import Proposition


def problem(n_agents: int = 3, horizon: int = 10) -> Problem:
    """Return the platoon of the module docstring."""
    n_agents = checked_count(n_agents, "n_agents", most=MOST_AGENTS)
    return Problem(
        name=f"platoon-{n_agents}-v0",
        horizon=horizon,
        agents=[_vehicle(i) for i in range(n_agents)],
        propositions={"placed": Proposition("vehicle_*", [-2.0, -2.0], [2.0, 2.0])},
        specification=Specification("G all(placed)", "finite-trace"),
    )


def _vehicle(i: int) -> Agent:
    """Return vehicle i; all but the first are pulled by the one ahead."""
    ahead = f"vehicle_{i - 1}"
    pull = f" + 0.1*({ahead}.place - place) + 0.1*({ahead}.speed - speed)" if i else ""
    told = {"communicated": [ahead]} if i else {}
    return Agent(
        name=f"vehicle_{i}",
        states=["place", "speed"],
        inputs=["force"],
        dynamics=["place + 0.5*speed", f"speed{pull} + force"],
        noise=[{"law": "gaussian", "std": 0.1}, {"law": "gaussian", "std": 0.2}],
        state_low=[-3.0, -2.0],
        state_high=[3.0, 2.0],
        input_low=[-2.0],
        input_high=[2.0],
        initial_state=[0.0 if i else 1.0, 0.0],
        **told,
    )
