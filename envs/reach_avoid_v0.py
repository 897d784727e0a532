"""Two-agent reach-avoid (RA2): one agent must reach its goal; two agents must not be in two places at once on the way.

| | |
|---|---|
| Import | `from certigym.envs import reach_avoid_v0` |
| Make | `pettingzoo.make("parallel", "certigym/reach-avoid-v0")` |
| Actions | continuous |
| Agents | `['agent_0', 'agent_1']` |
| Action shape, values | `(1,)`, [-5, 5]; values beyond are clipped |
| Observation shape, values | `(1 + 3 + 1,)`: own state in [-20, 5], automaton state one-hot, fraction of time left |
| State shape, values | `(2 + 3 + 1,)`: both states, then as above |

**Dynamics** of each agent: `x' = .9 x + .5 u + w`, `w ~ N(0, .25)` (variance .25, standard deviation .5); workspace
[-20, 5].

**Propositions**: `p1`: agent_0 in [0, 5]; `p2`: agent_0 in [-5, 0); `p3`: agent_1 in [-20, -15).

**Task**, co-safe: `(!p2 | !p3) U p1`, within the horizon. The automaton has three states: undecided, accepted, and
one from which acceptance is out of reach.

**Rewards**: 1 to both agents on satisfaction, else 0.

**Start**: uniform in agent_0 in [-20, 0), agent_1 in [-5, -2.5).

**Episode ends**: (1) satisfied: terminated; (2) an agent leaves its workspace: terminated; (3) `p2` and `p3` hold
before `p1`: terminated; (4) horizon: truncated.

**Arguments**: `horizon` (7).

**Versions**: v0, first.
"""

from __future__ import annotations

from .agent import LinearAgent
from .labeling import Proposition
from .problem import Problem
from .specification import Specification
from .suite import environments


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


parallel_env, env, raw_env = environments("reach-avoid-v0")
