"""Integrator chain: one agent, whose input is integrated `dimension` times, stays within its bounds.

The chain is sampled exactly with the period .1 s. With two states they are position and velocity, and the input is an
acceleration. The dimension of the agent makes this a scaling family.

**Versions**: v0: the first version.
"""

from __future__ import annotations

from math import factorial

from ...systems.agents import LinearAgent
from ...systems.arguments import checked_count
from ...tasks.problem import Problem, Specification
from ...tasks.regions import Proposition

_PERIOD = 0.1  # seconds, as in the literature
_LONGEST = 20  # integrations: in longer chains the input hardly moves the first state


def problem(dimension: int = 2, horizon: int = 5) -> Problem:
    """Return the integrator chain of the literature, started near its bound on the first state."""
    # Entry k steps above the diagonal of exp(A t) is t^k / k!; the input enters at the last state.
    d = checked_count(dimension, "dimension", most=_LONGEST)
    powers = [_PERIOD**k / factorial(k) for k in range(d + 1)]
    chain = LinearAgent(
        name="chain_0",
        A=[[powers[column - row] if column >= row else 0.0 for column in range(d)] for row in range(d)],
        B=[[powers[d - row]] for row in range(d)],
        noise_covariance=[[0.01 if column == row else 0.0 for column in range(d)] for row in range(d)],
        state_low=[-10.0] * d,
        state_high=[10.0] * d,
        input_low=[-1.0],
        input_high=[1.0],
        initial_state=[7.5] + [0.0] * (d - 1),
    )
    return Problem(
        name="integrator-chain-v0",
        horizon=horizon,
        agents=[chain],
        propositions={"safe": Proposition("chain_0", [-8.0] * d, [8.0] * d)},
        specification=Specification("G safe", "finite-trace"),
    )
