"""Cells, regions and starts, read once more: nothing of the grids, labels and shares of the search is used.

A cell is a product of intervals of its axes, half-open but for the last, as regions and workspace are. The class of a
point, which propositions of its agent hold there, changes at region edges alone. So the classes that occur in a
half-open box are those at its lower corner and at the region edges inside it, axis by axis; closed boxes are taken for
half-open ones that reach a little further. Certain labels are exact; wider boxes give supersets.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ....envs.systems.agents import AnyAgent, with_expressions, with_matrices
from ....envs.tasks.problem import Problem
from ...certificates.cell_probabilities import AgentRecord
from ...relations.grids import FloatArray
from .mean_enclosures import output_spans

OUTWARD = 2.0**-47
"""Relative widening of boxes that went through a matrix: some sixty times the rounding of one operation."""


def cell_boxes(part: AgentRecord) -> tuple[FloatArray, FloatArray]:
    """Lower and upper corners (S, d) of the cells."""
    sides = ([axis[:-1] for axis in part.grid.edges], [axis[1:] for axis in part.grid.edges])
    low, high = (np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(axes)) for axes in sides)
    return low, high


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
    closed_axes = np.full(model.n_outputs, True)
    if not model.has_identity_output:
        boxes = low, high
        if model.is_affine:
            low, high = box_image(low, high, with_matrices(model).output_matrix)
        else:
            low, high = output_spans(with_expressions(model), low, high)
        # Outputs that are the states are read as they are, whatever was added to them for shapes.
        for image, own in zip((low, high), boxes, strict=True):
            image[:, : model.state_outputs] = own[:, : model.state_outputs]
    states = slice(model.state_outputs)
    closed_axes[states] = closed
    edge = model.workspace.high[states]
    region_high[:, states] = np.where(region_high[:, states] >= edge, np.inf, region_high[:, states])  # closed there
    classes, meets = np.ones((1, len(regions)), dtype=bool), np.ones((len(low), 1), dtype=bool)
    # Axis by axis: a class is the conjunction of what holds along each axis.
    for k, own_closed in enumerate(closed_axes.tolist()):
        rows, here = _along(low[:, k], high[:, k], region_low[:, k], region_high[:, k], own_closed)
        found: dict[bytes, NDArray[np.bool_]] = {}
        reached: dict[bytes, NDArray[np.bool_]] = {}
        for a, row in enumerate(classes):
            for b, also in enumerate(rows):
                both = meets[:, a] & here[:, b]
                if both.any():
                    key = (row & also).tobytes()
                    found[key] = row & also
                    reached[key] = reached[key] | both if key in reached else both
        classes, meets = np.array(list(found.values())), np.array([reached[key] for key in found]).T
    return classes, meets


def _along(
    below: FloatArray, above: FloatArray, region_low: FloatArray, region_high: FloatArray, closed: bool
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """What may hold (n, P) along one axis, and which of it (S, n) in each interval ``below`` to ``above``."""
    edges = np.unique(np.concatenate([region_low, region_high]))
    edges = edges[np.isfinite(edges)]
    inside = (below[:, None] < edges) & ((edges <= above[:, None]) if closed else (edges < above[:, None]))
    used = inside.any(axis=0)
    rows: dict[bytes, NDArray[np.bool_]] = {}
    meets: dict[bytes, NDArray[np.bool_]] = {}

    def note(row: NDArray[np.bool_], where: NDArray[np.bool_]) -> None:
        rows.setdefault(row.tobytes(), row)
        meets.setdefault(row.tobytes(), np.zeros(len(below), dtype=bool))[...] |= where

    for edge, where in zip(edges[used], inside[:, used].T, strict=True):
        note((region_low <= edge) & (edge < region_high), where)
    # Between two edges nothing changes: lower ends are told apart by the edges that they have reached.
    place = np.searchsorted(edges, below, side="right")
    for number in np.unique(place):
        where = place == number
        first = below[where][0]
        note((region_low <= first) & (first < region_high), where)
    return np.array(list(rows.values())), np.array([meets[key] for key in rows]).T


def start_shares(agent: AnyAgent, part: AgentRecord) -> FloatArray:
    """Lower bounds (S,), up to rounding, on the probability of each cell under the start of an agent."""
    low, high = agent.initial.low, agent.initial.high
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
