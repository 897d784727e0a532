"""Grids of single agents: cells per axis, edges on region boundaries."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from ....envs.systems.agents import AnyAgent
from ....envs.tasks.problem import Problem
from .grid import Grid, aligned_edges
from .refusal import RelationRefused

DEFAULT_CELLS = {1: 500, 2: 80, 3: 24}
"""Cells per axis by state dimension when the caller names none; 10 from dimension 4 on."""

DEFAULT_CELLS_IN_THE_PLANE = 64
"""The same for two states whose inputs reach every mean: two targets per cell and axis pay more than further cells."""

DEFAULT_TARGETS = {1: 2, 2: 2}
"""Target means per cell and axis by state dimension, for agents that choose one for each cell; 1 in all others."""

MOST_CELLS = 20_000_000
"""Most cells of one agent: their tables take some GB."""

CellCounts = int | Sequence[int] | Mapping[str, int | Sequence[int]] | None
"""Cells per axis as a caller gives them: one number, one per axis, or these by agent; None for the default."""


def agent_grid(problem: Problem, i: int, cells: tuple[int, ...]) -> Grid:
    """Return the grid of agent i, whose axes are its states and whose edges lie on boundaries of regions.

    Raises
    ------
    RelationRefused
        If the noise of its states is not independent: masses of cells are products over the axes.
    """
    agent = problem.agents[i]
    if not agent.has_independent_noise:
        raise RelationRefused(
            f"agent `{agent.name}`: cells need noise that is independent along the states, got correlated noise; ask "
            "for `path`"
        )
    ends = zip(agent.workspace.low.tolist(), agent.workspace.high.tolist(), cells, strict=True)
    return Grid(tuple(aligned_edges(*end, region_boundaries(problem, i, k)) for k, end in enumerate(ends)))


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
