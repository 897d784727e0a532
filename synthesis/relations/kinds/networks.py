"""Policies that are feed-forward networks, as they are deployed: from an agent's state to its input.

A network reads a row of numbers in single precision: the agent's state, moved into the workspace and either scaled to
[-1, 1] or left in its units, and filled up with zeros; the automaton state (one-hot); the share of time left; which
agent it is (one-hot). Its outputs are clipped to [-1, 1] or squashed by tanh, and stand for the input box; or they are
inputs in their units, clipped to the input box. Trained actors use this very code.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from ....envs.systems.agents import AnyAgent, Box
from ..grids import FloatArray

Array = NDArray[Any]


def _logistic(x: Array) -> Array:
    # exponentials of what is negative alone: nothing overflows
    small = np.exp(-np.abs(x))
    return np.asarray(np.where(x >= 0, 1.0, small) / (1.0 + small), dtype=x.dtype)


ACTIVATIONS: dict[str, Callable[[Array], Array]] = {
    "tanh": np.tanh,
    "relu": lambda x: np.maximum(x, 0.0),
    "sigmoid": _logistic,
    "elu": lambda x: np.where(x > 0, x, np.expm1(np.minimum(x, 0.0))),
    "silu": lambda x: x * _logistic(x),
}
"""Activations between layers, in the precision of what they are given."""

ON_CELLS = ("tanh", "relu")
"""Those of networks that are certified on cells as they are; along their run without noise all are."""

SCALES, OUTPUTS = ("unit", "raw"), ("unit", "box")
"""How networks see states: scaled to [-1, 1], or in their units. And what clips outputs: [-1, 1], or the input box."""

LARGEST_WEIGHT, MOST_LAYERS, MOST_UNITS = 1e6, 16, 4096
"""Largest weight, and most layers and units of each, that a file may ask a check to compute with."""


@dataclass(frozen=True, eq=False)
class Network:
    """A feed-forward network: layers ``x -> x W' + b`` with an activation between them.

    Parameters
    ----------
    weights : tuple of (out, in) arrays
    biases : tuple of (out,) arrays
    activation : str
        One of ``ACTIVATIONS``.
    squashed : bool
        Whether the last layer goes through tanh (SAC); otherwise it is clipped to [-1, 1] (PPO).
    outputs : "unit" or "box"
        Whether outputs in [-1, 1] stand for the input box, or are inputs that are clipped to it (never squashed).
    """

    weights: tuple[Array, ...]
    biases: tuple[Array, ...]
    activation: str
    squashed: bool
    outputs: str = "unit"

    def actions(self, rows: Array) -> Array:
        """Return actions (N, m) for observations (N, n): in [-1, 1], or inputs that are not clipped yet."""
        # In single precision, as torch computes them.
        hidden, apply = np.asarray(rows, dtype=np.float32), ACTIVATIONS[self.activation]
        for weight, bias in zip(self.weights[:-1], self.biases[:-1], strict=True):
            hidden = apply(hidden @ weight.T + bias)
        last = hidden @ self.weights[-1].T + self.biases[-1]
        if self.outputs == "box":
            return np.asarray(last)
        return np.asarray(np.tanh(last) if self.squashed else np.clip(last, -1.0, 1.0))


@dataclass(frozen=True)
class OwnView:
    """What an agent's network sees: the agent's own state, the automaton state, the time left, and which agent it is.

    Parameters
    ----------
    agent, agents : int
        Number of the agent, and how many there are; 0 if a network for a single agent is not told so.
    width : int
        Columns of the state; those that the agent does not have are 0.
    states : int
        Automaton states.
    horizon : int
        Steps of the problem.
    scale : "unit" or "raw"
        Whether states are scaled from the workspace to [-1, 1], or stand in their units.
    """

    agent: int
    agents: int
    width: int
    states: int
    horizon: int
    scale: str = "unit"

    @property
    def size(self) -> int:
        """Numbers of a row."""
        return self.width + self.states + 1 + self.agents

    def rows(self, workspace: Box, states: Array, q: Array, time: Any) -> NDArray[np.float32]:
        """Return rows (N, size) at states (d, N), automaton states (N,) that it is told of, and times, one or (N,)."""
        rows = np.zeros((states.shape[1], self.size), dtype=np.float32)
        seen = scaled if self.scale == "unit" else moved_inside
        rows[:, : len(states)] = seen(workspace, states).T
        write_task(rows, self.width, self.states, q, 1.0 - np.asarray(time) / self.horizon)
        if self.agents:
            rows[:, self.width + self.states + 1 + self.agent] = 1.0
        return rows


@dataclass(frozen=True, eq=False)
class NetworkPolicy:
    """The policy of one agent that a network is.

    Its *modes* are the pairs of a time t and an automaton state q that the network is told of, numbered
    ``t * states + q``.

    Parameters
    ----------
    network : Network
    view : OwnView
    workspace, input_box : Box
        Of the agent.
    """

    network: Network
    view: OwnView
    workspace: Box
    input_box: Box

    sees_all: ClassVar[bool] = False

    @property
    def n_modes(self) -> int:
        """Number of modes."""
        return self.view.horizon * self.view.states

    def inputs(self, states: FloatArray, q: Array, time: int) -> FloatArray:
        """Return the inputs (m, N) at states (d, N), automaton states (N,) and a time."""
        return answered(self.network, self.view.rows(self.workspace, states, q, time), self.input_box)

    def replaced(
        self,
        choices: NDArray[Any],
        points: FloatArray,
        moment: tuple[NDArray[Any], int],
        inputs: FloatArray,
    ) -> FloatArray:
        """Return ``inputs`` (m, n, M) with those of the network where one of its modes is chosen.

        Parameters
        ----------
        choices : (n, M) int array
            Modes are the first ones; -1 for none.
        points : (d, n, M) array
        moment : automaton states (M,), time
        inputs : (m, n, M) array
        """
        q, time = moment
        asked = (choices >= 0) & (choices < self.n_modes)
        states = points[:, asked]
        own_q = np.broadcast_to(q, choices.shape)[asked]
        result = np.array(inputs)
        if states.size:
            result[:, asked] = self.inputs(states, own_q, min(time, self.view.horizon - 1))
        return result

    def modes_in(self, n_states: int) -> NDArray[np.int32]:
        """Return the modes (T, n_states) at each time in each automaton state."""
        return np.asarray(
            np.arange(self.view.horizon)[:, None] * self.view.states + np.arange(n_states), dtype=np.int32
        )

    @property
    def idle_menu(self) -> FloatArray:
        """Inputs (modes, m) in the place of modes in a menu: they mean nothing."""
        return np.tile(0.5 * self.input_box.low + 0.5 * self.input_box.high, (self.n_modes, 1))

    def constants(self, mode: int) -> FloatArray:
        """Return what the network sees in a mode besides the state: a row (size - width,), exact."""
        t, q = divmod(mode, self.view.states)
        middle = 0.5 * self.workspace.low + 0.5 * self.workspace.high
        row = self.view.rows(self.workspace, middle[:, None], np.array([q]), t)[0]
        return row[self.view.width :].astype(float)

    @property
    def arrays(self) -> tuple[Array, ...]:
        """All that the policy depends on, for comparing relations."""
        view = self.view
        facts = [view.agent, view.agents, view.width, view.states, view.horizon, self.network.squashed]
        kind = sorted(ACTIVATIONS).index(self.network.activation)
        forms = SCALES.index(view.scale), OUTPUTS.index(self.network.outputs)
        return (np.array([*facts, kind, *forms]), *self.network.weights, *self.network.biases)

    @property
    def description(self) -> dict[str, Any]:
        """All numbers of the policy as plain values; ``network_policy`` makes the same policy from them."""
        network, forms = self.network, {"scale": self.view.scale, "outputs": self.network.outputs}
        return {
            "weights": [weight.tolist() for weight in network.weights],
            "biases": [bias.tolist() for bias in network.biases],
            "activation": network.activation,
            "squashed": network.squashed,
            **{name: getattr(self.view, name) for name in VIEW_FIELDS},
            **{name: form for name, form in forms.items() if form != "unit"},
        }


VIEW_FIELDS = ("agent", "agents", "width", "states", "horizon")
"""Fields of ``OwnView`` that are numbers."""


def network_policy(description: dict[str, Any], agent: AnyAgent) -> NetworkPolicy:
    """Return the policy of an agent that a description (see ``NetworkPolicy.description``) stands for."""
    weights, biases = (
        tuple(np.array(layer, dtype=np.float32) for layer in description[name]) for name in ("weights", "biases")
    )
    kind = description["activation"], description["squashed"], description.get("outputs", "unit")
    network = Network(weights, biases, *kind)
    numbers = {name: int(description[name]) for name in VIEW_FIELDS}
    view = OwnView(**numbers, scale=description.get("scale", "unit"))
    return NetworkPolicy(network, view, agent.workspace, agent.chosen_box)


def check_network(
    description: Any, agent: AnyAgent, n_choices: int, activations: Collection[str] = tuple(ACTIVATIONS)
) -> None:
    """Raise ValueError unless a value describes a network for ``agent``, with no more modes than there are choices."""
    if not isinstance(description, dict) or description.get("activation") not in activations:
        raise ValueError("a network has an activation that is not known")
    numbers = [description[name] for name in VIEW_FIELDS]
    if any(isinstance(n, bool) or not isinstance(n, int) or not 0 <= n < 2**31 for n in numbers):
        raise ValueError("a network has a view whose sizes are not numbers")
    view = OwnView(*numbers)
    forms = description.get("scale", "unit"), description.get("outputs", "unit")
    if forms[0] not in SCALES or forms[1] not in OUTPUTS or (forms[1] == "box" and description["squashed"]):
        raise ValueError("a network sees states, or answers, in a form that is not known")
    box = agent.chosen_box
    if forms[1] == "box" and np.any(box.low >= box.high):
        raise ValueError("a network answers with inputs in a box that is flat")
    if (
        not view.agent < view.agents
        or not agent.n_states <= view.width
        or not isinstance(description["squashed"], bool)
    ):
        raise ValueError("a network has a view that does not fit its agent")
    if "told" in description:
        raise ValueError("networks of problems that name the time have no cells since 0.4; certify the network anew")
    if not 0 < view.horizon * view.states <= n_choices:
        raise ValueError("a network has no choice for each time and automaton state")
    weights, biases = description["weights"], description["biases"]
    if not isinstance(weights, list) or not 0 < len(weights) <= MOST_LAYERS or len(biases) != len(weights):
        raise ValueError(f"a network has not between 1 and {MOST_LAYERS} layers")
    size = view.size
    for matrix, bias in zip(weights, biases, strict=True):
        layer, shift = np.array(matrix, dtype=float), np.array(bias, dtype=float)
        if layer.ndim != 2 or layer.shape[1] != size or shift.shape != layer.shape[:1]:
            raise ValueError("a network has layers that do not fit together")
        size = len(layer)
        if not 0 < size <= MOST_UNITS or not all(np.all(np.abs(x) <= LARGEST_WEIGHT) for x in (layer, shift)):
            raise ValueError(f"a network has weights beyond {LARGEST_WEIGHT:g}, or more than {MOST_UNITS} units")
        if not all(np.array_equal(x, x.astype(np.float32)) for x in (layer, shift)):
            raise ValueError("a network has weights that are not of single precision")
    if size < agent.n_inputs:
        raise ValueError("a network has fewer outputs than its agent has inputs")


def answered(network: Network, rows: Array, box: Box) -> FloatArray:
    """Return the inputs (m, N) that a network answers rows (N, n) with, its first outputs, in the box of inputs."""
    own = network.actions(rows)[:, : box.dimension].T.astype(float)
    return np.clip(own, box.low[:, None], box.high[:, None]) if network.outputs == "box" else inputs_of(box, own)


def inputs_of(box: Box, actions: Array) -> Array:
    """Return the inputs (m, N) within an input box for which actions (m, N) in [-1, 1] stand."""
    low, high = box.low[:, None], box.high[:, None]
    middle, half = 0.5 * low + 0.5 * high, 0.5 * high - 0.5 * low
    return np.clip(middle + half * np.clip(actions, -1.0, 1.0), low, high)


def moved_inside(workspace: Box, states: Array) -> Array:
    """Return states (d, N) moved into the workspace; NaN counts as the lower corner."""
    low, high = workspace.low[:, None], workspace.high[:, None]
    return np.clip(np.where(np.isnan(states), low, states), low, high)


def scaled(workspace: Box, states: Array) -> Array:
    """Return states (d, N) moved into the workspace and scaled to [-1, 1]; NaN counts as the lower corner."""
    low, high = workspace.low[:, None], workspace.high[:, None]
    return 2.0 * (moved_inside(workspace, states) - low) / (high - low) - 1.0


def write_task(rows: Array, first: int, n_states: int, q: Array, left: Any) -> None:
    """Write the automaton state (one-hot) and the share of time left into the columns from ``first`` on."""
    rows[np.arange(len(rows)), first + np.asarray(q)] = 1.0
    rows[:, first + n_states] = left
