"""Explore behind a shield: a success probability that holds whatever is proposed."""

from __future__ import annotations

import certigym as cg
from certigym.baselines import RandomController
from certigym.synthesis.extended_check.shields import shield_of

problem = cg.make_problem("reach-avoid-v0", horizon=5)
certificate = cg.synthesize(problem, 100, relation="exact").certificate

# An environment: random actions, and yet every episode succeeds with a probability of at least .7.
env = cg.shield(problem, certificate, probability=0.7)
observations, infos = env.reset(seed=0)
while env.agents:
    actions = {name: env.action_space(name).sample() for name in env.agents}
    observations, rewards, terminations, truncations, infos = env.step(actions)
    print({name: (round(info["budget"], 3), info["overridden"]) for name, info in infos.items()})

# A policy: the same for rollouts and comparisons.
shield = shield_of(certificate, 0.7)
assert isinstance(shield, cg.Shield)
policies = {"random": RandomController(), "random, shielded": cg.shield(RandomController(), shield)}
print(cg.compare(problem, policies, episodes=4_000))
