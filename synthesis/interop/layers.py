"""Feed-forward networks of torch read as layers: linear ones with one kind of activation between them, or nothing."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np

from ..relations.kinds import ACTIVATIONS, Network

SILENT = ("Identity", "Flatten", "Dropout")
"""Layers that do nothing to rows in evaluation."""

TORCH_ACTIVATIONS = {"Tanh": "tanh", "ReLU": "relu", "Sigmoid": "sigmoid", "ELU": "elu", "SiLU": "silu"}
"""Activations by the names of their classes."""


class NotFeedForward(ValueError):
    """A model has layers that cannot be certified as they are; the text says which."""


def flat(module: Any) -> Iterator[Any]:
    """Yield the layers of a module, those of sequences one by one."""
    if "Sequential" in {kind.__name__ for kind in type(module).__mro__}:
        for layer in module:
            yield from flat(layer)
    elif type(module).__name__ not in SILENT:
        yield module


def network_of(
    layers: Iterable[Any], *, squashed: bool | None = None, outputs: str = "unit", count: int | None = None
) -> Network:
    """Return layers of torch as a network with the very same numbers.

    Parameters
    ----------
    layers : iterable of modules
    squashed : bool, optional
        Whether tanh follows; by default that is so if the last layer is a Tanh.
    outputs : "unit" or "box"
    count : int, optional
        How many outputs count, the first ones; default: all.

    Raises
    ------
    NotFeedForward
        If there is another kind of layer, an activation of another kind, or weights of double precision.
    ValueError
        If a layer takes another number of inputs than the one before it gives.
    """
    chain = [layer for given in layers for layer in flat(given)]
    kinds = [type(layer).__name__ for layer in chain]
    if kinds and kinds[-1] == "Tanh":
        chain, kinds, squashed = chain[:-1], kinds[:-1], True
    linear, between = kinds[::2], set(kinds[1::2])
    strange = sorted({kind for kind in linear if kind != "Linear"} | (between - TORCH_ACTIVATIONS.keys()))
    if strange or len(kinds) % 2 == 0:
        shown = ", ".join(strange) or "no linear layer at its end"
        known = ", ".join(TORCH_ACTIVATIONS.values())
        raise NotFeedForward(f"expected linear layers with {known} between them, got {shown}")
    if len(between) > 1:
        shown = " and ".join(sorted(between))
        raise NotFeedForward(f"expected one kind of activation between linear layers, got {shown}")
    if any(getattr(layer, "alpha", 1.0) != 1.0 for layer in chain[1::2]):
        raise NotFeedForward("expected an ELU with alpha = 1, got another one")
    pairs = [(numbers(layer.weight), numbers(layer.bias, len(layer.weight))) for layer in chain[::2]]
    weights, biases = [weight for weight, _ in pairs], [bias for _, bias in pairs]
    for first, second in itertools.pairwise(weights):
        if len(first) != second.shape[1]:
            raise ValueError(f"`model`: expected layers that fit together, got {len(first)} outputs before "
                             f"{second.shape[1]} inputs")  # fmt: skip
    if count is not None:
        weights[-1], biases[-1] = weights[-1][:count], biases[-1][:count]
    activation = TORCH_ACTIVATIONS[between.pop()] if between else "relu"
    assert activation in ACTIVATIONS
    return Network(tuple(weights), tuple(biases), activation, bool(squashed), "unit" if squashed else outputs)


def numbers(tensor: Any, size: int = 0) -> Any:
    """Return a copy of the numbers of a parameter; zeros for a bias that is not there."""
    if tensor is None:
        return np.zeros(size, dtype=np.float32)
    array = np.array(tensor.detach().cpu().numpy())
    if array.dtype != np.float32:
        raise NotFeedForward(f"expected weights of single precision (float32), got {array.dtype}")
    return array
