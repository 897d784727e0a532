"""Enclosures of networks over cells: linear bounds, pulled back from the mean of the next state to the state.

On the box of a cell every activation f is replaced by a line and a radius, ``f(z) in s z + m +- r`` for all z between
its bounds, with the slope s of the chord. What follows is affine in the layer before, so that rows of the last layer
are pulled back layer by layer until they act on the state (backward bounds; docs/theory/networks.md). The bounds of a
layer are what these forms and plain intervals have in common. All of it holds for the numbers that single precision
computes: each layer is off by a share of what it sums.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..grids import FloatArray
from .networks import NetworkPolicy

SINGLE = 2.0**-24
"""Unit roundoff of single precision."""

SMALLEST = 2.0**-126
"""What an operation in single precision may be off by where numbers underflow."""

TANH = 2.0**-21
"""Relative error of tanh in single precision, at most: eight units of rounding, of which libraries use two or three."""

FUNCTIONS: dict[str, Callable[[FloatArray], FloatArray]] = {
    "tanh": np.tanh,
    "relu": lambda z: np.maximum(z, 0.0),
    "clip": lambda z: np.clip(z, -1.0, 1.0),
}
"""Activations, and what is done to outputs."""

KINKS = {"relu": (0.0,), "clip": (-1.0, 1.0)}
"""Where they bend, if they do so at points."""

WIDER = 1.0 + 1e-7
"""Factor on what single precision is off by: the rounding of this file is 2e-9 of that, for each of a few sums."""

OUTWARD, ABSOLUTE, MORE = 1e-12, 2.01e-11, 1.001
"""Share by which boxes are wider than computed; what is added in units of the largest move of an input, for the sums
that are pulled back through all layers; and a factor on what these may be off by. More than the check adds, so that its
boxes lie inside, and hardly more, since what is left after unions from below depends on boxes in both directions."""

CELLS_AT_ONCE = 1024
"""Cells that are enclosed at once: arrays of some megabytes."""


@dataclass(frozen=True, eq=False)
class Line:
    """A line and a radius around a function, for arrays of intervals: ``slope z + middle +- radius``."""

    slope: FloatArray
    middle: FloatArray
    radius: FloatArray


@dataclass(frozen=True, eq=False)
class Form:
    """Affine forms ``slopes e + centre +- radius`` of the offset e (d,) from the centre of N cells.

    ``slopes`` (N, n, d), ``centre`` (N, n), ``radius`` (N, n).
    """

    slopes: FloatArray
    centre: FloatArray
    radius: FloatArray

    def ends(self, half: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the least and the largest values (N, n) for offsets of at most ``half`` (N, d)."""
        reach = np.einsum("end,ed->en", np.abs(self.slopes), half) + self.radius
        return self.centre - reach, self.centre + reach


def line_around(kind: str, low: FloatArray, high: FloatArray) -> Line:
    """Return lines around ``tanh``, ``relu`` or ``clip`` (to [-1, 1]) on intervals (outer bounds).

    The difference to the line is extreme at an end, a kink, or where the derivative is that of the line.
    """
    function, width = FUNCTIONS[kind], high - low
    ends = function(low), function(high)
    # Where an interval is nearly a point, rounding may give any slope; all slopes between 0 and 1 are sound.
    chord = (ends[1] - ends[0]) / np.where(width > 0.0, width, 1.0)
    slope = np.clip(np.where(width > 1e-12, chord, 0.0), 0.0, 1.0)
    rest = [ends[0] - slope * low, ends[1] - slope * high]
    if kind == "tanh":
        # The derivative is 1 - tanh^2, so that tanh is +-sqrt(1 - s) there.
        value = np.minimum(np.sqrt(1.0 - slope), 1.0 - 1e-16)
        turns = [(side * np.arctanh(value), side * value) for side in (-1.0, 1.0)]
    else:
        turns = [(np.full_like(low, kink), function(np.full_like(low, kink))) for kink in KINKS[kind]]
    rest += [np.where((low <= z) & (z <= high), value - slope * z, rest[0]) for z, value in turns]
    least, most = np.minimum.reduce(rest), np.maximum.reduce(rest)
    computed = 1e-15 * (1.0 + np.abs(low) + np.abs(high))
    error = TANH * np.maximum(np.abs(ends[0]), np.abs(ends[1])) if kind == "tanh" else 0.0
    return Line(slope, 0.5 * (least + most), (0.5 * (most - least) + error) * WIDER + computed)


@dataclass(frozen=True, eq=False)
class NetworkBounds:
    """Linear bounds on the actions of a network over N cells, in one mode; layers are numbered from 0.

    Parameters
    ----------
    weights : list of (n_k, n_k-1) arrays
        Of all layers after the first one, the last one cut to the actions of the agent.
    biases : list of (n_k,) arrays
    errors : list of (N, n_k) arrays
        What single precision is off by in these layers, for the layers reached so far.
    lines : list of Line
        Around the activations of layers 1 and up, (N, n_k) each, for the layers reached so far.
    first : Form
        Of the first layer, behind its activation.
    """

    weights: list[FloatArray]
    biases: list[FloatArray]
    errors: list[FloatArray]
    lines: list[Line]
    first: Form

    def pulled_back(self, rows: FloatArray, behind: int) -> Form:
        """Return forms of ``rows`` (r, n) or (N, r, n) of what is behind the activation of layer ``behind``."""
        centre: FloatArray | float = 0.0
        radius: FloatArray | float = 0.0
        for k in range(behind, 0, -1):
            line, error = self.lines[k - 1], self.errors[k - 1]
            centre = centre + _times(rows, line.middle)
            radius = radius + _times(np.abs(rows), line.radius)
            rows = rows * line.slope[:, None, :]
            centre = centre + _times(rows, np.broadcast_to(self.biases[k - 1], error.shape))
            radius = radius + _times(np.abs(rows), error)
            rows = rows @ self.weights[k - 1]
        if rows.ndim == 2:  # axis by axis: a few large products in place of many small ones
            columns = [self.first.slopes[..., k] @ rows.T for k in range(self.first.slopes.shape[2])]
            slopes = np.stack(columns, axis=-1)
        else:
            slopes = rows @ self.first.slopes
        centre, radius = centre + _times(rows, self.first.centre), radius + _times(np.abs(rows), self.first.radius)
        return Form(slopes, np.asarray(centre), np.asarray(radius))


def widening(policy: NetworkPolicy, B: FloatArray) -> FloatArray:
    """Return an upper bound (d,) on what means are off by in double precision."""
    box = policy.input_box
    absolute = ABSOLUTE + MORE * _double_rounding(policy)
    return np.asarray(absolute * (np.abs(B) @ (np.abs(box.low) + np.abs(box.high))))


def _double_rounding(policy: NetworkPolicy) -> float:
    """Return an upper bound on what double precision is off by in actions, with all weights taken as positive.

    Rows that are pulled back through layers may be sums of large numbers that cancel each other.
    """
    size, widest, network = 4.0, 0, policy.network
    if policy.view.scale == "raw":
        size += float(np.max([np.abs(policy.workspace.low), np.abs(policy.workspace.high)]))
    pairs = [(np.abs(w).astype(float), np.abs(b)) for w, b in zip(network.weights, network.biases, strict=True)]
    if network.outputs == "box":
        last = _layers(policy)[-1]
        pairs[-1] = np.abs(last.weight), np.abs(last.bias) + np.abs(last.moved)
    for weight, bias in pairs:
        size = float((weight.sum(axis=1) * size + bias).max()) + 1.0
        widest = max(widest, weight.shape[1])
    return len(pairs) * (widest + 16.0) * 2.0**-50 * size


@dataclass(frozen=True, eq=False)
class Layer:
    """A layer ``(W h + b) - moved`` in double precision, all of it divided by ``unit``.

    Parameters
    ----------
    weight : (n, k) array
    bias : (n,) array
        As single precision adds it.
    moved, unit : (n,) arrays
        Middle and half width of the input box behind a layer that answers with inputs; else 0 and 1.
    """

    weight: FloatArray
    bias: FloatArray
    moved: FloatArray
    unit: FloatArray

    def rounded(self, largest: FloatArray) -> FloatArray:
        """Return what single precision is off by in ``W h + b``, in any order, for ``|h| <= largest`` (N, k)."""
        count = self.weight.shape[1] + 2
        share = count * SINGLE / (1.0 - count * SINGLE)
        sums = largest @ np.abs(self.weight).T + np.abs(self.bias)
        return np.asarray((share * sums + count * SMALLEST / self.unit) * WIDER)


def _layers(policy: NetworkPolicy) -> list[Layer]:
    """Return the layers of a network; the last one leads to actions in [-1, 1] before clipping.

    Outputs beyond the inputs of the agent are dropped.
    """
    network, box, m = policy.network, policy.input_box, policy.input_box.dimension
    weights, biases = [w.astype(float) for w in network.weights], [b.astype(float) for b in network.biases]
    layers = [Layer(w, b, np.zeros(len(b)), np.ones(len(b))) for w, b in zip(weights[:-1], biases[:-1], strict=True)]
    moved, unit = np.zeros(m), np.ones(m)
    if network.outputs == "box":
        moved, unit = (0.5 * box.low + 0.5 * box.high) / box.half_width, box.half_width
    return [*layers, Layer(weights[-1][:m] / unit[:, None], biases[-1][:m] / unit, moved, unit)]


def mean_form(
    policy: NetworkPolicy,
    moves: tuple[FloatArray, FloatArray, FloatArray],
    cells: tuple[FloatArray, FloatArray],
    mode: int,
) -> Form:
    """Return affine forms of the means from cells with centres and half widths (N, d) in one mode.

    Double precision is not paid for: ``widening`` says what is to be added.

    Parameters
    ----------
    policy : NetworkPolicy
    moves : A (k, d), B (k, m), offset (k,)
        Dynamics, or anything else that is ``A x + B u + offset``.
    cells : two (N, d) arrays
    mode : int
    """
    (A, B, offset), (centre, half), network = moves, cells, policy.network
    layers = _layers(policy)
    weights, biases = [layer.weight for layer in layers], [layer.bias - layer.moved for layer in layers]
    kinds = [network.activation] * (len(layers) - 1) + ["tanh" if network.squashed else "clip"]
    slopes, before, error = _first_layer(policy, layers[0], cells, mode)
    form = Form(np.broadcast_to(slopes, (len(centre), *slopes.shape)), before, error)
    low, high = form.ends(half)
    line = line_around(kinds[0], low, high)
    behind = Form(slopes * line.slope[..., None], before * line.slope + line.middle, error * line.slope + line.radius)
    bounds = NetworkBounds(weights[1:], biases[1:], [], [], behind)
    values = _values(kinds[0], low, high)
    for k, kind in enumerate(kinds[1:]):
        weight, bias = weights[k + 1], biases[k + 1]
        error = layers[k + 1].rounded(np.maximum(np.abs(values[0]), np.abs(values[1])))
        form = bounds.pulled_back(weight, k)
        low, high = Form(form.slopes, form.centre + bias, form.radius + error).ends(half)
        # Plain intervals are narrower where the activations before are saturated.
        plain = _interval(weight, *values)
        low, high = np.maximum(low, plain[0] + bias - error), np.minimum(high, plain[1] + bias + error)
        bounds.errors.append(error)
        bounds.lines.append(line_around(kind, low, high))
        values = _values(kind, low, high)
    # The mean is A x + B (middle + half width * action) + offset.
    box = policy.input_box
    form = bounds.pulled_back(B * box.half_width, len(kinds) - 1)
    still = centre @ A.T + (B @ (0.5 * box.low + 0.5 * box.high) + offset)
    return Form(form.slopes + A, form.centre + still, form.radius)


def _first_layer(
    policy: NetworkPolicy,
    layer: Layer,
    cells: tuple[FloatArray, FloatArray],
    mode: int,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the first layer before its activation: slopes (n, d), centres (N, n) and errors (N, n)."""
    d, space, weight = policy.workspace.dimension, policy.workspace, layer.weight
    # What is seen of a state x is ``scale (x - low) - 1``, or x itself.
    scale, low, shift = 2.0 / (space.high - space.low), space.low, 1.0
    if policy.view.scale == "raw":
        scale, low, shift = np.ones(d), np.zeros(d), 0.0
    centre = cells[0] * scale - scale * low - shift
    largest = np.abs(centre) + cells[1] * scale
    # A row is computed in double precision and rounded to single.
    off = SINGLE * largest + 2.0**-49 * (1.0 + scale * (np.abs(space.low) + np.abs(space.high)))
    constants = policy.constants(mode)
    rest = weight[:, policy.view.width :]
    before = centre @ weight[:, :d].T + (rest @ constants + (layer.bias - layer.moved))
    size = np.zeros((len(largest), weight.shape[1]))
    size[:, :d], size[:, policy.view.width :] = largest + off, np.abs(constants)
    error = off @ np.abs(weight[:, :d]).T * WIDER + layer.rounded(size)
    return weight[:, :d] * scale, before, error


def _values(kind: str, low: FloatArray, high: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the ends of an activation between bounds, as single precision computes it."""
    if kind == "tanh":
        ends = np.tanh(low), np.tanh(high)
        return ends[0] - TANH * WIDER * np.abs(ends[0]), ends[1] + TANH * WIDER * np.abs(ends[1])
    bound = np.inf if kind == "relu" else 1.0
    least = 0.0 if kind == "relu" else -1.0
    return np.clip(low, least, bound), np.clip(high, least, bound)


def _interval(rows: FloatArray, low: FloatArray, high: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the ends of ``rows @ h`` for h between ``low`` and ``high`` (N, n)."""
    up, down = np.maximum(rows, 0.0), np.minimum(rows, 0.0)
    return low @ up.T + high @ down.T, high @ up.T + low @ down.T


def _times(rows: FloatArray, vectors: FloatArray) -> FloatArray:
    """Return products (N, r) of rows (r, n) or (N, r, n) with vectors (N, n)."""
    if rows.ndim == 2:
        return np.asarray(vectors @ rows.T)
    return np.asarray((rows @ vectors[..., None])[..., 0])
