"""Actors of ``certigym train``: files ``.npz`` with a JSON header, weights and biases, read without pickle."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from ..relations.kinds import ACTIVATIONS, Network
from .detected import Detected

ENVS = {"shared": "shared_vec_env", "team": "shared_vec_env", "central": "central_vec_env"}
"""What actors see, by the view that their header names."""


class NotAnActor(ValueError):
    """A file holds no actor; it may hold something else, such as a certificate."""


def stored(path: str | Path, agents: int) -> tuple[dict[str, Any], tuple[Network, ...]]:
    """Return the header of a file, and its networks: one, or of a team one for each of so many agents.

    Raises
    ------
    ValueError
        If the file holds no actor (``NotAnActor``), or a team of another size.
    """
    try:
        with np.load(path, allow_pickle=False) as file:
            header = json.loads(str(file["header"]))
            count = sum(name.startswith("weight_") for name in file.files)
            weights = tuple(file[f"weight_{k}"] for k in range(count))
            biases = tuple(file[f"bias_{k}"] for k in range(count))
    except (KeyError, ValueError, EOFError) as error:
        raise NotAnActor(f"`{path}`: expected the file of an actor (.npz of `certigym train`)") from error
    # Certificates are .npz files, too: a file without the fields of an actor is not an actor.
    if not count or header.get("view") not in ENVS or header.get("activation") not in ACTIVATIONS:
        raise NotAnActor(f"`{path}`: expected the file of an actor (.npz of `certigym train`)")
    teams = agents if header["view"] == "team" else 1
    if count % teams:
        raise ValueError(f"`{path}`: expected a network for each of {teams} agents; it has {count} layers in all")
    kind, depth = (header["activation"], bool(header["squashed"])), count // teams
    cuts = [slice(first, first + depth) for first in range(0, count, depth)]
    return header, tuple(Network(weights[cut], biases[cut], *kind) for cut in cuts)


def read_actor(path: Path, agents: int) -> tuple[Detected, str]:
    """Return what a file holds, and the environment in which it was trained."""
    header, networks = stored(path, agents)
    sizes = networks[0].weights[0].shape[1], networks[0].weights[-1].shape[0]
    act = networks[0].actions if len(networks) == 1 else None
    return Detected(f"the actor in {path.name}", *sizes, act=act, networks=networks), ENVS[header["view"]]
