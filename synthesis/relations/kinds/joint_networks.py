"""Networks that see states of all agents: central ones, and those that see neighbours in a fixed order.

A row is affine in the joint state, ``V x + b``, and holds the automaton state (one-hot) and the share of time left.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from ....envs.systems.agents import AnyAgent, Box
from ..grids import FloatArray
from .networks import ACTIVATIONS, OUTPUTS, Array, Network, NetworkPolicy, answered, write_task


@dataclass(frozen=True, eq=False)
class JointNetworkPolicy:
    """The policy of one agent whose network sees the states of all.

    Parameters
    ----------
    network : Network
        Its first outputs are the inputs of the agent.
    matrix : (n, D) array
        What the row is of the joint state.
    offset : (n,) array
        Added to it.
    told, states : int
        Column from which the automaton state stands, and the number of automaton states; the time left follows.
    horizon : int
    input_box : Box
    """

    network: Network
    matrix: FloatArray
    offset: FloatArray
    told: int
    states: int
    horizon: int
    input_box: Box

    sees_all: ClassVar[bool] = True

    def inputs(self, states: FloatArray, q: Array, time: int) -> FloatArray:
        """Return the inputs (m, N) at joint states (D, N), automaton states (N,) and a time."""
        rows = (self.matrix @ np.where(np.isfinite(states), states, 0.0) + self.offset[:, None]).T
        write_task(rows, self.told, self.states, q, 1.0 - time / self.horizon)
        return answered(self.network, rows.astype(np.float32), self.input_box)

    @property
    def description(self) -> dict[str, Any]:
        """All numbers of the policy as plain values; ``joint_network_policy`` makes the same policy from them."""
        network = self.network
        return {
            "weights": [weight.tolist() for weight in network.weights],
            "biases": [bias.tolist() for bias in network.biases],
            "activation": network.activation,
            "squashed": network.squashed,
            "outputs": network.outputs,
            "matrix": self.matrix.tolist(),
            "offset": self.offset.tolist(),
            **{name: getattr(self, name) for name in ("told", "states", "horizon")},
        }


def seen_jointly(policy: NetworkPolicy, first: int, count: int) -> JointNetworkPolicy:
    """Return the same policy, up to rounding, as one of ``count`` states, those of its agent from ``first`` on."""
    view, low, high = policy.view, policy.workspace.low, policy.workspace.high
    raw, d = view.scale == "raw", len(low)
    middle, half = (np.zeros(d), np.ones(d)) if raw else (0.5 * (low + high), 0.5 * (high - low))
    matrix, offset, own = np.zeros((view.size, count)), np.zeros(view.size), np.arange(d)
    matrix[own, first + own], offset[:d] = 1.0 / half, -middle / half
    if view.agents:
        offset[view.width + view.states + 1 + view.agent] = 1.0
    return JointNetworkPolicy(
        policy.network, matrix, offset, view.width, view.states, view.horizon, policy.input_box
    )  # fmt: skip


def joint_network_policy(description: dict[str, Any], agent: AnyAgent, count: int) -> JointNetworkPolicy:
    """Return the policy that a description stands for, for ``count`` states of all agents; ValueError if it is none."""
    layers = [[np.array(layer, dtype=np.float32) for layer in description[name]] for name in ("weights", "biases")]
    matrix, offset = (np.array(description[name], dtype=float) for name in ("matrix", "offset"))
    told, states, horizon = (description[name] for name in ("told", "states", "horizon"))
    forms = description["activation"], description["squashed"], description["outputs"]
    if any(type(number) is not int for number in (told, states, horizon)) or not 0 <= told < len(offset) - states:
        raise ValueError("a network is told of the automaton state where its row has no columns")
    if forms[0] not in ACTIVATIONS or type(forms[1]) is not bool or forms[2] not in OUTPUTS:
        raise ValueError("a network answers in a form that is not known")
    if matrix[told : told + states + 1].any() or offset[told : told + states + 1].any():
        raise ValueError("a network sees states where it is told of the automaton state and the time")
    size = len(offset)
    if matrix.shape != (size, count) or not layers[0] or len(layers[0]) != len(layers[1]):
        raise ValueError("a network sees another number of states than there are")
    for weight, bias in zip(*layers, strict=True):
        if weight.ndim != 2 or weight.shape[1] != size or bias.shape != weight.shape[:1]:
            raise ValueError("a network has layers that do not fit together")
        size = len(bias)
    if size < agent.n_inputs or not all(np.all(np.isfinite(x)) for x in (*layers[0], *layers[1], matrix, offset)):
        raise ValueError("a network has fewer outputs than its agent has inputs, or numbers that are none")
    network = Network(tuple(layers[0]), tuple(layers[1]), *forms)
    return JointNetworkPolicy(network, matrix, offset, told, states, horizon, agent.chosen_box)
