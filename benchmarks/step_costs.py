"""Steps per second, sparse and with progress: ``python benchmarks/step_costs.py [--json PATH] [ID ...]``.

1024 worlds on one core, all in one run, each the best of several turns that are taken one after the other. Machines
differ, so all are also shown as a ratio to Gymnasium's vector environment of CartPole, of as many worlds.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
import time
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np

import certigym as cg
from measuring import save, show

WORLDS = 1024
STEPS = 200
TURNS = 7
IDS = ("reach-avoid-v0", "meeting-v0", "door-formation-v0", "swarm-v0", "fleet-v0")


def turn(envs: Any, actions: list[np.ndarray]) -> float:
    """Return the world steps per second of one turn of a vector environment."""
    began = time.perf_counter()
    for action in actions:
        envs.step(action)
    return len(actions) * WORLDS / (time.perf_counter() - began)


def main() -> None:
    """Measure and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("ids", nargs="*", default=IDS)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    makers: dict[tuple[str, str], Any] = {
        ("CartPole-v1", "-"): gymnasium.make_vec("CartPole-v1", WORLDS, vectorization_mode="vector_entry_point")
    }
    for name in options.ids:
        for reward in ("sparse", "progress"):
            makers[name, reward] = cg.vector_env(name, WORLDS, reward=reward)
    best = dict.fromkeys(makers, 0.0)
    actions = {}
    for key, envs in makers.items():
        envs.action_space.seed(0)
        envs.reset(seed=0)
        actions[key] = [envs.action_space.sample() for _ in range(STEPS)]
    for _ in range(TURNS):
        for key, envs in makers.items():
            best[key] = max(best[key], turn(envs, actions[key]))
    unit = best["CartPole-v1", "-"]
    rows: list[dict[str, Any]] = [
        {"environment": name, "reward": reward, "steps/s": round(speed), "of CartPole": round(speed / unit, 3)}
        for (name, reward), speed in best.items()
    ]
    show(f"steps of {WORLDS} worlds", rows)
    save({"step costs": rows}, options.json)


if __name__ == "__main__":
    main()
