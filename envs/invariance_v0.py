"""Invariance of any number of agents (IV-N): every agent must stay in a safe interval up to the horizon.

| | |
|---|---|
| Import | `from certigym.envs import invariance_v0` |
| Make | `pettingzoo.make("parallel", "certigym/invariance-v0", n_agents=8)` |
| Actions | continuous |
| Agents | `['agent_0', ..., 'agent_{N-1}']` |
| Action shape, values | `(1,)`, [-2, 2]; values beyond are clipped |
| Observation shape, values | `(1 + 2 + 1,)`: own state in [-10, 10], automaton state one-hot, fraction of time left |
| State shape, values | `(N + 2 + 1,)`: all states, then as above |

**Dynamics** of each agent, workspace [-10, 10]: setting "A": `x' = .9 x + .5 u + w`, `w ~ N(0, .25)`; setting "B":
`x' = x + u + w`, `w ~ N(0, 1)`. The second argument of N is the variance.

**Propositions**: the family `safe`: each agent in [-5, 5).

**Task**, finite-trace: `G all(safe)` over times 0 to the horizon. The automaton has two states: safe so far, or not.

**Rewards**: 1 to every agent on satisfaction, which is known at the horizon, else 0.

**Start**: 0 for every agent.

**Episode ends**: (1) an agent leaves the safe interval or the workspace: terminated; (2) horizon: truncated.

**Arguments**: `n_agents` (4), `horizon` (7), `setting` ("A").

**Versions**: v0, first. `invariance-4-v0` and `invariance-20-v0` are this problem with the number of agents fixed.
"""

from __future__ import annotations

from .agent import LinearAgent
from .arrays import shown
from .labeling import Proposition
from .problem import Problem
from .specification import Specification
from .suite import checked_count, environments

_SETTINGS = {"A": (0.9, 0.5, 0.25), "B": (1.0, 1.0, 1.0)}


def problem(n_agents: int = 4, horizon: int = 7, setting: str = "A") -> Problem:
    """Return the problem IV-N of the module docstring."""
    if setting not in _SETTINGS:
        raise ValueError(f"`setting`: expected 'A' or 'B', got {shown(setting)}")
    a, b, variance = _SETTINGS[setting]
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
        name=f"invariance-{checked_count(n_agents, 'n_agents')}-v0",
        horizon=horizon,
        agents=agent.copies(n_agents),
        propositions={"safe": Proposition("agent_*", [-5.0], [5.0])},
        specification=Specification("G all(safe)", "finite-trace"),
    )


parallel_env, env, raw_env = environments("invariance-v0")
