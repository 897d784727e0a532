"""Feed-forward networks of torch read as layers: linear ones with one kind of activation between them, or nothing."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..relations.kinds import ACTIVATIONS, Network

Array = NDArray[Any]

SILENT = ("Identity", "Flatten", "Dropout")
"""Layers that do nothing to rows in evaluation."""

TORCH_ACTIVATIONS = {"Tanh": "tanh", "ReLU": "relu", "Sigmoid": "sigmoid", "ELU": "elu", "SiLU": "silu"}
"""Activations by the names of their classes."""

LEAKY = {"LeakyReLU": "negative_slope", "PReLU": "weight"}
"""Activations that are lines on both sides of 0, and the attribute that is their slope below it."""


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
    strange = sorted(set(kinds) - {"Linear", *TORCH_ACTIVATIONS, *LEAKY})
    if strange or set(kinds[::2]) != {"Linear"} or "Linear" in kinds[1::2] or len(kinds) % 2 == 0:
        shown = ", ".join(strange) or "a chain of " + (", ".join(kinds) or "no layers")
        known = ", ".join((*TORCH_ACTIVATIONS.values(), *LEAKY))
        raise NotFeedForward(f"expected linear layers with {known} between them, got {shown}")
    between = set(kinds[1::2])
    # What is a line on both sides of 0 becomes relus, so that all such kinds may stand beside each other.
    is_leaky = bool(between & LEAKY.keys())
    between = between - LEAKY.keys() | {"ReLU"} if is_leaky else between
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
    if is_leaky:
        slopes = [_slopes_below(layer, len(bias)) for layer, bias in zip(chain[1::2], biases, strict=False)]
        weights, biases = of_relus(weights, biases, slopes)
    if count is not None:
        weights[-1], biases[-1] = weights[-1][:count], biases[-1][:count]
    activation = TORCH_ACTIVATIONS[between.pop()] if between else "relu"
    assert activation in ACTIVATIONS
    return Network(tuple(weights), tuple(biases), activation, bool(squashed), "unit" if squashed else outputs)


def of_relus(
    weights: Sequence[Array], biases: Sequence[Array], slopes: Sequence[Array]
) -> tuple[list[Array], list[Array]]:
    """Return layers between which stand relus, as those between which stand lines with a kink at 0.

    A number z becomes relu(z) and relu(-z), of which ``z`` times the slope below 0 is the second one times ``-slope``.
    Single precision rounds both networks by less than certificates charge for (docs/theory/paths.md, "Networks").

    Parameters
    ----------
    weights, biases : sequence of (n', n) and (n',) arrays, float32
    slopes : sequence of (n',) arrays, float32
        Below 0, of each number of every layer but the last one.

    Examples
    --------
    >>> ones = np.ones((1, 1), np.float32)
    >>> of_relus([ones, ones], [ones[0], ones[0]], [np.float32([0.25])])[0][1]
    array([[ 1.  , -0.25]], dtype=float32)
    """
    wide, shifts = list(weights), list(biases)
    for k, slope in enumerate(slopes):
        below = np.flatnonzero(slope)
        wide[k] = np.concatenate([wide[k], -wide[k][below]])
        shifts[k] = np.concatenate([shifts[k], -shifts[k][below]])
        wide[k + 1] = np.concatenate([wide[k + 1], -(wide[k + 1] * slope)[:, below]], axis=1)
    return wide, shifts


def _slopes_below(activation: Any, size: int) -> Array:
    """Return the slopes (size,) below 0 of an activation that is a line on both sides of it."""
    slope = getattr(activation, LEAKY.get(type(activation).__name__, ""), 0.0)
    own = np.full(1, slope, np.float32) if isinstance(slope, float | int) else numbers(slope)
    if len(own) not in (1, size):
        raise ValueError(f"`model`: expected layers that fit together, got {len(own)} slopes of {size} numbers")
    return np.broadcast_to(own, (size,)).astype(np.float32)


def numbers(tensor: Any, size: int = 0) -> Any:
    """Return a copy of the numbers of a parameter; zeros for a bias that is not there."""
    if tensor is None:
        return np.zeros(size, dtype=np.float32)
    array = np.array(tensor.detach().cpu().numpy())
    if array.dtype != np.float32:
        raise NotFeedForward(f"expected weights of single precision (float32), got {array.dtype}")
    return array
