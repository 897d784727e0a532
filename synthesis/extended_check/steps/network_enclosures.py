"""Affine maps around the means under networks, written a second time: nothing of the search's is used.

Affine forms go forward through the network, from the state to the mean. A number of a layer is ``a e + b + sum_j p_j
y_j`` with the offset e of the state from the centre of its cell, and symbols y_j between -1 and 1, one for each number
of the layers before. A bent function adds a symbol: between the ends of its argument it is a line, the chord, up to a
radius. The rows that the network sees are made here from the problem, and what single precision is off by is added in
every layer (docs/theory/networks.md).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....envs.systems.agents import AnyAgent, LinearAgent
from ...certificates.cell_probabilities import AgentRecord, state
from ...relations.grids import FloatArray
from .geometry import cell_boxes

HALF_UNIT, TINY = 2.0**-24, 2.0**-126
"""Largest relative rounding in single precision, and what underflow adds."""

TANGENS = 2.0**-21
"""Largest relative error of the hyperbolic tangent in single precision."""

SPARE, LATER = 1.0 + 2e-8, 2e-11
"""Factor on these, for what is computed here in double precision, where rounding is 2e-9 of that in single; and what is
added at the end, in units of the largest move of an input. The search takes more of both."""

BOXES_AT_ONCE = 64
"""Cells whose forms are carried along at once: some ten thousand numbers each, which stay in the cache."""


@dataclass(frozen=True, eq=False)
class Forms:
    """Numbers (C, n) of C cells as affine forms.

    ``slopes`` (C, n, d); ``constants`` (C, n); ``symbols`` (C, n, s), coefficients of what earlier layers are off by;
    ``own`` (C, n), those of a symbol that each number has to itself.
    """

    slopes: FloatArray
    constants: FloatArray
    symbols: FloatArray
    own: FloatArray

    def between(self, half: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Least and largest numbers (C, n)."""
        spread = (np.abs(self.slopes) @ half[:, :, None])[:, :, 0] + np.abs(self.symbols).sum(axis=2) + self.own
        return self.constants - spread, self.constants + spread

    def through(self, matrix: FloatArray, shift: FloatArray) -> Forms:
        """Forms of ``matrix @ numbers + shift``."""
        symbols = matrix @ self.symbols
        if np.any(self.own):  # rows are known, so that the first layer has no symbols
            symbols = np.concatenate([symbols, matrix * self.own[:, None, :]], axis=2)
        constants = self.constants @ matrix.T + shift
        return Forms(matrix @ self.slopes, constants, symbols, np.zeros(constants.shape))

    def bent(self, share: FloatArray, shift: FloatArray, radius: FloatArray) -> Forms:
        """Forms of ``share * number + shift`` with a new symbol of a radius for each number, (C, n) each."""
        scale = share[:, :, None]
        return Forms(self.slopes * scale, self.constants * share + shift, self.symbols * scale, radius)


def network_maps(
    agent: LinearAgent, part: AgentRecord, cells: NDArray[np.int64], mode: int
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """z (C, d), G (C, d, d) and rho (C, d) of closed cells under a mode of the network.

    The mean from x in a cell with middle c is ``z + G (x - c)``, give or take rho; what means are off by in floating
    point besides the network is not in it.
    """
    low, high = (corner[cells] for corner in cell_boxes(part))
    z, gain, rho = np.zeros(low.shape), np.zeros((*low.shape, low.shape[1])), np.zeros(low.shape)
    for some in np.array_split(np.arange(len(cells)), len(cells) // BOXES_AT_ONCE + 1):
        form, spare = _mean_forms(agent, part, low[some], high[some], mode)
        z[some], gain[some] = form.constants, form.slopes
        rho[some] = np.abs(form.symbols).sum(axis=2) + form.own + spare
    return z, gain, rho


def _spare(agent: AnyAgent, part: AgentRecord, layers: list[tuple[Any, Any]]) -> FloatArray:
    """What double precision may be off by in inputs (m,)."""
    network, box = part.relation["network"], agent.chosen_box
    cancelled = _cancelled(layers, _largest_seen(agent, network), agent if _is_in_units(network) else None)
    return np.asarray((LATER + cancelled) * (np.abs(box.low) + np.abs(box.high)))


def _mean_forms(
    agent: LinearAgent, part: AgentRecord, left: FloatArray, right: FloatArray, mode: int
) -> tuple[Forms, FloatArray]:
    """Forms of the means from boxes of states with corners (C, d).

    Also what double precision may be off by (d,).
    """
    A, B, c = agent.A, agent.B, agent.offset
    middle, half = 0.5 * (left + right), 0.5 * (right - left) * (1.0 + 1e-13)
    forms, layers = _answers(agent, part, middle, half, mode)
    box = agent.input_box
    gain, still = B * (0.5 * (box.high - box.low)), middle @ A.T + c + B @ (0.5 * (box.low + box.high))
    total = forms.through(gain, np.zeros(len(gain)))
    spare = np.abs(B) @ _spare(agent, part, layers)
    return Forms(total.slopes + A, total.constants + still, total.symbols, total.own), spare


def _answers(
    agent: AnyAgent, part: AgentRecord, middle: FloatArray, half: FloatArray, mode: int
) -> tuple[Forms, list[tuple[Any, Any]]]:
    """Forms of the actions in [-1, 1] that a network answers on boxes of states, and its layers."""
    network, box = part.relation["network"], agent.chosen_box
    forms, low, high, off = _seen(agent, part, middle, half, mode)
    layers = list(zip(network["weights"], network["biases"], strict=True))
    for k, (weights, biases) in enumerate(layers):
        is_last = k == len(layers) - 1
        matrix, shift = np.array(weights, dtype=float), np.array(biases, dtype=float)
        if is_last:
            matrix, shift = matrix[: box.dimension], shift[: box.dimension]
        # What sums of products are off by in any order: a rounding for each number, and two more.
        count = matrix.shape[1] + 2
        rounding = np.maximum(np.abs(low), np.abs(high)) @ np.abs(matrix).T + np.abs(shift)
        rounding = (rounding * (count * HALF_UNIT / (1.0 - count * HALF_UNIT)) + count * TINY) * SPARE
        if is_last and _is_in_units(network):
            # Inputs are cut to their box: the same as their share of it cut to [-1, 1].
            shares, centres = 2.0 / (box.high - box.low), 0.5 * (box.low + box.high)
            matrix, shift, rounding = matrix * shares[:, None], (shift - centres) * shares, rounding * shares
        if k == 0:
            rounding = rounding + off @ np.abs(matrix).T * SPARE
        positive, negative = np.where(matrix > 0, matrix, 0.0), np.where(matrix < 0, matrix, 0.0)
        plain = low @ positive.T + high @ negative.T + shift, high @ positive.T + low @ negative.T + shift
        forms = forms.through(matrix, shift)
        low, high = forms.between(half)
        low, high = np.maximum(low, plain[0]) - rounding, np.minimum(high, plain[1]) + rounding
        kind = network["activation"] if not is_last else ("tanh" if network["squashed"] else "cut")
        share, shifted, radius = chord(kind, low, high)
        forms = forms.bent(share, shifted, radius + share * rounding)
        low, high = _ends(kind, low, high)
    return forms, layers


def _is_in_units(network: dict[str, Any]) -> bool:
    """Whether outputs are inputs, cut to their box, and not actions in [-1, 1]."""
    return bool(network.get("outputs", "unit") == "box")


def _largest_seen(agent: AnyAgent, network: dict[str, Any]) -> float:
    """A number that no number of a row, nor a sum that it is made of, exceeds by far."""
    if network.get("scale", "unit") == "unit":
        return 4.0
    return 4.0 + max(float(np.max(np.abs(end))) for end in (agent.workspace.low, agent.workspace.high))


def _cancelled(layers: list[tuple[Any, Any]], size: float, in_units: AnyAgent | None) -> float:
    """What double precision is off by in actions, at most, however much weights cancel each other.

    No number of any layer, nor any coefficient of a form, is larger than what absolute values lead to, and what is
    rounded in one layer grows in the later ones as these do. With an agent outputs are inputs of its, in their units.
    """
    widest = 0
    for k, (weights, biases) in enumerate(layers):
        matrix, shift = np.abs(np.array(weights, dtype=float)), np.abs(np.array(biases, dtype=float))
        if in_units is not None and k == len(layers) - 1:
            box = in_units.chosen_box
            matrix, shift = matrix[: box.dimension], shift[: box.dimension] + 0.5 * np.abs(box.low + box.high)
            shares = 2.0 / (box.high - box.low)
            matrix, shift = matrix * shares[:, None], shift * shares
        size = float(np.max(matrix.sum(axis=1) * size + shift)) + 1.0
        widest = max(widest, matrix.shape[1])
    return len(layers) * (widest + 16.0) * 2.0**-50 * size


def _seen(
    agent: AnyAgent, part: AgentRecord, middle: FloatArray, half: FloatArray, mode: int
) -> tuple[Forms, FloatArray, FloatArray, FloatArray]:
    """Forms of the rows that the network sees in a mode, their least and largest numbers, and what they are off by."""
    network = part.relation["network"]
    time, q = divmod(mode, network["states"])
    (n, d), width = middle.shape, int(network["width"])
    size = width + network["states"] + 1 + network["agents"]
    scale = 2.0 / (agent.workspace.high - agent.workspace.low)
    slopes, constants, off = np.zeros((n, size, d)), np.zeros((n, size)), np.zeros((n, size))
    first, shift = agent.workspace.low, 1.0
    if network.get("scale", "unit") == "raw":  # states are seen in their units
        scale, first, shift = np.ones(d), np.zeros(d), 0.0
    slopes[:, :d] = np.diag(scale)
    constants[:, :d] = (middle - first) * scale - shift
    # States are scaled in double precision, and the row rounded to single.
    reach = np.abs(constants[:, :d]) + half @ np.abs(slopes[0, :d]).T
    doubled = 2.0**-50 * (1.0 + scale * (np.abs(agent.workspace.low) + np.abs(agent.workspace.high)))
    off[:, :d] = HALF_UNIT * reach + doubled
    constants[:, width + q] = 1.0
    constants[:, width + network["states"]] = float(np.float32(1.0 - time / network["horizon"]))
    if network["agents"]:
        constants[:, width + network["states"] + 1 + network["agent"]] = 1.0
    forms = Forms(slopes, constants, np.zeros((n, size, 0)), np.zeros((n, size)))
    low, high = forms.between(half)
    return forms, low - off, high + off, off


def chord(kind: str, low: FloatArray, high: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Slopes, constants and radii of lines around the tangent, the positive part, or numbers cut to [-1, 1]."""

    if kind not in ("tanh", "relu", "cut"):
        raise ValueError(f"networks with the activation {kind!r} are not enclosed on cells")

    def value(z: FloatArray) -> FloatArray:
        return _tangent(z) if kind == "tanh" else np.clip(z, 0.0 if kind == "relu" else -1.0, _most(kind))

    wide, first, last = high - low > 1e-12, value(low), value(high)
    slope = np.where(wide, (last - first) / np.where(wide, high - low, 1.0), 0.0)
    slope = np.minimum(np.maximum(slope, 0.0), 1.0)
    # What is left is extreme at the ends, or where the function has the slope of the line, or a kink.
    at_ends = first - slope * low, last - slope * high
    smallest, largest = np.minimum(*at_ends), np.maximum(*at_ends)
    steep = np.minimum(np.sqrt(1.0 - slope), 1.0 - 1e-16)  # the tangent of z where its derivative is the slope
    places = {"relu": [0.0], "cut": [-1.0, 1.0]}.get(kind, [])
    turns: list[tuple[Any, Any]] = [(z, np.clip(z, 0.0 if kind == "relu" else -1.0, _most(kind))) for z in places]
    if kind == "tanh":
        turns = [(side * np.arctanh(steep), side * steep) for side in (-1.0, 1.0)]
    for z, there in turns:
        inside, left = (z >= low) & (z <= high), there - slope * z
        smallest = np.where(inside, np.minimum(smallest, left), smallest)
        largest = np.where(inside, np.maximum(largest, left), largest)
    radius = 0.5 * (largest - smallest)
    if kind == "tanh":
        radius = radius + TANGENS * np.maximum(np.abs(first), np.abs(last))
    return slope, 0.5 * (smallest + largest), radius * SPARE + 5e-16 * (1.0 + np.abs(low) + np.abs(high))


def _tangent(z: FloatArray) -> FloatArray:
    """The hyperbolic tangent, up to a few units in the last place: single precision is charged far more."""
    at = np.tanh(z)
    off = 1e-15 * np.abs(at) + np.finfo(float).tiny
    state("function", "tanh", (), z, at - off, at + off)
    return np.asarray(at)


def _most(kind: str) -> float:
    return np.inf if kind == "relu" else 1.0


def _ends(kind: str, low: FloatArray, high: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Least and largest values as single precision computes them."""
    if kind == "tanh":
        least, most = _tangent(low), _tangent(high)
        return least - TANGENS * SPARE * np.abs(least), most + TANGENS * SPARE * np.abs(most)
    floor = 0.0 if kind == "relu" else -1.0
    return np.clip(low, floor, _most(kind)), np.clip(high, floor, _most(kind))
