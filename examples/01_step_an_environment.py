"""Step one problem through all four interfaces: PettingZoo parallel and AEC, Gymnasium centralised and vectorised."""

from __future__ import annotations

import numpy as np

import certigym as cg

print(f"{len(cg.problem_ids())} problems, the first one is {cg.problem_ids()[0]}")

# PettingZoo, parallel: every agent steers for the middle of its first goal
env = cg.parallel_env("reach-avoid-v0", render_mode="ansi")
observations, infos = env.reset(seed=0)
targets = {"agent_0": 2.5, "agent_1": -4.0}
while env.agents:
    # x' = .9 x + .5 u + w: the input that puts the mean on the target, as far as the input box allows
    actions = {name: np.clip((targets[name] - 0.9 * observations[name][:1]) / 0.5, -5.0, 5.0) for name in env.agents}
    observations, rewards, terminations, truncations, infos = env.step(actions)
    print(env.render())
print("satisfied" if infos["agent_0"]["satisfied"] else "not satisfied")

# PettingZoo, one agent after the other
turns = cg.aec_env("reach-avoid-v0")
turns.reset(seed=0)
for name in turns.agent_iter():
    observation, reward, terminated, truncated, info = turns.last()
    turns.step(None if terminated or truncated else turns.action_space(name).sample())

# Gymnasium: one learner moves all agents, actions scaled to [-1, 1]
central = cg.central_env("reach-avoid-v0", reward="shaped")
observation, info = central.reset(seed=0)
done = False
while not done:
    observation, reward, terminated, truncated, info = central.step(central.action_space.sample())
    done = terminated or truncated

# the same environment by the word that users of Gymnasium know
observation, info = cg.make("reach-avoid-v0", reward="shaped").reset(seed=0)

# Gymnasium, a batch of worlds in one array
worlds = cg.vector_env("reach-avoid-v0", 1000)
worlds.reset(seed=0)
satisfied = 0.0
for _ in range(20):
    satisfied += float(worlds.step(worlds.action_space.sample())[1].sum())
print(f"{satisfied:g} episodes satisfied by chance in 20 steps of 1000 worlds")
