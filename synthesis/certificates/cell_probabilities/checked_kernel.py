"""The kernel once more, for checks: cell masses from the complementary error function, and from formulas of laws."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from scipy.special import erfc

from ...relations.grids import CellAxis, FloatArray, MeanAxis, ScaleAxis, lattice_axes, points_by_axis
from .checked_laws import law_error, law_height, masses_of_law
from .stated import state

TAIL, ONE = 1e-15, 3e-16
"""What a tail of the normal law may be off by: a share of it, times ``1 + x^2`` for the rounding of its argument, and a
share of the tail that is taken, which may be near 1. Half as much again as was ever seen; balls prove the numbers."""

FAINT = 1e-280
"""What is taken off every mass: numbers near the smallest double have few digits."""

if TYPE_CHECKING:
    from ....envs.systems.agents import AnyAgent
    from .agent_record import AgentRecord


def axis_tables(
    agent: AnyAgent, part: AgentRecord, known: dict[tuple[bytes, ...], list[FloatArray]]
) -> list[FloatArray]:
    """Cell masses around every lattice point, per state, from the complementary error function of the smaller tail.

    Where the noise of a state has scales, the points of all means come scale after scale.
    """
    key = kernel_key(agent, part)
    if key not in known:
        known[key] = _tables(agent, part)
    state("masses", agent, part, known[key])
    return known[key]


def _tables(agent: AnyAgent, part: AgentRecord) -> list[FloatArray]:
    deviations = np.sqrt(np.diag(agent.noise_covariance))
    if not agent.has_plain_noise:
        return _uneven_tables(agent, part, deviations)
    tables = []
    for k, (edges, axis) in enumerate(zip(part.grid.edges, part.lattice, strict=True)):
        if agent.laws is not None:
            tables.append(_over_windings(agent, k, axis, partial(masses_of_law, agent.laws[k], edges)))
        else:
            deviation = float(deviations[k])
            tables.append(_over_windings(agent, k, axis, partial(_gaussian_masses, edges, deviation=deviation)))
    return tables


def _over_windings(
    agent: AnyAgent, k: int, means: FloatArray, masses: Callable[[FloatArray], FloatArray]
) -> FloatArray:
    """Masses (Z, S) of cells around means (Z,), from below; of an angle, those of each cell and its copies.

    A copy a turn to the right of a cell has the mass of the cell around a mean a turn to the left.
    """
    if not agent.wrapped_axes[k]:
        return masses(means)
    copies = [masses(means - turn) for turn in COPIES]
    return np.asarray(sum(copies[1:], copies[0]) * (1.0 - 4e-15))


COPIES = tuple(6.283185307179586 * number for number in (-3, -2, -1, 0, 1, 2, 3))
"""How far copies of a cell of an angle are from it: all others hold next to nothing, and count as nothing."""


def kernel_key(agent: AnyAgent, part: AgentRecord) -> tuple[bytes, ...]:
    """Return all that tables are made of: noise, cells, and the lattice with what its axes stand for.

    Agents that differ in none of it may share what is computed from it. Arrays alone do not tell scales from means.
    """
    return (
        *agent.noise_key,
        repr(lattice_axes(agent)).encode(),
        agent.wrapped_axes.tobytes(),
        *(array.tobytes() for array in (*part.grid.edges, *part.lattice)),
    )


def _gaussian_masses(edges: FloatArray, axis: FloatArray, deviation: float) -> FloatArray:
    """Cell masses (Z, S) around means (Z,), from below."""
    x = (edges - axis[:, None]) / (deviation * np.sqrt(2.0))
    right, left = 0.5 * erfc(x), 0.5 * erfc(-x)
    upper_half = x[:, :-1] + x[:, 1:] > 0
    mass = np.where(upper_half, right[:, :-1] - right[:, 1:], left[:, 1:] - left[:, :-1])
    off = TAIL * (1.0 + x * x) * np.minimum(left, right)
    one = ONE * np.where(upper_half, right[:, :-1] + right[:, 1:], left[:, 1:] + left[:, :-1])
    return np.maximum(mass - off[:, :-1] - off[:, 1:] - one - FAINT, 0.0)


def _uneven_tables(agent: AnyAgent, part: AgentRecord, deviations: FloatArray) -> list[FloatArray]:
    """Cell masses of an agent with scales, or with states without noise, whose next cell is that of the mean."""
    points = points_by_axis(agent, part.lattice)
    tables = []
    for k, edges in enumerate(part.grid.edges):
        if CellAxis(k) in points:
            tables.append((points[CellAxis(k)][:, None] == np.arange(len(edges) - 1)).astype(float))
        elif agent.laws is None:
            normal = partial(_gaussian_masses, edges, deviation=float(deviations[k]))
            tables.append(_over_windings(agent, k, points[MeanAxis(k)], normal))
        else:
            scales, means = np.exp(points.get(ScaleAxis(k), np.zeros(1))), points[MeanAxis(k)]
            # There is room for one such table, not for two.
            table = np.empty((len(scales), len(means), len(edges) - 1))
            for own, scale in zip(table, scales, strict=True):
                own[...] = _over_windings(agent, k, means, partial(masses_of_law, agent.laws[k], edges, scale=scale))
            tables.append(table.reshape(-1, len(edges) - 1))
    return tables


def lost_to_rounding(agent: AnyAgent, part: AgentRecord) -> float:
    """Upper bound on the mass per step that ``axis_tables`` take off to be lower bounds, twice over.

    The complementary error function is accurate to a few units in the last place of the tail it stands for.
    """
    if agent.laws is not None:
        # A mass is off by two errors, and two are taken off; a fifth one is for the rounding of all this.
        lost = sum(5.0 * law_error(law) * n for law, n in zip(agent.laws, part.grid.shape, strict=True))
        lost += _near_copies(agent, part)
        state("lost", agent, part, lost)
        return lost
    total, deviations = 0.0, np.sqrt(np.diag(agent.noise_covariance))
    for edges, axis, deviation in zip(part.grid.edges, part.lattice, deviations, strict=True):
        if deviation == 0.0:
            continue  # whole numbers
        x = np.abs(edges - axis[:, None]) / (deviation * np.sqrt(2.0))
        total += 8.0 * TAIL * float(np.max(np.sum(0.5 * erfc(x) * (1.0 + x * x), axis=1))) + 8.0 * ONE
    total += _near_copies(agent, part)
    state("lost", agent, part, total)
    return total


def _near_copies(agent: AnyAgent, part: AgentRecord) -> float:
    """Upper bound on the mass so near to edges of copies of cells that rounding may move it over them.

    Edges are a cell apart, but where a turn ends and the next one begins: densities at all of them sum to at most twice
    ``1 / width`` and their variation.
    """
    points = points_by_axis(agent, part.lattice)
    total, deviations = 0.0, np.sqrt(np.diag(agent.noise_covariance))
    for k in np.flatnonzero(agent.wrapped_axes).tolist():
        if MeanAxis(k) not in points:
            continue  # without noise the cell is that of the mean
        off = 1e-15 * (float(np.abs(points[MeanAxis(k)]).max()) + COPIES[-1])
        height = 0.39895 / deviations[k] if agent.laws is None else law_height(agent.laws[k])
        height = height / min(1.0, float(np.exp(points.get(ScaleAxis(k), np.zeros(1))).min()))
        total += 4.0 * off * (1.0 / float(np.diff(part.grid.edges[k]).min()) + 2.0 * height)
    return total


def backup(factors: FloatArray, tables: list[FloatArray]) -> FloatArray:
    """Expected value (n, Z) of factors (n, S) around every lattice point."""
    tensor = factors.reshape(len(factors), *(table.shape[1] for table in tables))
    for axis, table in enumerate(tables, start=1):
        tensor = np.moveaxis(np.tensordot(tensor, table, axes=(axis, 1)), -1, axis)
    return tensor.reshape(len(factors), int(np.prod(tensor.shape[1:])))
