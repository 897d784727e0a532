"""Problems, networks and changed certificates for the tests of networks as they are."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from numpy.typing import NDArray

import certigym as cg
from certigym.envs.systems.agents import LinearAgent
from certigym.synthesis.certificates.proofs import changed
from certigym.synthesis.relations.kinds import Network
from certigym.validation.policies.actors import SharedActor
from certigym.validation.policies.views import SharedView

RNG = np.random.default_rng(0)


def network(sizes: list[int], activation: str = "tanh", squashed: bool = False, scale: float = 1.5) -> Network:
    """A random network whose outputs reach both ends of the input box."""
    pairs = list(zip(sizes[:-1], sizes[1:], strict=True))
    weights = tuple((scale * RNG.normal(size=(b, a)) / np.sqrt(a)).astype(np.float32) for a, b in pairs)
    biases = tuple((0.3 * RNG.normal(size=b)).astype(np.float32) for _, b in pairs)
    return Network(weights, biases, activation, squashed)


def reach(*agents: LinearAgent, horizon: int = 4) -> cg.Problem:
    """All agents are to be in [1, 3] on their first axes at the same time."""
    regions = {}
    for agent in agents:
        low, high = np.array(agent.workspace.low), np.array(agent.workspace.high)
        low[0], high[0] = 1.0, 3.0
        regions[f"p_{agent.name}"] = cg.Proposition(agent.name, low.tolist(), high.tolist())
    return cg.Problem(
        name="reach",
        horizon=horizon,
        agents=list(agents),
        propositions=regions,
        specification=cg.Specification(f"F ({' & '.join(regions)})", "co-safe"),
    )


def proportional(problem: cg.Problem, hidden: int = 8) -> SharedActor:
    """A sensible policy: every agent goes to 2 on its first axis, by a tanh network with two hidden layers."""
    view = SharedView(problem)
    width = np.zeros((hidden, view.size), dtype=np.float32)
    width[:, 0] = RNG.uniform(0.5, 1.0, hidden)
    bias = (-0.5 * width[:, 0]).astype(np.float32)  # the goal is half way from the middle to the upper end
    deep = (np.eye(hidden) + 0.02 * RNG.normal(size=(hidden, hidden))).astype(np.float32)
    out = np.full((view.n_actions, hidden), -4.0 / hidden, dtype=np.float32)
    zeros = np.zeros(hidden, dtype=np.float32), np.zeros(view.n_actions, dtype=np.float32)
    return SharedActor(problem, Network((width, deep, out), (bias, *zeros), "tanh", False))


def means_at(problem: cg.Problem, actor: Any, agent: int, states: NDArray, q: int, t: int) -> NDArray:
    """Means (d, N) under the deployed network, in single precision."""
    inputs = actor.inputs(agent, states, np.full(states.shape[1], q), t)
    return np.asarray(problem.agents[agent].mean(states, inputs))


def with_network(certificate: cg.Certificate, **facts: Any) -> cg.Certificate:
    """The certificate with other facts about its networks."""
    parts = []
    for part in certificate.proof.agents:
        relation = {**part.relation, "network": {**part.relation["network"], **facts}}
        parts.append(dataclasses.replace(part, relation=relation))
    return changed(certificate, agents=tuple(parts))
