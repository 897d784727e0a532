"""Train with other libraries, bring the policy back, judge it: ``python benchmarks/come_back.py NAME``.

Each learner has a minute of wall time on one thread (``--seconds``) on reach-avoid-v0, with the reward "progress"; what
it made goes through ``cg.as_policy``, and is simulated; if it sees its own state alone it is certified, wrapped
on a grid and as it is. Prints a row of the table in docs/how-to/clients.md for each name; libraries that are not
installed are left out.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np

import certigym as cg

ID = "reach-avoid-v0"
EPISODES, CELLS = 20_000, 500

Trained = tuple[Any, Any, int]
"""Model, environment for ``as_policy`` (or None), and world steps taken."""


def _stopper(seconds: float) -> Any:
    """A callback of Stable-Baselines3 that stops after some seconds."""
    from stable_baselines3.common.callbacks import BaseCallback

    class Stop(BaseCallback):
        def _on_training_start(self) -> None:
            self.until = time.perf_counter() + seconds

        def _on_step(self) -> bool:
            return time.perf_counter() < self.until

    return Stop()


def _of_sb3(learner: Any, policy: str, env: Any, seconds: float, per: int, **options: Any) -> Trained:
    model = learner(policy, env, device="cpu", **options)
    model.learn(10**9, callback=_stopper(seconds))
    with tempfile.TemporaryDirectory() as folder:  # by file, as somebody else would get it
        model.save(Path(folder) / "model.zip")
        policy = cg.as_policy(Path(folder) / "model.zip", ID)
    return policy, None, int(model.num_timesteps) // per


def _worlds(central: bool = False) -> Any:
    from certigym.baselines import central_vec_env, shared_vec_env

    make = central_vec_env if central else shared_vec_env
    return make(cg.make_problem(ID), worlds=16, reward="progress", horizon_ends="terminated")


def sb3_ppo(seconds: float) -> Trained:
    """PPO of Stable-Baselines3, one network for all agents."""
    from stable_baselines3 import PPO

    return _of_sb3(PPO, "MlpPolicy", _worlds(), seconds, 2, seed=0, n_steps=64, batch_size=256, gamma=1.0)


def sb3_td3(seconds: float) -> Trained:
    """TD3 of Stable-Baselines3, one network for all agents."""
    from stable_baselines3 import TD3
    from stable_baselines3.common.noise import NormalActionNoise

    noise = NormalActionNoise(np.zeros(1), np.full(1, 0.2))
    return _of_sb3(TD3, "MlpPolicy", _worlds(), seconds, 2, seed=0, action_noise=noise, gamma=1.0)


def sb3_sac(seconds: float) -> Trained:
    """SAC of Stable-Baselines3 on the centralised Gymnasium environment."""
    from stable_baselines3 import SAC

    return _of_sb3(SAC, "MlpPolicy", cg.central_env(ID, reward="progress"), seconds, 1, seed=0, gamma=1.0)


def contrib_trpo(seconds: float) -> Trained:
    """TRPO of sb3-contrib, one network for all agents."""
    from sb3_contrib import TRPO

    return _of_sb3(TRPO, "MlpPolicy", _worlds(), seconds, 2, seed=0, n_steps=64, gamma=1.0)


def contrib_crossq(seconds: float) -> Trained:
    """CrossQ of sb3-contrib (batch normalisation), one network for all agents."""
    from sb3_contrib import CrossQ

    return _of_sb3(CrossQ, "MlpPolicy", _worlds(), seconds, 2, seed=0, gamma=1.0)


def contrib_recurrent(seconds: float) -> Trained:
    """RecurrentPPO of sb3-contrib, one network for all agents."""
    from sb3_contrib import RecurrentPPO

    return _of_sb3(RecurrentPPO, "MlpLstmPolicy", _worlds(), seconds, 2, seed=0, n_steps=64, gamma=1.0)


def supersuit_ppo(seconds: float) -> Trained:
    """PPO of Stable-Baselines3 on SuperSuit's rows of the PettingZoo environment."""
    import supersuit as wrappers
    from stable_baselines3 import PPO

    env = wrappers.pad_action_space_v0(cg.parallel_env(ID, actions="unit", reward="progress"))
    rows = wrappers.pettingzoo_env_to_vec_env_v1(wrappers.pad_observations_v0(env))
    worlds = wrappers.concat_vec_envs_v1(rows, 8, base_class="stable_baselines3")
    return _of_sb3(PPO, "MlpPolicy", worlds, seconds, 2, n_steps=64, batch_size=256, gamma=1.0)


def single_file(seconds: float) -> Trained:
    """PPO in one file in the manner of CleanRL: a module with `actor_mean`, on 256 worlds of `team_env`."""
    from one_file import ppo

    agent, steps = ppo(cg.team_env(ID, 256, reward="progress"), seconds)
    # Own state in [-1, 1], automaton state, time left, which agent: the rows of shared worlds.
    return agent, "shared_vec_env", steps


def torchrl_ppo(seconds: float) -> Trained:
    """PPO of TorchRL on the group of agents that its PettingZooWrapper makes."""
    import torch
    from tensordict.nn import NormalParamExtractor, TensorDictModule
    from torchrl.collectors import Collector
    from torchrl.envs import PettingZooWrapper
    from torchrl.modules import MLP, ProbabilisticActor, TanhNormal
    from torchrl.objectives import ClipPPOLoss, ValueEstimators

    torch.manual_seed(0)
    options = {"actions": "unit", "dtype": "float32", "reward": "progress"}
    zoo = cg.parallel_env(ID, **options)
    env = PettingZooWrapper(zoo, use_mask=False)
    group = next(iter(env.group_map))
    seen, action = (group, "observation"), (group, "action")
    size = env.observation_spec[seen].shape[-1]
    net = torch.nn.Sequential(MLP(size, 2, num_cells=[64, 64], activation_class=torch.nn.Tanh), NormalParamExtractor())
    outs = [(group, "loc"), (group, "scale")]
    actor = ProbabilisticActor(
        TensorDictModule(net, in_keys=[seen], out_keys=outs),
        in_keys=outs,
        out_keys=[action],
        distribution_class=TanhNormal,
        return_log_prob=True,
        log_prob_key=(group, "log_prob"),
    )
    critic = TensorDictModule(MLP(size, 1, num_cells=[64, 64]), in_keys=[seen], out_keys=[(group, "state_value")])
    collector = Collector(env, actor, frames_per_batch=500, total_frames=-1)
    loss = ClipPPOLoss(actor, critic, entropy_coeff=1e-3)
    loss.set_keys(
        reward=(group, "reward"), action=action, sample_log_prob=(group, "log_prob"), value=(group, "state_value"),
        done=(group, "done"), terminated=(group, "terminated"),
    )  # fmt: skip
    loss.make_value_estimator(ValueEstimators.GAE, gamma=1.0, lmbda=0.95)
    adam, until, steps = torch.optim.Adam(loss.parameters(), 1e-3), time.perf_counter() + seconds, 0
    for data in collector:
        steps += 500
        with torch.no_grad():
            loss.value_estimator(
                data, params=loss.critic_network_params, target_params=loss.target_critic_network_params
            )
        for _ in range(6):
            found = loss(data)
            adam.zero_grad()
            sum(found[k].mean() for k in list(found.keys()) if k.startswith("loss_")).backward()
            adam.step()
        if time.perf_counter() > until:
            break
    collector.shutdown()
    return actor, "parallel_env(actions=unit)", steps


def tianshou_sac(seconds: float) -> Trained:
    """SAC of Tianshou on the centralised environment, by its high-level interface."""
    from tianshou.highlevel.config import OffPolicyTrainingConfig
    from tianshou.highlevel.env import EnvFactoryRegistered, VectorEnvType
    from tianshou.highlevel.experiment import ExperimentConfig, SACExperimentBuilder

    envs = EnvFactoryRegistered(task=f"certigym/{ID}", venv_type=VectorEnvType.DUMMY, reward="progress")
    taken = int(60 * seconds)
    training = OffPolicyTrainingConfig(
        max_epochs=1, epoch_num_steps=taken, collection_step_num_env_steps=40, num_training_envs=4, num_test_envs=1,
        batch_size=128, start_timesteps=500, update_step_num_gradient_steps_per_sample=0.5,
    )  # fmt: skip
    with tempfile.TemporaryDirectory() as folder:
        config = ExperimentConfig(persistence_enabled=False, watch=False, persistence_base_dir=folder)
        experiment = SACExperimentBuilder(envs, config, training).build()
        result = experiment.run(run_name="certigym")
    return result.world.algorithm, "central_env", taken


def rllib_ppo(seconds: float) -> Trained:
    """PPO of RLlib with one policy for all agents; its checkpoint comes back."""
    import ray
    from ray.rllib.algorithms.ppo import PPOConfig
    from ray.rllib.core.rl_module.default_model_config import DefaultModelConfig
    from ray.rllib.env.wrappers.pettingzoo_env import ParallelPettingZooEnv
    from ray.tune.registry import register_env

    options = {"actions": "unit", "dtype": "float32", "reward": "progress"}
    register_env("certigym", lambda config: ParallelPettingZooEnv(cg.parallel_env(ID, **options)))
    ray.init(num_cpus=1, include_dashboard=False, log_to_driver=False)
    config = (
        PPOConfig()
        .environment("certigym")
        .env_runners(num_env_runners=0)
        .multi_agent(policies={"shared"}, policy_mapping_fn=lambda agent, episode, **rest: "shared")
        .rl_module(model_config=DefaultModelConfig(fcnet_hiddens=[64, 64], fcnet_activation="tanh"))
        .training(train_batch_size=1000, minibatch_size=250, num_epochs=6, gamma=1.0, lr=1e-3)
    )
    try:
        algorithm, until, steps = config.build_algo(), time.perf_counter() + seconds, 0
        while time.perf_counter() < until:
            algorithm.train()
            steps += 1000
        folder = tempfile.mkdtemp()
        algorithm.save_to_path(folder)
        policy = cg.as_policy(folder, ID, "parallel_env(actions=unit)", module="shared")
    finally:
        ray.shutdown()
    return policy, None, steps


def benchmarl_ippo(seconds: float) -> Trained:
    """IPPO of BenchMARL, one network for all agents; its weights come back as a plain network."""
    import torch
    from benchmarl.algorithms import IppoConfig
    from benchmarl.experiment import Experiment, ExperimentConfig
    from benchmarl.models.mlp import MlpConfig

    from benchmarl_task import BenchmarlTask, StopAfter, TimeOver

    with tempfile.TemporaryDirectory() as folder:
        config = ExperimentConfig.get_from_yaml()
        config.max_n_iters, config.max_n_frames, config.evaluation = None, 10**8, False
        config.loggers, config.create_json, config.render, config.save_folder = [], False, False, folder
        config.on_policy_collected_frames_per_batch, config.on_policy_n_envs_per_worker = 600, 1
        config.on_policy_minibatch_size, config.on_policy_n_minibatch_iters = 200, 6
        config.gamma, config.lr = 1.0, 1e-3
        model = MlpConfig.get_from_yaml()
        model.num_cells = [64, 64]
        task = BenchmarlTask(ID, {"reward": "progress"})
        experiment = Experiment(
            task, IppoConfig.get_from_yaml(), model, seed=0, config=config, callbacks=[StopAfter(seconds)]
        )
        with suppress(TimeOver):
            experiment.run()

    # One network for all agents: its weights are those of a plain network, whose first outputs are the means.
    ((_, policy),) = experiment.group_policies.items()
    numbers = [value.detach().squeeze(0) for value in policy.parameters()]
    weights, biases = ([v for v in numbers if v.ndim == n] for n in (2, 1))
    layers: list[Any] = []
    for weight, bias in zip(weights, biases, strict=True):
        size = 1 if weight is weights[-1] else len(weight)
        layers += [torch.nn.Linear(weight.shape[1], size), torch.nn.Tanh()]
        layers[-2].load_state_dict({"weight": weight[:size], "bias": bias[:size]})
    net = torch.nn.Sequential(*layers[:-1])
    return cg.as_policy(net, ID, "parallel_env(actions=unit)", squashed=True), None, experiment.total_frames


def skrl_ppo(seconds: float) -> Trained:
    """PPO of skrl on the centralised environment; its actor is a module of torch."""
    import torch
    from skrl.agents.torch.ppo import PPO, PPO_CFG
    from skrl.envs.wrappers.torch import wrap_env
    from skrl.memories.torch import RandomMemory
    from skrl.models.torch import DeterministicMixin, GaussianMixin, Model

    torch.manual_seed(0)
    env = wrap_env(cg.central_env(ID, reward="progress", dtype="float32"))
    sizes = env.observation_space.shape[0], env.action_space.shape[0]

    def net(n_outputs: int) -> Any:
        layers = (torch.nn.Linear(sizes[0], 64), torch.nn.Tanh(), torch.nn.Linear(64, 64), torch.nn.Tanh())
        return torch.nn.Sequential(*layers, torch.nn.Linear(64, n_outputs))

    spaces = {"observation_space": env.observation_space, "action_space": env.action_space, "device": env.device}

    class Actor(GaussianMixin, Model):
        def __init__(self) -> None:
            Model.__init__(self, **spaces)
            GaussianMixin.__init__(self)
            self.net, self.log_std = net(sizes[1]), torch.nn.Parameter(torch.zeros(sizes[1]))

        def compute(self, inputs: Any, role: str = "") -> Any:
            return self.net(inputs["observations"]), {"log_std": self.log_std}

    class Critic(DeterministicMixin, Model):
        def __init__(self) -> None:
            Model.__init__(self, **spaces)
            DeterministicMixin.__init__(self)
            self.net = net(1)

        def compute(self, inputs: Any, role: str = "") -> Any:
            return self.net(inputs["observations"]), {}

    models = {"policy": Actor(), "value": Critic()}
    settings = PPO_CFG(rollouts=500, learning_epochs=6, mini_batches=4, discount_factor=1.0, learning_rate=1e-3)
    settings.experiment.write_interval = settings.experiment.checkpoint_interval = 0
    memory = RandomMemory(memory_size=500, num_envs=1, device=env.device)
    agent = PPO(models=models, memory=memory, cfg=settings, device=env.device,
                observation_space=env.observation_space, state_space=None, action_space=env.action_space)  # fmt: skip
    agent.init()
    agent.enable_training_mode(True)
    until, steps = time.perf_counter() + seconds, 0
    seen, _ = env.reset()
    while time.perf_counter() < until:
        agent.pre_interaction(timestep=steps, timesteps=10**9)
        with torch.no_grad():
            chosen, _ = agent.act(seen, None, timestep=steps, timesteps=10**9)
            after, rewards, terminated, truncated, infos = env.step(chosen)
            agent.record_transition(
                observations=seen, states=None, actions=chosen, rewards=rewards, next_observations=after,
                next_states=None, terminated=terminated, truncated=truncated, infos=infos,
                timestep=steps, timesteps=10**9,
            )  # fmt: skip
        agent.post_interaction(timestep=steps, timesteps=10**9)
        steps += 1
        seen = env.reset()[0] if bool((terminated | truncated).any()) else after
    return models["policy"].net, "central_env", steps


def agilerl_ippo(seconds: float) -> Trained:
    """IPPO of AgileRL on 64 worlds of `team_env`, one network for all agents."""
    import torch
    from agilerl.algorithms import IPPO
    from agilerl.training.train_multi_agent_on_policy import train_multi_agent_on_policy

    from client_worlds import agile_worlds

    torch.manual_seed(0)
    np.random.seed(0)  # noqa: NPY002 (AgileRL shuffles with it)
    worlds, per = agile_worlds(ID, 64, reward="progress"), 64 * 128
    plain = {"hidden_size": [64], "activation": "Tanh", "layer_norm": False}
    learner = IPPO(
        [worlds.single_observation_space(name) for name in worlds.agents],
        [worlds.single_action_space(name) for name in worlds.agents],
        agent_ids=worlds.agents,
        net_config={"encoder_config": {**plain, "output_layernorm": False}, "head_config": plain},
        gamma=1.0, lr=1e-3, learn_step=64 * 32, batch_size=512, update_epochs=6, ent_coef=0.0,
    )  # fmt: skip
    until, steps = time.perf_counter() + seconds, 0
    while time.perf_counter() < until:
        steps += per
        train_multi_agent_on_policy(
            worlds, ID, "IPPO", [learner], max_steps=steps, evo_steps=per, eval_steps=7, verbose=False
        )
    ((_, actor),) = learner.actors.items()
    *layers, last, _ = (*actor.encoder.model, *actor.head_net._wrapped.model)
    # The last number of an action was ignored in training.
    means = torch.nn.Linear(last.in_features, last.out_features - 1)
    means.load_state_dict({name: values[:-1] for name, values in last.state_dict().items()})
    return torch.nn.Sequential(*layers, means), "team_env", steps


def xuance_ippo(seconds: float) -> Trained:
    """IPPO of Xuance on 16 worlds, a network for each agent."""
    import torch
    import xuance
    import yaml
    from xuance.environment import REGISTRY_MULTI_AGENT_ENV, make_envs
    from xuance.torch.agents import IPPO_Agents

    from client_worlds import xuance_worlds

    options = {"actions": "unit", "scale": "unit", "dtype": "float32", "reward": "progress"}
    REGISTRY_MULTI_AGENT_ENV["certigym"] = xuance_worlds(ID, **options)
    folder, settings = Path(xuance.__file__).parent / "configs", {}
    for name in ("basic.yaml", "ippo/mpe/simple_spread_v3.yaml"):
        settings.update(yaml.safe_load((folder / name).read_text(encoding="utf-8")))
    logs = tempfile.mkdtemp()
    settings |= {
        "env_name": "certigym", "env_id": ID, "env_seed": 0, "seed": 0, "device": "cpu", "running_steps": 10**9,
        "vectorize": "DummyVecMultiAgentEnv", "parallels": 16, "buffer_size": 1024, "n_epochs": 6, "n_minibatch": 4,
        "learning_rate": 3e-4, "gamma": 1.0, "ent_coef": 0.0, "gain": 1.0, "activation": "tanh",
        "activation_action": "tanh", "use_parameter_sharing": False, "log_dir": logs, "model_dir": logs,
        "logger": "tensorboard", "render": False, "test_mode": False,
    }  # fmt: skip
    del settings["normalize"]
    torch.manual_seed(0)
    settings = argparse.Namespace(**settings)
    agents = IPPO_Agents(config=settings, envs=make_envs(settings))
    until = time.perf_counter() + seconds
    while time.perf_counter() < until:
        agents.train(64)
    parts = agents.policy.actor_representation, agents.policy.actor
    nets = {key: torch.nn.Sequential(*parts[0][key].model, *parts[1][key].mu) for key in agents.model_keys}
    return nets, "parallel_env(scale=unit,actions=unit)", int(agents.current_step)


CLIENTS: dict[str, tuple[str, Callable[[float], Trained]]] = {
    "sb3-ppo": ("stable-baselines3", sb3_ppo),
    "sb3-td3": ("stable-baselines3", sb3_td3),
    "sb3-sac": ("stable-baselines3", sb3_sac),
    "contrib-trpo": ("sb3-contrib", contrib_trpo),
    "contrib-crossq": ("sb3-contrib", contrib_crossq),
    "contrib-recurrent": ("sb3-contrib", contrib_recurrent),
    "supersuit-ppo": ("SuperSuit", supersuit_ppo),
    "single-file": ("torch", single_file),
    "torchrl": ("torchrl", torchrl_ppo),
    "tianshou": ("tianshou", tianshou_sac),
    "rllib": ("ray", rllib_ppo),
    "benchmarl": ("benchmarl", benchmarl_ippo),
    "skrl": ("skrl", skrl_ppo),
    "agilerl": ("agilerl", agilerl_ippo),
    "xuance": ("xuance", xuance_ippo),
}


def judged(name: str, package: str, train: Callable[[float], Trained], seconds: float) -> str:
    """Train, bring back, judge: a row of the table."""
    began = time.perf_counter()
    model, env, steps = train(seconds)
    spent = time.perf_counter() - began
    problem = cg.make_problem(ID)
    policy = cg.as_policy(model, problem, env)
    runs = cg.rollout(problem, policy, EPISODES)
    rate = f"{runs.successes / runs.episodes:.5f}"
    wrapped = raw = "-"
    why = getattr(policy, "why_not_certified", "")
    if not why:
        wrapped = f"{cg.certify(problem, policy, CELLS).certificate.lower_bound:.5f}"
        why = policy.why_not_as_it_is
        if not why:
            found = cg.certify(problem, policy, CELLS, as_is=True)
            assert cg.check(found)
            raw = f"{found.certificate.lower_bound:.5f}"
    text = (train.__doc__ or "").strip().rstrip(".")
    return (
        f"| {text} ({package} {version(package)}) | {steps:,} in {spent:.0f} s | {policy.information} | {rate} | "
        f"{wrapped} | {raw} | {why or '-'} |"
    )


def main() -> int:
    """Try the libraries that are named, or all that are installed; return 1 if one failed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", default=list(CLIENTS))
    parser.add_argument("--seconds", type=float, default=60.0)
    options, failed = parser.parse_args(), 0
    for name in options.names:
        package, train = CLIENTS[name]
        try:
            version(package)
        except PackageNotFoundError:
            print(f"{name}: {package} is not installed", flush=True)
            continue
        try:
            print(judged(name, package, train, options.seconds), flush=True)
        except Exception as error:  # noqa: BLE001 (whatever a foreign library raises is a finding)
            failed += 1
            print(f"{name}: {type(error).__name__}: {error}", flush=True)
    return min(failed, 1)


if __name__ == "__main__":
    sys.exit(main())
