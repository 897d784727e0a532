"""Grids of single agents: cells per axis, coordinates in which the noise is diagonal, edges on region boundaries."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from ....envs.systems.agents import AnyAgent
from ....envs.tasks.problem import Problem
from .grid import FloatArray, Grid, aligned_edges
from .refusal import RelationRefused

DEFAULT_CELLS = {1: 500, 2: 80, 3: 24}
"""Cells per axis by state dimension when the caller names none; 10 from dimension 4 on."""

DEFAULT_CELLS_IN_THE_PLANE = 64
"""The same for two states whose inputs reach every mean: two targets per cell and axis pay more than further cells."""

DEFAULT_TARGETS = {1: 2, 2: 2}
"""Target means per cell and axis by state dimension, for agents that choose one for each cell; 1 in all others."""

SINGULAR = 1e-12
"""Smallest eigenvalue of the correlations of a noise up to which its covariance counts as singular."""

MOST_MORE = 3
"""Most cells that an axis gets beyond those asked for, to have its edges off the start."""

LOWER = 1e-6
"""How much wider such an axis may get, as a share of itself, for the same purpose: this is tried before more cells."""

APART = 1e-9
"""Least distance of such a start from edges, as a share of the numbers that it is computed from."""

MOST_CELLS = 20_000_000
"""Most cells of one agent: their tables take some GB."""

CellCounts = int | Sequence[int] | Mapping[str, int | Sequence[int]] | None
"""Cells per axis as a caller gives them: one number, one per axis, or these by agent; None for the default."""


def agent_grid(problem: Problem, i: int, cells: tuple[int, ...]) -> tuple[Grid, FloatArray]:
    """Return the grid of agent i and its coordinates (d, d), state = coordinates @ grid coordinates."""
    agent = problem.agents[i]
    coordinates = _noise_coordinates(agent)
    if np.array_equal(coordinates, np.eye(agent.n_states)):
        low, high = agent.workspace.low, agent.workspace.high
    else:
        # The smallest box in grid coordinates around the workspace, which is a parallelepiped there.
        inverse = np.linalg.inv(coordinates)
        centre = 0.5 * (agent.workspace.low + agent.workspace.high)
        middle, reach = inverse @ centre, np.abs(inverse) @ (0.5 * (agent.workspace.high - agent.workspace.low))
        low, high = middle - reach, middle + reach
    # Axes that are state axes up to scale (rows with a single entry) have their edges on region boundaries.
    edges = []
    for k in range(agent.n_states):
        inside = region_boundaries(problem, i, k) if np.count_nonzero(coordinates[k]) == 1 else []
        ends = float(low[k]), float(high[k])
        # Where an axis has no edges of its own, those that lie a little lower leave a start in the cell above its face.
        lower = [] if np.count_nonzero(coordinates[k]) == 1 else [(ends[0] - LOWER * (ends[1] - ends[0]), cells[k])]
        ways = [(ends[0], cells[k]), *lower, *((ends[0], cells[k] + more) for more in range(1, MOST_MORE + 1))]
        tried = (aligned_edges(bottom, ends[1], number, inside) for bottom, number in ways)
        edges.append(_off_the_start(agent, coordinates, k, tried))
    return Grid(tuple(edges)), coordinates


def _off_the_start(agent: AnyAgent, coordinates: FloatArray, axis: int, tried: Iterator[FloatArray]) -> FloatArray:
    """Return the first edges on none of which a start lies to rounding, in coordinates other than the states.

    There a controller may read another cell than the proof. A coordinate that is a state and a start of zeros are
    read without rounding.
    """
    first, start = next(tried), agent.initial
    inverse = np.linalg.inv(coordinates)
    is_state = np.array_equal(coordinates[axis], np.eye(len(coordinates))[axis]) and np.array_equal(
        inverse[axis], coordinates[axis]
    )
    if is_state or not start.is_point or not np.any(start.low):
        return first
    point, size = inverse[axis] @ start.low, np.abs(inverse[axis]) @ np.abs(start.low)
    for edges in (first, *tried):
        if np.all(np.abs(edges - point) > APART * (size + max(abs(edges[0]), abs(edges[-1])))):
            return edges
    raise RelationRefused(
        f"`initial_state`: expected a start of agent `{agent.name}` off the edges of regions and workspace along state "
        f"{axis}, as its noise is correlated and its cells lie askew, got {start.low.tolist()}; move it a little"
    )


def _noise_coordinates(agent: AnyAgent) -> FloatArray:
    """Return the unit lower triangular L with ``Sigma = L D L'``; the identity for a diagonal covariance.

    Of all coordinates in which Gaussian noise is diagonal these keep the first axis aligned. Laws have their own axes.
    """
    if agent.laws is not None:
        return agent.noise_axes
    covariance = agent.noise_covariance
    if np.any(agent.still_axes) and np.count_nonzero(covariance - np.diag(np.diag(covariance))) == 0:
        return np.eye(agent.n_states)
    # Units of the states do not matter: what counts are the correlations.
    deviations = np.sqrt(np.diag(covariance))
    known = bool(np.all(deviations > 0))
    smallest = float(np.min(np.linalg.eigvalsh(covariance / deviations / deviations[:, None]))) if known else 0.0
    if smallest <= SINGULAR:
        raise RelationRefused(
            f"agent `{agent.name}`: the abstraction needs a positive definite `noise_covariance`, got the smallest "
            f"eigenvalue {smallest:.3g} of its correlations; give every state some noise, or none and no correlations"
        )
    if np.count_nonzero(covariance - np.diag(np.diag(covariance))) == 0:
        return np.eye(agent.n_states)
    # Cholesky gives Sigma = C C'; dividing the columns of C by its diagonal leaves the unit triangular factor.
    factor = np.linalg.cholesky(covariance)
    return np.asarray(np.tril(factor / np.diag(factor)))


def region_boundaries(problem: Problem, i: int, axis: int) -> list[float]:
    """Return the region boundaries of agent i that are hyperplanes of one state coordinate."""
    agent = problem.agents[i]
    boundaries = []
    for proposition in problem.propositions.values():
        if proposition.agent != agent.name:
            continue
        for k, (low, high) in enumerate(zip(proposition.low, proposition.high, strict=True)):
            # A region bounds a single state where its output is a multiple of that state.
            found = agent.output_axis(k)
            if found is not None and found[0] == axis:
                boundaries += [float(low / found[1]), float(high / found[1])]
    return boundaries


def fewest_cells(problem: Problem) -> dict[str, tuple[int, ...]]:
    """Return cells per axis of each agent that regions leave room for: one for each part into which they cut it."""
    return {
        agent.name: tuple(1 + len({*region_boundaries(problem, i, k)}) for k in range(agent.n_states))
        for i, agent in enumerate(problem.agents)
    }


def cells_of_agent(agent: AnyAgent, cells: CellCounts) -> tuple[int, ...]:
    """Return the cells per axis of one agent.

    Raises
    ------
    RelationRefused
        If nobody asked for cells, and the agent has too many states for a grid.
    ValueError
        If they are no positive whole numbers, or too many.
    """
    wanted = cells.get(agent.name) if isinstance(cells, Mapping) else cells
    is_asked_for = wanted is not None
    if wanted is None:
        wanted = DEFAULT_CELLS.get(agent.n_states, 10)
        if agent.n_states == 2 and agent.has_full_rank:
            wanted = DEFAULT_CELLS_IN_THE_PLANE
    per_axis = tuple(wanted) if isinstance(wanted, Sequence) else (wanted,) * agent.n_states
    whole = all(isinstance(n, int | np.integer) and not isinstance(n, bool) and n >= 1 for n in per_axis)
    if len(per_axis) != agent.n_states or not whole:
        raise ValueError(
            f"`cells`: expected a positive whole number or {agent.n_states} of them (cells per axis) for agent "
            f"`{agent.name}`, got {wanted!r}"
        )
    in_all = math.prod(int(n) for n in per_axis)
    if in_all > MOST_CELLS and not is_asked_for:
        raise RelationRefused(
            f"agent `{agent.name}`: it has {agent.n_states} states, {per_axis[0]} cells along each of them are "
            f"{in_all:.2g} in all, and grids hold {MOST_CELLS:.2g} at most"
        )
    if in_all > MOST_CELLS:
        raise ValueError(
            f"`cells`: expected at most {MOST_CELLS} in all for agent `{agent.name}`, got {wanted!r}; ask for fewer"
        )
    return tuple(int(n) for n in per_axis)
