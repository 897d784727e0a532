"""Cells, regions and starts, read once more: nothing of the grids, labels and shares of the search is used.

A cell is a product of intervals of its axes, half-open but for the last, as regions and workspace are. The class of a
point, which propositions of its agent hold there, changes at region edges alone. So the classes that occur in a
half-open box are those at its lower corner and at the region edges inside it, axis by axis; closed boxes are taken for
half-open ones that reach a little further. Certain labels are exact; wider boxes give supersets.
"""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import NDArray

from ...envs.agents import Agent, AnyAgent, LinearAgent
from ...envs.problem import Problem
from ..cells import FloatArray
from ..certificates import AgentPart
from .mean_spans import output_spans

OUTWARD = 2.0**-47
"""Relative widening of boxes that went through a matrix: some sixty times the rounding of one operation."""

MOST_CLASSES_AT_ONCE = 20_000_000
"""Most entries of the tables of points against propositions that are held at once."""


def cell_boxes(part: AgentPart) -> tuple[FloatArray, FloatArray]:
    """Lower and upper corners (S, d) of the cells, in grid coordinates."""
    sides = ([axis[:-1] for axis in part.grid.edges], [axis[1:] for axis in part.grid.edges])
    low, high = (np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(axes)) for axes in sides)
    return low, high


def is_identity(matrix: FloatArray) -> bool:
    """Whether grid coordinates are those of the state."""
    return bool(np.array_equal(matrix, np.eye(len(matrix))))


def box_image(low: FloatArray, high: FloatArray, matrix: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Boxes (S, p) around the images ``matrix @ x`` of closed boxes (S, d), rounded outwards."""
    centre, reach = 0.5 * (low + high) @ matrix.T, 0.5 * (high - low) @ np.abs(matrix).T
    slack = OUTWARD * (np.maximum(np.abs(low), np.abs(high)) @ np.abs(matrix).T + reach)
    return centre - reach - slack, centre + reach + slack


def classes_in_boxes(
    problem: Problem, agent: int, low: FloatArray, high: FloatArray, closed: bool
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Classes (K, P) that occur, and which of them (S, K) the points of boxes (S, d) in state space may have.

    Exact for half-open boxes of agents whose outputs are their states; supersets otherwise.

    Parameters
    ----------
    problem : Problem
    agent : int
    low, high : (S, d) arrays
        Corners of boxes inside the workspace.
    closed : bool
        Whether upper faces belong to them.
    """
    model = problem.agents[agent]
    names = [problem.labeling.names[k] for k in problem.labeling.agent_propositions[agent]]
    regions = [problem.propositions[name] for name in names]
    if not regions:
        return np.zeros((1, 0), dtype=bool), np.ones((len(low), 1), dtype=bool)
    region_low = np.array([r.low for r in regions]).reshape(len(regions), -1)  # (P, p)
    region_high = np.array([r.high for r in regions]).reshape(len(regions), -1)
    if model.has_identity_output:
        region_high = np.where(region_high >= model.workspace.high, np.inf, region_high)  # closed at the workspace
    else:
        closed = True
        if isinstance(model, LinearAgent):
            low, high = box_image(low, high, model.output_matrix)
        else:
            assert isinstance(model, Agent)
            low, high = output_spans(model, low, high)
    axes = []  # per axis: (S, 1 + E) coordinates, (S, 1 + E) whether the box reaches them
    for k in range(low.shape[1]):
        edges = np.unique(np.concatenate([region_low[:, k], region_high[:, k]]))
        edges = np.broadcast_to(edges[np.isfinite(edges)], (len(low), np.isfinite(edges).sum()))
        below, above = low[:, k, None], high[:, k, None]
        inside = (below < edges) & ((edges <= above) if closed else (edges < above))
        used = inside.any(axis=0)
        points = np.concatenate([below, edges[:, used]], axis=1)
        axes.append((points, np.concatenate([np.ones_like(below, dtype=bool), inside[:, used]], axis=1)))
    found: dict[bytes, NDArray[np.bool_]] = {}
    meets: dict[bytes, NDArray[np.bool_]] = {}
    for corner in itertools.product(*(range(points.shape[1]) for points, _ in axes)):
        reached = np.logical_and.reduce([inside[:, c] for (_, inside), c in zip(axes, corner, strict=True)])
        where = np.flatnonzero(reached)
        for rows in np.array_split(where, max(1, len(where) * len(regions) // MOST_CLASSES_AT_ONCE + 1)):
            holds = np.ones((len(rows), len(regions)), dtype=bool)
            for k, ((points, _), c) in enumerate(zip(axes, corner, strict=True)):
                at = points[rows, c, None]
                holds &= (region_low[:, k] <= at) & (at < region_high[:, k])
            for row in np.unique(holds, axis=0):
                key = row.tobytes()
                found.setdefault(key, row)
                meets.setdefault(key, np.zeros(len(low), dtype=bool))[rows[np.all(holds == row, axis=1)]] = True
    return np.array(list(found.values())), np.array([meets[key] for key in found]).T


def start_shares(agent: AnyAgent, part: AgentPart) -> FloatArray:
    """Lower bounds (S,), up to rounding, on the probability of each cell under the start of an agent."""
    low, high = agent.initial.low, agent.initial.high
    if not is_identity(part.coordinates):
        if not np.array_equal(low, high):
            raise ValueError("a start box is read on cells that are no boxes in state space")
        low = high = np.linalg.solve(part.coordinates, low)
    shares = np.ones(1)
    for edges, a, b in zip(part.grid.edges, low.tolist(), high.tolist(), strict=True):
        left, right = edges[:-1], edges[1:]
        if a == b:
            here = (left <= a) & (a < right)
            here[-1] |= a == right[-1]
            axis = here.astype(float)
        else:
            axis = np.maximum(np.minimum(right, b) - np.maximum(left, a), 0.0) / (b - a)
        shares = (shares[:, None] * axis).ravel()
    return shares
