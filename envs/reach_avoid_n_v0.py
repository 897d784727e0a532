"""Reach-avoid of any number of agents (RA-N): all stay safe until one of them reaches the target.

| | |
|---|---|
| Import | `from certigym.envs import reach_avoid_n_v0` |
| Make | `pettingzoo.make("parallel", "certigym/reach-avoid-n-v0", n_agents=8)` |
| Actions | continuous |
| Agents | `['agent_0', ..., 'agent_{N-1}']` |
| Action shape, values | `(1,)`, [-2, 2]; values beyond are clipped |
| Observation shape, values | `(1 + 3 + 1,)`: own state in [-10, 10], automaton state one-hot, fraction of time left |
| State shape, values | `(N + 3 + 1,)`: all states, then as above |

**Dynamics** of each agent: `x' = x + u + w`, `w ~ N(0, 1)`; workspace [-10, 10].

**Propositions**: the families `safe`: an agent in [-5, 5), and `target`: an agent in [-2, 2).

**Task**, co-safe: `all(safe) U (any(target) & all(safe))`, within the horizon. The automaton has three states:
undecided, accepted, and one from which acceptance is out of reach.

**Rewards**: 1 to every agent on satisfaction, else 0.

**Start**: 4 for every agent.

**Episode ends**: (1) satisfied: terminated; (2) an agent leaves the safe interval or the workspace first: terminated;
(3) horizon: truncated.

**Arguments**: `n_agents` (4), `horizon` (6).

**Versions**: v0, first.
"""

from __future__ import annotations

from .agent import LinearAgent
from .labeling import Proposition
from .problem import Problem
from .specification import Specification
from .suite import checked_count, environments


def problem(n_agents: int = 4, horizon: int = 6) -> Problem:
    """Return the problem RA-N of the module docstring."""
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
        name=f"reach-avoid-{checked_count(n_agents, 'n_agents')}-v0",
        horizon=horizon,
        agents=agent.copies(n_agents),
        propositions={
            "safe": Proposition("agent_*", [-5.0], [5.0]),
            "target": Proposition("agent_*", [-2.0], [2.0]),
        },
        specification=Specification("all(safe) U (any(target) & all(safe))", "co-safe"),
    )


parallel_env, env, raw_env = environments("reach-avoid-n-v0")
