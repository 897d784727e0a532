"""Policies of Tianshou 2: asked as its collectors ask them in a test, deterministically and mapped to the input box."""

from __future__ import annotations

from typing import Any

import numpy as np

from .found import Found, agreed, origins
from .layers import NotFeedForward, network_of

SAYS = "of Tianshou"


def recognises(model: Any) -> bool:
    """Return whether a model is a policy or an algorithm of Tianshou."""
    return "tianshou" in origins(model) and (hasattr(model, "map_action") or hasattr(model, "policy"))


def read(model: Any, facts: dict[str, Any]) -> Found:
    """Return what a policy is."""
    policy = model if hasattr(model, "map_action") else model.policy
    space = policy.action_space
    ends = np.asarray(space.low), np.asarray(space.high)
    linear = [layer for layer in policy.actor.modules() if hasattr(layer, "in_features")]
    observed, answered = int(linear[0].in_features), int(ends[0].shape[0])
    common: dict[str, Any] = {"observed": observed, "answered": answered, "action_space": ends}
    name = f"{type(model).__name__} of Tianshou"
    act, why = _asked(policy), "its layers are of a kind that is not known"
    # The last linear layers of an actor are means, then perhaps deviations: what agrees with the policy is its network.
    hidden = [layer for layer in policy.actor.modules() if type(layer).__name__ in ("Linear", "Tanh", "ReLU")]
    outputs = "unit" if np.all(ends[0] == -1.0) and np.all(ends[1] == 1.0) else "box"
    for stop in range(len(hidden), 0, -1):
        for squashed in (True, False):
            try:
                network = network_of(hidden[:stop], squashed=squashed, outputs=outputs)
            except NotFeedForward as error:
                why = str(error)
                continue
            if len(network.biases[-1]) != answered:
                continue
            found = agreed(Found(name, act=act, networks=(network,), **common))
            if found.networks:
                return found
            why = found.why_not
    return Found(name, act=act, why_not=why, **common)


def _asked(policy: Any) -> Any:
    """Return a policy as a function of rows."""

    def act(rows: Any) -> Any:
        import torch
        from tianshou.data import Batch

        was = policy.training
        policy.eval()
        if hasattr(policy, "is_within_training_step"):
            policy.is_within_training_step = False
        try:
            with torch.no_grad():
                answer = policy(Batch(obs=np.asarray(rows, dtype=np.float32), info=Batch()))
        finally:
            policy.train(was)
        return np.asarray(policy.map_action(answer.act.detach().cpu().numpy()))

    return act
