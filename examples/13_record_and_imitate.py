"""Record episodes of certified controllers, and imitate them offline by linear least squares."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

import certigym as cg
from certigym.baselines import RandomController, Recording

problem = cg.make_problem("reach-avoid-v0")
certificate = cg.synthesize(problem, 60).certificate
data: Recording = cg.record(problem, certificate, episodes=500, seed=1)
data.save("episodes.npz")  # arrays, with problem, seed and fingerprint in the header

# One rule per agent, on own state, automaton state and time left, from the steps of satisfied episodes.
good, rules = data.satisfied, {}
left = problem.horizon - np.arange(problem.horizon)
for name, columns, inputs in zip(problem.agent_names, problem.columns, problem.input_columns, strict=True):
    x, u, q = data.states[good, :-1, columns], data.inputs[good][..., inputs], data.automaton_states[good, :-1]
    seen = np.concatenate([x, np.stack([q, np.broadcast_to(left, q.shape), np.ones(q.shape)], axis=2)], axis=2)
    held = np.isfinite(u).all(axis=2)  # steps before the end of the episode
    rules[name] = np.linalg.lstsq(seen[held], u[held], rcond=None)[0]


def clone_of(rule: np.ndarray) -> Callable[[Any, int, int], Any]:
    """Return the linear rule as a policy."""
    return lambda x, q, t: np.array([*x, q, problem.horizon - t, 1.0]) @ rule


clones = {name: clone_of(rule) for name, rule in rules.items()}
policies = {"certified": certificate, "clone": clones, "random": RandomController()}
print(cg.compare(problem, policies, episodes=500))

# The same problem in a batch of worlds with one array per agent, and as a row of the leaderboard.
team = cg.team_env("reach-avoid-v0", 256)
step = team.reset(seed=0)
step = team.step({name: np.zeros((256, 1)) for name in team.agents})
print(step.observations["agent_0"].shape, cg.leaderboard(["reach-avoid-v0"], ["random"], 500).rows[0])
