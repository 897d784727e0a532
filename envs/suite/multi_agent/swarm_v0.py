"""Swarm: planar robots on a circle swap places with those across, and never come nearer than 1 to each other.

All of them want through the middle. Each robot sees only itself, so they must agree beforehand on who goes around whom
and when: at the end every robot has to be in the square around the place across. With an even number of robots these
are the places of others.

**Versions**: v0: the first version.
"""

from __future__ import annotations

import math

from ...systems.agents import LinearAgent
from ...systems.arguments import checked_count
from ...tasks.problem import Problem, Specification
from ...tasks.regions import Pair, Proposition

RADIUS, SPACE = 5.0, 0.45
"""Least radius of the circle, and what it grows with every robot: neighbours start about 2.8 apart along it."""

MOST_ROBOTS = 100
"""Most robots: the circle of more would take too many cells."""


def problem(n_agents: int = 4, horizon: int | None = None) -> Problem:
    """Return the swarm of the module docstring."""
    n_agents = checked_count(n_agents, "n_agents", least=2, most=MOST_ROBOTS)
    radius = max(RADIUS, SPACE * n_agents)
    side = math.ceil(radius) + 3.0
    robots = LinearAgent(
        name="robot",
        A=[[1.0, 0.0], [0.0, 1.0]],
        B=[[1.0, 0.0], [0.0, 1.0]],
        noise_covariance=[[0.04, 0.0], [0.0, 0.04]],
        state_low=[-side, -side],
        state_high=[side, side],
        input_low=[-1.5, -1.5],
        input_high=[1.5, 1.5],
    ).copies(n_agents)
    # Places lie on a lattice of halves, so that goals lie on the edges of cells.
    angles = [2.0 * math.pi * (k + 0.5) / n_agents for k in range(n_agents)]
    places = [[round(2.0 * radius * turn(angle)) / 2.0 for turn in (math.cos, math.sin)] for angle in angles]
    goals = {
        f"goal_{k}": Proposition(f"robot_{k}", [-x - 1.0, -y - 1.0], [-x + 1.0, -y + 1.0])
        for k, (x, y) in enumerate(places)
    }
    arrived = " & ".join(goals)
    return Problem(
        name=f"swarm-{n_agents}-v0",
        horizon=horizon if horizon is not None else math.ceil(3.0 * radius),
        agents=[robot.replace(initial_state=place) for robot, place in zip(robots, places)],
        propositions={**goals, "near": Pair("robot_*", [-1.0, -1.0], [1.0, 1.0])},
        specification=Specification(f"G !any(near) & F G ({arrived})", "finite-trace"),
    )
