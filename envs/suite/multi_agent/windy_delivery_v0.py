"""Windy delivery: drones pick up together and deliver together, in a wind of which only bounds are known.

The wind may be anything within its bounds, at every step anew, but does not know the noise of the step. Certificates
hold for all of it; environments take its behaviour by `disturbance`.

**Versions**: v0: the first version.
"""

from __future__ import annotations

from ...systems.agents import Agent
from ...systems.arguments import checked_count
from ...tasks.problem import Problem, Specification
from ...tasks.regions import Proposition

MOST_DRONES = 20
"""Most drones: all must be in one place at once."""


def problem(n_agents: int = 1, horizon: int = 10) -> Problem:
    """Return the delivery of the module docstring."""
    n_agents = checked_count(n_agents, "n_agents", most=MOST_DRONES)
    drones = Agent(
        name="drone",
        states=["x", "y"],
        inputs=["u", "v"],
        disturbances={"east_wind": [-0.1, 0.1], "north_wind": [-0.1, 0.1]},
        dynamics=["x + u + east_wind", "y + v + north_wind"],
        noise=[{"law": "gaussian", "std": 0.3}, {"law": "gaussian", "std": 0.3}],
        state_low=[-5.0, -4.0],
        state_high=[5.0, 4.0],
        input_low=[-1.5, -1.5],
        input_high=[1.5, 1.5],
        initial_state=[-3.0, 0.0],
    ).copies(n_agents)
    return Problem(
        name=f"windy-delivery-{n_agents}-v0",
        horizon=horizon,
        agents=drones,
        propositions={
            "pickup": Proposition("drone_*", [-2.0, 1.0], [1.0, 3.5]),
            "delivery": Proposition("drone_*", [1.5, -3.0], [4.5, 0.5]),
        },
        specification=Specification("F (all(pickup) & F all(delivery))", "co-safe"),
    )
