"""Trained actors as plain numbers: evaluated by numpy, stored as ``.npz`` with a JSON header and without pickle.

An actor is the deterministic part of a learned policy: a small network from a row of its view (``views``) to an action
in [-1, 1]. The shared actor, and a team of actors, are decentralised (``synthesis.controllers.decentralised``), so they
can be certified. The central actor sees the states of all agents, and can be certified along its run.
"""

from __future__ import annotations

import io
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...envs.simulation import Dynamics, Worlds, joint
from ...envs.suite import as_problem
from ...envs.systems.arguments import write_bytes
from ...envs.tasks.problem import Problem
from ...synthesis.interop import LocalBatch, NotAnActor, as_policy, stored
from ...synthesis.relations.kinds import JointNetworkPolicy, Network, NetworkPolicy, OwnView, inputs_of
from ..statistical_tests import BatchPolicy
from .views import CentralView, SharedView, View

Array = NDArray[Any]
VIEWS = {"shared": SharedView, "team": SharedView, "central": CentralView}

__all__ = ["Actor", "CentralActor", "NotAnActor", "SharedActor", "TeamActor", "actor_of", "load_actor", "networks_of",
           "save_actor"]  # fmt: skip

ACTOR_FORMAT = "certigym actor 1"
"""Name and version of the file format."""


@dataclass(frozen=True, eq=False)
class SharedActor:
    """One network that serves all agents of a problem, each with its row: a decentralised policy.

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
        """Return the inputs (m, N) of one agent at states (d, N), automaton states (N,) and a time."""
        return self.agent_policy(agent).inputs(states, q, time)

    def agent_policy(self, agent: int) -> NetworkPolicy:
        """Return the policy of one agent."""
        moved = self.problem.agents[agent]
        view = SharedView(self.problem).of_agent(agent)
        return NetworkPolicy(self.network, view, moved.workspace, moved.input_box)

    def batch(self, dynamics: Dynamics) -> BatchPolicy:
        """Return the policy for batched rollouts."""
        return LocalBatch(self, dynamics)


@dataclass(frozen=True, eq=False)
class TeamActor:
    """A network of its own for each agent of a problem: a decentralised policy.

    Parameters
    ----------
    problem : Problem
    networks : tuple of Network
        One per agent; each reads a row of ``SharedView``.
    """

    problem: Problem
    networks: tuple[Network, ...]

    view = "team"
    information = SharedView.information

    def inputs(self, agent: int, states: Array, q: Array, time: int) -> Array:
        """Return the inputs (m, N) of one agent at states (d, N), automaton states (N,) and a time."""
        return self.agent_policy(agent).inputs(states, q, time)

    def agent_policy(self, agent: int) -> NetworkPolicy:
        """Return the policy of one agent."""
        return SharedActor(self.problem, self.networks[agent]).agent_policy(agent)

    def batch(self, dynamics: Dynamics) -> BatchPolicy:
        """Return the policy for batched rollouts."""
        return LocalBatch(self, dynamics)


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

    def agent_policy(self, agent: int) -> NetworkPolicy | JointNetworkPolicy:
        """Return the policy of the only agent, or of one of several, which sees the states of all."""
        problem = self.problem
        if problem.n_agents > 1:
            policy: JointNetworkPolicy = as_policy(self.network, problem, "central_vec_env").agent_policy(agent)
            return policy
        alone = problem.agents[agent]
        view = OwnView(0, 0, alone.n_states, problem.automaton.n_states, problem.horizon)
        return NetworkPolicy(self.network, view, alone.workspace, alone.input_box)

    def batch(self, dynamics: Dynamics) -> BatchPolicy:
        """Return the policy for batched rollouts."""
        return _CentralBatch(self, dynamics)


@dataclass(frozen=True, eq=False)
class _CentralBatch:
    """A central actor arranged for batches; nothing is remembered."""

    actor: CentralActor
    dynamics: Dynamics

    def begin(self, worlds: Worlds, rng: np.random.Generator) -> None:
        return None

    def act(self, worlds: Worlds, memory: Any) -> tuple[tuple[Array, ...], Any]:
        problem = self.dynamics.problem
        rows = CentralView(problem).observations(joint(self.dynamics, worlds), worlds.q, worlds.time)
        actions = self.actor.network.actions(rows).astype(float).T
        pairs = zip(problem.agents, problem.input_columns, strict=True)
        inputs = [inputs_of(agent.input_box, actions[columns]) for agent, columns in pairs]
        return tuple(np.stack([inputs[i] for i in block.agents], axis=1) for block in self.dynamics.blocks), None


Actor = SharedActor | TeamActor | CentralActor


def actor_of(view: View, networks: tuple[Network, ...]) -> Actor:
    """Return the actor that sees what the view shows, with one network for all agents or with one for each."""
    if not isinstance(view, SharedView):
        return CentralActor(view.problem, networks[0])
    return SharedActor(view.problem, networks[0]) if len(networks) == 1 else TeamActor(view.problem, networks)


def networks_of(actor: Actor) -> tuple[Network, ...]:
    """Return the networks of an actor: one, or one for each agent."""
    return actor.networks if isinstance(actor, TeamActor) else (actor.network,)


def save_actor(actor: Actor, path: str | Path, **header: Any) -> None:
    """Write an actor as ``.npz``; the facts in ``header`` are stored as JSON beside the numbers."""
    networks = networks_of(actor)
    facts = {
        **header,
        "format": ACTOR_FORMAT,
        "view": actor.view,
        "activation": networks[0].activation,
        "squashed": networks[0].squashed,
        "problem": actor.problem.name,
        "fingerprint": actor.problem.fingerprint,
    }
    # The archive is made in memory, so that the file is written completely or not at all.
    # The layers of a team follow one another, agent by agent; all agents have the same number of them.
    arrays = {f"weight_{k}": w for k, w in enumerate(w for network in networks for w in network.weights)}
    arrays |= {f"bias_{k}": b for k, b in enumerate(b for network in networks for b in network.biases)}
    file = io.BytesIO()
    np.savez_compressed(file, allow_pickle=False, header=np.array(json.dumps(facts)), **arrays)
    write_bytes(path, file.getvalue())


def load_actor(path: str | Path, problem: Any) -> Actor:
    """Read an actor for ``problem`` (a Problem, an id or a path).

    The actor may have been trained on another problem (another horizon or start, say) if its sizes fit.

    Raises
    ------
    ValueError
        If the file holds no actor (``NotAnActor``), or if the sizes of the actor do not fit the problem.
    """
    problem = as_problem(problem)
    header, networks = stored(path, problem.n_agents)
    # The first layer fixes the size of observations, the last one that of actions.
    view: View = VIEWS[header["view"]](problem)  # type: ignore[assignment]
    weights = networks[0].weights
    sizes = (weights[0].shape[1], weights[-1].shape[0])
    if sizes != (view.size, view.n_actions):
        raise ValueError(
            f"`{path}`: expected {view.size} observed numbers and {view.n_actions} actions for problem "
            f"{problem.name!r}, got {sizes[0]} and {sizes[1]}; it was trained on {header.get('problem')!r}"
        )
    return actor_of(view, networks)
