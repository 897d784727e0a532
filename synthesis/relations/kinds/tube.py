"""Tube relation of a stabilisable agent: delta = 0, also where B has not full row rank.

With a stabilising feedback K and F = 0 the error moves as ``e' = (A + B K) e + beta``, ``beta in W``, where W is the
box of half a cell plus half a lattice spacing. If ``(A + B K)^s W inside alpha W``, the zonotope

    E = (1 - alpha)^-1 sum_{k < s} (A + B K)^k W

is invariant, ``(A + B K) E + W inside E``, so that ``x - xhat in E`` holds at all times with certainty
(docs/theory/relations.md, "The tube"). The price: labels and workspace shrink by E, the abstract inputs by K E.
"""

from __future__ import annotations

from itertools import product

import numpy as np
from scipy.linalg import LinAlgError, solve_discrete_are

from ....envs.systems.agents import LinearAgent
from ..grids import FloatArray, Grid, RelationRefused, in_grid_coordinates
from .coupled import CoupledRelation
from .rounding import error_rounding, feedback_rounding, sizes_of

MOST_TUBE_TERMS = 400
"""Most terms of the zonotope: feedbacks whose errors take longer to die out make tubes too wide to be of use."""

ENLARGEMENT = 1.0 + 1e-9
"""Every bound of the tube is enlarged by this, far above rounding."""

LARGE_GRID = 100_000
"""Cells from which half widths are taken axis by axis, without the table of all cells."""

INPUT_PRICES = np.logspace(-2.0, 4.0, 13)
"""Prices of inputs against errors that are tried, from cheap ones (fast feedback) to dear ones (slow feedback)."""

ONE_AXIS_PRICES = np.logspace(-2.0, 4.0, 7)
"""The same where the errors of one axis weigh a hundred times more, or less, than those of the others."""

MOST_INPUTS = {1: 41, 2: 13}
"""Most abstract inputs per component by the number of components; 5 from three components on."""


def tube_relation(
    agent: LinearAgent,
    grid: Grid,
    coordinates: FloatArray,
    feedback: FloatArray,
    inputs: FloatArray | None = None,
    snap: FloatArray | None = None,
) -> CoupledRelation:
    """Return the tube of an agent around its finite model under a given feedback; its margins are upper bounds.

    Parameters
    ----------
    agent : LinearAgent
    grid : Grid
        Cells in grid coordinates.
    coordinates : (d, d) array
        Grid coordinates to state.
    feedback : (m, d) array
        K in grid coordinates; ``A + B K`` must be stable.
    inputs : (A, m) array, optional
        Abstract inputs; default: a grid over the reduced input box whose steps move the mean by cells.
    snap : (d,) array, optional
        Half lattice spacings that means are rounded by; default 0.

    Raises
    ------
    ValueError
        If the feedback does not stabilise, or the tube uses up the inputs.
    """
    moves = in_grid_coordinates(agent, coordinates)
    A, B, drift = moves.A, moves.B, moves.offset
    disturbance = disturbance_of(grid, snap)
    generators = tube_generators(A + B @ feedback, disturbance)
    if generators is None:
        raise RelationRefused(f"agent `{agent.name}`: expected a feedback that stabilises `A`, got {feedback.tolist()}")
    # Bounding boxes of the zonotope and of its images under K and the coordinates: sums of absolute generators.
    reach = np.abs(generators).sum(axis=0) * ENLARGEMENT
    sizes = sizes_of(agent, coordinates)
    reserve = np.abs(generators @ feedback.T).sum(axis=0) * ENLARGEMENT + feedback_rounding(sizes, feedback)
    refuse_rounding(agent, disturbance, error_rounding(sizes, feedback, np.zeros_like(A)))
    low, high = agent.input_box.low + reserve, agent.input_box.high - reserve
    if np.any(low > high):
        raise RelationRefused(
            f"agent `{agent.name}`: the tube needs an input reserve of {reserve.tolist()}, more than `input_low`, "
            "`input_high` leave; ask for more `cells`"
        )
    widths = np.array([float(np.max(np.diff(edges))) for edges in grid.edges])
    return CoupledRelation(
        kind="tube",
        A=A,
        B=B,
        drift=drift,
        covariance=np.diag(moves.covariance).copy(),
        feedback=feedback,
        coupling=np.zeros_like(A),
        reach=reach,
        state_reach=np.abs(generators @ coordinates.T).sum(axis=0) * ENLARGEMENT,
        delta=0.0,
        inputs=input_grid(low, high, B, widths) if inputs is None else inputs,
        input_low=agent.input_box.low,
        input_high=agent.input_box.high,
        coordinates=coordinates,
        snap=np.zeros(len(A)) if snap is None else snap,
    )


def refuse_rounding(agent: LinearAgent, disturbance: FloatArray, rounding: FloatArray) -> None:
    """Refuse agents whose errors are rounded by more than ``disturbance`` is enlarged by."""
    if np.any(rounding > 0.5 * (ENLARGEMENT - 1.0) * disturbance):
        raise RelationRefused(
            f"agent `{agent.name}`: its states, inputs or offset are so large next to its cells that rounding would "
            "count; measure states from a point nearby, or ask for fewer `cells`"
        )


def disturbance_of(grid: Grid, snap: FloatArray | None) -> FloatArray:
    """Return upper bounds (d,) on the half widths of W: half the largest cell, plus what snapping adds."""
    half = grid.half_widths.max(axis=0) if grid.n_cells < LARGE_GRID else _half_cells(grid)
    return np.asarray((half + (0.0 if snap is None else snap)) * ENLARGEMENT)


def _half_cells(grid: Grid) -> FloatArray:
    """Return half the width (d,) of the widest cell per axis, rounded up."""
    return np.array([0.5 * float(np.max(np.diff(edges))) * (1 + 1e-12) for edges in grid.edges])


def tube_generators(closed: FloatArray, disturbance: FloatArray) -> FloatArray | None:
    """Return generators (G, d) of a zonotope E with ``closed E + W inside E``, W the box ``|beta| <= disturbance``.

    The number of terms is the one that makes the tube smallest. None if no number of terms was found: ``closed`` is
    then not stable, or next to it.
    """
    # powers[k] holds the generators of closed^k W as columns. Sizes are measured in units of the disturbance.
    powers, best, size = [np.diag(disturbance)], None, np.inf
    mass = float(len(disturbance))
    for _ in range(MOST_TUBE_TERMS):
        following = closed @ powers[-1]
        scaled = np.abs(following) / disturbance[:, None]
        # The smallest alpha with closed^s W inside alpha W: the largest row sum of the absolute generators.
        alpha = float(np.max(scaled.sum(axis=1))) * ENLARGEMENT
        if alpha < 1.0:
            # 1 / (1 - alpha) scales the sum of the terms so far; more terms cost mass but make alpha smaller.
            if mass / (1.0 - alpha) < size * (1 - 1e-6):
                best, size = (len(powers), alpha), mass / (1.0 - alpha)
            elif alpha < 1e-6 or mass >= size:
                break
        mass += float(scaled.sum())
        if not np.isfinite(mass):
            return None
        powers.append(following)
    if best is None:
        return None
    count, alpha = best
    return np.concatenate([power.T for power in powers[:count]]) / (1.0 - alpha)


def stabilising_feedbacks(agent: LinearAgent, grid: Grid, coordinates: FloatArray) -> list[FloatArray]:
    """Return feedbacks (m, d) to try, by linear-quadratic design, in grid coordinates.

    Inputs go from cheap to dear. Errors weigh alike when measured in cells, or those of one axis weigh more or less
    than the others.

    Raises
    ------
    ValueError
        If the agent is not stabilisable.
    """
    moves = in_grid_coordinates(agent, coordinates)
    A, B = moves.A, moves.B
    cells = disturbance_of(grid, None)
    room = 0.5 * (agent.input_box.high - agent.input_box.low)
    feedbacks = []
    # Pairs of an exponent of ten per axis, for the weight of its error, and a price of the inputs.
    designs = list(product([np.zeros(len(A))], INPUT_PRICES))
    if len(A) > 1:
        one_axis = [share * axis for axis in np.eye(len(A)) for share in (-2.0, 2.0)]
        designs += product(one_axis, ONE_AXIS_PRICES)
    for share, price in designs:
        weight, cost = np.diag(10.0**share / cells**2), np.diag(price / np.maximum(room, 1e-9) ** 2)
        try:
            value = solve_discrete_are(A, B, weight, cost)
        except (LinAlgError, ValueError):
            continue
        feedbacks.append(-np.linalg.solve(cost + B.T @ value @ B, B.T @ value @ A))
    if not feedbacks:
        raise RelationRefused(
            f"agent `{agent.name}`: expected a stabilisable pair `A`, `B`, got one that no feedback stabilises; "
            "give it an input that moves what is unstable"
        )
    return feedbacks


def best_feedback(agent: LinearAgent, grid: Grid, coordinates: FloatArray, room_for_labels: FloatArray) -> FloatArray:
    """Return the feedback (m, d) with the least sum of input reserve and label margin, as shares of what there is.

    ``room_for_labels`` (d,) is the half width, per state, of the narrowest region that labels are to be kept in.
    """
    moves = in_grid_coordinates(agent, coordinates)
    A, B = moves.A, moves.B
    room = np.maximum(0.5 * (agent.input_box.high - agent.input_box.low), 1e-9)
    disturbance = disturbance_of(grid, None)
    scored: list[tuple[float, int, FloatArray]] = []
    for feedback in stabilising_feedbacks(agent, grid, coordinates):
        generators = tube_generators(A + B @ feedback, disturbance)
        if generators is not None:
            reserve = np.max(np.abs(generators @ feedback.T).sum(axis=0) / room)
            margin = np.max(np.abs(generators @ coordinates.T).sum(axis=0) / room_for_labels)
            # The position in the list decides between equal scores, so that arrays are never compared.
            scored.append((float(reserve + margin), len(scored), feedback))
    if not scored:
        raise RelationRefused(
            f"agent `{agent.name}`: no feedback that was tried keeps the error bounded; ask for more `cells`"
        )
    return min(scored)[2]


def input_grid(low: FloatArray, high: FloatArray, B: FloatArray, widths: FloatArray) -> FloatArray:
    """Return abstract inputs (A, m): per component a symmetric grid whose steps move means by cells, and the extremes.

    The extremes are rounded inwards to moves of half a cell, so that means stay on a lattice of few points.
    """
    axes = []
    limit = MOST_INPUTS.get(len(low), 5)
    for j in range(len(low)):
        middle, half = 0.5 * (low[j] + high[j]), 0.5 * (high[j] - low[j])
        moves = np.abs(B[:, j]) > 1e-12
        if half <= 0 or not moves.any():  # there is nothing to choose
            axes.append(np.array([middle]))
            continue
        # One step moves the mean by a whole cell; double it or halve it until the number of inputs fits.
        step = cell = float(np.min(widths[moves] / np.abs(B[moves, j])))
        while 2 * half / step + 1 > limit:
            step *= 2.0
        while 2 * half / step + 1 < min(limit, 9) / 2:
            step /= 2.0
        count, unit = int(np.floor(half / step)), 0.5 * min(cell, step)
        largest = unit * np.floor(half / unit)
        offsets = step * np.arange(-count, count + 1)
        extremes = [-largest, largest] if largest > count * step + 0.25 * step else []
        axes.append(middle + np.unique(np.concatenate([offsets, extremes])))
    return np.stack([m.ravel() for m in np.meshgrid(*axes, indexing="ij")], axis=-1)
