"""Learn offline from three tiers of data: `python docs/offline_learners.py` (extra `data`, and d3rlpy).

Writes `docs/offline.json`, from which `python docs/numbers_of_pages.py` makes the table of *Record episodes*, and goes
on where it was stopped. For each problem it reads the Minari datasets `certigym/ID/TIER-v0` that `certigym record` has
written (certified controllers, seed 0, 1000 episodes), and makes those that are not there. Behaviour cloning and IQL
(Kostrikov, Nair and Levine 2022) are those of d3rlpy, with its defaults but for what is said below; they act on the
environment that a dataset recovers, in batches.
"""

from __future__ import annotations

import json
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import d3rlpy
import minari
import numpy as np
import torch
from d3rlpy.preprocessing import MinMaxActionScaler, StandardObservationScaler

import certigym as cg
from certigym.cli.main import main as certigym
from certigym.validation.statistical_tests import clopper_pearson

FILE = Path(__file__).with_name("offline.json")
IDS = ("reach-avoid-v0", "car-slalom-v0", "quadrotor-v0", "patrol-robot-v0", "rendezvous-v0")
TIERS = ("random", "medium", "expert")
EPISODES, CONFIDENCE = 10_000, 0.999
"""Episodes that judge a learner, on starts and noise that no dataset has."""

STEPS = 3000
"""Gradient steps of either learner, half a minute of IQL."""

LEARNERS = {"bc": d3rlpy.algos.BCConfig, "iql": d3rlpy.algos.IQLConfig}


def dataset_of(id: str, tier: str) -> Any:
    """Return a Minari dataset, made if it is not there."""
    name = f"certigym/{id}/{tier}-v0"
    if name not in minari.list_local_datasets():
        with TemporaryDirectory() as folder:
            words = f"record {id} --policy certified --tiers --out {folder} --minari certigym/{id}"
            assert certigym(words.split()) == 0
    return minari.load_dataset(name)


def learned(name: str, dataset: Any, seed: int = 0) -> Any:
    """Return a learner of d3rlpy that has learned from a dataset."""
    episodes = list(dataset.iterate_episodes())
    ends = [np.arange(len(e.rewards)) == len(e.rewards) - 1 for e in episodes]
    # Agents see the time left, so the horizon is an end like any other. The `get_minari` of d3rlpy 2.8 keeps the last
    # observation of each episode, which belongs to no action.
    data = d3rlpy.dataset.MDPDataset(
        np.concatenate([e.observations[:-1] for e in episodes]).astype(np.float32),
        np.concatenate([e.actions for e in episodes]).astype(np.float32),
        np.concatenate([e.rewards for e in episodes]),
        np.concatenate(ends),
    )
    d3rlpy.seed(seed)
    space = dataset.action_space
    # Each observed number has a scale of its own (at least .1: automaton states that no episode enters have no spread).
    # The reward comes at the end, so it is not discounted.
    learner = LEARNERS[name](
        batch_size=128,
        gamma=1.0,
        observation_scaler=StandardObservationScaler(eps=0.1),
        action_scaler=MinMaxActionScaler(minimum=space.low, maximum=space.high),
    ).create(device="cpu:0")
    logger = d3rlpy.logging.NoopAdapterFactory()
    learner.fit(data, STEPS, STEPS, logger_adapter=logger, show_progress=False)
    return learner


def successes(learner: Any, dataset: Any) -> int:
    """Return how many episodes satisfy the task, in the environment that the dataset recovers."""
    problem = dataset.recover_environment().unwrapped.problem
    env = cg.vector_env(problem, EPISODES, actions="input")
    seen, infos = env.reset(seed=1)
    satisfied = np.zeros(EPISODES, dtype=bool)
    going = ~satisfied
    for _ in range(problem.horizon):
        seen, _, terminated, truncated, infos = env.step(learner.predict(seen.astype(np.float32)))
        satisfied |= going & infos["satisfied"] & (terminated | truncated)
        going &= ~(terminated | truncated)
    assert not going.any()
    return int(satisfied.sum())


def entry(count: int, episodes: int) -> dict[str, float]:
    """Return a count of successes with its exact limits."""
    low, high = clopper_pearson(count, episodes, CONFIDENCE)
    return {"successes": count, "episodes": episodes, "low": float(low), "high": float(high)}


def main() -> None:
    """Measure what is not in the file yet."""
    torch.set_num_threads(1)  # small networks; the order of sums depends on threads
    found = json.loads(FILE.read_text(encoding="utf-8")) if FILE.exists() else {}
    for id in IDS:
        for tier in TIERS:
            key = f"{id}/{tier}"
            if key in found:
                continue
            dataset = dataset_of(id, tier)
            rewards = [float(e.rewards.sum()) for e in dataset.iterate_episodes()]
            row = {"data": entry(int(sum(rewards)), len(rewards)), "policy": dataset.storage.metadata["algorithm_name"]}
            for name in LEARNERS if sum(rewards) else ():  # without any reward there is nothing to learn
                row[name] = entry(successes(learned(name, dataset), dataset), EPISODES)
            found[key] = row
            FILE.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
            print(key, row, flush=True)


if __name__ == "__main__":
    main()
