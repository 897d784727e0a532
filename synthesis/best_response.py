"""Best admissible target of every cell for a cell-dependent objective.

Agent i's objective at cell s is ``sum_n weights[s, n] * table[n, z]`` over its admissible targets z, a matrix product
followed by a windowed argmax. Cells are taken in blocks whose windows overlap, so that only a band of the matrix is
formed. With a single objective and windows that are products of intervals the maximum slides along one axis after the
other instead.

Ties, down to ``TIE`` relative, go to the incumbent, then to the lowest lattice index: the result is deterministic and
rounding noise never changes a policy.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .abstraction import AgentModel
from .grid import FloatArray

BLOCK = 64
"""Cells per block."""

TIE = 1e-12
"""Relative improvement below which the incumbent stays."""

Law = NDArray[np.int32]


def best_targets(model: AgentModel, weights: FloatArray, table: FloatArray, incumbent: Law) -> Law:
    """Target (S,) that maximises ``weights[s] @ table[:, z]`` over the admissible targets z of each cell s.

    Parameters
    ----------
    weights : (S, n) array
        Nonnegative weights of the objectives per cell.
    table : (n, Z) array
        Value of every lattice point under each objective.
    incumbent : (S,) int32 array
        Current targets; -1 where a cell has none. Kept where nothing is better.
    """
    best, score = np.full(model.n_cells, -1, dtype=np.int64), np.full(model.n_cells, -np.inf)
    if table.shape[0] == 1 and len(model.lattice) == 1 and model.relation.is_box:
        best = _sliding_argmax(table[0], model.window_low[:, 0], model.window_high[:, 0])
        score = np.where(best >= 0, weights[:, 0] * table[0, best], -np.inf)
    else:
        for start in range(0, model.n_cells, BLOCK):
            block = np.arange(start, min(start + BLOCK, model.n_cells))
            best[block], score[block] = _best_in_block(model, block, weights[block], table)
    current = np.sum(weights * table[:, np.maximum(incumbent, 0)].T, axis=1)
    better = (best >= 0) & ((incumbent < 0) | (score > current * (1 + TIE)))
    return np.where(better, best, incumbent).astype(np.int32)


def _best_in_block(
    model: AgentModel, block: NDArray[np.integer], weights: FloatArray, table: FloatArray
) -> tuple[NDArray[np.int64], FloatArray]:
    """Argmax and maximum of the objective over the windows of a block of cells."""
    low, high = model.window_low[block], model.window_high[block]
    nonempty = np.all(low < high, axis=1)
    if not nonempty.any():
        return np.full(len(block), -1), np.full(len(block), -np.inf)
    axes = [np.arange(a, b) for a, b in zip(low[nonempty].min(axis=0), high[nonempty].max(axis=0), strict=True)]
    flat = np.ravel_multi_index(np.meshgrid(*axes, indexing="ij"), model.lattice_shape).ravel()
    scores = weights @ table[:, flat]
    if model.relation.is_box:
        allowed = np.ones((len(block), *(len(axis) for axis in axes)), dtype=bool)
        for k, axis in enumerate(axes):
            inside = (axis >= low[:, k, None]) & (axis < high[:, k, None])
            allowed &= inside.reshape(len(block), *(-1 if j == k else 1 for j in range(len(axes))))
        allowed = allowed.reshape(len(block), -1)
    else:
        allowed = model.admissible(block[:, None], flat[None, :])
    scores[~allowed] = -np.inf
    first = np.argmax(scores, axis=1)
    value = scores[np.arange(len(block)), first]
    return np.where(np.isfinite(value), flat[first], -1), value


def _sliding_argmax(values: FloatArray, low: NDArray[np.integer], high: NDArray[np.integer]) -> NDArray[np.int64]:
    """First argmax of ``values[low:high]`` for many windows at once (sparse table); -1 for empty windows."""
    width = np.maximum(high - low, 0)
    level = np.zeros(len(low), dtype=int)
    positive = width > 0
    level[positive] = np.floor(np.log2(width[positive])).astype(int)
    result = np.full(len(low), -1, dtype=np.int64)
    table = np.arange(len(values))
    for k in range(int(level.max(initial=0)) + 1):
        if k:
            half = 1 << (k - 1)
            left, right = table[:-half], table[half:]
            table = np.where(values[left] >= values[right], left, right)
        here = positive & (level == k)
        a, b = table[low[here]], table[high[here] - (1 << k)]
        result[here] = np.where(values[a] >= values[b], a, b)
    return result
