"""Autonomous decoupled chain: any number of agents, which no input moves, stay safe or not by chance alone.

A yardstick for probabilities, not for policies: an environment needs inputs, but B = 0. From 0 each agent stays safe
with probability .626213 for 6 steps and .430846 for 10 steps, so all of 14 agents stay safe for 6 steps with
probability 1.426e-3.

**Versions**: v0: the first version.
"""

from __future__ import annotations

from ...systems.agents import LinearAgent
from ...systems.arguments import MOST_AGENTS, checked_count
from ...tasks.problem import Problem, Specification
from ...tasks.regions import Proposition


def problem(n_agents: int = 2, horizon: int = 6) -> Problem:
    """Return the autonomous decoupled chain of the literature."""
    n_agents = checked_count(n_agents, "n_agents", most=MOST_AGENTS)
    agent = LinearAgent(
        name="agent",
        A=[[0.8]],
        B=[[0.0]],
        noise_covariance=[[0.2]],
        state_low=[-3.0],
        state_high=[3.0],
        input_low=[-1.0],
        input_high=[1.0],
        initial_state=[0.0],
    )
    return Problem(
        name=f"decoupled-chain-{n_agents}-v0",
        horizon=horizon,
        agents=agent.copies(n_agents),
        propositions={"safe": Proposition("agent_*", [-1.0], [1.0])},
        specification=Specification("G all(safe)", "finite-trace"),
    )
