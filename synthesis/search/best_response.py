"""Best choice of every cell for a cell-dependent objective.

Agent i's objective at cell s is ``sum_n weights[s, n] * table[n, z]`` over the lattice points z it can choose. With
target windows this is a matrix product followed by a windowed argmax: cells are taken in bricks whose windows overlap,
so that only a band of the matrix is formed. With a single objective and windows that are products of intervals the
maximum slides instead. With a menu of inputs the few points of each cell are read off the table.

Ties, down to ``TIE`` relative, go to the incumbent, then to the lowest index: the result is deterministic, and rounding
noise never changes a policy.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..cells import FloatArray
from ..models import BoxChoices, Choices, CornerChoices, InputMenu, StepPolicy, TargetWindows
from ..values import beside, namespace, take, to_host

CELLS_PER_BLOCK = 64
"""Cells per block: enough rows for a fast product, few enough that their windows overlap."""

NUMBERS_PER_BLOCK = 1 << 20
"""Numbers that a block may have on a device, which prefers a few large products."""

NUMBERS_IN_CACHE = 4
"""Part of ``NUMBERS_PER_BLOCK`` that the scores of a block may take on this machine, so that they stay in its cache."""

TIE = 1e-12
"""Relative improvement below which the incumbent stays: more than rounding, less than any policy is worth."""


def best_choices(choices: Choices, weights: FloatArray, table: FloatArray, incumbent: StepPolicy) -> StepPolicy:
    """Return the choice (S,) that maximises ``weights[s] @ table[:, z]`` over the points z each cell s can choose.

    The incumbent stays unless another choice is better by more than ``TIE``, relative.

    Parameters
    ----------
    choices : Choices
    weights : (S, n) array, or (1, n) for the same weights everywhere
        Nonnegative weights of the objectives per cell.
    table : (n, Z) array
        Value of every lattice point under each objective.
    incumbent : (S,) int32 array
        Current choices; -1 where a cell has none. They stay where nothing is better, and where nothing weighs.
    """
    if isinstance(choices, CornerChoices):
        weights = np.broadcast_to(weights, (weights.shape[0] if len(weights) > 1 else choices.n_places, len(table)))
        return choices.best(to_host(weights), to_host(table), incumbent)
    if isinstance(choices, BoxChoices):
        weights = np.broadcast_to(weights, (len(incumbent), len(table)))
        return choices.best(to_host(weights), to_host(table), incumbent)
    n_cells, points = len(incumbent), choices.points(incumbent)
    # The same weights everywhere make one objective of all.
    if len(weights) == 1:
        weights, table = np.ones((n_cells, 1)), weights @ table
    if len(table) == 1:  # too little work for a device
        weights, table = to_host(weights), to_host(table)
    if isinstance(choices, TargetWindows) and len(table) == 1 and choices.axis_windows is not None:
        # One objective on product windows: its largest point in a window does not depend on the weight.
        best = _sliding_argmax(table[0].reshape(choices.shape), choices.axis_windows)
        score = np.where(best >= 0, weights[:, 0] * table[0, best], -np.inf)
    else:
        # Block by block; blocks in which every cell has a choice and nothing weighs are left out.
        on_device = not isinstance(table, np.ndarray)
        idle = to_host(~namespace(weights).any(weights != 0, axis=1)) & (points >= 0)
        in_block: Any
        if isinstance(choices, InputMenu):
            # Menus need no neighbours in a block, so cells with something to decide are taken in large blocks.
            in_block, busy = _best_on_menu, np.flatnonzero(~idle)
            size = max(
                CELLS_PER_BLOCK, NUMBERS_PER_BLOCK // (choices.leads_to.shape[1] * (len(table) if on_device else 4))
            )
            blocks = [busy[first : first + size] for first in range(0, len(busy), size)]
        else:
            in_block = _best_in_window
            size = max(CELLS_PER_BLOCK, NUMBERS_PER_BLOCK // table.shape[1]) if on_device else CELLS_PER_BLOCK
            blocks = [block for block in choices.blocks(size) if not idle[block].all()]
        results = [in_block(choices, block, take(weights, block, axis=0), table) for block in blocks]
        best, score = np.full(n_cells, -1, dtype=np.int64), np.zeros(n_cells)
        for block, (chosen, value) in zip(blocks, results, strict=True):
            best[block], score[block] = chosen, value
    # Compare with what the incumbents attain.
    aims = take(table, np.maximum(points, 0), axis=1)
    current = to_host(namespace(table).einsum("sn,ns->s", weights, aims))
    better = (best >= 0) & ((points < 0) | (score > current * (1 + TIE)))
    return np.where(better, best, incumbent).astype(np.int32)


def best_offered(
    offered: tuple[Choices, int], weights: FloatArray, table: FloatArray, incumbent: StepPolicy
) -> StepPolicy:
    """Return the best of choices that are offered, which are numbered from the second number on."""
    choices, first = offered
    if not first:
        return best_choices(choices, weights, table, incumbent)
    before = np.where(incumbent >= 0, incumbent - first, -1).astype(np.int32)
    best = best_choices(choices, weights, table, before)
    return np.where(best >= 0, best + first, -1).astype(np.int32)


def _best_on_menu(
    choices: InputMenu, block: NDArray[Any], weights: FloatArray, table: FloatArray
) -> tuple[NDArray[Any], FloatArray]:
    """Return argmax and maximum of the objective over the inputs of a block of cells."""
    points = choices.leads_to[block]
    if isinstance(table, np.ndarray):
        # Row by row: the numbers that a row of the table gives to a block stay in the cache.
        scores = np.zeros(points.shape)
        for weight, row in zip(weights.T, table, strict=True):
            if weight.any():
                scores += weight[:, None] * row.take(points)
        return _largest(scores)
    reached = take(table, points.ravel(), axis=1).reshape(len(table), *points.shape)
    return _largest(namespace(table).einsum("sn,nsa->sa", weights, reached))


def _best_in_window(
    choices: TargetWindows, block: NDArray[Any], weights: FloatArray, table: FloatArray
) -> tuple[NDArray[Any], FloatArray]:
    """Return argmax and maximum of the objective over the windows of a block of cells."""
    flat, allowed = choices.band(block)
    if len(flat) == 0:
        return np.full(len(allowed), -1), np.full(len(allowed), -np.inf)
    first, value = _largest(
        namespace(table).where(choices.memory.beside(allowed, table), weights @ take(table, flat, axis=1), -np.inf)
    )
    return np.where(np.isfinite(value), flat[first], -1), value


def _largest(scores: FloatArray) -> tuple[NDArray[Any], FloatArray]:
    """Return the column of the first of the largest numbers of every row, and that number."""
    first = namespace(scores).argmax(scores, axis=1)
    return to_host(first), to_host(scores[beside(np.arange(len(scores)), scores), first])


def _sliding_argmax(values: FloatArray, windows: Sequence[tuple[NDArray[Any], NDArray[Any]]]) -> NDArray[np.int64]:
    """Return the flat argmax (S,) of a tensor (Z_1, .., Z_d) over products of windows; -1 for empty ones.

    The maximum over a product is taken along one axis after the other; the first of equal maxima along each counts.
    """
    # `flat` goes along with the values: after the last axis it holds the point of each maximum.
    flat = np.arange(values.size).reshape(values.shape)
    for axis, (low, high) in enumerate(windows):
        # Bring the axis to the end and take the argmax over its windows, row by row.
        lead = np.moveaxis(values, axis, -1)
        shape = lead.shape[:-1]
        chosen = _sliding_rows(np.ascontiguousarray(lead).reshape(-1, lead.shape[-1]), low, high)
        points = np.moveaxis(flat, axis, -1).reshape(chosen.shape[0], -1)
        rows = np.arange(len(chosen))[:, None]
        # Read value and point there; an axis of lattice points has become one of cells.
        empty = chosen < 0
        best = np.where(empty, -np.inf, lead.reshape(len(chosen), -1)[rows, np.maximum(chosen, 0)])
        point = np.where(empty, -1, points[rows, np.maximum(chosen, 0)])
        values = np.moveaxis(best.reshape(*shape, -1), -1, axis)
        flat = np.moveaxis(point.reshape(*shape, -1), -1, axis)
    return flat.ravel()


def _sliding_rows(values: FloatArray, low: NDArray[Any], high: NDArray[Any]) -> NDArray[np.int64]:
    """Return the first argmax (R, S) of every row of values (R, Z) over windows ``low[s] .. high[s] - 1``.

    A sparse table: level k holds the argmax of every run of ``2^k`` points, and two overlapping runs cover a window.
    """
    # The largest power of two that fits into each window.
    width = np.maximum(high - low, 0)
    positive = width > 0
    level = np.zeros(len(low), dtype=int)
    level[positive] = np.floor(np.log2(width[positive])).astype(int)
    result = np.full((len(values), len(low)), -1, dtype=np.int64)
    rows = np.arange(len(values))[:, None]
    table = np.broadcast_to(np.arange(values.shape[1]), values.shape)
    for k in range(int(level.max(initial=0)) + 1):
        # A run of 2^k points consists of two runs of 2^(k-1).
        if k:
            half = 1 << (k - 1)
            left, right = table[:, :-half], table[:, half:]
            table = np.where(values[rows, left] >= values[rows, right], left, right)
        here = positive & (level == k)
        if here.any():
            a, b = table[:, low[here]], table[:, high[here] - (1 << k)]
            result[:, here] = np.where(values[rows, a] >= values[rows, b], a, b)
    return result
