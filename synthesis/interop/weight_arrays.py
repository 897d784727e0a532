"""Networks as arrays: parameters of JAX, flax or anything else that computes ``x @ W + b`` with one activation between.

    [(W, b), (W, b), ...]                       layers with W of shape (inputs, outputs)
    {"params": {"Dense_0": {"kernel", "bias"}}}  parameters of flax, in the order of their numbers
    {"weights": [...], "biases": [...]}          layers with W of shape (outputs, inputs), as torch has them
    Network                                      a network of this package

The activation and whether tanh follows the outputs are said beside them: ``as_policy(..., activation="relu",
squashed=True)``; by default tanh between layers, and outputs that are clipped.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ..relations.kinds import ACTIVATIONS, Network
from .detected import Detected

SAYS = "layers as arrays [(W, b), ...]"


def recognises(model: Any) -> bool:
    """Return whether a model is a network, or layers as arrays."""
    if isinstance(model, Network):
        return True
    if isinstance(model, Mapping):
        return {"weights", "biases"} <= set(model) or bool(_dense(model))
    return isinstance(model, Sequence) and bool(model) and all(_is_layer(pair) for pair in model)


def read(model: Any, facts: dict[str, Any]) -> Detected:
    """Return what arrays are."""
    network = model if isinstance(model, Network) else _network(model, facts)
    shape = network.weights[0].shape[1], network.weights[-1].shape[0]
    why = ""
    if any(array.dtype != np.float32 for array in (*network.weights, *network.biases)):
        why = "expected weights of single precision (float32), got others"
    # What is clipped, and to what, the environment decides.
    act = (network if network.squashed else replace(network, outputs="box")).actions
    return Detected("a network given as arrays", *shape, act=act, networks=() if why else (network,), why_not=why)


def _network(model: Any, facts: dict[str, Any]) -> Network:
    """Return arrays as a network."""
    if isinstance(model, Mapping) and "weights" in model:
        pairs = [(np.asarray(w), np.asarray(b)) for w, b in zip(model["weights"], model["biases"], strict=True)]
        facts = {**{k: model[k] for k in ("activation", "squashed") if k in model}, **facts}
    else:
        layers = _dense(model) if isinstance(model, Mapping) else model
        pairs = [(np.asarray(w).T, np.asarray(b)) for w, b in layers]
    activation, squashed = facts.get("activation", "tanh"), bool(facts.get("squashed", False))
    if activation not in ACTIVATIONS:
        raise ValueError(f"`activation`: expected {' or '.join(map(repr, ACTIVATIONS))}, got {activation!r}")
    before = None
    for k, (weight, bias) in enumerate(pairs):
        if weight.ndim != 2 or bias.shape != weight.shape[:1] or before not in (None, weight.shape[1]):
            raise ValueError(
                f"`model`: expected layers that fit together, got weights {weight.shape} (outputs, inputs) and biases "
                f"{bias.shape} in layer {k}"
            )
        before = len(weight)
    return Network(tuple(w for w, _ in pairs), tuple(b for _, b in pairs), activation, squashed)


def _is_layer(pair: Any) -> bool:
    """Whether something is a pair of a matrix and a vector."""
    return isinstance(pair, Sequence) and len(pair) == 2 and [getattr(part, "ndim", None) for part in pair] == [2, 1]


def _dense(model: Mapping[Any, Any]) -> list[tuple[Any, Any]]:
    """Return the dense layers of parameters of flax in the order of their numbers; none if there are other layers."""
    layers = model.get("params", model)
    if not isinstance(layers, Mapping) or not layers:
        return []
    if not all(isinstance(layer, Mapping) and set(layer) == {"kernel", "bias"} for layer in layers.values()):
        return []
    numbered = sorted(layers.items(), key=lambda item: [int(n) for n in re.findall(r"\d+", str(item[0]))])
    return [(layer["kernel"], layer["bias"]) for _, layer in numbered]
