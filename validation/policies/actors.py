"""Trained actors as plain numbers: evaluated by numpy, stored as ``.npz`` with a JSON header, no pickle.

An actor is the deterministic part of a learned policy, a small network from a row of its view (``views``) to an action
in [-1, 1]. The shared actor is a decentralised policy (``synthesis.decentralised``), so it can be certified; the
central one sees all states and cannot.
"""

from __future__ import annotations

import io
import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...envs.agents import write_bytes
from ...envs.dynamics import Dynamics, Worlds, joint
from ...envs.problem import Problem
from ...envs.suite import as_problem
from ..simulation import BatchPolicy
from .rollout_policies import as_controller
from .views import CentralView, SharedView, View, inputs_of

Array = NDArray[Any]
VIEWS = {"shared": SharedView, "central": CentralView}
ACTIVATIONS: dict[str, Callable[[Array], Array]] = {"tanh": np.tanh, "relu": lambda x: np.maximum(x, 0.0)}


@dataclass(frozen=True, eq=False)
class Network:
    """Layers ``x -> x W' + b`` with an activation between them.

    Parameters
    ----------
    weights : tuple of (out, in) arrays
    biases : tuple of (out,) arrays
    activation : "tanh" or "relu"
    squashed : bool
        Whether the last layer goes through tanh (SAC); otherwise it is clipped to [-1, 1] (PPO).
    """

    weights: tuple[Array, ...]
    biases: tuple[Array, ...]
    activation: str
    squashed: bool

    def actions(self, rows: Array) -> Array:
        """Actions (N, m) in [-1, 1] for observations (N, n)."""
        hidden, apply = np.asarray(rows, dtype=np.float32), ACTIVATIONS[self.activation]
        for weight, bias in zip(self.weights[:-1], self.biases[:-1], strict=True):
            hidden = apply(hidden @ weight.T + bias)
        last = hidden @ self.weights[-1].T + self.biases[-1]
        return np.asarray(np.tanh(last) if self.squashed else np.clip(last, -1.0, 1.0))


@dataclass(frozen=True, eq=False)
class SharedActor:
    """One network for all agents of a problem, each with its own row: a decentralised policy.

    Parameters
    ----------
    problem : Problem
    network : Network
    """

    problem: Problem
    network: Network

    view = "shared"
    information = SharedView.information

    def inputs(self, agent: int, states: Array, q: Array, time: int) -> Array:
        """Inputs (m, N) of one agent at states (d, N)."""
        rows = SharedView(self.problem).agent_rows(agent, states, q, time)
        own = self.problem.agents[agent]
        return inputs_of(own, self.network.actions(rows)[:, : own.n_inputs].T.astype(float))

    def batch(self, dynamics: Dynamics) -> BatchPolicy:
        """The policy for batched rollouts."""
        return as_controller(self.problem, self).batch(dynamics)


@dataclass(frozen=True, eq=False)
class CentralActor:
    """One network that sees all states and moves all agents.

    Parameters
    ----------
    problem : Problem
    network : Network
    """

    problem: Problem
    network: Network

    view = "central"
    information = CentralView.information

    def batch(self, dynamics: Dynamics) -> BatchPolicy:
        """The policy for batched rollouts."""
        return _CentralBatch(self, dynamics)


@dataclass(frozen=True, eq=False)
class _CentralBatch:
    actor: CentralActor
    dynamics: Dynamics

    def begin(self, worlds: Worlds, rng: np.random.Generator) -> None:
        return None

    def act(self, worlds: Worlds, memory: Any) -> tuple[tuple[Array, ...], Any]:
        agents = self.dynamics.problem.agents
        rows = CentralView(self.dynamics.problem).observations(joint(self.dynamics, worlds), worlds.q, worlds.time)
        actions = self.actor.network.actions(rows).astype(float).T
        ends = np.cumsum([0, *(agent.n_inputs for agent in agents)])
        inputs = [inputs_of(agent, actions[a:b]) for agent, a, b in zip(agents, ends[:-1], ends[1:], strict=True)]
        return tuple(np.stack([inputs[i] for i in block.agents], axis=1) for block in self.dynamics.blocks), None


Actor = SharedActor | CentralActor


def actor_of(view: View, network: Network) -> Actor:
    """The actor of a view."""
    return (SharedActor if isinstance(view, SharedView) else CentralActor)(view.problem, network)


def save_actor(actor: Actor, path: str | Path, **header: Any) -> None:
    """Write an actor as ``.npz``; ``header`` is kept as JSON beside the numbers."""
    network = actor.network
    kept = {
        **header, "format": "certigym actor 1", "view": actor.view, "activation": network.activation,
        "squashed": network.squashed, "problem": actor.problem.name, "fingerprint": actor.problem.fingerprint,
    }  # fmt: skip
    arrays = {f"weight_{k}": w for k, w in enumerate(network.weights)}
    arrays |= {f"bias_{k}": b for k, b in enumerate(network.biases)}
    file = io.BytesIO()
    np.savez_compressed(file, allow_pickle=False, header=np.array(json.dumps(kept)), **arrays)
    write_bytes(path, file.getvalue())


class NotAnActor(ValueError):
    """A file holds no actor at all; it may hold something else."""


def load_actor(path: str | Path, problem: Any) -> Actor:
    """Read an actor for ``problem`` (a Problem, an id or a path).

    It may have been trained on another problem (another horizon, another start) as long as its sizes fit.

    Raises
    ------
    ValueError
        If the file holds no actor (``NotAnActor``), or its sizes are not those of the problem.
    """
    try:
        with np.load(path, allow_pickle=False) as stored:
            header = json.loads(str(stored["header"]))
            count = sum(name.startswith("weight_") for name in stored.files)
            weights = tuple(stored[f"weight_{k}"] for k in range(count))
            biases = tuple(stored[f"bias_{k}"] for k in range(count))
    except (KeyError, ValueError, EOFError) as error:
        raise NotAnActor(f"`{path}`: expected the file of an actor (.npz of `certigym train`)") from error
    if not count or header.get("view") not in VIEWS or header.get("activation") not in ACTIVATIONS:
        raise NotAnActor(f"`{path}`: expected the file of an actor (.npz of `certigym train`)")
    problem = as_problem(problem)
    view: View = VIEWS[header["view"]](problem)  # type: ignore[assignment]
    sizes = (weights[0].shape[1], weights[-1].shape[0])
    if sizes != (view.size, view.n_actions):
        raise ValueError(
            f"`{path}`: expected {view.size} observed numbers and {view.n_actions} actions for problem "
            f"{problem.name!r}, got {sizes[0]} and {sizes[1]}; it was trained on {header.get('problem')!r}"
        )
    return actor_of(view, Network(weights, biases, header["activation"], bool(header["squashed"])))
