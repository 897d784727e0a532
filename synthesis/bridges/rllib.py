"""RLlib: modules of the new API stack (``RLModule``), algorithms, and checkpoints (folders).

A module answers with means and logarithms of deviations; the mean, cut to [-1, 1], stands for the input box
(``normalize_actions``, the default of RLlib).
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from .found import Found, agreed, need_trust, origins
from .layers import NotFeedForward, network_of

SAYS = "of RLlib (folders)"


def recognises(model: Any) -> bool:
    """Return whether a model is a module or an algorithm of RLlib."""
    return "ray" in origins(model) and (hasattr(model, "forward_inference") or hasattr(model, "get_module"))


def read(model: Any, facts: dict[str, Any]) -> Found:
    """Return what a module is; ``facts["module"]`` names one of an algorithm that has several."""
    module = model if hasattr(model, "forward_inference") else model.get_module(facts.get("module", "default_policy"))
    if not hasattr(module, "forward_inference"):
        raise ValueError("`model`: expected the name of a module of the algorithm, as in `as_policy(..., module=NAME)`")
    if hasattr(module, "is_stateful") and module.is_stateful():
        raise ValueError("`model`: expected a module of RLlib without memory, got a recurrent one; give a callable")
    space, actions = module.observation_space, module.action_space
    answered = int(actions.shape[0])
    common: dict[str, Any] = {
        "name": f"the RLlib module {type(module).__name__}",
        "observed": int(space.shape[0]),
        "answered": answered,
        "space": (np.asarray(space.low), np.asarray(space.high)),
        "shares": True,
    }
    act, why = _asked(module, answered), "its layers are of a kind that is not known"
    encoder, head = getattr(module, "encoder", None), getattr(module, "pi", None)
    try:
        inner = [layer for part in (getattr(encoder, "actor_encoder", encoder), head) for layer in _layers(part)]
        return agreed(Found(act=act, networks=(network_of(inner, count=answered),), **common))
    except NotFeedForward as error:
        why = str(error)
    return Found(act=act, why_not=why, **common)


def read_file(path: Path, facts: dict[str, Any]) -> Found:
    """Return what a checkpoint holds: a folder of a module, or of an algorithm. It is unpickled: trust it."""
    need_trust(path, facts)
    from ray.rllib.core.rl_module.rl_module import RLModule

    name = facts.get("module", "default_policy")
    inner = path / "learner_group" / "learner" / "rl_module" / name
    return read(RLModule.from_checkpoint(str((inner if inner.is_dir() else path).absolute())), facts)


def _layers(part: Any) -> list[Any]:
    """Return the layers of a part of a module, in the order in which they were made."""
    kinds = ("Linear", "Tanh", "ReLU", "LayerNorm")
    return [] if part is None else [layer for layer in part.modules() if type(layer).__name__ in kinds]


def _asked(module: Any, answered: int) -> Any:
    """Return a module as a function of rows: means, cut to [-1, 1]."""

    def act(rows: Any) -> Any:
        import torch

        with torch.no_grad():
            answer = module.forward_inference({"obs": torch.as_tensor(np.asarray(rows, dtype=np.float32))})
        means = answer["action_dist_inputs"].cpu().numpy()[:, :answered]
        return np.clip(means, -1.0, 1.0)

    return act
