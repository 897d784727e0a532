"""Numbers of cells that fit together, and the memory that they need.

A *resolution* is a number of cells per standard deviation of the noise, the same for all axes of all agents: what cells
lose depends on their width against the noise. Near the number that a resolution asks for on an axis, those numbers are
preferred

- for which the region boundaries cut the axis into whole numbers of equal cells (no slivers, which would cost inputs
  and labels as much as a wide cell, and more lattice points);
- under relations with a menu of inputs, for which the means fall on few lattice points per cell: with equal cells of
  widths h the means of axis k lie on the multiples of ``h_k / q`` where ``A_kj h_j / h_k`` has the denominator q. For
  position and velocity, ``p' = p + s v``, cells of width ``h_v = h_p / s`` (or twice that) have q = 1 (or 2).

Memory is estimated from the shapes of tables, policies and menus. What the value function takes is not known
beforehand; it is scaled from a run with fewer cells (see ``refine``).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from itertools import product
from typing import Any

import numpy as np

from ...envs.agents import AnyAgent, LinearAgent, with_expressions
from ...envs.problem import Problem
from ..cells import DEFAULT_TARGETS, FloatArray, deviations_of, region_boundaries
from ..models import BAND_BYTES, INPUT_LEVELS, SNAPPED_POINTS
from ..readings import LATTICE_BLOCK, REACH_DEVIATIONS
from ..relations import commands_of, coupling_failure

Shape = tuple[int, ...]

NEAR_FACTOR = 1.25
"""Numbers of cells up to this factor from what is asked for are considered."""

MOST_CELLS_PER_AXIS = 4000
"""Most cells per axis of one agent that are considered."""

MOST_NUMBERS = 24
"""Most numbers of cells per axis that are compared: for three axes they make some ten thousand combinations."""

MOST_COMBINATIONS = MOST_NUMBERS**3
"""Combinations of numbers of cells that are compared: all of three axes; of more axes fewer numbers each."""

POINTS_OF_BOXES = 4
"""Lattice points per cell and axis under the relation ``boxes``, about."""

WEIGHING_STATES, DIFFERENCE = 64, 1e-5
"""States at which Jacobians are taken, and the step for it, as a share of the workspace."""

LEAST_WEIGHT = 0.15
"""Least weight of an axis: wider cells on commanded axes would cost inputs and labels too much."""

UNKNOWN_STATES = 3
"""Automaton states assumed for independent tasks, where the automaton of the whole is not built."""


LINEAR_TABLES = 6.0
"""What linear cells take against other relations: tables of hats, second differences and losses on top (measured)."""


@dataclass(frozen=True)
class AgentCells:
    """Cells per axis of one agent, and the memory that they need.

    Parameters
    ----------
    shape : tuple of int
        Cells per axis.
    per_cell : tuple of int
        Lattice points per cell and axis.
    tables : float
        Bytes of kernel and choices, building them included.
    policy : float
        Bytes of one policy table.
    points : float
        Cells and lattice points together: what value functions are arrays over.
    """

    shape: Shape
    per_cell: tuple[int, ...]
    tables: float
    policy: float
    points: float


def cells_at(problem: Problem, resolution: float, kinds: Sequence[str]) -> dict[str, AgentCells]:
    """Return cells of every agent at about ``resolution`` cells per standard deviation; equal agents get equal ones.

    Parameters
    ----------
    problem : Problem
    resolution : float
        Cells per standard deviation of the noise (dimensionless), positive.
    kinds : sequence of str
        Relation of each agent.
    """
    alike: dict[tuple[Any, ...], list[int]] = {}
    for i, agent in enumerate(problem.agents):
        corners = (agent.state_low, agent.state_high, agent.input_low, agent.input_high)
        key = (kinds[i], *agent.motion_key, *agent.noise_key, *(a.tobytes() for a in corners))
        alike.setdefault(key, []).append(i)
    cells_of: dict[int, AgentCells] = {}
    for (kind, *_), members in alike.items():
        first = problem.agents[members[0]]
        # The boundaries of all members, so that they share edges, and with them kernels.
        axes = [{b for i in members for b in region_boundaries(problem, i, k)} for k in range(first.n_states)]
        cells = _agent_cells(problem, first, [sorted(axis) for axis in axes], resolution, kind)
        cells_of |= dict.fromkeys(members, cells)
    return {agent.name: cells_of[i] for i, agent in enumerate(problem.agents)}


def base_bytes(problem: Problem, cells: Mapping[str, AgentCells]) -> float:
    """Return the bytes of kernels, choices and policies, apart from the value function (an estimate)."""
    agents = list(cells.values())
    distinct = {id(agent_cells): agent_cells for agent_cells in agents}.values()
    # Held at a time: the policies of the last sweep, those of the best one, and those of the starts.
    policies = 5 if len(agents) > 1 else 4
    return sum(each.tables for each in distinct) + policies * sum(each.policy for each in agents)


def snapping_loss(problem: Problem, cells: Mapping[str, AgentCells]) -> float:
    """Return an upper bound on what choosing means from a lattice instead of freely can cost a whole run.

    A mean moved by r whitened units changes the law of a step by at most ``2 Phi(r / 2) - 1`` in total variation; the
    nearest lattice point is half a spacing away per axis at most. Inputs and labels that cells use up come on top.
    """
    # Sums of logarithms: probabilities of losing nothing multiply over agents and steps.
    log_kept = 0.0
    for agent in problem.agents:
        agent_cells = cells[agent.name]
        deviations = deviations_of(agent)
        points = np.array(agent_cells.shape) * np.array(agent_cells.per_cell)
        spacing = (agent.state_high - agent.state_low) / points
        lost = coupling_failure(float(np.linalg.norm(0.5 * spacing / deviations)))
        log_kept += math.log1p(-min(1 - 1e-12, lost))
    return min(1.0, -math.expm1(problem.horizon * log_kept))


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
    free[[command.axis for command in commands_of(agent)]] = False
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


def _agent_cells(
    problem: Problem, agent: AnyAgent, boundaries: Sequence[list[float]], resolution: float, relation: str
) -> AgentCells:
    """Return the cells of one agent: of the numbers near the resolution those with the fewest lattice points."""
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
    automatic = ("auto", "best", "quick")
    by_target = relation == "exact" or (relation in automatic and agent.has_full_rank)
    # Compare all combinations: fewest lattice points first, then most axes of equal cells, then nearest to the wish.
    scored = []
    for choice in product(*options):
        shape, even = tuple(n for n, _ in choice), tuple(e for _, e in choice)
        if not isinstance(agent, LinearAgent):
            per_cell = (POINTS_OF_BOXES,) * agent.n_states
        elif by_target:
            per_cell = (DEFAULT_TARGETS.get(agent.n_states, 1),) * agent.n_states
        else:
            per_cell = _points_per_cell(agent, np.array(shape), even)
        axes = zip(shape, wanted, boundaries, strict=True)
        far = sum(abs(math.log(n / max(number, len(inside) + 1))) for n, number, inside in axes)
        scored.append((math.prod(per_cell), -sum(even), far, shape, per_cell))
    *_, shape, per_cell = min(scored)
    if not isinstance(agent, LinearAgent):
        return _boxes_sized(problem, agent, shape, per_cell)
    sized = _sized(problem, agent, shape, per_cell, by_target)
    return replace(sized, tables=LINEAR_TABLES * sized.tables) if relation == "linear" else sized


def _numbers(low: float, high: float, boundaries: Sequence[float], wanted: float) -> list[tuple[int, bool]]:
    """Return numbers of cells to consider for one axis, and whether all cells are equal with each."""
    inside = sorted({b for b in boundaries if low < b < high})
    least = len(inside) + 1
    unit = _equal_parts(low, high, inside)
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


def _equal_parts(low: float, high: float, inside: Sequence[float]) -> int | None:
    """Return the fewest equal cells that have all boundaries on their edges; None if that takes too many."""
    n_parts = 1
    for boundary in inside:
        share = Fraction((boundary - low) / (high - low)).limit_denominator(MOST_CELLS_PER_AXIS)
        if abs(float(share) * (high - low) + low - boundary) > 1e-9 * (high - low):
            return None
        n_parts = math.lcm(n_parts, share.denominator)
        if n_parts > MOST_CELLS_PER_AXIS:
            return None
    return n_parts


def _points_per_cell(agent: LinearAgent, shape: np.ndarray, even: Sequence[bool]) -> tuple[int, ...]:
    """Return the lattice points per cell and axis that the means of equal cells need, ``SNAPPED_POINTS`` at most."""
    widths = (agent.state_high - agent.state_low) / shape
    per_cell = []
    for k in range(agent.n_states):
        # What moves the mean along axis k: a cell of each axis, and half a step of each input.
        moves = [agent.A[k, j] * widths[j] for j in range(agent.n_states)]
        for column in agent.B.T:
            if column[k] != 0:
                used = column != 0
                moves.append(0.5 * column[k] * float(np.min(widths[used] / np.abs(column[used]))))
        # The common denominator of these moves, in cells.
        q = 1 if all(even) else SNAPPED_POINTS
        for move in moves:
            share = Fraction(float(move / widths[k])).limit_denominator(SNAPPED_POINTS)
            q = math.lcm(q, share.denominator) if abs(float(share) - move / widths[k]) <= 1e-9 else SNAPPED_POINTS
            q = min(q, SNAPPED_POINTS)
        per_cell.append(q)
    return tuple(per_cell)


def _sized(
    problem: Problem, agent: LinearAgent, shape: Shape, per_cell: tuple[int, ...], by_target: bool
) -> AgentCells:
    """Return the cells with the bytes of tables, choices and policies (an estimate)."""
    d, m, n_cells = agent.n_states, agent.n_inputs, math.prod(shape)
    widths = (agent.state_high - agent.state_low) / np.array(shape)
    deviations = deviations_of(agent)
    reach = np.abs(agent.B) @ (0.5 * (agent.input_high - agent.input_low))
    # Kernel: lattice points inside the grid and as far beyond as means get, times the cells in the band of each.
    lattice, kernel = 1.0, 0.0
    for k in range(d):
        beyond = 2 * reach[k] + (np.abs(agent.A[k]) - np.eye(d)[k]).clip(0) @ (agent.state_high - agent.state_low)
        beyond = min(beyond, 6 * deviations[k]) if by_target else beyond
        points = shape[k] * per_cell[k] * (1 + beyond / (agent.state_high[k] - agent.state_low[k]))
        band = min(shape[k], 2 * REACH_DEVIATIONS * deviations[k] / widths[k] + LATTICE_BLOCK / per_cell[k])
        kernel += 8 * points * band
        lattice *= points
    if by_target:
        # Windows and what is computed to make them, per cell, and the remembered bands of targets.
        window = math.prod(2 * r / w * q + 1 for r, w, q in zip(reach, widths, per_cell, strict=True))
        choices = n_cells * (8 * d + 40 * d + 16 * m) + min(BAND_BYTES, 2.0 * n_cells * min(window, lattice))
    else:
        # The menu, and the means and distances that it is made from, per cell and input.
        inputs = {1: 41, 2: 169}.get(m, 5**m)
        step = [float(np.min(widths[c != 0] / np.abs(c[c != 0]))) if c.any() else math.inf for c in agent.B.T]
        spread = agent.input_high - agent.input_low
        inputs = min(inputs, math.prod(max(5, math.ceil(s / h) + 1) for s, h in zip(spread, step, strict=True)))
        choices = n_cells * inputs * (4 + 8 * (3 * d + 4))
    policy = 4.0 * problem.horizon * _n_states(problem) * n_cells
    return AgentCells(shape, per_cell, kernel + choices, policy, n_cells + lattice)


def _boxes_sized(problem: Problem, agent: AnyAgent, shape: Shape, per_cell: tuple[int, ...]) -> AgentCells:
    """Return the cells of an agent with expressions, with the bytes of boxes, lattice and policies (an estimate)."""
    d, n_cells = agent.n_states, math.prod(shape)
    lattice = float(math.prod(n * k for n, k in zip(shape, per_cell, strict=True)))
    # Corners of boxes, the windows that cover them, and some lattice tables at a time.
    inputs = INPUT_LEVELS.get(agent.n_inputs, 3) ** agent.n_inputs
    tables = n_cells * inputs * (16.0 * d + 4.0 * 2**d + 2.0) + 64.0 * lattice
    policy = 4.0 * problem.horizon * _n_states(problem) * n_cells
    return AgentCells(shape, per_cell, tables, policy, n_cells + lattice)


def _n_states(problem: Problem) -> int:
    """Return the automaton states that need policies, or a guess where the automaton of the whole is not built."""
    return UNKNOWN_STATES if getattr(problem, "groups", ()) else problem.automaton.n_states
