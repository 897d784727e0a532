"""What an offline learner makes of our datasets: three tiers of a problem as Minari datasets, and d3rlpy on each.

``python benchmarks/offline_learning.py [ID]`` records 1,000 episodes of random inputs, of a PPO of Stable-Baselines3
that has trained for 20,000 steps, and of the certified controllers; writes a Minari dataset of each, reads it back, and
trains behaviour cloning and TD3+BC of d3rlpy on it for the same number of gradient steps. The policies come back by
`cg.as_policy` and are judged by 10,000 rollouts with limits of 99 %. Needs the extras `data` and `rl`, and d3rlpy.
The page docs/how-to/record.md has the outcome.
"""

from __future__ import annotations

import logging
import os
import sys
import tempfile
import warnings
from collections.abc import Mapping
from typing import Any

import numpy as np

import certigym as cg
from certigym.baselines import RandomController, shared_vec_env

EPISODES, JUDGED, SEED = 1_000, 10_000, 1
PPO_STEPS, GRADIENT_STEPS, BATCH = 20_000, 2_000, 256


def tiers(problem: Any, id: str) -> dict[str, Any]:
    """Return the policies that are recorded."""
    from stable_baselines3 import PPO

    learner = PPO("MlpPolicy", shared_vec_env(problem, worlds=16), n_steps=64, batch_size=256, seed=SEED, device="cpu")
    learner.learn(PPO_STEPS)
    return {"random": RandomController(), "learned": learner, "certified": cg.synthesize(problem).certificate}


def read_back(name: str) -> Any:
    """Return a Minari dataset, checked, as d3rlpy holds it."""
    import minari
    from d3rlpy.dataset import MDPDataset

    from certigym.validation.policies import checked_dataset

    episodes = list(checked_dataset(minari.load_dataset(name)).iterate_episodes())
    ends = [np.arange(len(e.rewards)) == len(e.rewards) - 1 for e in episodes]
    return MDPDataset(
        observations=np.concatenate([e.observations[:-1] for e in episodes]).astype(np.float32),
        actions=np.concatenate([e.actions for e in episodes]).astype(np.float32),
        rewards=np.concatenate([e.rewards for e in episodes]).astype(np.float32),
        # The task is judged by the horizon, which observations tell: no value lies beyond it.
        terminals=np.concatenate(ends).astype(np.float32),
    )


def offline(algorithm: str, dataset: Any, box: Any) -> Any:
    """Train one learner of d3rlpy on actions in a box, and return it as a module of torch."""
    import d3rlpy
    import torch

    d3rlpy.seed(SEED)
    scalers = {
        "observation_scaler": d3rlpy.preprocessing.StandardObservationScaler(),
        # The box of the environment: in the data an input may be the same everywhere.
        "action_scaler": d3rlpy.preprocessing.MinMaxActionScaler(minimum=box.low, maximum=box.high),
    }
    makers: Mapping[str, Any] = {"behaviour cloning": d3rlpy.algos.BCConfig, "TD3+BC": d3rlpy.algos.TD3PlusBCConfig}
    learner = makers[algorithm](batch_size=BATCH, **scalers).create(device="cpu:0")
    learner.fit(
        dataset, n_steps=GRADIENT_STEPS, n_steps_per_epoch=GRADIENT_STEPS, show_progress=False,
        logger_adapter=d3rlpy.logging.NoopAdapterFactory(),
    )  # fmt: skip

    class Answers(torch.nn.Module):
        """What the learner predicts."""

        def forward(self, seen: torch.Tensor) -> torch.Tensor:
            return torch.as_tensor(learner.predict(seen.numpy().astype(np.float32)))

    return Answers()


def main(id: str = "reach-avoid-v0") -> None:
    """Print a row for each tier: the policy that was recorded, and what was learned from it."""
    import structlog

    structlog.configure(wrapper_class=structlog.make_filtering_bound_logger(logging.WARNING))
    warnings.filterwarnings("ignore", module="minari")
    problem = cg.make_problem(id)
    env = cg.central_env(problem, actions="input")
    print(f"{id}: share of satisfied episodes")
    with tempfile.TemporaryDirectory() as folder:
        os.environ["MINARI_DATASETS_PATH"] = folder
        for tier, policy in tiers(problem, id).items():
            name = f"certigym/{id.removesuffix('-v0')}/{tier}-v0"
            cg.record(problem, policy, episodes=EPISODES, seed=SEED).to_minari(name)
            dataset = read_back(name)
            entrants = {"recorded": policy}
            for algorithm in ("behaviour cloning", "TD3+BC"):
                entrants[algorithm] = cg.as_policy(offline(algorithm, dataset, env.action_space), problem, env=env)
            print(f"\n{tier}:\n{cg.compare(problem, entrants, episodes=JUDGED)}", flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:2])
