"""What learners lose to noisy sensors: ``python benchmarks/noisy_sensors.py [--seconds S] [--seeds N]``.

The same learner (``benchmarks/one_file.py``) is trained and judged with exact sensors, and with sensors whose readings
have errors; nothing else changes. No certificate holds there yet: certificates are about controllers that read exact
states, and refuse these environments. Rates are over 20,000 episodes each, with exact limits of 99.9 %. The numbers go
to docs/noisy_sensors.json, where rows that are there already stay.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np
import torch

import certigym as cg
from certigym.validation.statistics import clopper_pearson
from one_file import Agent, inputs_of, ppo, rows_of

CASES = (
    ("reach-avoid-v0", (0.0, 0.5, 1.5)),
    ("room-network-v0", (0.0, 0.5, 1.0)),
    ("van-der-pol-v0", (0.0, 0.2, 0.5)),
    ("car-park-v0", (0.0, 0.5, 1.0)),
)
"""Problems, and standard deviations of the errors, in the units of the states."""

WORLDS, ROUNDS = 2000, 10
PAGE = Path(__file__).parents[1] / "docs" / "noisy_sensors.json"


def successes(agent: Agent, id: str, noise: float) -> int:
    """Return how many of `WORLDS` times `ROUNDS` episodes satisfy the task under the mean actions of an agent."""
    env, count = cg.team_env(id, WORLDS, sensor_noise=noise), 0
    for k in range(ROUNDS):
        told, first = env.reset(seed=1000 + k), np.ones(WORLDS, dtype=bool)
        # Worlds begin anew when they end: only their first episodes count.
        while first.any():
            with torch.no_grad():
                told = env.step(inputs_of(env, agent.actor_mean(rows_of(env, told))))
            count += int((told.satisfied & first).sum())
            first &= ~told.ended
    return count


def main() -> None:
    """Train and judge, and write the numbers after each training."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=30.0)
    parser.add_argument("--seeds", type=int, default=1)
    options = parser.parse_args()
    torch.set_num_threads(1)
    rows = json.loads(PAGE.read_text(encoding="utf-8")) if PAGE.is_file() else []
    known = {(row["id"], row["noise"], row["seed"]) for row in rows}
    for id, noise, seed in ((id, noise, seed) for id, all_ in CASES for noise in all_ for seed in range(options.seeds)):
        if (id, noise, seed) in known:
            continue
        env = cg.team_env(id, 256, reward="progress", sensor_noise=noise)
        agent, steps = ppo(env, options.seconds, seed)
        found, episodes = successes(agent, id, noise), WORLDS * ROUNDS
        low, high = clopper_pearson(found, episodes, 0.999)
        numbers = {"rate": found / episodes, "low": low, "high": high, "steps": steps}
        rows.append({"id": id, "noise": noise, "seed": seed, **numbers})
        print(rows[-1], flush=True)
        PAGE.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
