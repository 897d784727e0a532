"""Policies of TorchRL and BenchMARL: modules that read and write dictionaries of tensors.

They are asked deterministically. A policy reads ``observation``, or the group of agents that one key holds.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from .found import Found, agreed, origins
from .layers import NotFeedForward, network_of

SAYS = "of TorchRL"


def recognises(model: Any) -> bool:
    """Return whether a model is a module of tensordict."""
    return "tensordict" in origins(model) and hasattr(model, "in_keys")


def read(model: Any, facts: dict[str, Any]) -> Found:
    """Return what a policy is; ``facts["key"]`` and ``facts["answer"]`` name what it reads and writes."""
    seen = [key for key in model.in_keys if "observation" in _words(key)] or list(model.in_keys)
    done = [key for key in model.out_keys if "action" in _words(key)] or list(model.out_keys)
    key, answer = facts.get("key", seen[0]), facts.get("answer", done[0])
    name = f"the TorchRL policy {type(model).__name__}"
    linear = [layer for layer in model.modules() if hasattr(layer, "in_features")]
    if not linear:
        return Found(name, act=_asked(model, key, answer), why_not="its layers are of a kind that is not known")
    observed = int(linear[0].in_features)
    act = _asked(model, key, answer)
    answered = int(np.asarray(act(np.zeros((1, observed), dtype=np.float32))).shape[1])
    found = Found(name, observed, answered, act=act)
    # Means come first where a layer answers with means and deviations.
    why = "its layers are of a kind that is not known"
    for part in model.modules():
        if type(part).__name__ not in ("MLP", "Sequential"):
            continue
        chain = [layer for layer in part if type(layer).__name__ not in ("NormalParamExtractor",)]
        for squashed in (True, False):
            try:
                network = network_of(chain, squashed=squashed, count=answered)
            except NotFeedForward as error:
                why = str(error)
                continue
            if network.weights[0].shape[1] != observed or len(network.biases[-1]) != answered:
                continue
            tried = agreed(Found(name, observed, answered, act=act, networks=(network,)))
            if tried.networks:
                return tried
            why = tried.why_not
    return Found(name, observed, answered, act=found.act, why_not=why)


def _words(key: Any) -> tuple[str, ...]:
    """Return a key of a nested dictionary as its words."""
    return key if isinstance(key, tuple) else (key,)


def _asked(model: Any, key: Any, answer: Any) -> Any:
    """Return a policy as a function of rows."""

    def act(rows: Any) -> Any:
        import torch
        from tensordict import TensorDict
        from tensordict.nn import InteractionType, set_interaction_type

        first = next(model.parameters(), torch.zeros(0))
        told = TensorDict({}, batch_size=[len(rows)], device=first.device)
        told.set(key, torch.as_tensor(np.asarray(rows)).to(first))
        was = model.training
        model.eval()
        with torch.no_grad(), set_interaction_type(InteractionType.DETERMINISTIC):
            result = model(told).get(answer)
        model.train(was)
        return result.reshape(len(rows), -1).cpu().numpy()

    return act
