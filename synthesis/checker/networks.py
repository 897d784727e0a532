"""Feed-forward networks as feedbacks: ``u + J e + rho`` for all errors e that are possible.

A network sees a row ``V x + b`` of the states of its agent, or of all; in it stand the automaton state, one-hot, and
the share of time left. Layers ``z = W h + b`` have an activation between them; the outputs are cut off at -1 and 1, or
go through tanh, and stand for the box of inputs; or they are cut off at that box. The row may be off by some units of
its sizes, in double precision, before it is rounded to single.

**Theorem** (``enclosed``). For all errors e that are ``Seen`` the input is within ``u + J e + rho``, with rho between
the ends that are returned, whatever the order of the network's sums is, in single precision or better.

*Proof.* By induction over layers each number of a layer is ``z0 + C e + e' Q e + sum_l G_l q_l`` with q_l in intervals:
what rounds, and what activations leave out of a parabola. Where z0 + d is in the interval of a neuron its activation is
``h + s d + k d^2 + q``. Between two points h apart with no kink of f between them, q is within
``h^2 sup |f'' - 2 k| / 8`` of the hull of what it is there (``_parabola``). With d = C e + x the square of d is that of
C e, a form of e, and ``x (2 C e + x)``, which joins q. QED What neurons bend cancels in the sums Q, which are bounded
as forms of e (``error_system``).

By hand: a smooth activation f is off by 2^-21 max(1, |f|) at most. Reference: docs/theory/paths.md, "Networks".
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from .automaton import followed
from .error_system import Seen
from .fields import Entry, Refused
from .intervals import add, down, exp, interval, mul, tanh, up
from .letters import known_at, known_at_start
from .problem import Agent, Problem
from .rigorous import Array, U, Whole

OUTPUTS = ("clip", "tanh", "box")
SINGLE = 2.0**-24  # relative rounding of one operation in single precision
ACTIVATION_OFF = 2.0**-21  # share of the larger of 1 and its size by which a smooth activation may be off
PIECES = 128  # parts of an interval at whose ends activations are looked at
NARROW = 1e-6  # intervals of neurons below it have no parabola: it would be made of rounding


@dataclass(frozen=True, eq=False)
class Network:
    """Layers: weights (n', n), biases (n',); ``view`` (n, D) and ``offset`` (n,) of a row; q from ``told`` on."""

    weights: tuple[Array, ...]
    biases: tuple[Array, ...]
    activation: str
    output: str
    view: Array
    offset: Array
    told: int


def read_network(entry: Entry, agent: Agent, seen: int, states: int) -> Network:
    """Return the network of an agent in a file; ``Unreadable`` unless it fits what is ``seen``: states of all."""
    own = entry.table(("weights", "biases", "activation", "output", "view", "offset", "told"))
    activation, output = own["activation"].one_of((*SMOOTH, "relu")), own["output"].one_of(OUTPUTS)
    view = own["view"].floats((None, seen))
    offset, told = own["offset"].floats((len(view),)), own["told"].whole(0, len(view) - states)
    # Each layer takes what the one before answers, the first one the row.
    weights, biases, count = [], [], len(view)
    layers = [own[key].entries() for key in ("weights", "biases")]
    for weight, bias in zip(*layers, strict=False):
        biases.append(bias.floats((None,)))
        weights.append(weight.floats((len(biases[-1]), count)))
        count = len(biases[-1])
    if not weights or len(layers[0]) != len(layers[1]) or count < len(agent.inputs):
        raise entry.wrong(f"its layers do not answer with the inputs of `{agent.name}`")
    return Network(tuple(weights), tuple(biases), activation, output, view, offset, told)


def automaton_states(problem: Problem, letters: Whole) -> list[int]:
    """Return the automaton state that a network sees at each time; -1 where every run has been accepted.

    ``Refused`` if runs that agree with the letters may be in two states, and are not accepted.
    """
    automaton, found = problem.automaton, []
    states = followed(automaton, {automaton.initial}, known_at_start(problem))
    for t in range(len(letters)):
        if t:
            states = followed(automaton, states, known_at(problem, letters[t], t))
        if automaton.is_co_safe:  # nothing is asked of runs that are accepted
            states = {q for q in states if not automaton.accepting[q]}
        if len(states) > 1:
            raise Refused(f"networks see the automaton state, and it is not known at time {t}")
        found.append(min(states, default=-1))
    return found


def enclosed(
    network: Network, agent: Agent, at: Array, row: tuple[int, int, float], seen: Seen
) -> tuple[Array, Array, Array]:
    """Return u (m,), J (m, k) and ends (2, m) of rho, for the errors around states ``at`` (k,) that it sees.

    ``row`` are the automaton state, how many there are, and the share of time left.
    """
    forms, m, (low, high) = row_seen(network, at, row, seen), len(agent.inputs), agent.input_box
    for weight, bias in zip(network.weights[:-1], network.biases[:-1], strict=True):
        forms = forms.times(weight, bias, SINGLE).through(network.activation)
    forms = forms.times(network.weights[-1][:m], network.biases[-1][:m], SINGLE)
    # Outputs are inputs, cut off at their box, or stand for it between -1 and 1.
    if network.output == "box":
        forms = forms.through("clip", low, high)
    else:
        forms = forms.through("tanh" if network.output == "tanh" else "clip", -1.0, 1.0)
        forms = forms.times(np.diag(0.5 * (high - low)), 0.5 * (low + high), U)
    return forms.h, forms.C, forms.rest()


@dataclass(frozen=True, eq=False)
class Layer:
    """Numbers ``h + C e + e' Q e + sum G q + own`` of a layer, q and own (2, n) between ends that hold 0.

    They are no larger than ``size``, for errors e that are ``seen``.
    """

    h: Array
    C: Array
    Q: Array
    parts: tuple[tuple[Array, Array], ...]
    own: Array
    size: Array
    seen: Seen

    def off_by(self, off: Array) -> Layer:
        """Return the layer with something more, no larger than ``off`` (n,)."""
        return replace(self, own=add(self.own, np.stack([-off, off])))

    def rest(self) -> Array:
        """Return ends (2, n) of all that is not ``h + C e``."""
        total = add(self.own, self.seen.forms(self.Q))
        for matrix, ends in self.parts:
            middle, half = 0.5 * (ends[0] + ends[1]), 0.5 * (ends[1] - ends[0])
            most, size = half + 4.0 * U * np.abs(ends).max(axis=0), np.abs(matrix)
            spread = (size @ most) * (1.0 + 4.0 * U * len(half))
            spread += (len(half) + 4.0) * U * (size @ np.abs(middle)) + 1e-290
            total = add(total, matrix @ middle + np.stack([-spread, spread]))
        return total

    def reach(self) -> Array:
        """Return sizes (n,) that ``|C| |e| + |e|' |Q| |e|`` does not exceed, up to rounding."""
        return np.asarray((np.abs(self.C) + np.abs(self.Q) @ self.seen.far) @ self.seen.far)

    def times(self, weight: Array, bias: Array, unit: float = 0.0) -> Layer:
        """Return ``weight @ self + bias``, with what the sums are rounded by here, and by a network of this unit."""
        n, size = weight.shape[1], np.abs(weight)
        parts = (*((weight @ g, q) for g, q in self.parts), (weight, self.own))
        here = np.abs(self.h) + self.reach() + np.abs(self.own).max(axis=0)
        here = size @ (here + sum(np.abs(g) @ np.abs(q).max(axis=0) for g, q in self.parts)) + np.abs(bias)
        off = 1.01 * (n + 2.0) * unit * (size @ self.size + np.abs(bias)) + 4.0 * (n + 8.0) * U * here + 1e-40
        Q = np.tensordot(weight, self.Q, axes=1)
        return Layer(weight @ self.h + bias, weight @ self.C, Q, parts, np.stack([-off, off]), here, self.seen)

    def through(self, activation: str, low: Any = 0.0, high: Any = np.inf) -> Layer:
        """Return the layer after an activation; what is not smooth cuts off at ``low`` and ``high`` (n,)."""
        line, others = self.seen.rows(self.C), self.rest()
        ends = add(line, others)
        ends = np.stack([np.minimum(ends[0], 0.0), np.maximum(ends[1], 0.0)])
        slope, bend, value, rest = _parabola(activation, self.h, ends, low, high)
        # The square of what is no row of e, and its product with the row.
        far, more = np.abs(line).max(axis=0), np.abs(others).max(axis=0)
        lost = np.abs(bend) * more * (2.0 * far + more) * (1.0 + 8.0 * U)
        # slopes and bends are multiplied into matrices and intervals, and round
        row = np.abs(self.C) @ self.seen.far
        lost += 8.0 * U * (np.abs(slope) * (self.reach() + more) + np.abs(bend) * row * row) + 1e-290
        rest = rest + np.stack([-lost, lost])
        wide, off = np.abs(ends).max(axis=0), np.abs(rest).max(axis=0)
        size = (np.abs(value) + wide * (np.abs(slope) + np.abs(bend) * wide) + off) * (1.0 + 8.0 * U)
        parts = tuple((slope[:, None] * g, q) for g, q in self.parts)
        own = add(np.sort(slope * self.own, axis=0), rest)
        C, Q = slope[:, None] * self.C, slope[:, None, None] * self.Q
        Q = Q + bend[:, None, None] * self.C[:, :, None] * self.C[:, None]
        return Layer(value, C, Q, parts, own, size, self.seen)


def row_seen(network: Network, at: Array, row: tuple[int, int, float], seen: Seen) -> Layer:
    """Return the row that a network sees."""
    (q, states, left), h, far = row, network.view @ at + network.offset, seen.far
    h[network.told : network.told + states + 1] += np.append(np.arange(states) == max(q, 0), left)
    # the row is computed in double precision, there and here, and rounded to single
    reach = np.abs(network.view) @ far
    most = reach + np.abs(network.view) @ np.abs(at) + np.abs(network.offset) + 1.0
    off = 1.01 * SINGLE * (np.abs(h) + reach) + (64.0 + 4.0 * len(at)) * U * most + 1e-45
    none = np.zeros((*network.view.shape, len(far)))
    return Layer(h, network.view, none, (), np.stack([-off, off]), np.abs(h) + reach + off, seen)


def _logistic(x: Array) -> Array:
    return 0.5 + 0.5 * tanh(0.5 * x) + np.array([-2 * U, 2 * U]).reshape(2, *[1] * (x.ndim - 1))


SMOOTH: dict[str, tuple[Callable[[Array], Array], float]] = {
    "tanh": (tanh, 0.76981),
    "sigmoid": (_logistic, 0.09623),
    "elu": (lambda x: np.maximum(x, add(exp(np.minimum(x, 0.0)), interval(-np.ones_like(x[0])))), 1.0),
    "silu": (lambda x: mul(x, _logistic(x)), 0.50001),
}
"""Activations on intervals of points, and the largest size of their second derivatives, rounded up."""


def _parabola(activation: str, z: Array, ends: Array, low: Any, high: Any) -> tuple[Array, Array, Array, Array]:
    """Return s, k, h and ends of q (n,): ``f(z + d) = h + s d + k d^2 + q`` for d between ends (2, n), which hold 0."""
    first, last = down(z + ends[0]), up(z + ends[1])
    # Points of the interval: many of them, or its ends and its kinks.
    if activation in SMOOTH:
        (f, most), points = SMOOTH[activation], np.linspace(first, last, PIECES + 1)
    else:
        f, most = (lambda x: np.clip(x, low, high)), 0.0
        points = np.stack([first, np.clip(low, first, last), np.clip(high, first, last), last])
    there, mid, wide = f(interval(points)), f(interval(z)), last - first
    # The parabola through the ends and the middle, or the line through the ends; any one would do.
    value, left, middle, right = 0.5 * (mid[0] + mid[1]), *there[0, [0, PIECES // 2 if most else 0, -1]]
    bend = 2.0 * (left - 2.0 * middle + right) / np.maximum(wide, NARROW) ** 2
    bend = np.where((wide > NARROW) & (most > 0.0), bend, 0.0)
    slope = ((right - left) / np.maximum(wide, 1e-300)).clip(-0.2, 1.2) - bend * (ends[0] + ends[1])
    d = points - z
    rest = there - (value + d * (slope + bend * d))
    # Between the points, in single precision, and by what this rounds.
    size = np.abs(there).max(axis=(0, 1))
    spare = (most + 2.0 * np.abs(bend)) / 8.0 * (1.001 * wide / PIECES) ** 2
    spare += ACTIVATION_OFF * np.maximum(size, 1.0) if most else 0.0
    spare += 16.0 * U * (size + np.abs(value) + wide * (np.abs(slope) + np.abs(bend) * wide))
    return slope, bend, value, np.stack([rest[0].min(axis=0) - spare, rest[1].max(axis=0) + spare])
