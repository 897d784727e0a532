"""Learners of Stable-Baselines3 on the worlds of a problem: made, sent through phases, watched, read out as numbers."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from inspect import signature
from typing import TYPE_CHECKING, Any

import numpy as np

from ...envs.systems.arguments import unknown_argument
from ...synthesis.interop import TORCH_ACTIVATIONS
from .actors import Actor, Network, actor_of
from .settings import Phase, Piece, Settings
from .views import TeamView, View

if TYPE_CHECKING:
    from stable_baselines3.common.base_class import BaseAlgorithm

Progress = Callable[[int, float], None]


def check_settings(algorithm: str, settings: Mapping[str, Any], known: Sequence[str]) -> None:
    """Raise ValueError at a setting that neither ``train`` nor the learner has, and name the nearest one."""
    try:
        from stable_baselines3 import PPO, SAC
    except ImportError as error:
        raise ValueError('training needs Stable-Baselines3: install "certigym[rl]"') from error
    kind = SAC if algorithm == "sac" else PPO
    taken = [name for name in signature(kind.__init__).parameters if name not in ("self", "policy", "env")]
    for name in settings:
        if name not in (*known, *taken):
            raise unknown_argument(name, "`train`", [*known, *taken])


def new_learner(algorithm: str, view: View, settings: Settings, seed: int) -> BaseAlgorithm:
    """Return an untrained learner on the worlds of its first phase, on one thread of the processor.

    Raises
    ------
    ValueError
        If Stable-Baselines3 is not installed, or a setting is wrong.
    """
    try:
        import torch
        from stable_baselines3 import PPO, SAC
    except ImportError as error:
        raise ValueError('training needs Stable-Baselines3: install "certigym[rl]"') from error
    torch.set_num_threads(1)  # small networks gain little from threads, which would change the order of sums
    phase = settings.phases[0]
    networks: dict[str, Any] = {"net_arch": list(settings.hidden)}
    if phase.deviation is not None:
        networks["log_std_init"] = float(np.log(phase.deviation))
    learner: Any = SAC if algorithm == "sac" else PPO
    env = _worlds(view, settings, phase)
    arguments = {**settings.learner, "learning_rate": phase.learning_rate, "policy_kwargs": networks}
    policy: Any = "MlpPolicy"
    if isinstance(view, TeamView) or algorithm == "ippo":
        from .team_policies import CentralCriticPolicy, OwnParametersPolicy

        if isinstance(view, TeamView):
            policy, networks["seen"] = CentralCriticPolicy, view.seen
        else:
            policy, networks["agents"] = OwnParametersPolicy, view.problem.n_agents
    model: BaseAlgorithm = learner(policy, env, seed=seed, **arguments)
    return model


def enter(
    model: BaseAlgorithm, view: View, settings: Settings, phase: Phase, seed: int, is_later: bool = False
) -> None:
    """Send a learner into a phase: its worlds, its deviation (later ones: at most). The seed decides the worlds."""
    import torch

    env = _worlds(view, settings, phase)
    env.seed(seed)
    model.set_env(env)
    if phase.deviation is not None:
        log_std: Any = model.policy.log_std
        with torch.no_grad():
            given = torch.full_like(log_std, float(np.log(phase.deviation)))
            log_std.copy_(torch.minimum(log_std, given) if is_later else given)
        # A learner that may choose makes small deviations smaller until it learns no more.
        log_std.requires_grad_(not phase.fixed)


def begins_anywhere(model: Any, phase: Phase) -> bool:
    """Return whether episodes of a phase may begin anywhere: not behind a shield, and not in tasks of survival."""
    return phase.spread > 0.0 and getattr(model.env.worlds, "has_stages", False)


def begin_again(model: Any, numbers: dict[str, Any]) -> None:
    """Let a learner of PPO forget what it has learned: its networks have these numbers, and its optimizer no memory."""
    model.policy.load_state_dict(numbers)
    model.policy.optimizer.state.clear()


def learn(model: Any, view: View, piece: Piece, watcher: Any) -> None:
    """Let a learner take (at least) the world steps of a piece."""
    model.env.worlds.spread, model.env.worlds.care = piece.spread, piece.care
    steps, first, last = piece.steps, *piece.rates
    total = steps * view.rows
    # The learner tells the share of all its steps that is left: 1 minus those before, at the beginning of this part.
    at_begin = total / (int(model.num_timesteps) + total)
    model.lr_schedule = lambda left: last + (first - last) * min(1.0, left / at_begin)
    model.learn(total, callback=watcher, reset_num_timesteps=False)
    model.lr_schedule = lambda _: last  # the schedule of this part means nothing to later ones


def actor_now(model: BaseAlgorithm, view: View) -> Actor:
    """Return the deterministic actor of a learner, a copy."""
    return actor_of(view, networks_of(model))


def numbers_of(model: Any) -> dict[str, Any]:
    """Return a copy of all numbers of a learner's networks."""
    return {name: value.detach().clone() for name, value in model.policy.state_dict().items()}


def networks_of(model: BaseAlgorithm) -> tuple[Network, ...]:
    """Return the deterministic actors of a PPO or SAC learner as numbers: one, or one for each agent."""
    policy: Any = model.policy
    # Agents with parameters of their own have whole networks, last layers included.
    teams = getattr(policy.mlp_extractor, "actors", None) if hasattr(policy, "mlp_extractor") else None
    if teams is not None:
        return tuple(_numbers(network[:-1], network[-1], squashed=False) for network in teams)
    # SAC squashes its actions by tanh; PPO's are clipped.
    squashed = hasattr(policy, "actor") and hasattr(policy.actor, "mu")
    if squashed:
        hidden, last = policy.actor.latent_pi, policy.actor.mu
    else:
        hidden, last = policy.mlp_extractor.policy_net, policy.action_net
    return (_numbers(hidden, last, squashed),)


def _numbers(hidden: Any, last: Any, squashed: bool) -> Network:
    """Return the layers of a network as numbers."""
    import torch

    # Linear layers become arrays; between them only one kind of activation is allowed.
    layers = [layer for layer in hidden if isinstance(layer, torch.nn.Linear)] + [last]
    kinds = {type(layer).__name__ for layer in hidden if not isinstance(layer, torch.nn.Linear)}
    if len(kinds) != 1 or not kinds <= TORCH_ACTIVATIONS.keys():
        known = ", ".join(TORCH_ACTIVATIONS.values())
        raise ValueError(f"`model`: expected an MLP with one of {known} between its layers, got {sorted(kinds)}")
    weights = tuple(layer.weight.detach().cpu().numpy().copy() for layer in layers)
    biases = tuple(layer.bias.detach().cpu().numpy().copy() for layer in layers)
    return Network(weights, biases, TORCH_ACTIVATIONS[kinds.pop()], squashed)


def new_watcher(rows: int, every: int, progress: Progress | None = None, deadline: float = float("inf")) -> Any:
    """Return a callback that records the training curve, one point about every ``every`` world steps.

    It stops the learner when ``time.perf_counter()`` passes its ``deadline``, which may be moved.
    """
    from stable_baselines3.common.callbacks import BaseCallback

    class Watcher(BaseCallback):
        """A callback that counts episodes by the infos of the first row of each world."""

        def __init__(self) -> None:
            super().__init__()
            self.curve: list[dict[str, float]] = []
            self.ended: list[tuple[bool, float]] = []
            self.began, self.last, self.deadline = time.perf_counter(), 0, deadline

        def _on_step(self) -> bool:
            # All rows of a world end together, so the first one stands for the world.
            infos = self.locals["infos"][::rows]
            ended = (i for i in infos if "is_success" in i)
            self.ended += [(i["is_success"], i["episode"]["r"]) for i in ended]
            steps = self.num_timesteps // rows
            if steps - self.last >= every and self.ended:
                success, gained = np.mean(np.array(self.ended, dtype=float), axis=0)
                point = {"steps": steps, "success": float(success), "episodes": len(self.ended)}
                point |= {"return": float(gained), "seconds": time.perf_counter() - self.began}
                self.curve.append(point)
                if progress is not None:
                    progress(steps - self.last, float(success))
                self.ended, self.last = [], steps
            return time.perf_counter() < self.deadline

    return Watcher()


def _worlds(view: View, settings: Settings, phase: Phase) -> Any:
    """Return the worlds of a phase; the horizon counts as an end, since agents see the time left."""
    from .learners import WorldsVecEnv

    return WorldsVecEnv(
        view,
        settings.worlds,
        reward=phase.reward,
        discount=settings.gamma,
        horizon_ends="terminated",
        shield=settings.shield,
        spread=phase.spread,
    )
