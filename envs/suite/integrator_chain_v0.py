"""Integrator chain: one agent whose input is integrated `dimension` times stays within its bounds.

Sampled exactly with the period .1 s. With two states the input is an acceleration, the states position and velocity. A
scaling family in the dimension of one agent.

**Versions**: v0, first.
"""

from __future__ import annotations

from math import factorial

from ..agents import LinearAgent, Proposition, checked_count
from ..problem import Problem, Specification
from .make import environments

_PERIOD = 0.1


def problem(dimension: int = 2, horizon: int = 5) -> Problem:
    """Return the integrator chain of the literature, started near its bound on the first state."""
    d = checked_count(dimension, "dimension", most=20)
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


parallel_env, env, raw_env = environments("integrator-chain-v0")
