"""Feed-forward networks as feedbacks: ``u + J e + rho`` for all errors e that are possible.

A network sees a row: the state of its agent, ``(x - middle) / half``, filled up with zeros; the automaton state,
one-hot; the share of time left; which agent it is, one-hot. Layers ``z = W h + b`` have an activation between them; the
outputs are cut off at -1 and 1, or go through tanh, and stand for the box of inputs; or they are cut off at that box.

**Theorem** (``enclosed``). If rows C of e lie between ``reach(C)``, and |e| <= far, then the input is within
``u + J e + rho``, with rho between the ends that are returned, whatever the order of the network's sums is, in single
precision or better.

*Proof.* By induction over layers each number of a layer is ``z0 + C e + sum_l G_l q_l`` with q_l in intervals: what
rounds, and what activations leave out of a line. Where z0 + d is in the interval of a neuron its activation is
``h + s d + q``; for fixed s these q are largest and least at ends of the interval, at kinks, and where the slope is s
(``_line``). QED

By hand: an activation of ``tanh`` is off by 2^-21 at most. Reference: docs/theory/paths.md, "Networks".
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import fields
from .automaton import followed
from .fields import Refused
from .file import Contents
from .intervals import add, down, interval, log, mul, neg, recip, root, tanh, up
from .letters import known_at, known_at_start
from .problem import Agent, Problem
from .rigorous import Array, U

ACTIVATIONS, OUTPUTS, SEES = ("tanh", "relu"), ("clip", "tanh", "box"), ("scaled", "raw")
SINGLE = 2.0**-24
"""Relative rounding of one operation in single precision."""

TANH_OFF = 2.0**-21
"""What an activation of ``tanh`` may be off by."""

MOST_UNITS = 4096


@dataclass(frozen=True, eq=False)
class Network:
    """Layers of one agent: weights (n', n) and biases (n',), and what its row holds."""

    weights: tuple[Array, ...]
    biases: tuple[Array, ...]
    activation: str
    output: str
    sees: str
    width: int
    agents: int
    number: int


def read_network(contents: Contents, value: Any, place: str, agent: Agent, states: int) -> Network:
    """Return the network of an agent in a file; raise ``Unreadable`` if it does not fit."""
    keys = "weights", "biases", "activation", "output", "sees", "width", "agents", "number"
    own = fields.table(value, place, keys)
    chosen = [(own[key], key, some) for key, some in zip(keys[2:5], (ACTIVATIONS, OUTPUTS, SEES), strict=True)]
    for word, key, some in chosen:
        if word not in some:
            raise fields.expected(f"{place}.{key}", " or ".join(some), word)
    width, agents = (fields.whole(own[key], f"{place}.{key}", 0, MOST_UNITS) for key in ("width", "agents"))
    number = fields.whole(own["number"], f"{place}.number", 0, max(1, agents))
    if width < len(agent.states):
        raise fields.Unreadable(f"{place}.width: the row has no room for the state of `{agent.name}`")
    weights, biases, count = [], [], width + states + 1 + agents
    layers = [fields.each(own[key], f"{place}.{key}", lambda number, _: number) for key in ("weights", "biases")]
    for k, (weight, bias) in enumerate(zip(*layers, strict=False)):
        biases.append(contents.floats(bias, f"{place}.biases[{k}]", (None,)))
        weights.append(contents.floats(weight, f"{place}.weights[{k}]", (len(biases[-1]), count)))
        count = len(biases[-1])
    if not weights or len(layers[0]) != len(layers[1]) or count < len(agent.inputs):
        raise fields.Unreadable(f"{place}: its layers do not answer with the inputs of `{agent.name}`")
    act, output, sees = (word for word, _, _ in chosen)
    return Network(tuple(weights), tuple(biases), act, output, sees, width, agents, number)


def automaton_states(problem: Problem, letters: NDArray[np.int64]) -> list[int]:
    """Return the automaton state that a network sees at each time; -1 where every run has been accepted.

    ``Refused`` if runs that agree with the letters may be in two states, and are not accepted.
    """
    automaton, found = problem.automaton, []
    states = followed(automaton, {automaton.initial}, known_at_start(problem))
    for t in range(len(letters)):
        if t:
            states = followed(automaton, states, known_at(problem, letters, t))
        if automaton.is_co_safe:  # nothing is asked of runs that are accepted
            states = {q for q in states if not automaton.accepting[q]}
        if len(states) > 1:
            raise Refused(f"networks see the automaton state, and it is not known at time {t}")
        found.append(min(states, default=-1))
    return found


def enclosed(
    network: Network,
    agent: Agent,
    at: Array,
    row: tuple[int, int, float],
    reach: Callable[[Array], Array],
    far: Array,
) -> tuple[Array, Array, Array]:
    """Return u (m,), J (m, d) and ends (2, m) of rho, for the errors around a state ``at`` (d,).

    ``row`` are the automaton state, how many there are, and the share of time left; ``reach`` takes rows C (n, d) to
    ends (2, n) of C e, and ``far`` (d,) is above |e|.
    """
    forms = _first(network, agent, at, row, far)
    for weight, bias in zip(network.weights[:-1], network.biases[:-1], strict=True):
        forms = _after(forms, weight, bias).through(network.activation, np.zeros(0), np.zeros(0), reach)
    m = len(agent.inputs)
    last = _after(forms, network.weights[-1][:m], network.biases[-1][:m])
    low, high = agent.input_box
    if network.output == "box":
        forms, middle, half = last.through("clip", low, high, reach), np.zeros(m), np.ones(m)
    else:
        forms = last.through("tanh" if network.output == "tanh" else "clip", -np.ones(m), np.ones(m), reach)
        middle, half = 0.5 * (low + high), 0.5 * (high - low)
    rest = forms.rest()
    # the move onto the box of inputs, as floating point computes it
    spare = 16.0 * U * (np.abs(low) + np.abs(high) + np.abs(middle) + half * (1.0 + np.abs(forms.C) @ far)) + 1e-290
    u, J = middle + half * forms.h, half[:, None] * forms.C
    return u, J, mul(interval(half), rest) + np.stack([-spare, spare])


@dataclass(frozen=True, eq=False)
class _Forms:
    """Numbers ``h + C e + sum G q`` of a layer; q between ends; no larger than ``size``, with errors up to ``far``."""

    h: Array
    C: Array
    parts: tuple[tuple[Array | None, Array], ...]  # no matrix: the identity
    size: Array
    far: Array

    def rest(self) -> Array:
        """Return ends (2, n) of the sum of all parts."""
        total = np.zeros((2, len(self.h)))
        for matrix, ends in self.parts:
            if matrix is None:
                total = add(total, ends)
                continue
            middle, half = 0.5 * (ends[0] + ends[1]), 0.5 * (ends[1] - ends[0])
            spread = (np.abs(matrix) @ (half + 4.0 * U * np.abs(ends).max(axis=0))) * (1.0 + 4.0 * U * len(half))
            shift = matrix @ middle
            spread += (len(half) + 4.0) * U * (np.abs(matrix) @ np.abs(middle)) + 1e-290
            total = add(total, np.stack([shift - spread, shift + spread]))
        return total

    def through(self, activation: str, low: Array, high: Array, reach: Callable[[Array], Array]) -> _Forms:
        """Return the forms after an activation; ``clip`` cuts off at ``low`` and ``high`` (n,)."""
        ends = add(reach(self.C), self.rest())
        ends = np.stack([np.minimum(ends[0], 0.0), np.maximum(ends[1], 0.0)])
        slope, value, rest = _line(activation, self.h, ends, low, high)
        # slopes are multiplied into matrices, and round
        lost = 4.0 * U * slope * (np.abs(self.C) @ self.far + np.abs(self.rest()).max(axis=0)) + 1e-290
        rest = rest + np.stack([-lost, lost])
        size = np.abs(np.stack([value + slope * ends[0] + rest[0], value + slope * ends[1] + rest[1]])).max(axis=0)
        parts = tuple((slope[:, None] * (np.eye(len(slope)) if g is None else g), q) for g, q in self.parts)
        return _Forms(value, slope[:, None] * self.C, (*parts, (None, rest)), size * (1.0 + 8.0 * U), self.far)


def _first(network: Network, agent: Agent, at: Array, row: tuple[int, int, float], far: Array) -> _Forms:
    """Return the row that a network sees, as forms of the error."""
    (q, states, left), d = row, len(at)
    low, high = agent.state_box
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    if network.sees == "raw":
        middle, half = np.zeros(d), np.ones(d)
    told = np.zeros(states + 1 + network.agents)
    told[max(q, 0)], told[states] = 1.0, left
    if network.agents:
        told[states + 1 + network.number] = 1.0
    count = network.width + len(told)
    h, C, size = np.zeros(count), np.zeros((count, d)), np.zeros(count)
    h[:d], C[:d], h[network.width :] = (at - middle) / half, np.diag(1.0 / half), told
    size[:d] = np.abs(h[:d]) + far / half
    # the row is scaled in double precision, and rounded to single
    off = SINGLE * size[:d] * 1.01 + 32.0 * U * (np.abs(at) + far + np.abs(low) + np.abs(high)) / half + 1e-45
    size[:d], size[network.width :] = size[:d] + off, np.abs(told)
    return _Forms(h, C, ((np.eye(count)[:, :d], np.stack([-off, off])),), size, far)


def _after(forms: _Forms, weight: Array, bias: Array) -> _Forms:
    """Return the forms after a layer, with what its sums are rounded by, by the network and here."""
    n, size = weight.shape[1], np.abs(weight)
    parts: list[tuple[Array | None, Array]] = [(weight if g is None else weight @ g, q) for g, q in forms.parts]
    here = size @ (np.abs(forms.h) + np.abs(forms.C) @ forms.far) + np.abs(bias)
    for g, q in forms.parts:
        most = np.abs(q).max(axis=0)
        here = here + size @ (most if g is None else np.abs(g) @ most)
    off = 1.01 * (n + 2.0) * SINGLE * (size @ forms.size + np.abs(bias)) + 4.0 * (n + 8.0) * U * here + 1e-40
    parts.append((None, np.stack([-off, off])))
    return _Forms(weight @ forms.h + bias, weight @ forms.C, tuple(parts), np.zeros(len(bias)), forms.far)


def _line(activation: str, z: Array, ends: Array, low: Array, high: Array) -> tuple[Array, Array, Array]:
    """Return s, h and ends of q (n,) with ``f(z + d) = h + s d + q`` for all d between ends (2, n), which hold 0."""
    first, last = down(z + ends[0]), up(z + ends[1])
    width = np.maximum(last - first, 1e-300)
    if activation == "tanh":
        a, b, mid = tanh(interval(first)), tanh(interval(last)), tanh(interval(z))
        value = 0.5 * (mid[0] + mid[1])
        slope = np.where(last - first > 1e-7, (b[0] - a[1]) / width, 1.0 - value * value)
    else:
        low, high = (np.zeros(len(z)), np.full(len(z), np.inf)) if activation == "relu" else (low, high)
        a, b = (interval(np.clip(end, low, high)) for end in (first, last))
        value = np.clip(z, low, high)
        slope = np.where(last > first, (b[0] - a[0]) / width, 1.0)
    slope = np.clip(slope, 0.0, 1.0)
    # inside of both kinks a neuron is what it gets
    if activation != "tanh":
        slope = np.where((first >= low) & (last <= high), 1.0, slope)

    def rest(at: Array, value_there: Array) -> Array:
        return add(add(value_there, neg(interval(value))), neg(mul(interval(slope), add(at, neg(interval(z))))))

    found = [rest(interval(first), a), rest(interval(last), b)]
    q = np.stack([np.minimum(found[0][0], found[1][0]), np.maximum(found[0][1], found[1][1])])
    if activation == "tanh":
        # where the slope is s, tanh is +-r with r^2 = 1 - s: the largest rest on the right, the least on the left
        r = root(np.maximum(add(interval(np.ones(len(z))), neg(interval(slope))), 0.0))
        with np.errstate(all="ignore"):
            beyond = r[1] >= 1.0 - 1e-15
            safe = np.where(beyond, 0.5, r)
            one = interval(np.ones(len(z)))
            at = 0.5 * log(mul(add(one, safe), recip(add(one, neg(safe)))))
        at = np.where(beyond, np.array([[18.0], [np.inf]]), at)
        right = ~((at[0] > last) | (at[1] < first))
        left = ~((-at[1] > last) | (-at[0] < first))
        most = rest(np.stack([at[0], np.where(beyond, 1e3, at[1])]), r)[1]
        least = rest(np.stack([np.where(beyond, -1e3, -at[1]), -at[0]]), neg(r))[0]
        q = np.stack([np.where(left, np.minimum(q[0], least), q[0]), np.where(right, np.maximum(q[1], most), q[1])])
        return slope, value, q + np.array([[-TANH_OFF], [TANH_OFF]])
    for kink in (low, high):
        met = np.isfinite(kink) & (first < kink) & (kink < last)
        there = rest(interval(np.where(met, kink, z)), interval(np.where(met, kink, value)))
        q = np.stack([np.where(met, np.minimum(q[0], there[0]), q[0]), np.where(met, np.maximum(q[1], there[1]), q[1])])
    return slope, value, q
