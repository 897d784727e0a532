"""Rendezvous: planar robots stay within reach of their leader, which goes to a depot and comes back to a dock.

All the time every follower has to be within 3 of the leader, and no two robots may come nearer than 1 to each other.
Each robot sees only itself, and all of them are pushed about by noise.

**Versions**: v0: the first version.
"""

from __future__ import annotations

from ...systems.agents import LinearAgent
from ...systems.arguments import checked_count
from ...tasks.problem import Problem, Specification
from ...tasks.regions import Pair, Proposition

PLACES = ((-1.8, 0.0), (0.0, -1.8), (0.0, 1.8), (-1.8, -1.8), (-1.8, 1.8))
"""Where followers start, as seen from the leader."""

START = (-4.0, 0.0)


def problem(n_followers: int = 2, horizon: int = 20) -> Problem:
    """Return the rendezvous of the module docstring."""
    n_followers = checked_count(n_followers, "n_followers", most=len(PLACES))
    leader = LinearAgent(
        name="leader_0",
        A=[[1.0, 0.0], [0.0, 1.0]],
        B=[[1.0, 0.0], [0.0, 1.0]],
        noise_covariance=[[0.01, 0.0], [0.0, 0.01]],
        state_low=[-8.0, -6.0],
        state_high=[8.0, 6.0],
        input_low=[-1.0, -1.0],
        input_high=[1.0, 1.0],
        initial_state=START,
    )
    followers = [
        leader.replace(name=f"follower_{k}", initial_state=[START[0] + x, START[1] + y])
        for k, (x, y) in enumerate(PLACES[:n_followers])
    ]
    propositions: dict[str, Proposition | Pair] = {
        "depot": Proposition("leader_0", [3.0, -1.0], [5.0, 1.0]),
        "dock": Proposition("leader_0", [-5.0, -1.0], [-3.0, 1.0]),
        "reach": Pair(["leader_0", "follower_*"], [-3.0, -3.0], [3.0, 3.0]),
        "touch": Pair(["leader_0", "follower_*"], [-1.0, -1.0], [1.0, 1.0]),
    }
    apart = "!any(touch)"
    if n_followers > 1:
        propositions["near"] = Pair("follower_*", [-1.0, -1.0], [1.0, 1.0])
        apart += " & !any(near)"
    return Problem(
        name="rendezvous-v0" if n_followers == 2 else f"rendezvous-{n_followers}-v0",
        horizon=horizon,
        agents=[leader, *followers],
        propositions=propositions,
        specification=Specification(f"G (all(reach) & {apart}) & F (depot & F G dock)", "finite-trace"),
    )
