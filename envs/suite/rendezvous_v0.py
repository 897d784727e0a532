"""Rendezvous: a follower on a line stays within reach of its leader, never runs into it, and both report at the end.

The leader goes to its depot and comes back to its dock. The follower must stay nearer than 3 to it all the time and
never nearer than 1, although both are pushed about by noise.

**Versions**: v0: the first version.
"""

from __future__ import annotations

from ..agents import LinearAgent, Pair, Proposition
from ..problem import Problem, Specification
from .make import environments


def problem(horizon: int = 14) -> Problem:
    """Return the rendezvous of the module docstring."""
    leader = LinearAgent(
        name="leader",
        A=[[1.0]],
        B=[[1.0]],
        noise_covariance=[[0.01]],
        state_low=[-6.0],
        state_high=[6.0],
        input_low=[-1.0],
        input_high=[1.0],
        initial_state=[-2.0],
    )
    follower = leader.replace(name="follower", initial_state=[-4.0])
    return Problem(
        name="rendezvous-v0",
        horizon=horizon,
        agents=[leader, follower],
        propositions={
            "depot": Proposition("leader", [2.0], [4.0]),
            "dock": Proposition("leader", [-3.0], [0.0]),
            "reach": Pair(["leader", "follower"], [-3.0], [3.0]),
            "near": Pair(["leader", "follower"], [-1.0], [1.0]),
        },
        specification=Specification("G (reach & !near) & F (depot & F G dock)", "finite-trace"),
    )


parallel_env, env, raw_env = environments("rendezvous-v0")
