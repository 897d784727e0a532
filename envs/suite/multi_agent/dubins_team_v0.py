"""Dubins cars: any number of cars that cannot stop stay on their field and off the pillar in its middle.

A car has a place and a heading, drives at constant speed and is steered by its turn alone. One car that leaves the
field or touches the pillar fails the whole team.

**Versions**: v0: the first version.
"""

from __future__ import annotations

from ...systems.agents import Agent
from ...systems.arguments import MOST_AGENTS, checked_count
from ...tasks.problem import Problem, Specification
from ...tasks.regions import Proposition


def problem(n_agents: int = 2, horizon: int = 10) -> Problem:
    """Return the team of the module docstring."""
    n_agents = checked_count(n_agents, "n_agents", most=MOST_AGENTS)
    cars = Agent(
        name="car",
        states=["x", "y", "heading"],
        inputs=["turn"],
        dynamics=["x + 0.8*cos(heading)", "y + 0.8*sin(heading)", "heading + turn"],
        noise=[{"law": "gaussian", "std": deviation} for deviation in (0.25, 0.25, 0.2)],
        state_low=[-5.0, -5.0, -4.0],
        state_high=[5.0, 5.0, 4.0],
        input_low=[-1.0],
        input_high=[1.0],
        initial_state=[-2.5, -2.0, 0.0],
    ).copies(n_agents)
    return Problem(
        name=f"dubins-team-{n_agents}-v0",
        horizon=horizon,
        agents=cars,
        propositions={
            "pillar": Proposition("car_*", [-0.5, -0.5, -4.0], [0.5, 0.5, 4.0]),
        },
        specification=Specification("G !any(pillar)", "finite-trace"),
    )
