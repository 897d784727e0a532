"""Two-agent reach-avoid (RA2): agent_0 must reach its goal; on the way the agents must not be in two places at once.

The running example of the literature on certified multi-agent synthesis: until agent_0 is in p1, it must not be in p2
while agent_1 is in p3. The common edge of neighbouring regions belongs to the upper one: at 0, agent_0 is in p1 and not
in p2. The noise `w` has the variance .25, that is a standard deviation of .5; published tables were computed with a
standard deviation of .25.

**Versions**: v0: the first version.
"""

from __future__ import annotations

from ...systems.agents import LinearAgent
from ...tasks.problem import Problem, Specification
from ...tasks.regions import Proposition


def problem(horizon: int = 7) -> Problem:
    """Return the problem RA2 of the module docstring."""
    first, second = LinearAgent(
        name="agent",
        A=[[0.9]],
        B=[[0.5]],
        noise_covariance=[[0.25]],
        state_low=[-20.0],
        state_high=[5.0],
        input_low=[-5.0],
        input_high=[5.0],
    ).copies(2)
    return Problem(
        name="reach-avoid-v0",
        horizon=horizon,
        agents=[
            first.replace(initial_low=[-20.0], initial_high=[0.0]),
            second.replace(initial_low=[-5.0], initial_high=[-2.5]),
        ],
        propositions={
            "p1": Proposition("agent_0", [0.0], [5.0]),
            "p2": Proposition("agent_0", [-5.0], [0.0]),
            "p3": Proposition("agent_1", [-20.0], [-15.0]),
        },
        specification=Specification("(!p2 | !p3) U p1", "co-safe"),
    )
