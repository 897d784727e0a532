"""Baselines that learn: PPO and SAC of Stable-Baselines3 on the worlds of a problem (the extra ``rl``).

``ppo``          decentralised: one network for all agents; each agent sees its state, the automaton state, the time
                 left and which agent it is, the same information as under certified policies.
``central-ppo``  one learner sees the states of all agents and moves all of them.
``sac``          like ``central-ppo``, but learning off policy.

Training uses the start and the dynamics of the problem. The seed decides everything: network, worlds, batches. The same
seed, versions and machine give the same actor.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...envs.agents import checked_count, counted, tree_text, write_bytes, write_json
from ...envs.problem import Problem
from ...envs.suite import as_problem
from .actors import Actor, Network, actor_of, save_actor
from .views import CentralView, SharedView, View

if TYPE_CHECKING:
    from stable_baselines3.common.base_class import BaseAlgorithm

ALGORITHMS = ("ppo", "central-ppo", "sac")
STEPS = {"ppo": 100_000, "central-ppo": 200_000, "sac": 20_000}
"""Default numbers of world steps: enough for the small problems of the suite."""

CURVE_POINTS = 50
"""Points of a training curve."""


@dataclass(frozen=True, eq=False, repr=False)
class Training:
    """A trained actor and how it was trained.

    Parameters
    ----------
    problem : Problem
    algorithm : str
    seed : int
    steps : int
        World steps taken.
    seconds : float
        Wall-clock time of learning.
    curve : tuple of dict
        The training curve: ``steps`` and ``seconds`` since the beginning; over the episodes since the point before,
        ``episodes``, ``success`` (share of satisfied ones, exploration included) and mean ``return``.
    actor : Actor
    settings : dict
    model : BaseAlgorithm
        The learner, to continue with Stable-Baselines3.
    """

    problem: Problem
    algorithm: str
    seed: int
    steps: int
    seconds: float
    curve: tuple[dict[str, float], ...]
    actor: Actor
    settings: dict[str, Any]
    model: BaseAlgorithm

    def __repr__(self) -> str:
        shapes = " x ".join(str(bias.size) for bias in self.actor.network.biases)
        rows = [
            ("trained", f"{counted(self.steps, 'world step')} in {self.seconds:.1f} s, seed {self.seed}"),
            ("sees", self.information),
            ("network", f"layers of {shapes} numbers, {self.actor.network.activation}"),
        ]
        if self.curve:
            rows.append(("success", f"{self.curve[-1]['success']:.3f} while exploring, at the end of the training"))
        return tree_text(f"Training of {self.algorithm!r} on {self.problem.name!r}", rows)

    @property
    def information(self) -> str:
        """What the actor sees."""
        return self.actor.information

    def to_dict(self) -> dict[str, Any]:
        """Return everything but actor and model as JSON values."""
        return {
            "problem": self.problem.name,
            "fingerprint": self.problem.fingerprint,
            "algorithm": self.algorithm,
            "information": self.information,
            "seed": self.seed,
            "steps": self.steps,
            "seconds": self.seconds,
            "settings": self.settings,
            "curve": list(self.curve),
        }

    def save(self, folder: str | Path) -> Path:
        """Write ``actor.npz``, ``training.json`` and ``model.zip`` (of Stable-Baselines3); return the actor's path."""
        target = Path(folder)
        target.mkdir(parents=True, exist_ok=True)
        record = self.to_dict()
        save_actor(
            self.actor, target / "actor.npz", **{k: record[k] for k in ("algorithm", "seed", "steps", "seconds")}
        )
        write_json(target / "training.json", record)
        model = BytesIO()
        self.model.save(model)
        write_bytes(target / "model.zip", model.getvalue())
        return target / "actor.npz"


def train(
    problem: Any,
    algorithm: str = "ppo",
    steps: int | None = None,
    seed: int = 0,
    *,
    worlds: int | None = None,
    reward: str = "shaped",
    progress: Callable[[int, float], None] | None = None,
    **settings: Any,
) -> Training:
    """Train a baseline on a problem; nothing about the result is certified.

    Parameters
    ----------
    problem : Problem, id or path
    algorithm : "ppo", "central-ppo" or "sac"
    steps : int, optional
        World steps of all worlds together; default: ``STEPS``. The learner finishes the round in which it reaches them.
    seed : int
    worlds : int, optional
        Worlds side by side; default: 64 for PPO, 16 for SAC.
    reward : "shaped" or "sparse"
        The shaped reward has the same optimal policies and is needed with three or more agents.
    progress : callable, optional
        Called with the world steps taken since the last call and the latest success rate.
    **settings
        Settings of the learner that replace the defaults.

    Raises
    ------
    ValueError
        If an argument is unknown or out of range, or Stable-Baselines3 is not installed.
    """
    problem = as_problem(problem)
    count = worlds or (16 if algorithm == "sac" else 64)
    _check(algorithm, seed, steps=steps, worlds=worlds)
    # The learner counts rows, we count steps of worlds: a world has as many rows as its view says.
    view: View = SharedView(problem) if algorithm == "ppo" else CentralView(problem)
    used = {**_defaults(algorithm, problem, view, count), **settings}
    model = _learner(algorithm, view, count, reward, seed, used)
    wanted = STEPS[algorithm] if steps is None else steps
    watcher = _watcher(view.rows, max(1, wanted // CURVE_POINTS), progress)
    began = time.perf_counter()
    model.learn(wanted * view.rows, callback=watcher)
    seconds = time.perf_counter() - began
    taken = int(model.num_timesteps) // view.rows
    settled = {**used, "worlds": count, "reward": reward}
    actor = actor_of(view, network_of(model))
    return Training(problem, algorithm, int(seed), taken, seconds, tuple(watcher.curve), actor, settled, model)


def _check(algorithm: str, seed: int, **counts: int | None) -> None:
    """Raise ValueError unless the algorithm exists and all numbers that are given are whole and large enough."""
    if algorithm not in ALGORITHMS:
        raise ValueError(f"`algorithm`: expected {', '.join(map(repr, ALGORITHMS))}, got {algorithm!r}")
    checked_count(seed, "seed", least=0)
    for name, value in counts.items():
        if value is not None:
            checked_count(value, name)


def _learner(algorithm: str, view: View, worlds: int, reward: str, seed: int, used: dict[str, Any]) -> BaseAlgorithm:
    """Return the untrained learner of Stable-Baselines3 on its worlds, on one thread of the processor."""
    try:
        import torch
        from stable_baselines3 import PPO, SAC

        from .learners import WorldsVecEnv
    except ImportError as error:
        raise ValueError('training needs Stable-Baselines3: install "certigym[rl]"') from error
    torch.set_num_threads(1)  # small networks gain little from threads, which would change the order of sums
    env = WorldsVecEnv(view, worlds, reward=reward, discount=float(used["gamma"]), horizon_ends="terminated")
    arguments = {name: value for name, value in used.items() if name not in ("hidden", "log_std_init")}
    arguments = {"device": "cpu", **arguments}
    arguments |= {"learning_rate": _falling(float(used["learning_rate"])), "policy_kwargs": _networks(used)}
    learner: Any = SAC if algorithm == "sac" else PPO
    model: BaseAlgorithm = learner("MlpPolicy", env, seed=seed, **arguments)
    return model


def network_of(model: BaseAlgorithm) -> Network:
    """Return the deterministic actor of a PPO or SAC learner with an ``MlpPolicy`` as numbers."""
    import torch

    policy: Any = model.policy
    # SAC squashes its actions by tanh; PPO's are clipped.
    squashed = hasattr(policy, "actor") and hasattr(policy.actor, "mu")
    if squashed:
        hidden, last = policy.actor.latent_pi, policy.actor.mu
    else:
        hidden, last = policy.mlp_extractor.policy_net, policy.action_net
    # Linear layers become arrays; between them only one kind of activation is allowed.
    layers = [layer for layer in hidden if isinstance(layer, torch.nn.Linear)] + [last]
    kinds = {type(layer).__name__ for layer in hidden if not isinstance(layer, torch.nn.Linear)}
    if kinds not in ({"Tanh"}, {"ReLU"}):
        raise ValueError(f"`model`: expected an MLP with tanh or relu between its layers, got {sorted(kinds)}")
    weights = tuple(layer.weight.detach().numpy().copy() for layer in layers)
    biases = tuple(layer.bias.detach().numpy().copy() for layer in layers)
    return Network(weights, biases, kinds.pop().lower(), squashed)


def _defaults(algorithm: str, problem: Problem, view: View, worlds: int) -> dict[str, Any]:
    """Return settings that learn the small problems of the suite in minutes."""
    if algorithm == "sac":
        return {
            "learning_rate": 1e-3,
            "gamma": 1.0,
            "buffer_size": 200_000,
            "batch_size": 256,
            "train_freq": 1,
            "gradient_steps": 8,
            "learning_starts": 1000,
            "ent_coef": "auto_0.1",
            "target_entropy": -2.0 * view.n_actions,
            "hidden": [64, 64],
        }
    # A round of PPO holds about two episodes of every world, and is split into eight batches.
    rounds = int(np.clip(2 * problem.horizon, 16, 64))
    batch = max(64, worlds * rounds * view.rows // 8)
    return {
        "learning_rate": 2e-3,
        "gamma": 1.0,
        "gae_lambda": 0.95,
        "n_steps": rounds,
        "batch_size": batch,
        "n_epochs": 8,
        "ent_coef": 0.0,
        "clip_range": 0.2,
        "hidden": [64, 64],
        "log_std_init": -1.0,
    }


def _networks(used: dict[str, Any]) -> dict[str, Any]:
    """Return the hidden layers, and for PPO the logarithm of the first deviation (1 is half of the input box)."""
    first = {"log_std_init": float(used["log_std_init"])} if "log_std_init" in used else {}
    return {"net_arch": list(used["hidden"]), **first}


def _falling(first: float) -> Callable[[float], float]:
    """Return a learning rate that falls linearly to a tenth, as a function of the share of training left."""
    return lambda left: first * (0.1 + 0.9 * left)


def _watcher(rows: int, every: int, progress: Callable[[int, float], None] | None) -> Any:
    """Return a callback that records the training curve, one point about every ``every`` world steps."""
    from stable_baselines3.common.callbacks import BaseCallback

    class Watcher(BaseCallback):
        """A callback that counts episodes by the infos of the first row of each world."""

        def __init__(self) -> None:
            super().__init__()
            self.curve: list[dict[str, float]] = []
            self.ended: list[tuple[bool, float]] = []
            self.began, self.last = time.perf_counter(), 0

        def _on_step(self) -> bool:
            # All rows of a world end together, so the first one stands for the world.
            infos = self.locals["infos"][::rows]
            self.ended += [(i["is_success"], i["episode"]["r"]) for i in infos if "is_success" in i]
            steps = self.num_timesteps // rows
            if steps - self.last >= every and self.ended:
                success, gained = np.mean(np.array(self.ended, dtype=float), axis=0)
                point = {"steps": steps, "success": float(success), "episodes": len(self.ended)}
                point |= {"return": float(gained), "seconds": time.perf_counter() - self.began}
                self.curve.append(point)
                if progress is not None:
                    progress(steps - self.last, float(success))
                self.ended, self.last = [], steps
            return True

    return Watcher()
