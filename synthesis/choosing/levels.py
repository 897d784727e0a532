"""Cells made finer level by level under the relation ``linear``, each level begun with the policies of the last.

The first cells are some standard deviations of the noise wide: a rough search is quick there. Each level halves them,
as long as an estimate of its time allows for that; then they are made finer once more by as much as it does. Policies
are carried over, so that a fine level needs one or two sweeps instead of a search. The estimate is counted from sizes,
not taken from a clock: the same problem gives the same certificate on every machine.
"""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np

from ...envs.agents import AnyAgent
from ...envs.problem import Problem
from ..cells import region_boundaries
from ..models import Abstraction, AffineChoices, AgentModel, Policies

FIRST_WIDTH = 2.5
"""Width of the first cells, in standard deviations of the noise."""

FINER = (2.0, 1.5, 1.25)
"""By how much cells are made finer: the most that time allows for; less than the first is tried only once."""

MOST_LEVELS = 7
"""Levels, at most: cells of the last are a twentieth of a standard deviation wide, and nothing is left to gain."""

LEAST_GAIN = 2e-3
"""Gain of a level from which the next one, which gains about a quarter of it, is worth its time."""

MOST_PARTS = 400
"""Most equal cells of an axis that are asked for to have region boundaries on their edges."""

FEWEST, MOST_PER_AXIS = 8, 2000
"""Fewest and most cells per axis."""

MULTIPLICATIONS_PER_SECOND = 5e8
"""Multiplications of smoothing, with its three tables and what goes with it."""

CELLS_PER_SECOND = 1e5
"""Cells in which the best choice is found, or a value read, with one term."""

READINGS, MENU_READINGS, TERMS_OF_A_READING = 4, 2.5, 30.0
"""How often cells are read in a level, more often with a menu, and the terms that double the time of a reading."""

MOST_SECONDS = 40.0
"""Estimate up to which a level is begun: all levels together then take about a minute at most."""

CHEAP_SECONDS = 0.5
"""Estimate below which a level is begun whatever the last one gained."""

GUESSED_RANK, MOST_GUESSED_RANK = 10, 20
"""Terms that the first level of two agents is expected to have, and further ones at most: sweeps have few."""

SOLVED, GOOD = 0.9995, 0.9
"""Bounds from which no finer level is worth its time, and from which no other relation is tried."""


def level_cells(problem: Problem, width: float) -> dict[str, tuple[int, ...]]:
    """Return the cells of every agent, about ``width`` standard deviations wide."""
    return {agent.name: _cells(problem, i, agent, width) for i, agent in enumerate(problem.agents)}


def _cells(problem: Problem, i: int, agent: AnyAgent, width: float) -> tuple[int, ...]:
    """Return cells per axis of about ``width`` standard deviations; equal ones, if boundaries allow for them."""
    span, deviations = agent.state_high - agent.state_low, np.sqrt(np.diag(agent.noise_covariance))
    numbers = []
    for k in range(agent.n_states):
        wanted = max(FEWEST, float(span[k]) / (width * float(deviations[k])))
        low, high = float(agent.state_low[k]), float(agent.state_high[k])
        inside = sorted({b for b in region_boundaries(problem, i, k) if low < b < high})
        unit = _equal_parts(low, high, inside)
        if unit is None:
            number = max(len(inside) + 1, round(wanted))
        else:
            number = unit * max(1, round(wanted / unit))
        numbers.append(min(MOST_PER_AXIS, number))
    return tuple(numbers)


def _equal_parts(low: float, high: float, inside: list[float]) -> int | None:
    """Return the fewest equal cells that have all boundaries on their edges; None if that takes too many."""
    parts = 1
    for boundary in inside:
        share = Fraction((boundary - low) / (high - low)).limit_denominator(MOST_PARTS)
        if abs(float(share) * (high - low) + low - boundary) > 1e-9 * (high - low):
            return None
        parts = math.lcm(parts, share.denominator)
        if parts > MOST_PARTS:
            return None
    return parts


def seconds_of(abstraction: Abstraction, horizon: int, n_states: int, rank: int) -> float:
    """Return an estimate of the seconds of a level on a core of 2024: two sweeps, and an evaluation.

    It is counted from sizes alone, so that it is the same on every machine.
    """
    total = 0.0
    for model in abstraction.models:
        places, points = model.kernel.shape, model.kernel.lattice_shape
        # Smoothing: one axis after the other, each lattice point meeting the cells within reach of the noise.
        size, smoothing = float(math.prod(places)), 0.0
        for axis, table in enumerate(model.kernel.tables):
            stored = sum(entries.size for *_, entries in table.blocks)
            size = size / places[axis] * points[axis]
            smoothing += size * stored / points[axis]
        reading = model.grid.n_cells * (1.0 + rank / TERMS_OF_A_READING)
        reading *= 1.0 if isinstance(model.choices, AffineChoices) and model.choices.windows else MENU_READINGS
        total += rank * smoothing / MULTIPLICATIONS_PER_SECOND + READINGS * reading / CELLS_PER_SECOND
    return horizon * n_states * total


def carried_over(coarse: Abstraction, fine: Abstraction, policies: Policies) -> Policies:
    """Return policies on finer cells that do what those on coarser cells did."""
    triples = zip(coarse.models, fine.models, policies, strict=True)
    return tuple(_carried(before, after, policy) for before, after, policy in triples)


def _carried(before: AgentModel, after: AgentModel, policy: np.ndarray) -> np.ndarray:
    """Return the policy (T, Q, S') of one agent."""
    old, new = before.choices, after.choices
    assert isinstance(old, AffineChoices) and isinstance(new, AffineChoices)
    cell = before.grid.cell_of(after.grid.centres.T)
    choices = policy[..., cell]
    if not new.windows:
        return np.ascontiguousarray(choices)
    moved = after.grid.centres - before.grid.centres[cell]
    carried = np.empty_like(choices)
    for t, q in np.ndindex(choices.shape[:2]):
        carried[t, q] = _targets(old, new, choices[t, q], moved)
    return carried


def _targets(old: AffineChoices, new: AffineChoices, choices: np.ndarray, moved: np.ndarray) -> np.ndarray:
    """Return the choices (S',) nearest to what coarse choices (S',) ask for, ``moved`` (S', d) from their centres."""
    gain, point = np.divmod(np.maximum(choices, 0), old.n_points)
    index = np.unravel_index(point, old.shape)
    target = np.stack([axis[k] for axis, k in zip(old.lattice, index, strict=True)], axis=1) + gain[:, None] * moved
    nearest = np.rint((target - new.origin) / new.pitch).astype(np.int64)
    result = new.resting_choice.astype(np.int64)
    for number, windows in enumerate(new.windows):
        fits = (gain == number) & (choices >= 0) & np.all(windows.low < windows.high, axis=1)
        clipped = np.clip(nearest, windows.low, np.maximum(windows.high - 1, windows.low))
        flat = np.ravel_multi_index(tuple(np.clip(clipped, 0, np.array(new.shape) - 1).T), new.shape)
        if not windows.relation.is_box:
            fits &= windows.admissible(np.arange(len(flat)), flat)
        result = np.where(fits, flat + number * new.n_points, result)
    return result.astype(np.int32)
