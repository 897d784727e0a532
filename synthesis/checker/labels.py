"""What is known of regions in boxes of states: that they hold everywhere, nowhere, or neither.

A cell is half-open, ``low <= x < high``, and the last one along an axis holds its upper face. Labels of outputs that
are states are exact; of other outputs they come from intervals on the closed cell.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from .fields import Refused
from .jets import value_on
from .problem import Agent, Problem
from .rigorous import Array

Labels = NDArray[np.int8]
"""By cell and proposition of the agent: 1 holds in all of the cell, -1 nowhere in it, 0 not known."""


def cell_boxes(edges: Sequence[Array]) -> tuple[Array, Array]:
    """Return lower and upper corners (S, d) of all cells, the last axis running fastest."""
    sides = ([axis[:-1] for axis in edges], [axis[1:] for axis in edges])
    low, high = (np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(edges)) for axes in sides)
    return low, high


def cell_labels(problem: Problem, i: int, edges: Sequence[Array]) -> tuple[list[int], Labels]:
    """Return the propositions of agent i and their labels (S, .) in its cells; ``Refused`` where regions move."""
    low, high = cell_boxes(edges)
    last = high == np.array([axis[-1] for axis in edges])  # cells that hold their upper face
    mine = [p for p, region in enumerate(problem.regions) if region.agent == i]
    labels = np.zeros((len(low), len(mine)), dtype=np.int8)
    outputs = [_on_cells(problem.agents[i], k, low, high, last) for k in range(len(problem.agents[i].outputs))]
    for column, p in enumerate(mine):
        region = problem.regions[p]
        if np.any(region.low != region.low[0]) or np.any(region.high != region.high[0]):
            raise Refused(f"`{region.name}` moves with the time, and cells know no time")
        holds, never = np.ones(len(low), dtype=bool), np.zeros(len(low), dtype=bool)
        for (least, most, is_reached), a, b in zip(outputs, region.low[0], region.high[0], strict=True):
            holds &= (a <= least) & np.where(is_reached, most < b, most <= b)
            never |= np.where(is_reached, most < a, most <= a) | (b <= least)
        labels[:, column] = np.where(never, -1, np.where(holds, 1, 0))
    return mine, labels


def _on_cells(
    agent: Agent, k: int, low: Array, high: Array, last: NDArray[np.bool_]
) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Return ends (S,) of an output on cells, and whether (S,) its upper end may be reached."""
    tree = agent.outputs[k]
    if isinstance(tree, str):
        axis = agent.states.index(tree)
        return low[:, axis], high[:, axis], last[:, axis]
    names = {name: np.stack([low[:, j], high[:, j]]) for j, name in enumerate(agent.states)}
    ends = np.broadcast_to(value_on(tree, names), (2, len(low)))
    return ends[0], ends[1], np.ones(len(low), dtype=bool)
