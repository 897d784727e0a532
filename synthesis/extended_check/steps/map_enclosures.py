"""Affine maps around means of expressions under inputs of a menu, for the check.

The map of a cell has the value and the slopes in its middle; what is left of the mean is enclosed with the spans of
``step_intervals``, under every disturbance (docs/theory/linear.md, "One reading for all").
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from ....envs.systems.agents import Agent
from ...certificates.cell_probabilities import AgentRecord, state
from ...relations.grids import FloatArray
from .geometry import cell_boxes
from .mean_enclosures import Enclosed, spans_of_means
from .step_intervals import Span, bounds, products

COMPUTED = 1e-14
"""Share of their size by which maps may be off as they are computed."""

CELLS_AT_ONCE = 20_000
"""Maps that are made at once."""


@dataclass(frozen=True, eq=False)
class Maps:
    """By increasing numbers ``cell * A + choice`` (K,): z (K, d), G (K, d, d) and rho (K, d)."""

    numbers: NDArray[np.int64]
    z: FloatArray
    gain: FloatArray
    rho: FloatArray

    def at(self, numbers: NDArray[np.int64]) -> tuple[FloatArray, FloatArray, FloatArray]:
        """The maps with some numbers (C,)."""
        places = np.searchsorted(self.numbers, numbers)
        return self.z[places], self.gain[places], self.rho[places]


def maps_of(agent: Agent, part: AgentRecord, numbers: NDArray[np.int64]) -> Maps:
    """The maps with some numbers (K,), in increasing order."""
    input_set = np.array(part.relation["menu"], dtype=float)
    cell, choice = np.divmod(numbers, len(input_set))
    low, high = cell_boxes(part)
    d, cuts = low.shape[1], int(part.relation["cuts"])
    maps = Maps(numbers, np.zeros((len(numbers), d)), np.zeros((len(numbers), d, d)), np.zeros((len(numbers), d)))
    for some in np.array_split(np.arange(len(numbers)), len(numbers) // CELLS_AT_ONCE + 1):
        made = map_enclosures(agent, low[cell[some]], high[cell[some]], input_set[choice[some]], cuts)
        maps.z[some], maps.gain[some], maps.rho[some] = made
    return maps


def map_enclosures(
    agent: Agent,
    low: FloatArray,
    high: FloatArray,
    inputs: FloatArray,
    cuts: int,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """z (n, d), G (n, d, d) and rho (n, d) of closed cells (n, d) under inputs (n, m), whatever disturbances do.

    rho is infinite, or no number, where nothing is known of the mean.
    """
    n, d = low.shape
    middle = 0.5 * (low + high)
    calm = [(np.full(n, a), np.full(n, b)) for a, b in agent.unknowns.values()]
    still = np.array([(x, x) for x in middle.T] + [(0.5 * (a + b),) * 2 for a, b in calm])
    with np.errstate(all="ignore"):
        at = spans_of_means(agent, inputs, still, True)
        z = np.stack([value.ends.mean(axis=0) for value in at], axis=1)
        gain = np.stack([value.slopes[:, :d].mean(axis=0).T for value in at], axis=1)
        outputs = partial(_left, agent, inputs, (z, gain, middle))
        first, last = np.full((n, d), np.inf), np.full((n, d), -np.inf)
        cut = [low + (high - low) * (k / cuts) for k in range(cuts)] + [high]
        for piece in itertools.product(range(cuts), repeat=d):
            box = np.array([(cut[k][:, axis], cut[k + 1][:, axis]) for axis, k in enumerate(piece)] + calm)
            ends = np.stack(bounds(outputs, box), axis=-1)
            first, last = np.minimum(first, ends[0]), np.maximum(last, ends[1])
        spans = Enclosed(agent.trees, agent, inputs, (z, gain))
        state("spans", spans, (low, high), calm, (first, last))
        moved = 0.5 * (first + last)
        rho = np.maximum(last - moved, moved - first) + COMPUTED * np.abs(z)
    return z + moved, gain, rho


def _left(
    agent: Agent,
    inputs: FloatArray,
    maps: tuple[FloatArray, FloatArray, FloatArray],
    on: FloatArray,
    with_slopes: bool = False,
) -> list[Span]:
    """Spans of what is left of the mean: less ``z + G (x - middle)``."""
    z, gain, middle = maps
    result = []
    for k, mean in enumerate(spans_of_means(agent, inputs, on, with_slopes)):
        left = mean + (-Span.of(z[:, k], z[:, k], mean))
        for j in range(z.shape[1]):
            if np.any(gain[:, k, j]):
                unit = np.zeros_like(mean.slopes)
                if with_slopes:
                    unit[:, j] = 1.0
                factor = np.stack([gain[:, k, j]] * 2)
                away = Span(on[j], unit) + (-Span.of(middle[:, j], middle[:, j], mean))
                left = left + (-away.scaled(products(factor, away.ends), factor))
        result.append(left)
    return result
