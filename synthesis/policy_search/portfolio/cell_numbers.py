"""Numbers of cells that fit together.

A *resolution* is a number of cells per standard deviation of the noise, the same for all axes of all agents: what cells
lose depends on their width against the noise. Near the number that a resolution asks for on an axis, those numbers are
preferred for which the region boundaries cut the axis into whole numbers of equal cells (no slivers, which would
cost inputs and labels as much as a wide cell, and more lattice points).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from fractions import Fraction
from itertools import product
from typing import Any

import numpy as np

from ....envs.systems.agents import Agent, AnyAgent, with_expressions
from ....envs.systems.expressions import Affine, Number, Tree, computed, enclosed, names_in, split_at
from ....envs.tasks.problem import Problem
from ...relations.grids import FloatArray, deviations_of, region_boundaries

Shape = tuple[int, ...]

NEAR_FACTOR = 1.25
"""Numbers of cells up to this factor from what is asked for are considered."""

MOST_CELLS_PER_AXIS = 2000
"""Most cells per axis of one agent that are considered: 4,000 took four times the memory for gains of 1e-6."""

MOST_NUMBERS = 24
"""Most numbers of cells per axis that are compared: for three axes they make some ten thousand combinations."""

MOST_COMBINATIONS = MOST_NUMBERS**3
"""Combinations of numbers of cells that are compared: all of three axes; of more axes fewer numbers each."""

WEIGHING_STATES, DIFFERENCE = 64, 1e-5
"""States at which Jacobians are taken, and the step for it, as a share of the workspace."""

LEAST_WEIGHT = 0.15
"""Least weight of an axis: wider cells on commanded axes would cost inputs and labels too much."""


def cells_at(problem: Problem, resolution: float) -> dict[str, Shape]:
    """Return cells per axis of every agent at about ``resolution`` cells per standard deviation of noise.

    Parameters
    ----------
    problem : Problem
    resolution : float
        Cells per standard deviation of the noise (dimensionless), positive.
    """
    alike: dict[tuple[Any, ...], list[int]] = {}
    for i, agent in enumerate(problem.agents):
        corners = (agent.state_low, agent.state_high, agent.input_low, agent.input_high)
        key = (*agent.motion_key, *agent.noise_key, *(a.tobytes() for a in corners))
        alike.setdefault(key, []).append(i)
    cells_of: dict[int, Shape] = {}
    for members in alike.values():
        first = problem.agents[members[0]]
        # The boundaries of all members, so that they share edges, and with them kernels.
        axes = [{b for i in members for b in region_boundaries(problem, i, k)} for k in range(first.n_states)]
        cells = _agent_cells(first, [sorted(axis) for axis in axes], resolution)
        cells_of |= dict.fromkeys(members, cells)
    return {agent.name: cells_of[i] for i, agent in enumerate(problem.agents)}


def axis_weights(agent: AnyAgent) -> FloatArray:
    """Return how fine the cells of each axis should be against the noise, relative to the axis that matters most.

    Under mean boxes a cell costs as much as it widens the boxes along axes without targets, in deviations of the noise:
    ``sum_k |J_kj| h_j / sigma_k``. For a given number of cells the sum over the axes j is least if all of them cost the
    same. The Jacobian J is averaged over the workspace, by differences. Linear agents have equal weights.
    """
    if agent.is_affine:
        return np.ones(agent.n_states)
    agent = with_expressions(agent)
    # An even sample of states, at the middle of the inputs: weights need one digit.
    d, middle = agent.n_states, agent.input_box.center
    shares = (np.arange(WEIGHING_STATES) + 0.5)[:, None] * np.sqrt(np.arange(2, 2 + d) + 0.5) % 1.0
    span = agent.state_high - agent.state_low
    states = (agent.state_low + shares * span).T
    inputs = np.broadcast_to(middle[:, None], (len(middle), WEIGHING_STATES))
    deviations = np.maximum(deviations_of(agent), 1e-12 * span)
    free = np.ones(d, dtype=bool)
    free[commanded_axes(agent)] = False
    free = free if np.any(free) else ~free
    cost = np.zeros(d)
    for j in range(d):
        step = np.zeros((d, 1))
        step[j] = DIFFERENCE * span[j]
        with np.errstate(all="ignore"):
            moved = np.abs(agent.mean(states + step, inputs) - agent.mean(states, inputs)) / step[j]
        mean = np.nan_to_num(moved, nan=0.0, posinf=0.0).mean(axis=1)
        cost[j] = float(np.sum((mean / deviations)[free])) * deviations[j]
    if not np.max(cost) > 0.0:
        return np.ones(d)
    return np.asarray(np.maximum(cost / np.max(cost), LEAST_WEIGHT))


def commanded_axes(agent: Agent) -> list[int]:
    """Return the axes whose means inputs put anywhere, at most one for each input: that which it moves farthest.

    The mean along such an axis is ``a(x) + b(x) u`` with one input u. The distance is measured at the middle of the
    workspace, in shares of its width.
    """
    axes: list[int] = []
    if agent.has_clock or any(names_in(tree) & {*agent.inputs} for tree in agent.scale_trees):
        return axes
    middle = {state: np.array([x]) for state, x in zip(agent.states, agent.workspace.center.tolist(), strict=True)}
    middle |= {name: np.array([0.5 * low + 0.5 * high]) for name, (low, high) in agent.unknowns.items()}
    for name in agent.inputs:
        best, farthest = None, 0.0
        for k, tree in enumerate(agent.trees):
            others = names_in(tree) & ({*agent.inputs, *agent.unknowns} - {name} - agent.measured)
            split = None if others or k in axes else split_at(tree, name)
            if split is None or split[1] == Number(0.0) or not _never_zero(agent, split[1]):
                continue
            [factor] = computed([split[1]], middle)
            moved = abs(float(factor[0])) / (agent.state_high[k] - agent.state_low[k])
            if moved > farthest:
                best, farthest = k, moved
        if best is not None:
            axes.append(best)
    return axes


def _never_zero(agent: Agent, factor: Tree) -> bool:
    """Return whether a factor has one sign in the whole workspace."""
    names = {name: Affine(np.zeros(1), {k: np.ones(1)}) for k, name in enumerate((*agent.states, *agent.unknowns))}
    ends = [*zip(agent.state_low, agent.state_high, strict=True), *agent.unknowns.values()]
    box = [(np.array([low]), np.array([high])) for low, high in ends]
    [(least, most)] = enclosed([factor], names, box)
    return bool(least[0] > 0.0 or most[0] < 0.0)


def _agent_cells(agent: AnyAgent, boundaries: Sequence[list[float]], resolution: float) -> Shape:
    """Return the cells per axis of one agent: of numbers near the resolution those with most axes of equal cells."""
    span = agent.state_high - agent.state_low
    deviations = deviations_of(agent)
    fineness = resolution * axis_weights(agent)
    wanted = [max(1.0, float(r * s / max(d, 1e-12 * s))) for r, s, d in zip(fineness, span, deviations, strict=True)]
    options = [
        _numbers(float(low), float(high), inside, number)
        for low, high, inside, number in zip(agent.state_low, agent.state_high, boundaries, wanted, strict=True)
    ]
    if math.prod(map(len, options)) > MOST_COMBINATIONS:
        few = max(1, int(MOST_COMBINATIONS ** (1.0 / agent.n_states)))
        options = [_nearest(own, number)[:few] for own, number in zip(options, wanted, strict=True)]
    # Compare all combinations: most axes of equal cells first, then nearest to the wish.
    scored = []
    for choice in product(*options):
        shape, even = tuple(n for n, _ in choice), tuple(e for _, e in choice)
        axes = zip(shape, wanted, boundaries, strict=True)
        far = sum(abs(math.log(n / max(number, len(inside) + 1))) for n, number, inside in axes)
        scored.append((-sum(even), far, shape))
    return min(scored)[-1]


def _numbers(low: float, high: float, boundaries: Sequence[float], wanted: float) -> list[tuple[int, bool]]:
    """Return numbers of cells to consider for one axis, and whether all cells are equal with each."""
    inside = sorted({b for b in boundaries if low < b < high})
    least = len(inside) + 1
    unit = equal_parts(low, high, inside)
    centre = min(MOST_CELLS_PER_AXIS, max(least, round(wanted)))
    if unit is None:
        return [(centre, False)]
    first, last = math.ceil(centre / NEAR_FACTOR / unit), math.floor(centre * NEAR_FACTOR / unit)
    even = [(k * unit, True) for k in range(max(1, first), last + 1) if k * unit <= MOST_CELLS_PER_AXIS]
    if len(even) > MOST_NUMBERS:
        even = sorted(even, key=lambda option: (_roughness(option[0]), abs(option[0] - centre)))[:MOST_NUMBERS]
    return even or [(centre, False)]


def _nearest(options: list[tuple[int, bool]], wanted: float) -> list[tuple[int, bool]]:
    """Return numbers of cells in the order of how near they are to the wish."""
    return sorted(options, key=lambda option: abs(math.log(option[0] / wanted)))


def _roughness(number: int) -> int:
    """Return the largest prime factor: axes whose numbers have small ones are commensurable more often."""
    largest, p = 1, 2
    while p * p <= number:
        while number % p == 0:
            largest, number = max(largest, p), number // p
        p += 1
    return max(largest, number) if number > 1 else largest


def equal_parts(low: float, high: float, boundaries: Sequence[float], most: int = MOST_CELLS_PER_AXIS) -> int | None:
    """Return the fewest equal cells that have all boundaries on their edges; None if that takes more than ``most``."""
    n_parts = 1
    for boundary in boundaries:
        share = Fraction((boundary - low) / (high - low)).limit_denominator(most)
        if abs(float(share) * (high - low) + low - boundary) > 1e-9 * (high - low):
            return None
        n_parts = math.lcm(n_parts, share.denominator)
        if n_parts > most:
            return None
    return n_parts
