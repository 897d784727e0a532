"""Stable-Baselines3 and sb3-contrib: models, their policies, and files that ``model.save`` writes."""

from __future__ import annotations

import inspect
from pathlib import Path
from typing import Any

import numpy as np

from .detected import Detected, agreed, need_trust, origins
from .layers import NotFeedForward, network_of

SAYS = "models of Stable-Baselines3 and sb3-contrib (.zip)"


def recognises(model: Any) -> bool:
    """Return whether a model is an algorithm or a policy of Stable-Baselines3."""
    return "stable_baselines3" in origins(model) and hasattr(model, "predict")


def read(model: Any, facts: dict[str, Any]) -> Detected:
    """Return what an algorithm or a policy is."""
    policy = getattr(model, "policy", model)
    name, spaces = type(model).__name__, (policy.observation_space, policy.action_space)
    if any(not hasattr(space, "low") or len(space.shape) != 1 for space in spaces):
        raise ValueError(f"`model`: expected spaces that are boxes of one axis, got {spaces[0]} and {spaces[1]}")
    ends = [(np.asarray(space.low), np.asarray(space.high)) for space in spaces]
    common: dict[str, Any] = {
        "name": f"{name} of {type(model).__module__.partition('.')[0]}",
        "answered": spaces[1].shape[0],
        "action_space": ends[1],
    }
    # A critic may see more than the actor, behind what that sees.
    seen = getattr(getattr(policy, "mlp_extractor", None), "seen", spaces[0].shape[0])
    common |= {"observed": int(seen), "space": (ends[0][0][:seen], ends[0][1][:seen])}
    spare = spaces[0].shape[0] - int(seen)
    scaled = _normalizer(model)
    if hasattr(policy, "lstm_actor"):
        return Detected(memory=_remembering(policy, scaled), why_not="it remembers earlier observations", **common)

    def act(rows: Any) -> Any:
        filled = np.pad(rows, ((0, 0), (0, spare)))
        return policy.predict(filled if scaled is None else scaled(filled), deterministic=True)[0]

    if scaled is not None:
        return Detected(act=act, why_not="its observations go through VecNormalize first", **common)
    try:
        networks = _networks(policy, "unit" if np.all(ends[1][0] == -1.0) and np.all(ends[1][1] == 1.0) else "box")
    except NotFeedForward as error:
        return Detected(act=act, why_not=str(error), **common)
    return agreed(Detected(act=act, networks=networks, **common))


def read_file(path: Path, facts: dict[str, Any]) -> Detected:
    """Return what a file is that ``model.save`` wrote. Such files are unpickled: read only those that you trust."""
    import torch
    from stable_baselines3.common.save_util import load_from_zip_file

    need_trust(path, facts)
    data, parameters, _ = load_from_zip_file(path, device="cpu")
    if data is None or "policy_class" not in data or "policy" not in parameters:
        raise ValueError(f"`{path}`: expected a file that a model of Stable-Baselines3 has saved")
    arguments, kind = dict(data["policy_kwargs"]), data["policy_class"]
    if data.get("use_sde") and "use_sde" in inspect.signature(kind.__init__).parameters:
        arguments["use_sde"] = True
    policy = kind(data["observation_space"], data["action_space"], lambda _: 0.0, **arguments)
    policy.load_state_dict(parameters["policy"])
    policy.set_training_mode(False)
    torch.set_num_threads(1)
    return read(policy, facts)


def _normalizer(model: Any) -> Any:
    """Return what scales the observations of a model that was trained with VecNormalize; None for others."""
    found = model.get_vec_normalize_env() if hasattr(model, "get_vec_normalize_env") else None
    return found.normalize_obs if found is not None and found.norm_obs else None


def _networks(policy: Any, outputs: str) -> tuple[Any, ...]:
    """Return the deterministic actors of a policy as numbers: one, or one for each agent."""
    actor = getattr(policy, "actor", policy)
    extractor = getattr(actor, "features_extractor", None)
    if extractor is not None and type(extractor).__name__ != "FlattenExtractor":
        raise NotFeedForward(f"its observations go through {type(extractor).__name__} first")
    mlp = getattr(policy, "mlp_extractor", None)
    if mlp is not None and hasattr(mlp, "actors"):  # networks of their own, last layers included
        return tuple(network_of([network], squashed=False, outputs=outputs) for network in mlp.actors)
    if mlp is not None:
        return (network_of([mlp.policy_net, policy.action_net], squashed=bool(policy.squash_output), outputs=outputs),)
    if hasattr(actor, "latent_pi"):
        return (network_of([actor.latent_pi, actor.mu], squashed=True),)
    if hasattr(actor, "mu"):
        return (network_of([actor.mu], outputs=outputs),)
    raise NotFeedForward(f"the actor of {type(policy).__name__} is of a kind that is not known")


def _remembering(policy: Any, scaled: Any) -> Any:
    """Return a recurrent policy as a function of rows and of what it remembers."""

    def step(rows: Any, remembered: Any) -> tuple[Any, Any]:
        begins = np.full(len(rows), remembered is None)
        told = rows if scaled is None else scaled(rows)
        actions, remembered = policy.predict(told, state=remembered, episode_start=begins, deterministic=True)
        return actions, remembered

    return step
