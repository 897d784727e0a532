"""Learners of other libraries take a few steps on our environments: ``python benchmarks/client_learners.py NAME ...``.

The names are below; each needs its library, and none is an extra of certigym. What counts is that the library accepts
the environment, steps it, and learns from it without an error; the steps are far too few for a good policy. Prints for
each library its version and what it did, or the error. docs/how-to/clients.md has the outcomes.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable
from importlib.metadata import version

import numpy as np

import certigym as cg

ID = "meeting-v0"


def sb3_contrib() -> str:
    """TRPO, TQC, CrossQ and RecurrentPPO of sb3-contrib."""
    from sb3_contrib import TQC, TRPO, CrossQ, RecurrentPPO

    from certigym.baselines import central_vec_env, shared_vec_env

    worlds = shared_vec_env(cg.make_problem(ID), worlds=8)
    TRPO("MlpPolicy", worlds, n_steps=16, batch_size=64, seed=0, device="cpu").learn(512)
    RecurrentPPO("MlpLstmPolicy", worlds, n_steps=16, batch_size=64, seed=0, device="cpu").learn(512)
    for learner in (TQC, CrossQ):
        learner("MlpPolicy", central_vec_env(cg.make_problem(ID), worlds=4), seed=0, device="cpu").learn(300)
    return "TRPO, RecurrentPPO, TQC and CrossQ learn"


def supersuit() -> str:
    """SuperSuit's wrappers and vectoriser, with PPO of Stable-Baselines3."""
    import supersuit as wrappers
    from stable_baselines3 import PPO

    env = wrappers.pad_action_space_v0(cg.parallel_env(ID, actions="unit"))
    rows = wrappers.pettingzoo_env_to_vec_env_v1(wrappers.pad_observations_v0(env))
    worlds = wrappers.concat_vec_envs_v1(rows, 4, base_class="stable_baselines3")
    # No seed: SuperSuit's vectoriser cannot be seeded by Stable-Baselines3.
    PPO("MlpPolicy", worlds, n_steps=16, batch_size=64, device="cpu").learn(512)
    return f"PPO learns on {worlds.num_envs} rows"


def benchmarl() -> str:
    """MAPPO and IPPO of BenchMARL."""
    from benchmarl.algorithms import IppoConfig, MappoConfig
    from benchmarl.experiment import Experiment, ExperimentConfig
    from benchmarl.models.mlp import MlpConfig

    from benchmarl_task import BenchmarlTask

    for algorithm in (MappoConfig, IppoConfig):
        with tempfile.TemporaryDirectory() as folder:
            config = ExperimentConfig.get_from_yaml()
            config.max_n_iters, config.evaluation, config.loggers, config.create_json = 2, True, [], False
            config.on_policy_collected_frames_per_batch = config.evaluation_interval = 600
            config.on_policy_n_envs_per_worker, config.on_policy_minibatch_size = 2, 200
            config.on_policy_n_minibatch_iters, config.save_folder, config.render = 2, folder, False
            model = MlpConfig.get_from_yaml()
            Experiment(BenchmarlTask(ID, {}), algorithm.get_from_yaml(), model, seed=0, config=config).run()
    return "MAPPO and IPPO learn and are evaluated"


def tianshou() -> str:
    """SAC of Tianshou on the centralised environment, by its high-level interface."""
    from tianshou.highlevel.config import OffPolicyTrainingConfig
    from tianshou.highlevel.env import EnvFactoryRegistered, VectorEnvType
    from tianshou.highlevel.experiment import ExperimentConfig, SACExperimentBuilder

    envs = EnvFactoryRegistered(task=f"certigym/{ID}", venv_type=VectorEnvType.DUMMY)
    training = OffPolicyTrainingConfig(
        max_epochs=1,
        epoch_num_steps=300,
        collection_step_num_env_steps=100,
        num_training_envs=2,
        num_test_envs=2,
        batch_size=32,
        start_timesteps=64,
    )
    with tempfile.TemporaryDirectory() as folder:
        config = ExperimentConfig(persistence_enabled=False, watch=False, persistence_base_dir=folder)
        SACExperimentBuilder(envs, config, training).build().run(run_name="certigym")
    return "SAC learns and is tested"


def agilerl() -> str:
    """IPPO and MATD3 of AgileRL on its vectoriser."""
    from agilerl.algorithms import IPPO, MATD3
    from agilerl.vector.pz_async_vec_env import AsyncPettingZooVecEnv

    envs = AsyncPettingZooVecEnv([lambda: cg.parallel_env(ID, actions="unit", dtype="float32")] * 2)
    spaces = {
        "observation_spaces": [envs.single_observation_space(name) for name in envs.agents],
        "action_spaces": [envs.single_action_space(name) for name in envs.agents],
        "agent_ids": list(envs.agents),
    }
    try:
        for learner in (IPPO(**spaces), MATD3(**spaces, vect_noise_dim=2)):
            observations, infos = envs.reset()
            for _ in range(30):
                chosen = learner.get_action(observations, infos=infos)
                observations, rewards, *_, infos = envs.step(chosen[0])
            assert np.isfinite(list(rewards.values())).all()
            if isinstance(learner, IPPO):
                assert np.isfinite(learner.test(envs, max_steps=20, loop=1)).all()
    finally:
        envs.close()
    return "IPPO and MATD3 act, IPPO is tested"


def rllib() -> str:
    """PPO of RLlib with one policy for all agents."""
    import ray
    from ray.rllib.algorithms.ppo import PPOConfig
    from ray.rllib.env.wrappers.pettingzoo_env import ParallelPettingZooEnv
    from ray.tune.registry import register_env

    register_env("certigym", lambda config: ParallelPettingZooEnv(cg.parallel_env(ID, actions="unit", dtype="float32")))
    ray.init(num_cpus=1, include_dashboard=False, log_to_driver=False)
    config = (
        PPOConfig()
        .environment("certigym")
        .env_runners(num_env_runners=0)
        .multi_agent(policies={"shared"}, policy_mapping_fn=lambda agent, episode, **rest: "shared")
        .training(train_batch_size=400, minibatch_size=100, num_epochs=2)
    )
    try:
        found = config.build_algo().train()
    finally:
        ray.shutdown()
    return f"PPO learns; mean return {found['env_runners']['episode_return_mean']:.3f}"


CLIENTS: dict[str, tuple[str, Callable[[], str]]] = {
    "sb3-contrib": ("sb3-contrib", sb3_contrib),
    "supersuit": ("SuperSuit", supersuit),
    "benchmarl": ("benchmarl", benchmarl),
    "tianshou": ("tianshou", tianshou),
    "agilerl": ("agilerl", agilerl),
    "rllib": ("ray", rllib),
}


def main() -> int:
    """Try the libraries that are named, or all; return 1 if one failed."""
    failed = 0
    for name in sys.argv[1:] or CLIENTS:
        package, attempt = CLIENTS[name]
        try:
            print(f"{name} {version(package)}: {attempt()}", flush=True)
        except Exception as error:  # noqa: BLE001 (whatever a foreign library raises is a finding)
            failed += 1
            print(f"{name}: {type(error).__name__}: {error}", flush=True)
    return min(failed, 1)


if __name__ == "__main__":
    sys.exit(main())
