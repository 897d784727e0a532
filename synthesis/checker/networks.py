"""Feed-forward networks as feedbacks: ``u + J e + rho`` for all errors e that are possible.

A network sees a row ``V x + b`` of the states of its agent, or of all; in it stand the automaton state, one-hot, and
the share of time left. Layers ``z = W h + b`` have an activation between them; the outputs are cut off at -1 and 1, or
go through tanh, and stand for the box of inputs; or they are cut off at that box. The row may be off by some units of
its sizes, in double precision, before it is rounded to single.

**Theorem** (``enclosed``). If rows C of e lie between ``reach(C)``, and |e| <= far, then the input is within
``u + J e + rho``, with rho between the ends that are returned, whatever the order of the network's sums is, in single
precision or better.

*Proof.* By induction over layers each number of a layer is ``z0 + C e + sum_l G_l q_l`` with q_l in intervals: what
rounds, and what activations leave out of a line. Where z0 + d is in the interval of a neuron its activation is
``h + s d + q``; for fixed s these q are largest and least at ends of the interval and at kinks, or, where f is smooth,
within ``h^2 sup |f''| / 8`` of the hull of those at two points h apart that d lies between (``_line``). QED

Errors keep in *ellipsoids*, which are narrower for many rows at once than a strip for each.

**Theorem** (``Ellipsoid``). Let g be the form of the errors that a network sees (``error_system``), W a matrix, V the
covariance of W g. Then ``P(|W g| > R) <= P(chi2_d > R^2 / v)``, where v is at least the largest eigenvalue of V; and
where ``|W g| <= R`` every row c satisfies ``|c g| <= R |a| + |c - a W| |g|``, for any a.

*Proof.* W g has the distribution of V^(1/2) z with z standard normal, no longer than sqrt(v) |z|. And
``c g = a W g + (c - a W) g``. QED Eigenvalues are bounded by absolute sums of rows (Gershgorin); W is about the inverse
of a root of the covariance of g, so that v is 1 up to rounding, and a is c times that root.

Of noise that is sub-Gaussian (``distributions``), also where its size depends on the past, ``P(|W g| > R)`` is at most
``(y / d)^(d/2) exp((d - y) / 2)``, y = R^2 / v > d. *Proof.* E exp(a W g) <= exp(v |a|^2 / 2) for all a. For
0 < s < 1 take the mean over normal a of variance s / v: E exp(s |W g|^2 / 2 v) <= (1 - s)^(-d/2). Markov's inequality
at s = 1 - d / y (Hsu, Kakade, Zhang, Electronic Communications in Probability 17, 2012). QED

By hand: a smooth activation f is off by 2^-21 max(1, |f|) at most. Reference: docs/theory/paths.md, "Networks".
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from . import rigorous
from .automaton import followed
from .distributions import LIGHT, NORMAL
from .error_system import ErrorSystem, covariance_of
from .fields import Entry, Refused
from .intervals import add, down, exp, interval, mul, neg, recip, tanh, up
from .letters import known_at, known_at_start
from .problem import Agent, Problem
from .rigorous import Array, U, Whole

OUTPUTS = ("clip", "tanh", "box")
SINGLE = 2.0**-24  # relative rounding of one operation in single precision
ACTIVATION_OFF = 2.0**-21  # share of the larger of 1 and its size by which a smooth activation may be off
PIECES = 128  # parts of an interval at whose ends smooth activations are looked at


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
    network: Network, agent: Agent, at: Array, row: tuple[int, int, float], reach: Callable[[Array], Array], far: Array
) -> tuple[Array, Array, Array]:
    """Return u (m,), J (m, k) and ends (2, m) of rho, for the errors around states ``at`` (k,) that it sees.

    ``row`` are the automaton state, how many there are, and the share of time left; ``reach`` takes rows C (n, k) to
    ends (2, n) of C e, and ``far`` (k,) is above |e|.
    """
    forms, m, (low, high) = row_seen(network, at, row, far), len(agent.inputs), agent.input_box
    for weight, bias in zip(network.weights[:-1], network.biases[:-1], strict=True):
        forms = forms.times(weight, bias, SINGLE).through(network.activation, np.zeros(0), np.zeros(0), reach)
    last, ones = forms.times(network.weights[-1][:m], network.biases[-1][:m], SINGLE), np.ones(m)
    # Outputs are inputs, cut off at their box, or stand for it between -1 and 1.
    in_box = network.output == "box"
    middle, half = (0.0 * ones, ones) if in_box else (0.5 * (low + high), 0.5 * (high - low))
    ends = np.stack([low, high]) if in_box else np.stack([-ones, ones])
    forms = last.through("tanh" if network.output == "tanh" else "clip", ends[0], ends[1], reach)
    # the move onto the box of inputs, as floating point computes it
    spare = 16.0 * U * (np.abs(low) + np.abs(high) + np.abs(middle) + half * (1.0 + np.abs(forms.C) @ far)) + 1e-290
    u, J = middle + half * forms.h, half[:, None] * forms.C
    return u, J, mul(interval(half), forms.rest()) + np.stack([-spare, spare])


@dataclass(frozen=True, eq=False)
class Layer:
    """Numbers ``h + C e + sum G q + own`` of a layer, q and own (2, n) between ends that hold 0.

    They are no larger than ``size``, with errors up to ``far``.
    """

    h: Array
    C: Array
    parts: tuple[tuple[Array, Array], ...]
    own: Array
    size: Array
    far: Array

    def off_by(self, off: Array) -> Layer:
        """Return the layer with something more, no larger than ``off`` (n,)."""
        return replace(self, own=add(self.own, np.stack([-off, off])))

    def rest(self) -> Array:
        """Return ends (2, n) of the sum of all parts."""
        total = self.own
        for matrix, ends in self.parts:
            middle, half = 0.5 * (ends[0] + ends[1]), 0.5 * (ends[1] - ends[0])
            most, size = half + 4.0 * U * np.abs(ends).max(axis=0), np.abs(matrix)
            spread = (size @ most) * (1.0 + 4.0 * U * len(half))
            spread += (len(half) + 4.0) * U * (size @ np.abs(middle)) + 1e-290
            total = add(total, matrix @ middle + np.stack([-spread, spread]))
        return total

    def times(self, weight: Array, bias: Array, unit: float = 0.0) -> Layer:
        """Return ``weight @ self + bias``, with what the sums are rounded by here, and by a network of this unit."""
        n, size = weight.shape[1], np.abs(weight)
        parts = (*((weight @ g, q) for g, q in self.parts), (weight, self.own))
        here = np.abs(self.h) + np.abs(self.C) @ self.far + np.abs(self.own).max(axis=0)
        here = size @ (here + sum(np.abs(g) @ np.abs(q).max(axis=0) for g, q in self.parts)) + np.abs(bias)
        off = 1.01 * (n + 2.0) * unit * (size @ self.size + np.abs(bias)) + 4.0 * (n + 8.0) * U * here + 1e-40
        return Layer(weight @ self.h + bias, weight @ self.C, parts, np.stack([-off, off]), here, self.far)

    def through(self, activation: str, low: Array, high: Array, reach: Callable[[Array], Array]) -> Layer:
        """Return the layer after an activation; ``clip`` cuts off at ``low`` and ``high`` (n,)."""
        others = self.rest()
        ends = add(reach(self.C), others)
        ends = np.stack([np.minimum(ends[0], 0.0), np.maximum(ends[1], 0.0)])
        slope, value, rest = _line(activation, self.h, ends, low, high)
        # slopes are multiplied into matrices and intervals, and round
        lost = 4.0 * U * np.abs(slope) * (np.abs(self.C) @ self.far + np.abs(others).max(axis=0)) + 1e-290
        rest = rest + np.stack([-lost, lost])
        moved = np.sort(slope * ends, axis=0)
        size = np.abs(value + moved + rest).max(axis=0) * (1.0 + 8.0 * U)
        parts = tuple((slope[:, None] * g, q) for g, q in self.parts)
        own = add(np.sort(slope * self.own, axis=0), rest)
        return Layer(value, slope[:, None] * self.C, parts, own, size, self.far)


def row_seen(network: Network, at: Array, row: tuple[int, int, float], far: Array) -> Layer:
    """Return the row that a network sees."""
    (q, states, left), h = row, network.view @ at + network.offset
    h[network.told : network.told + states + 1] += np.append(np.arange(states) == max(q, 0), left)
    # the row is computed in double precision, there and here, and rounded to single
    reach = np.abs(network.view) @ far
    most = reach + np.abs(network.view) @ np.abs(at) + np.abs(network.offset) + 1.0
    off = 1.01 * SINGLE * (np.abs(h) + reach) + (64.0 + 4.0 * len(at)) * U * most + 1e-45
    return Layer(h, network.view, (), np.stack([-off, off]), np.abs(h) + reach + off, far)


def _logistic(x: Array) -> Array:
    return 0.5 + 0.5 * tanh(0.5 * x) + np.array([-2 * U, 2 * U]).reshape(2, *[1] * (x.ndim - 1))


SMOOTH: dict[str, tuple[Callable[[Array], Array], float]] = {
    "tanh": (tanh, 0.76981),
    "sigmoid": (_logistic, 0.09623),
    "elu": (lambda x: np.maximum(x, add(exp(np.minimum(x, 0.0)), interval(-np.ones_like(x[0])))), 1.0),
    "silu": (lambda x: mul(x, _logistic(x)), 0.50001),
}
"""Activations on intervals of points, and the largest size of their second derivatives, rounded up."""


def _line(activation: str, z: Array, ends: Array, low: Array, high: Array) -> tuple[Array, Array, Array]:
    """Return s, h and ends of q (n,) with ``f(z + d) = h + s d + q`` for all d between ends (2, n), which hold 0."""
    first, last = down(z + ends[0]), up(z + ends[1])
    if activation == "relu":
        low, high = np.zeros(len(z)), np.full(len(z), np.inf)
    # Points of the interval: many of them, or its ends and those kinks that are inside.
    f, bend = SMOOTH.get(activation, (lambda x: np.clip(x, low, high), 0.0))
    if activation in SMOOTH:
        points = np.linspace(first, last, PIECES + 1)
    else:
        points = np.stack([first, *(np.where((k > first) & (k < last), k, z) for k in (low, high)), last])
    there, mid, wide = f(interval(points)), f(interval(z)), last - first
    value, chord = 0.5 * (mid[0] + mid[1]), (there[0, -1] - there[1, 0]) / np.maximum(wide, 1e-300)
    slope = chord.clip(-0.2, 1.2)  # any one would do
    line = add(interval(value)[:, None], mul(interval(slope)[:, None], add(interval(points), -interval(z)[:, None])))
    left, off = add(there, neg(line)), ACTIVATION_OFF * np.maximum(np.abs(there).max(axis=(0, 1)), 1.0)
    spare = bend / 8.0 * (1.001 * wide / PIECES) ** 2 + (off if bend else 0.0)
    return slope, value, np.stack([left[0].min(axis=0) - spare, left[1].max(axis=0) + spare])


@dataclass(frozen=True, eq=False)
class Ellipsoid:
    """``|W g| <= radius`` for the errors of one agent; ``root`` is about the inverse of W."""

    root: Array
    white: Array
    radius: float
    lost: float

    @classmethod
    def of(cls, errors: ErrorSystem, places: Whole, radius: float, kinds: Whole) -> Ellipsoid:
        """Return the ellipsoid of errors now, and the probability that they are outside; ``kinds`` of sources."""
        D = len(errors.spread)
        (_, now), d = errors.rows(np.eye(D)[places]), len(places)
        covariance = covariance_of(now, now)[0]
        # Any root will do: states that no noise has reached get a little of their own.
        scale = np.sqrt(np.maximum(np.diag(covariance), 1e-30))
        root = np.linalg.cholesky(covariance / np.outer(scale, scale) + 1e-10 * np.eye(d)) * scale[:, None]
        rows = np.zeros((d, D))
        rows[:, places] = np.linalg.inv(root)
        _, white = errors.rows(rows)
        found, off = covariance_of(white, white)
        largest = float(np.max(np.sum(np.abs(found) + off, axis=1))) * (1.0 + 4.0 * U * d)
        kind = int(np.where(white.sources, kinds, NORMAL).max(initial=NORMAL))
        return cls(root, rows[:, places], radius, length_tail(radius, d, largest, kind))

    @property
    def widths(self) -> Array:
        """Upper bounds (d,) on |g|."""
        # g = root h + (1 - root W) g: what the root misses is small, and g is hardly more than root h
        d, most = len(self.root), 1.01 * self.radius * np.sqrt(np.max(np.sum(self.root**2, axis=1)))
        off = np.abs(np.eye(d) - self.root @ self.white) + (d + 4.0) * U * np.abs(self.root) @ np.abs(self.white)
        known = np.max(off.sum(axis=1)) <= 1e-3
        return self.reach(np.eye(d), np.full(d, most)) if known else np.full(d, np.inf)

    def reach(self, rows: Array, most: Array) -> Array:
        """Return upper bounds (n,) on ``|c g|`` for rows (n, d), where ``|g| <= most`` (d,)."""
        a = rows @ self.root
        size, d = np.abs(a), len(most)
        missed = np.abs(rows - a @ self.white) + (d + 4.0) * U * (np.abs(rows) + size @ np.abs(self.white))
        length = np.sqrt(np.sum(a * a, axis=1)) * (1.0 + (d + 8.0) * U)
        return np.asarray(up(self.radius * length) + (missed @ most) * (1.0 + (d + 4.0) * U) + 1e-290)


def length_tail(radius: float, d: int, largest: float, kind: int = NORMAL) -> float:
    """Return an upper bound on P(|W g| > radius) for noise of a kind of tails, by the theorems above.

    For normal noise, and x = radius^2 / (2 largest), it is ``exp(-x)`` times the sum of ``x^k / k!`` for k < d / 2 if d
    is even; else twice the normal tail at sqrt(2 x), and ``exp(-x)`` times the sum of ``x^(k + 1/2) / Gamma(k + 3/2)``.
    """
    if not (radius > 0.0 and 0.0 < largest < np.inf) or kind > LIGHT:
        return 1.0
    y = min(radius * radius / largest, 1360.0) * (1.0 - 8.0 * U)
    if kind != NORMAL:
        exponent = 0.5 * (d * (float(rigorous.log(np.full(1, up(y / d)))[1][0]) + 1.0) - y) + 16.0 * U * (d + y)
        return min(1.0, float(rigorous.exp(np.full(1, exponent))[1][0])) if y > d else 1.0
    # The first term, and what each is more than the one before: half-odd powers if d is odd.
    x, half, one = np.full(1, 0.5 * y), 0.5 * (d % 2), interval(np.ones(1))
    term, total = exp(-interval(x)[::-1]), np.zeros((2, 1))
    if half:
        factor = np.array([[1.1283791670955125], [1.1283791670955128]])  # 1 / Gamma(3/2) = 2 / sqrt(pi)
        term = mul(mul(term, np.stack([down(np.sqrt(x)), up(np.sqrt(x))])), factor)
        total = 2.0 * np.stack(rigorous.tail(np.minimum(down(np.sqrt(2.0 * x)), 37.0)))
    for k in range(d // 2):
        total = add(total, term)
        term = mul(term, mul(interval(x), recip((k + 1.0 + half) * one)))
    return min(1.0, float(total[1, 0]))
