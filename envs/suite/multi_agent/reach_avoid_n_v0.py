"""Reach-avoid of any number of agents (RA-N): all stay safe until one of them reaches the target.

A scaling family: each further agent can help, and can fail.

**Versions**: v0: the first version.
"""

from __future__ import annotations

from ...systems.agents import LinearAgent
from ...systems.arguments import MOST_AGENTS, checked_count
from ...tasks.problem import Problem, Specification
from ...tasks.regions import Proposition


def problem(n_agents: int = 4, horizon: int = 6) -> Problem:
    """Return the problem RA-N of the module docstring."""
    n_agents = checked_count(n_agents, "n_agents", most=MOST_AGENTS)
    agent = LinearAgent(
        name="agent",
        A=[[1.0]],
        B=[[1.0]],
        noise_covariance=[[1.0]],
        state_low=[-10.0],
        state_high=[10.0],
        input_low=[-2.0],
        input_high=[2.0],
        initial_state=[4.0],
    )
    return Problem(
        name=f"reach-avoid-{n_agents}-v0",
        horizon=horizon,
        agents=agent.copies(n_agents),
        propositions={
            "safe": Proposition("agent_*", [-5.0], [5.0]),
            "target": Proposition("agent_*", [-2.0], [2.0]),
        },
        specification=Specification("all(safe) U (any(target) & all(safe))", "co-safe"),
    )
