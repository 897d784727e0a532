"""What a reader finds in a model of another library, before it is known what the model sees."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from ..relations.kinds import Network

Array = NDArray[Any]

REMEMBERS = (
    "it remembers earlier observations, and is measured by rollouts (`compare`, `rollout`), not certified, because a "
    "proof follows a function of the present observation"
)
"""Why policies with a memory are not certified, and what to do with them."""

ELSE = "measure it by rollouts (`compare`, `rollout`), or certify what it becomes on cells (`wrap=True`, `--wrap`)"
"""What to do with networks that are not certified as they are."""

Act = Callable[[Array], Any]
"""Rows (N, n) to actions (N, m), as the library itself computes them in evaluation."""


class Memory(Protocol):
    """A model that remembers earlier rows of an episode."""

    def __call__(self, rows: Array, remembered: Any) -> tuple[Any, Any]:
        """Return actions (N, m) for rows (N, n), and what is remembered next; None is remembered at first."""


@dataclass(frozen=True, eq=False)
class Detected:
    """A model as its reader understands it.

    Parameters
    ----------
    name : str
        What it is, in words.
    observed, answered : int or None
        Numbers of a row and of an answer; None where the library does not say.
    act : callable, optional
        The model itself; None for one that remembers.
    memory : callable, optional
        The model itself if it remembers earlier rows.
    networks : tuple of Network
        What it computes, if it is a feed-forward network that can be certified as it is: one, or one for each agent.
    why_not : str
        Why there are no networks.
    space, action_space : pair of arrays, optional
        Ends of the spaces that it was trained with, where the library keeps them.
    shares : bool
        Whether answers in [-1, 1] stand for the input box whatever the actions of the environment are.
    """

    name: str
    observed: int | None = None
    answered: int | None = None
    act: Act | None = None
    memory: Memory | None = None
    networks: tuple[Network, ...] = ()
    why_not: str = ""
    space: tuple[Array, Array] | None = None
    action_space: tuple[Array, Array] | None = None
    shares: bool = False

    def __getstate__(self) -> dict[str, Any]:
        """Send networks to workers without the model itself, which they do not need and which may not be pickled."""
        return {**vars(self), "act": None} if self.networks else vars(self)


class Reader(Protocol):
    """What is known of one library: a module of this room with these names."""

    SAYS: str

    def recognises(self, model: Any) -> bool:
        """Return whether a model is one of this library, without importing the library."""

    def read(self, model: Any, facts: dict[str, Any]) -> Detected:
        """Return what the model is; ``facts`` are what its file or its user says beside it."""


def need_trust(path: Path, facts: dict[str, Any]) -> None:
    """Raise ValueError for a file that has to be unpickled, which runs code that is in it, and is not trusted."""
    if not facts.get("trust", True):
        raise ValueError(
            f"`{path}`: expected a file without code, got one that runs code as it is read (pickle); if you trust "
            "whoever wrote it, give --trust (in Python `as_policy(path, problem, trust=True)`), else ask for .onnx or "
            ".npz"
        )


def origins(model: Any) -> frozenset[str]:
    """Return the names of the packages in which the classes of an object are defined: nothing is imported for it."""
    return frozenset(kind.__module__.partition(".")[0] for kind in type(model).__mro__)


def agreed(found: Detected, tolerance: float = 1e-5) -> Detected:
    """Return what was found, without its network if that does not compute what the model itself does.

    Both are asked about some rows. They must agree up to rounding in single precision: then the network is that of the
    model, as far as its structure and these rows tell.
    """
    if len(found.networks) != 1 or found.act is None:
        return found
    network = found.networks[0]
    rows = np.random.default_rng(0).uniform(-1.0, 1.0, (64, network.weights[0].shape[1])).astype(np.float32)
    own, theirs = network.actions(rows), np.asarray(found.act(rows), dtype=float)
    if found.action_space is not None:
        low, high = found.action_space
        if network.outputs == "box":
            own = np.clip(own, low, high)
        elif network.squashed:  # tanh, moved onto the space of actions
            own = low + 0.5 * (own + 1.0) * (high - low)
    apart = float(np.max(np.abs(own - theirs))) if own.shape == theirs.shape else np.inf
    if apart <= tolerance * max(1.0, float(np.max(np.abs(theirs)))):
        return found
    why = f"its layers do not compute what it answers (a difference of {apart:.2g} on some rows)"
    return without_networks(found, why)


def without_networks(found: Detected, why: str) -> Detected:
    """Return the same model as one that is not certified as it is, and why."""
    facts = {name: getattr(found, name) for name in Detected.__dataclass_fields__}
    return Detected(**{**facts, "networks": (), "why_not": why})
