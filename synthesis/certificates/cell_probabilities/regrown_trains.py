"""The tensor trains of a certificate, grown again from its policies.

Like ``regrow``: policies, guards and the rounding's settings come from the certificate, kernel and relations are
computed anew. Rounding chooses its own subspaces again and measures its own error, so that the outcome is right
whatever the certificate says; cells outside ``visited`` count as failure.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....envs.tasks.problem import Problem
from ...relations.grids import FloatArray
from ..value_functions import (
    Backup,
    Cells,
    Guards,
    Rounding,
    Train,
    Trains,
    arrival,
    assembled,
    core_backup,
    ones,
    routes,
)
from .agent_record import AgentRecord
from .checked_kernel import axis_tables, backup


class BrokenTrainError(ValueError):
    """What a certificate says about its tensor trains makes no sense."""


def regrow_trains(
    problem: Problem,
    agents: Sequence[AgentRecord],
    guards: Guards,
    rounding: Rounding,
    each: Callable[[int, Trains], None] | None = None,
) -> Trains:
    """Value function at time 0 as tensor trains, with their errors; ``each(t, value)`` at t = T - 1 .. 0.

    Raises
    ------
    BrokenTrainError
        If the rounding does not fit the horizon, or its cells are no cells.
    """
    automaton, n_cells = problem.automaton, [part.grid.n_cells for part in agents]
    _check_rounding(rounding, problem.horizon, n_cells)
    visited = rounding.visited
    ways = routes(guards, guards.masks, automaton.n_states)
    tables: dict[tuple[bytes, ...], list[FloatArray]] = {}
    kernels = [axis_tables(a, p, tables) for a, p in zip(problem.agents, agents, strict=True)]
    smooths = [partial(backup, tables=axes) for axes in kernels]
    shapes = [[table.shape[1] for table in axes] for axes in kernels]
    value = Trains(tuple(ones(n_cells, visited[-1]) if yes else None for yes in automaton.accepting))
    # One step back in every automaton state: sum over the guards, smooth by the kernels.
    for t in reversed(range(problem.horizon)):
        states: list[Train | None] = []
        for q in range(automaton.n_states):
            if automaton.finished[q]:
                states.append(ones(n_cells, visited[t]))
                continue
            arriving = arrival(value, ways[q], rounding.tolerance / problem.horizon)
            if arriving is None:
                states.append(None)
                continue
            points = [part.points(t, q) for part in agents]
            states.append(_moved(arriving, points, smooths, shapes, n_cells, visited[t]))
        value = Trains(tuple(states))
        if each is not None:
            each(t, value)
    return value


def _check_rounding(rounding: Rounding, horizon: int, n_cells: Sequence[int]) -> None:
    """Raise BrokenTrainError unless visited cells are cells of the grids, given for every time."""
    visited = rounding.visited
    if len(visited) != horizon + 1 or not 0 < rounding.tolerance < 1:
        raise BrokenTrainError("its rounding does not fit its horizon")
    for cells in visited:
        for numbers, n in zip(cells or (), n_cells, strict=cells is not None):
            if len(numbers) == 0 or numbers[0] < 0 or numbers[-1] >= n or np.any(np.diff(numbers) <= 0):
                raise BrokenTrainError("the cells that its tensor trains cover are no cells")


def _moved(
    arriving: Train,
    points: Sequence[NDArray[Any]],
    smooths: Sequence[Backup],
    shapes: Sequence[Sequence[int]],
    n_cells: Sequence[int],
    cells: Cells,
) -> Train:
    """Expected value one step before arriving, at the given cells."""
    cores = []
    for i, smooth_rows in enumerate(smooths):
        targets = points[i] if cells is None else points[i][cells[i]]
        cores.append(core_backup(arriving, i, n_cells[i], targets, smooth_rows))
    return assembled(arriving, cores, shapes, cells)
