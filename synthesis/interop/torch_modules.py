"""Modules of torch: chains of layers, modules with an actor inside (CleanRL), and any other that maps rows to actions.

A module answers with actions, which environments clip, or with what a tanh at its end makes of them. One with recurrent
layers takes rows and what it remembers, and answers with actions and what it remembers next. The first member of these
that there is is taken for the deterministic actor: ``actor_mean`` and ``actor`` (PPO of CleanRL), ``fc_mean`` and
``fc_mu`` behind ``fc1``, ``fc2`` (its SAC, DDPG and TD3), ``mean_net``, ``mu``, ``pi``.
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

RECURRENT = {"RNNBase", "RNNCellBase"}
"""Classes of torch from which recurrent layers are made: RNN, GRU, LSTM, and their cells."""


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
    for own in (actor, model):
        if any(_is_recurrent(layer) for layer in own.modules()):
            return _of_recurrent(own, name)
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


def _is_recurrent(layer: Any) -> bool:
    return bool(RECURRENT & {kind.__name__ for kind in type(layer).__mro__})


def _of_recurrent(model: Any, name: str) -> Detected:
    """Return a module with recurrent layers, which rollouts judge: it is told rows and what it remembers."""
    layers = [layer for layer in model.modules() if _is_recurrent(layer) or hasattr(layer, "in_features")]
    first, last = layers[0], layers[-1]
    sizes = {"observed": getattr(first, "in_features", None) or first.input_size}
    sizes["answered"] = getattr(last, "out_features", None) or last.hidden_size
    # Sequences of one row for each world have an axis of time; cells have none.
    sequences = [layer for layer in layers if hasattr(layer, "batch_first")]
    axis = int(sequences[0].batch_first) if sequences else None

    def step(rows: Any, remembered: Any) -> tuple[Any, Any]:
        told = np.asarray(rows) if axis is None else np.expand_dims(rows, axis)
        answer = _answer_of(model, told, *(() if remembered is None else (remembered,)))
        if not isinstance(answer, tuple) or len(answer) != 2:
            raise ValueError(
                f"`model`: expected recurrent layers to answer with actions and what they remember, got "
                f"{type(answer).__name__} from {name}"
            )
        actions, kept = answer
        return (actions if axis is None else actions.squeeze(axis)).cpu().numpy(), kept

    return Detected(name, memory=step, why_not="it remembers earlier observations", **sizes)


def _answer_of(module: Any, rows: Any, *more: Any) -> Any:
    """Return all that a module answers in evaluation."""
    import torch

    first = next(module.parameters(), torch.zeros(0))
    was = module.training
    module.eval()
    try:
        with torch.no_grad():
            return module(torch.as_tensor(np.asarray(rows)).to(first), *more)
    finally:
        module.train(was)


def _asked(module: Any, rows: Any) -> Any:
    """Return the answer of a module in evaluation, the first one if there are several."""
    answer = _answer_of(module, rows)
    answer = answer[0] if isinstance(answer, tuple) else answer
    return answer.cpu().numpy()
