"""Room network: any number of rooms on a ring stay comfortable while warmth flows between neighbours.

Every room has a heater and is told the temperatures of its two neighbours. It also loses warmth to the cold outside.

**Versions**: v0: the first version.
"""

from __future__ import annotations

from ...systems.agents import Agent
from ...systems.arguments import MOST_AGENTS, checked_count
from ...tasks.problem import Problem, Specification
from ...tasks.regions import Proposition


def problem(n_agents: int = 4, horizon: int = 12) -> Problem:
    """Return the ring of rooms of the module docstring; at least three."""
    n_agents = checked_count(n_agents, "n_agents", most=MOST_AGENTS)
    if n_agents < 3:
        raise ValueError(f"`n_agents`: expected at least 3 rooms on a ring, got {n_agents}")
    return Problem(
        name=f"room-network-{n_agents}-v0",
        horizon=horizon,
        agents=[_room(i, n_agents) for i in range(n_agents)],
        propositions={"comfort": Proposition("room_*", [19.5], [22.5])},
        specification=Specification("G all(comfort)", "finite-trace"),
    )


def _room(i: int, n: int) -> Agent:
    """Return room i of n; exchange with the neighbours, loss to the outside at 5 degrees, and the heater."""
    before, after = f"room_{(i - 1) % n}", f"room_{(i + 1) % n}"
    exchange = f"0.05*({before}.temperature + {after}.temperature - 2*temperature)"
    return Agent(
        name=f"room_{i}",
        states=["temperature"],
        inputs=["heater"],
        dynamics=[f"temperature + {exchange} + 0.05*(5 - temperature) + heater"],
        communicated=[before, after],
        noise=[{"law": "gaussian", "std": 0.2}],
        state_low=[17.0],
        state_high=[25.0],
        input_low=[0.0],
        input_high=[2.0],
        initial_state=[20.5],
    )
