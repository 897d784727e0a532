"""The relation ``linear``, once more: losses, choices and stored factors by code of the check's own.

With f(x) = E l(m(x) + w) for a choice ``m(x) = z + G (x - c)`` of a cell, and the values of f at the points of a
lattice inside the cell's image, the certificate's factor is a multilinear function below f. What f may lack between
points is at most ``sum_k |u_k|^2/8 sup (d^2 f)^+`` over the steps u_k between them (see ``linear_tables``).
"""

from __future__ import annotations

import itertools
import math

import numpy as np
from numpy.typing import NDArray

from ...envs.agents import AnyAgent, LinearAgent, with_matrices
from ..cells import FloatArray
from ..masses import AgentPart
from .linear_tables import ON_LATTICE, UNIT, LinearTables, grid_matrix, values_and_bends
from .written_linear import WrittenTables, image_values, written_values

RELATIVE = 1e-11
"""Share by which stored factors may exceed what is computed here; the claim's own reserve is larger."""

CHUNK = 3_000_000
"""Numbers that are formed at once."""


def linear_values(
    agent: AnyAgent,
    part: AgentPart,
    tables: LinearTables | WrittenTables,
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
    smoothed = _smoothed(part, tables, factors)
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
            lower, at, lacking, blend = _corner_values(agent, part, tables, smoothed, cells, policy[cells])
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


def _smoothed(part: AgentPart, tables: LinearTables | WrittenTables, factors: FloatArray) -> list[FloatArray]:
    """Values of factors on the lattice and what is known of them between its points; last the largest of each (n,)."""
    largest = factors.max(axis=1, initial=0.0)
    if isinstance(tables, WrittenTables):
        return [*written_values(part, tables, factors), largest]
    return [*values_and_bends(tables, factors), largest]


def by_cell(rows: FloatArray, shape: tuple[int, ...]) -> FloatArray:
    """Factors (n, places) by cell and corner: (n, S, 2^d)."""
    d = len(shape)
    table = rows.reshape(len(rows), *(n for size in shape for n in (size, 2)))
    order = [0, *range(1, 2 * d, 2), *range(2, 2 * d + 1, 2)]
    return table.transpose(order).reshape(len(rows), math.prod(shape), 2**d)


def _corner_values(
    agent: AnyAgent,
    part: AgentPart,
    tables: LinearTables | WrittenTables,
    smoothed: list[FloatArray],
    cells: NDArray[np.int64],
    choices: NDArray[np.integer],
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Corners (n, C, 2^d) of multilinear functions below the value of every point of the cells.

    Also the values (n, C, K) at the points that are read, what they may lack between them (n, C), and the weights
    (2^d, K) of corners at these points.
    """
    d = len(part.lattice)
    share = np.array(list(itertools.product(np.linspace(0.0, 1.0, int(part.relation["parts"]) + 1), repeat=d)))
    if isinstance(tables, WrittenTables):
        at, lacking, inside = image_values(part, tables, smoothed[:-1], smoothed[-1], cells, choices, share)
    else:
        agent = with_matrices(agent)
        at, lacking, inside = _images(agent, part, tables, smoothed, cells, choices, share)
    sides = np.array(list(itertools.product((0.0, 1.0), repeat=d)))
    corners = at[:, :, np.flatnonzero(np.all((share == 0.0) | (share == 1.0), axis=1))]
    blend = np.prod(np.where(sides[:, None] == 1.0, share, 1.0 - share), axis=2)
    # An image that leaves the lattice is not known there.
    at, lower = at * inside[:, None], _below(at, corners, corners @ blend, lacking) * inside[:, None]
    return lower, at, lacking, blend


def _images(
    agent: LinearAgent,
    part: AgentPart,
    tables: LinearTables,
    smoothed: list[FloatArray],
    cells: NDArray[np.int64],
    choices: NDArray[np.integer],
    share: FloatArray,
) -> tuple[FloatArray, FloatArray, NDArray[np.bool_]]:
    """Values (n, C, K) at the images of points ``share`` (K, d), what they may lack (n, C), and images inside (C,)."""
    d, shape = len(part.lattice), tuple(len(axis) for axis in part.lattice)
    n_points = math.prod(shape)
    places = np.unravel_index(cells, part.grid.shape)
    low = np.stack([edges[k] for edges, k in zip(part.grid.edges, places, strict=True)], axis=1)
    high = np.stack([edges[k + 1] for edges, k in zip(part.grid.edges, places, strict=True)], axis=1)
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    if len(part.relation["menu"]):
        A = grid_matrix(agent, part)
        inputs = np.array(part.relation["menu"], dtype=float)[choices]
        offset = np.linalg.solve(part.coordinates, (agent.offset + inputs @ agent.B.T).T).T
        z, gains = middle @ A.T + offset, np.broadcast_to(A, (len(cells), d, d))
    else:
        gain, point = np.divmod(choices, n_points)
        z = np.stack([axis[k] for axis, k in zip(part.lattice, np.unravel_index(point, shape), strict=True)], axis=1)
        gains = gain[:, None, None] * np.eye(d)
    position = z[:, None] + np.einsum("sij,sj,kj->ski", gains, half, 2.0 * share - 1.0)
    first = np.array([axis[0] for axis in part.lattice])
    pitch = np.array([(axis[-1] - axis[0]) / (len(axis) - 1) for axis in part.lattice])
    at, lacking, inside = _read(smoothed[0], smoothed[1], (position - first) / pitch, shape, tables.between)
    # A choice that commands one mean has one value, and loses nothing.
    lacking[:, ~gains.any(axis=(1, 2))] = 0.0
    return at, lacking, inside


def _read(
    values: FloatArray, bends: FloatArray, position: FloatArray, shape: tuple[int, ...], between: bool
) -> tuple[FloatArray, FloatArray, NDArray[np.bool_]]:
    """Values (n, C, K) at positions (C, K, d) in lattice steps, what they may lack (n, C), and images inside (C,).

    Images that are said to lie on the lattice and do not are not read.
    """
    whole = np.rint(position)
    exact = np.abs(position - whole) <= ON_LATTICE
    base = np.where(exact, whole, np.floor(position)).astype(np.int64)
    rest = np.where(exact, 0.0, position - base)
    last = np.array(shape) - 1
    inside = np.all((base >= 0) & (base + (rest > 0) <= last), axis=(1, 2))
    inside &= between | np.all(exact, axis=(1, 2))
    base[~inside] = 0
    read, lacking = np.zeros((len(values), *position.shape[:2])), np.zeros((len(values), len(position)))
    for corner in itertools.product((0, 1), repeat=len(shape)):
        weight = np.prod(np.where(np.array(corner) == 1, rest, 1.0 - rest), axis=2)
        if not weight.any():
            continue
        flat = np.ravel_multi_index(tuple(np.moveaxis(np.minimum(base + np.array(corner), last), 2, 0)), shape)
        read += weight * values[:, flat]
        lacking = np.maximum(lacking, np.where(weight > 0.0, bends[:, flat], 0.0).max(axis=2))
    return read, lacking, inside


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


def hat_weights(agent: AnyAgent, part: AgentPart) -> FloatArray:
    """Weights (places,) that give the mean of a multilinear factor over the start of an agent, up to rounding."""
    low, high = agent.initial.low, agent.initial.high
    if not np.array_equal(part.coordinates, np.eye(len(low))):
        if not np.array_equal(low, high):
            raise ValueError("a start box is read on cells that are no boxes in state space")
        low = high = np.linalg.solve(part.coordinates, low)
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


def places_of(part: AgentPart) -> int:
    """Number of places at which factors of an agent have values: its cells, or their corners."""
    return part.grid.n_cells * (2 ** len(part.lattice) if part.relation["kind"] == "linear" else 1)


def masks_of(part: AgentPart, masks: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Masks (K, places) at the places of factors."""
    return doubled(masks, part.grid.shape) if part.relation["kind"] == "linear" else masks
