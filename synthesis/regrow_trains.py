"""The tensor trains of a certificate, grown again from its policies.

Like ``regrow``: policies, guards and the rounding's settings come from the certificate, kernel and relations are
computed anew. Rounding chooses its own subspaces again and measures its own error, so that the outcome is right
whatever the certificate says; cells outside ``visited`` count as failure.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from .checked_kernel import axis_tables, smooth
from .guards import Guards
from .train import Train, added, ones
from .train_above import counted_as_failed
from .train_value import Trains, arrival, assembled, routes, smoothed_core

if TYPE_CHECKING:
    from .certificate import Certificate

FloatArray = NDArray[Any]


class BrokenTrainError(ValueError):
    """What a certificate says about its tensor trains makes no sense."""


def regrow_trains(
    certificate: Certificate, each: Callable[[int, Trains], None] | None = None, above: bool = False
) -> Trains:
    """Value function at time 0 as tensor trains, with their errors; ``each(t, value)`` at t = T - 1 .. 0.

    With ``above`` what the value counts as failed and the continuous system may survive is added (``train_above``).

    Raises
    ------
    ValueError
        If the certificate has no trains, or its cells are no cells.
    """
    problem, agents = certificate.problem, certificate.agents
    automaton, n_cells = problem.automaton, [part.grid.n_cells for part in agents]
    rounding = certificate.rounding
    if rounding is None:
        raise BrokenTrainError("it has a value tree and no tensor trains")
    visited = rounding.visited
    if len(visited) != problem.horizon + 1 or not 0 < rounding.tolerance < 1:
        raise BrokenTrainError("its rounding does not fit its horizon")
    for cells in visited:
        for own, n in zip(cells or (), n_cells, strict=cells is not None):
            if len(own) == 0 or own[0] < 0 or own[-1] >= n or np.any(np.diff(own) <= 0):
                raise BrokenTrainError("the cells that its tensor trains cover are no cells")
    masks = tuple(part.masks for part in agents)
    guards = Guards(masks, certificate.guard_source, certificate.guard_target, certificate.guard_mask)
    ways = routes(guards, masks, automaton.n_states)
    tables: dict[tuple[bytes, ...], list[FloatArray]] = {}
    kernels = [axis_tables(a.noise_covariance, p, tables) for a, p in zip(problem.agents, agents, strict=True)]
    finished = automaton.accepting & (automaton.semantics == "co-safe")
    value = Trains(tuple(ones(n_cells, visited[-1]) if yes else None for yes in automaton.accepting))
    for t in reversed(range(problem.horizon)):
        states: list[Train | None] = []
        for q in range(automaton.n_states):
            if finished[q]:
                states.append(ones(n_cells, visited[t]))
                continue
            arriving = arrival(value, ways[q], rounding.tolerance / problem.horizon)
            if arriving is None:
                states.append(None)
                continue
            before = _moved(certificate, kernels, arriving, t, q)
            states.append(added(before, _beside(certificate, kernels, t, q) if above else None))
        value = Trains(tuple(states))
        if each is not None:
            each(t, value)
    return value


def _moved(certificate: Certificate, kernels: list[list[FloatArray]], arriving: Train, t: int, q: int) -> Train:
    """Expected value one step before arriving."""
    assert certificate.rounding is not None
    cells, cores = certificate.rounding.visited[t], []
    for i, (part, axes) in enumerate(zip(certificate.agents, kernels, strict=True)):
        points = part.points(t, q) if cells is None else part.points(t, q)[cells[i]]
        cores.append(smoothed_core(arriving, i, part.grid.n_cells, points, partial(smooth, tables=axes)))
    return assembled(arriving, cores, [[table.shape[1] for table in axes] for axes in kernels], cells)


def _beside(certificate: Certificate, kernels: list[list[FloatArray]], t: int, q: int) -> Train | None:
    """What is counted as failed one step before arriving, of what may succeed."""
    assert certificate.rounding is not None
    here, there = certificate.rounding.visited[t : t + 2]
    points, n_cells = [part.points(t, q) for part in certificate.agents], [p.grid.n_cells for p in certificate.agents]
    return counted_as_failed(points, [partial(smooth, tables=axes) for axes in kernels], n_cells, here, there)
