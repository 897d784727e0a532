"""A network of another library becomes a policy here, and a certified controller becomes a C header that runs there."""

from __future__ import annotations

from pathlib import Path
from tempfile import mkdtemp

import numpy as np

import certigym as cg

problem = cg.make_problem("reach-avoid-v0")

# layers as arrays, from any library; `env` says in which environment the network was trained, and so what it sees
weights = np.zeros((7, 1), np.float32)
weights[0] = -0.5  # against its own position
policy = cg.as_policy([(weights, np.zeros(1, np.float32))], problem, env="shared_vec_env")
print(policy.information, "| certified as it is:", policy.why_not_as_it_is or "yes")
print(cg.compare(problem, {"network": policy, "certified": cg.synthesize(problem, 100)}, episodes=2_000))

# the other way: the tables of a certified controller as C, with the same inputs to the last bit
header = cg.save(cg.synthesize(problem, 100, relation="exact"), Path(mkdtemp()) / "robots.h")
print(header.name, header.stat().st_size, "bytes,", header.read_text().splitlines()[0])
