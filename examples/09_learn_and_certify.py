"""Train a decentralised policy, certify it, improve it, and probe the result (needs the extra `rl`)."""

from __future__ import annotations

import certigym as cg
from certigym.baselines import Training, load_actor
from certigym.synthesis.certificates.controllers import Decentralised
from certigym.validation.policies import Probe

problem = cg.make_problem("reach-avoid-v0", horizon=5)
training: Training = cg.train(problem, "ppo", steps=10_000, seed=0)
print(f"{training.algorithm} on {training.information}: {training.curve[-1]}")

file = training.save("trained")
actor = load_actor(file, problem)  # needs no torch
assert isinstance(actor, Decentralised)  # only policies that see one agent at a time can be certified

certified = cg.certify(problem, actor, cells=100)
improved = cg.improve(problem, actor, cells=100)
print(cg.compare(problem, {"raw": training, "certified": certified, "improved": improved}, episodes=4_000))

# The network as it is deployed, wrapped in nothing.
raw = cg.certify(problem, actor, cells=500)
print(f"the network itself: P >= {raw.certificate.lower_bound:.4f}")

# Can a learner that starts from the certified controllers do better than they do?
found: Probe = cg.probe(problem, improved, episodes=4_000, steps=1_000)
print(found)
