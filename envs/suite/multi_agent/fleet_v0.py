"""Fleet: vehicles on a circle, which cannot move sideways, swap places with those across and keep apart on the way.

All of them want through the middle, and every two of them have to keep apart. Each vehicle sees itself alone, so they
must agree beforehand. Speed and rate of turning are the inputs; place and heading are the states, all of them noisy.

**Versions**: v0: the first version.
"""

from __future__ import annotations

import math

from ...systems.agents import Agent
from ...systems.arguments import checked_count
from ...tasks.problem import Problem, Specification
from ...tasks.regions import Pair, Proposition

STEP, DEVIATION = 0.5, 0.01
"""Time step, and standard deviation of the noise in every state."""

RADIUS, SPACE = 5.0, 0.5
"""Least radius of the circle, and what it grows with every vehicle."""

MOST_VEHICLES = 60
"""Most vehicles: more of them have too many pairs."""


def problem(n_agents: int = 20, horizon: int = 30) -> Problem:
    """Return the fleet of the module docstring."""
    n_agents = checked_count(n_agents, "n_agents", least=2, most=MOST_VEHICLES)
    radius = max(RADIUS, SPACE * n_agents)
    side, fastest = math.ceil(radius) + 4.0, round(3.0 * radius / (horizon * STEP), 2)
    vehicles, goals = [], {}
    for k in range(n_agents):
        angle = 2.0 * math.pi * (k + 0.5) / n_agents
        x, y = (round(radius * turn(angle), 2) for turn in (math.cos, math.sin))
        vehicles.append(
            Agent(
                name=f"vehicle_{k}",
                states=["x", "y", "heading"],
                inputs=["speed", "turn"],
                dynamics=[
                    f"x + {STEP}*speed*cos(heading)",
                    f"y + {STEP}*speed*sin(heading)",
                    f"heading + {STEP}*turn",
                ],
                outputs=["x", "y"],
                noise=[{"law": "gaussian", "std": DEVIATION}] * 3,
                state_low=[-side, -side, -7.0],
                state_high=[side, side, 7.0],
                input_low=[0.0, -1.0],
                input_high=[max(1.5, fastest), 1.0],
                initial_state=[x, y, round(math.atan2(-y, -x), 4)],
            )
        )
        goals[f"goal_{k}"] = Proposition(f"vehicle_{k}", [-x - 0.5, -y - 0.5], [-x + 0.5, -y + 0.5])
    return Problem(
        name=f"fleet-{n_agents}-v0",
        horizon=horizon,
        agents=vehicles,
        propositions={**goals, "near": Pair("vehicle_*", [-0.5, -0.5], [0.5, 0.5])},
        specification=Specification(f"!any(near) U ({' & '.join(goals)})", "co-safe"),
    )
