"""Guesses of agents that keep apart along a line: nobody overtakes there, so that the order is that of the start.

Guesses of several agents that are to be in one region end in its middle, all of them. Where pairs compare one output
alone no plan that begins there finds the order again. So guesses are moved as little as possible (by least squares)
until everybody is behind the next one by what their pair asks for, and a little more.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...relations.grids import FloatArray
from ..chance_constraints import PairLimits

MORE = 1.25
"""Share of what pairs ask for by which guesses are apart."""


def follow_the_leader(guesses: Sequence[FloatArray], limits: Sequence[PairLimits]) -> list[FloatArray]:
    """Return guesses (S + 1, p) of all agents, those that keep apart along a line in the order of their starts."""
    result = [guess.copy() for guess in guesses]
    for group in limits:
        if group.low.shape[2] != 1:
            continue
        apart = [k for k in range(len(group.numbers)) if np.any(group.asked[:, k] < 0)]
        for line in _lines(group, apart):
            _order(result, line, _gaps(group, apart))
    return result


def _lines(group: PairLimits, apart: Sequence[int]) -> list[list[tuple[int, int]]]:
    """Return the (agent, output) that pairs tie together, each set once."""
    parts: list[set[tuple[int, int]]] = []
    for k in apart:
        ends = {(int(group.agents[side, k]), int(group.outputs[side, k, 0])) for side in (0, 1)}
        touched = [part for part in parts if part & ends]
        parts = [part for part in parts if not part & ends] + [ends.union(*touched)]
    return [sorted(part) for part in parts]


def _gaps(group: PairLimits, apart: Sequence[int]) -> dict[frozenset[int], FloatArray]:
    """Return how far two agents are to be apart (S + 1,), by the pair of them."""
    gaps = {}
    for k in apart:
        wide = np.maximum(np.abs(group.low[:, k, 0]), np.abs(group.high[:, k, 0]))
        gaps[frozenset(group.agents[:, k].tolist())] = np.where(np.isfinite(wide), wide, 0.0)
    return gaps


def _order(guesses: list[FloatArray], line: list[tuple[int, int]], gaps: dict[frozenset[int], FloatArray]) -> None:
    """Move the guesses of some agents so that they keep the order of their starts, in place."""
    line = sorted(line, key=lambda end: float(guesses[end[0]][0, end[1]]))
    asked = [gaps.get(frozenset((a[0], b[0]))) for a, b in zip(line, line[1:])]
    if any(gap is None for gap in asked):
        return  # those without a pair may pass each other
    ahead = np.cumsum([np.zeros(len(guesses[0])), *(MORE * gap for gap in asked if gap is not None)], axis=0)
    for t in range(1, len(guesses[0])):
        at = np.array([guesses[i][t, k] for i, k in line]) - ahead[:, t]
        for (i, k), place in zip(line, _rising(at) + ahead[:, t], strict=True):
            guesses[i][t, k] = place


def _rising(values: FloatArray) -> FloatArray:
    """Return the numbers nearest to some that do not fall: means of neighbours that would.

    Examples
    --------
    >>> _rising(np.array([1.0, 4.0, 2.0, 5.0])).tolist()
    [1.0, 3.0, 3.0, 5.0]
    """
    blocks = list[tuple[float, int]]()
    for value in values.tolist():
        block = (value, 1)
        while blocks and blocks[-1][0] > block[0]:
            mean, count = blocks.pop()
            block = ((mean * count + block[0] * block[1]) / (count + block[1]), count + block[1])
        blocks.append(block)
    return np.repeat([mean for mean, _ in blocks], np.array([count for _, count in blocks], dtype=np.int64))
