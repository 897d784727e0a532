"""Modules of torch: chains of layers, modules with an actor inside (CleanRL), and any other that maps rows to actions.

A module answers with actions, which environments clip, or with what a tanh at its end makes of them. These members are
taken for the deterministic actor, the first that there is: ``actor_mean`` and ``actor`` (PPO of CleanRL), ``fc_mean``
and ``fc_mu`` behind ``fc1``, ``fc2`` (its SAC, DDPG and TD3), ``mean_net``, ``mu``, ``pi``.
"""

from __future__ import annotations

import pickle
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from .detected import Detected, agreed, need_trust, origins
from .layers import NotFeedForward, network_of

SAYS = "modules of torch (.pt)"

ACTORS = ("actor_mean", "actor", "mean_net", "mu", "pi")
"""Members that are the deterministic actor of a module."""


def recognises(model: Any) -> bool:
    """Return whether a model is a module of torch."""
    return "torch" in origins(model) and hasattr(model, "state_dict") and callable(model)


def read(model: Any, facts: dict[str, Any]) -> Detected:
    """Return what a module is; ``facts["squashed"]`` says whether tanh follows its outputs."""
    name = f"the torch module {type(model).__name__}"
    actor, squashed = model, facts.get("squashed")
    if hasattr(model, "fc_mean") or hasattr(model, "fc_mu"):
        return _of_clean_rl(model, name)
    for member in ACTORS:
        if recognises(getattr(model, member, None)):
            actor = getattr(model, member)
            break
    layers = [layer for layer in actor.modules() if hasattr(layer, "in_features")]
    sizes = {"observed": layers[0].in_features, "answered": layers[-1].out_features} if layers else {}

    def act(rows: Any) -> Any:
        answer = _asked(actor, rows)
        return np.tanh(answer) if squashed else answer

    try:
        network = network_of([actor], squashed=squashed)
    except NotFeedForward as error:
        return Detected(name, act=act, why_not=str(error), **sizes)
    sizes = {"observed": network.weights[0].shape[1], "answered": network.weights[-1].shape[0]}
    # The environment clips what is not squashed, so that such a network is compared before it clips.
    plain = network if network.squashed else replace(network, outputs="box")
    found = agreed(Detected(name, act=act, networks=(plain,), **sizes))
    return Detected(name, act=act, networks=(network,) if found.networks else (), why_not=found.why_not, **sizes)


def read_file(path: Path, facts: dict[str, Any]) -> Detected:
    """Return what a file of ``torch.save(module)`` holds. Such files are unpickled: read only those that you trust."""
    import torch

    try:  # numbers alone, which run nothing
        model = torch.load(path, map_location="cpu", weights_only=True)
    except (pickle.UnpicklingError, RuntimeError):
        need_trust(path, facts)
        model = torch.load(path, map_location="cpu", weights_only=False)
    if not recognises(model):
        raise ValueError(
            f"`{path}`: expected a whole module of torch, got {type(model).__name__}; load the numbers into their "
            "module, and give that, or save it whole: torch.save(module, path)"
        )
    return read(model, facts)


def _of_clean_rl(model: Any, name: str) -> Detected:
    """Return the actor of CleanRL's SAC, DDPG or TD3: two relu layers, tanh, and the scale of the input box."""
    last = model.fc_mean if hasattr(model, "fc_mean") else model.fc_mu
    first = model.fc1
    sizes = {"observed": first.in_features, "answered": last.out_features}
    scale, bias = (np.asarray(getattr(model, k).detach().cpu()).reshape(-1) for k in ("action_scale", "action_bias"))

    def act(rows: Any) -> Any:
        answer = _asked(model, rows)
        return np.tanh(answer) * scale + bias if hasattr(model, "fc_mean") else answer

    space = (bias - scale, bias + scale)
    import torch

    layers = [first, torch.nn.ReLU(), model.fc2, torch.nn.ReLU(), last]
    return agreed(Detected(name, act=act, networks=(network_of(layers, squashed=True),), action_space=space, **sizes))


def _asked(module: Any, rows: Any) -> Any:
    """Return the answer of a module in evaluation, the first one if there are several."""
    import torch

    first = next(module.parameters(), torch.zeros(0))
    was = module.training
    module.eval()
    try:
        with torch.no_grad():
            answer = module(torch.as_tensor(np.asarray(rows)).to(first))
    finally:
        module.train(was)
    answer = answer[0] if isinstance(answer, tuple) else answer
    return answer.cpu().numpy()
