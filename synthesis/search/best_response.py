"""Best choice of every cell for a cell-dependent objective.

Agent i's objective at cell s is ``sum_n weights[s, n] * table[n, z]`` over the lattice points z it can choose. With
target windows that is a matrix product followed by a windowed argmax: cells are taken in bricks whose windows overlap,
so that only a band of the matrix is formed; with a single objective and one axis the maximum slides instead. With a
menu of inputs the few points of each cell are read off the table.

Ties, down to ``TIE`` relative, go to the incumbent, then to the lowest index: the result is deterministic and rounding
noise never changes a policy.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..cells import FloatArray
from ..models import Choices, InputMenu, StepPolicy, TargetWindows
from ..values import beside, namespace, take, to_host

BLOCK = 64
"""Cells per block."""

ROOM = 1 << 20
"""Numbers that the blocks of a device may have: few and large ones suit it."""

TIE = 1e-12
"""Relative improvement below which the incumbent stays."""


def best_choices(choices: Choices, weights: FloatArray, table: FloatArray, incumbent: StepPolicy) -> StepPolicy:
    """Choice (S,) that maximises ``weights[s] @ table[:, z]`` over the points z that each cell s can choose.

    Parameters
    ----------
    choices : Choices
    weights : (S, n) array, or (1, n) for the same weights everywhere
        Nonnegative weights of the objectives per cell.
    table : (n, Z) array
        Value of every lattice point under each objective.
    incumbent : (S,) int32 array
        Current choices; -1 where a cell has none. Kept where nothing is better, and where nothing weighs.
    """
    n_cells, points = len(incumbent), choices.points(incumbent)
    if len(weights) == 1:
        weights, table = np.ones((n_cells, 1)), weights @ table
    if len(table) == 1:  # too little for a device
        weights, table = to_host(weights), to_host(table)
    if isinstance(choices, TargetWindows) and len(table) == 1 and choices.axis_windows is not None:
        best = _sliding_argmax(table[0].reshape(choices.shape), choices.axis_windows)
        score = np.where(best >= 0, weights[:, 0] * table[0, best], -np.inf)
    else:
        size = BLOCK if isinstance(table, np.ndarray) else max(BLOCK, ROOM // table.shape[1])
        in_block = _best_on_menu if isinstance(choices, InputMenu) else _best_in_window
        idle = to_host(~namespace(weights).any(weights != 0, axis=1)) & (points >= 0)
        blocks = [block for block in choices.blocks(size) if not idle[block].all()]
        found = [in_block(choices, block, take(weights, block, axis=0), table) for block in blocks]  # type: ignore[arg-type]
        best, score = np.full(n_cells, -1, dtype=np.int64), np.zeros(n_cells)
        for block, (chosen, value) in zip(blocks, found, strict=True):
            best[block], score[block] = chosen, value
    aims = take(table, np.maximum(points, 0), axis=1)
    current = to_host(namespace(table).einsum("sn,ns->s", weights, aims))
    better = (best >= 0) & ((points < 0) | (score > current * (1 + TIE)))
    return np.where(better, best, incumbent).astype(np.int32)


def _best_on_menu(
    choices: InputMenu, block: NDArray[Any], weights: FloatArray, table: FloatArray
) -> tuple[NDArray[Any], FloatArray]:
    """Argmax and maximum of the objective over the inputs of a block of cells."""
    points = choices.leads_to[block]
    reached = take(table, points.ravel(), axis=1).reshape(len(table), *points.shape)
    return _largest(namespace(table).einsum("sn,nsa->sa", weights, reached))


def _best_in_window(
    choices: TargetWindows, block: NDArray[Any], weights: FloatArray, table: FloatArray
) -> tuple[NDArray[Any], FloatArray]:
    """Argmax and maximum of the objective over the windows of a block of cells."""
    flat, allowed = choices.band(block)
    if len(flat) == 0:
        return np.full(len(allowed), -1), np.full(len(allowed), -np.inf)
    first, value = _largest(
        namespace(table).where(choices.memory.beside(allowed, table), weights @ take(table, flat, axis=1), -np.inf)
    )
    return np.where(np.isfinite(value), flat[first], -1), value


def _largest(scores: FloatArray) -> tuple[NDArray[Any], FloatArray]:
    """The first of the largest numbers of every row, and its column."""
    first = namespace(scores).argmax(scores, axis=1)
    return to_host(first), to_host(scores[beside(np.arange(len(scores)), scores), first])


def _sliding_argmax(values: FloatArray, windows: Sequence[tuple[NDArray[Any], NDArray[Any]]]) -> NDArray[np.int64]:
    """Flat argmax (S,) of a tensor (Z_1, .., Z_d) over products of windows; -1 for empty ones.

    One axis after the other; the first of equal maxima along each is taken.
    """
    flat = np.arange(values.size).reshape(values.shape)
    for axis, (low, high) in enumerate(windows):
        lead = np.moveaxis(values, axis, -1)
        shape = lead.shape[:-1]
        chosen = _sliding_rows(np.ascontiguousarray(lead).reshape(-1, lead.shape[-1]), low, high)
        own = np.moveaxis(flat, axis, -1).reshape(chosen.shape[0], -1)
        rows = np.arange(len(chosen))[:, None]
        empty = chosen < 0
        best = np.where(empty, -np.inf, lead.reshape(len(chosen), -1)[rows, np.maximum(chosen, 0)])
        point = np.where(empty, -1, own[rows, np.maximum(chosen, 0)])
        values = np.moveaxis(best.reshape(*shape, -1), -1, axis)
        flat = np.moveaxis(point.reshape(*shape, -1), -1, axis)
    return flat.ravel()


def _sliding_rows(values: FloatArray, low: NDArray[Any], high: NDArray[Any]) -> NDArray[np.int64]:
    """First argmax (R, S) of every row of values (R, Z) over windows ``low[s] .. high[s] - 1`` (sparse table)."""
    width = np.maximum(high - low, 0)
    positive = width > 0
    level = np.zeros(len(low), dtype=int)
    level[positive] = np.floor(np.log2(width[positive])).astype(int)
    result = np.full((len(values), len(low)), -1, dtype=np.int64)
    rows = np.arange(len(values))[:, None]
    table = np.broadcast_to(np.arange(values.shape[1]), values.shape)
    for k in range(int(level.max(initial=0)) + 1):
        if k:
            half = 1 << (k - 1)
            left, right = table[:, :-half], table[:, half:]
            table = np.where(values[rows, left] >= values[rows, right], left, right)
        here = positive & (level == k)
        if here.any():
            a, b = table[:, low[here]], table[:, high[here] - (1 << k)]
            result[:, here] = np.where(values[rows, a] >= values[rows, b], a, b)
    return result
