"""Step a suite problem as a PettingZoo environment, with each agent steering for the middle of its first goal."""

from __future__ import annotations

import numpy as np

import certigym as cg


def main(seed: int = 0) -> bool:
    env = cg.parallel_env("reach-avoid-v0", render_mode="ansi")
    observations, infos = env.reset(seed=seed)
    targets = {"agent_0": 2.5, "agent_1": -4.0}
    while env.agents:
        print(env.render())
        # x' = .9 x + .5 u + w: the input that puts the mean on the target, as far as the input box allows
        actions = {
            name: np.clip((targets[name] - 0.9 * observations[name][:1]) / 0.5, -5.0, 5.0) for name in env.agents
        }
        observations, _, _, _, infos = env.step(actions)
    print(env.render())
    return bool(infos["agent_0"]["satisfied"])


if __name__ == "__main__":
    print("satisfied" if main() else "not satisfied")
