"""Invariance of any number of agents (IV-N): every agent must stay in a safe interval up to the horizon.

There are two settings from the literature. In "A" the agents are pulled towards 0 (a = .9, b = .5, variance .25). In
"B" they drift freely with much noise (a = b = 1, variance 1). The task is judged at the horizon.

**Versions**: v0: the first version.
"""

from __future__ import annotations

from ...systems.agents import LinearAgent
from ...systems.arguments import MOST_AGENTS, checked_count, shown
from ...tasks.problem import Problem, Specification
from ...tasks.regions import Proposition

# State coefficient a, input coefficient b and noise variance.
_SETTINGS = {"A": (0.9, 0.5, 0.25), "B": (1.0, 1.0, 1.0)}


def problem(n_agents: int = 4, horizon: int = 7, setting: str = "A") -> Problem:
    """Return the problem IV-N of the module docstring."""
    if setting not in _SETTINGS:
        raise ValueError(f"`setting`: expected 'A' or 'B', got {shown(setting)}")
    a, b, variance = _SETTINGS[setting]
    n_agents = checked_count(n_agents, "n_agents", most=MOST_AGENTS)
    agent = LinearAgent(
        name="agent",
        A=[[a]],
        B=[[b]],
        noise_covariance=[[variance]],
        state_low=[-10.0],
        state_high=[10.0],
        input_low=[-2.0],
        input_high=[2.0],
        initial_state=[0.0],
    )
    return Problem(
        name=f"invariance-{n_agents}-v0",
        horizon=horizon,
        agents=agent.copies(n_agents),
        propositions={"safe": Proposition("agent_*", [-5.0], [5.0])},
        specification=Specification("G all(safe)", "finite-trace"),
    )
