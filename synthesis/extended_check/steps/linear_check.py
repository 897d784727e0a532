"""The relation ``linear``, once more: losses, choices and stored factors by code of the check's own.

With f(x) = E l(m(x) + w) for a choice ``m(x) = z + G (x - c)`` of a cell, and the values of f at the points of a
lattice inside the cell's image, the certificate's factor is a multilinear function below f (see ``symbolic_linear``).
"""

from __future__ import annotations

import itertools
import math

import numpy as np
from numpy.typing import NDArray

from ....envs.systems.agents import AnyAgent
from ...certificates.cell_probabilities import UNIT, AgentRecord
from ...relations.grids import FloatArray
from .symbolic_linear import SymbolicTables, image_values, written_values

RELATIVE = 1e-11
"""Share by which stored factors may exceed what is computed here; the claim's own reserve is larger."""

CHUNK = 3_000_000
"""Numbers that are formed at once."""


def linear_values(
    part: AgentRecord,
    tables: SymbolicTables,
    factors: FloatArray,
    t: int,
    q: int,
    stored: FloatArray | None = None,
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Value factors (n, places) one step earlier, below the truth on every cell, of factors (n, places) >= 0.

    Also which ``stored`` factors (n, places) are proved to be below the truth, too: (n,).
    """
    if not len(factors):
        return np.zeros((0, places_of(part))), np.ones(0, dtype=bool)
    backed_up, largest = written_values(part, tables, factors), factors.max(axis=1, initial=0.0)
    d, parts = len(part.lattice), int(part.relation["parts"])
    policy = part.policy[min(t, len(part.policy) - 1), q]
    result = np.zeros((len(factors), part.grid.n_cells, 2**d))
    chosen_cells = np.flatnonzero(policy >= 0)
    proved = np.ones(len(factors), dtype=bool)
    if stored is not None:
        given = by_cell(stored, part.grid.shape)
        # Where there is no choice the value is 0.
        proved = np.all(stored >= 0.0, axis=1) & ~given[:, policy < 0].any(axis=(1, 2))
    pieces = len(chosen_cells) * len(factors) * (parts + 1) ** d // CHUNK + 1
    for cells in np.array_split(chosen_cells, pieces):
        if len(cells):
            lower, at, lacking, blend = _corner_values(part, tables, backed_up, largest, cells, policy[cells])
            result[:, cells] = lower
            if stored is not None:
                # Any multilinear function will do that is below f at the points that are read by what f may lack.
                between = given[:, cells] @ blend
                fits = np.all(between + lacking[:, :, None] <= at * (1.0 + RELATIVE), axis=2)
                proved &= np.all(fits | ~between.any(axis=2), axis=1)
    # From the corners of each cell to the ends of intervals, axis by axis.
    result = result.reshape(len(factors), *part.grid.shape, *(2,) * d)
    order = [0, *(axis for k in range(d) for axis in (1 + k, 1 + d + k))]
    return result.transpose(order).reshape(len(factors), -1), proved


def by_cell(rows: FloatArray, shape: tuple[int, ...]) -> FloatArray:
    """Factors (n, places) by cell and corner: (n, S, 2^d)."""
    d = len(shape)
    table = rows.reshape(len(rows), *(n for size in shape for n in (size, 2)))
    order = [0, *range(1, 2 * d, 2), *range(2, 2 * d + 1, 2)]
    return table.transpose(order).reshape(len(rows), math.prod(shape), 2**d)


def _corner_values(
    part: AgentRecord,
    tables: SymbolicTables,
    backed_up: list[FloatArray],
    largest: FloatArray,
    cells: NDArray[np.int64],
    choices: NDArray[np.integer],
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Corners (n, C, 2^d) of multilinear functions below the value of every point of the cells.

    Also the values (n, C, K) at the points that are read, what they may lack between them (n, C), and the weights
    (2^d, K) of corners at these points.
    """
    d = len(part.lattice)
    share = np.array(list(itertools.product(np.linspace(0.0, 1.0, int(part.relation["parts"]) + 1), repeat=d)))
    at, lacking, inside = image_values(part, tables, backed_up, largest, cells, choices, share)
    sides = np.array(list(itertools.product((0.0, 1.0), repeat=d)))
    corners = at[:, :, np.flatnonzero(np.all((share == 0.0) | (share == 1.0), axis=1))]
    blend = np.prod(np.where(sides[:, None] == 1.0, share, 1.0 - share), axis=2)
    # An image that leaves the lattice is not known there.
    at, lower = at * inside[:, None], _below(at, corners, corners @ blend, lacking) * inside[:, None]
    return lower, at, lacking, blend


def _below(at: FloatArray, corners: FloatArray, between: FloatArray, lacking: FloatArray) -> FloatArray:
    """The best of three: shifted down, scaled down, constant; never single corners moved."""
    sure = np.maximum(at - lacking[:, :, None], 0.0)
    floor = sure.min(axis=2)
    shift = np.maximum(between - at, 0.0).max(axis=2) + lacking
    with np.errstate(divide="ignore", invalid="ignore"):
        # A function that is 0 at a point is not below f around it, unless nothing lacks there.
        ratio = np.where(between > 0.0, sure / between, np.where(at >= lacking[:, :, None], 1.0, 0.0))
    scale = np.minimum(1.0, ratio.min(axis=2)) * (1.0 - 4.0 * UNIT)
    moved, scaled = corners - shift[:, :, None], scale[:, :, None] * corners
    average = corners.mean(axis=2)
    # Two forms often have the same mean; the earlier one is taken unless the other is clearly better.
    result = np.where((scale * average >= (1.0 - 1e-6) * floor)[:, :, None], scaled, floor[:, :, None])
    take = np.all(moved >= 0.0, axis=2) & (average - shift >= (1.0 - 1e-6) * np.maximum(scale * average, floor))
    return np.where(take[:, :, None], moved, result)


def hat_weights(agent: AnyAgent, part: AgentRecord) -> FloatArray:
    """Weights (places,) that give the mean of a multilinear factor over the start of an agent, up to rounding."""
    low, high = agent.initial.low, agent.initial.high
    weights = np.ones(1)
    for edges, a, b in zip(part.grid.edges, low.tolist(), high.tolist(), strict=True):
        axis = np.zeros((len(edges) - 1, 2))
        for k in range(len(edges) - 1):
            left, right = edges[k], edges[k + 1]
            last = k == len(edges) - 2
            if a == b:
                mass, centre = float(left <= a and (a < right or (last and a == right))), a
            else:
                mass = max(min(right, b) - max(left, a), 0.0) / (b - a)
                centre = 0.5 * (min(right, b) + max(left, a))
            up = min(max((centre - left) / (right - left), 0.0), 1.0)
            axis[k] = mass * (1.0 - up), mass * up
        weights = (weights[:, None] * axis.ravel()).ravel()
    return weights


def doubled(rows: NDArray, shape: tuple[int, ...]) -> NDArray:
    """Numbers of cells (K, S) at both ends of every interval: (K, places)."""
    table = rows.reshape(len(rows), *shape)
    for axis in range(1, len(shape) + 1):
        table = np.repeat(table, 2, axis=axis)
    return table.reshape(len(rows), 2 ** len(shape) * math.prod(shape))


def places_of(part: AgentRecord) -> int:
    """Number of places at which factors of an agent have values: its cells, or their corners."""
    return part.grid.n_cells * (2 ** len(part.lattice) if part.relation["kind"] == "linear" else 1)


def masks_of(part: AgentRecord, masks: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Masks (K, places) at the places of factors."""
    return doubled(masks, part.grid.shape) if part.relation["kind"] == "linear" else masks
