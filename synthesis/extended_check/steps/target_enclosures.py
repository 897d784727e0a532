"""Exact targets of agents with expressions, verified: inputs put the mean there from the whole cell.

For every cell and every target that some policy chooses in it, the solution of ``mean = target`` is read on the closed
cell with the spans of ``step_intervals``. The ranges that the search put together from a middle target and slopes are
not used. That solutions solve is tested where the controller acts (``execution``).

Whether polar inputs give a vector is decided by the angles under which the corners of its box are seen from 0; the
search looks at half planes.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from functools import partial

import numpy as np
from numpy.typing import NDArray

from ....envs.systems.agents import Agent
from ....envs.systems.expressions import Tree, operations_in
from ...certificates.cell_probabilities import AgentRecord, state
from ...relations.grids import FloatArray
from ...relations.kinds import SymbolicTargets, Turn
from .geometry import cell_boxes
from .mean_enclosures import Enclosed, leaves_of
from .step_intervals import Span, bounds, computed_off, span

AT_ONCE = 100_000
"""Pairs of cells and targets that are verified at once."""

ROUNDED = 4.0 * 2.0**-53
"""Share of their size by which each operation of an expression may put inputs off."""

WHOLE_TURN = 2.0 * np.pi * (1.0 - 1e-15)
"""Angles over so much go all the way round, up to the rounding of pi, which is part of what vectors may be off by."""

PRODUCTS = 2.0
"""Factor on what inner terms lose, for products of such losses."""

MOST_LOST = 0.25
"""Share of the factors of inputs that may be lost, measured through their inverse: its series then converges."""

PARTS = 4
"""Parts into which cells are cut along each axis at most: the sums of the search are sometimes tighter."""


def wrong_targets(agent: Agent, part: AgentRecord, relation: SymbolicTargets) -> list[str]:
    """Targets of the policies that some state of their cell does not reach with inputs of the box."""
    low, high = cell_boxes(part)
    n_points = int(np.prod([len(axis) for axis in part.lattice]))
    pairs, first = np.zeros(0, dtype=np.int64), np.arange(part.policy.shape[-1]) * n_points
    for row in part.policy.reshape(-1, part.policy.shape[-1]):
        pairs = np.union1d(pairs, (first + row)[row >= 0])
    lost = inner_losses(relation, low, high)
    for some in np.array_split(pairs, len(pairs) // AT_ONCE + 1):
        cells, points = np.divmod(some, n_points)
        index = np.unravel_index(points, tuple(len(axis) for axis in part.lattice))
        targets = np.stack([axis[k] for axis, k in zip(part.lattice, index, strict=True)], axis=1)
        left = np.arange(len(some))
        parts = 1
        while len(left) and parts <= PARTS:
            here = cells[left]
            inside = _inside(relation, (low[here], high[here], lost[here]), targets[left], parts)
            left, parts = left[~inside], 2 * parts
        if len(left):
            return ["it is asked for inputs beyond its input box"]
    return []


def target_losses(part: AgentRecord, relation: SymbolicTargets) -> FloatArray:
    """Upper bounds (d,) on how far means are off their targets, as inputs are rounded, in cells with a choice.

    A share of the parts of the solution, as often as its operations cancel, times the factors of the inputs.
    """
    low, high = cell_boxes(part)
    used = np.any(part.policy.reshape(-1, part.policy.shape[-1]) >= 0, axis=0)
    low, high = low[used], high[used]
    rest, inverse, factors = _sizes(relation, low, high)
    largest = np.array([_largest(relation, name) for name in relation.columns])
    parts = 2.0 * rest + factors @ largest
    growth = np.einsum("njk,nkl->njl", inverse, factors).sum(axis=2).max(axis=1)
    off = _computed_off(relation) * growth[:, None] * np.einsum("nkj,njl,nl->nk", factors, inverse, parts)
    off = off + np.einsum("nkj,nj->nk", factors, inner_losses(relation, low, high))
    return np.asarray(np.where(np.isfinite(off), off, np.inf).max(axis=0, initial=0.0))


def _sizes(relation: SymbolicTargets, low: FloatArray, high: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Largest sizes on closed cells of the rests (n, d), of the inverse, and of the factors (n, d, d) of inputs."""
    d = relation.agent.n_states
    matrices = (tree for rows in (relation.inverse, relation.form.factors) for row in rows for tree in row)
    trees = [*relation.form.rests, *matrices]
    with np.errstate(all="ignore"):
        ends = bounds(partial(_spans, relation, trees, np.zeros((len(low), d))), _variables(relation.agent, low, high))
    sizes = np.abs(np.stack(ends, axis=-1)).max(axis=0)
    rest, inverse, factors = np.split(sizes, [d, d + d * d], axis=1)
    return rest, inverse.reshape(-1, d, d), factors.reshape(-1, d, d)


def inner_losses(relation: SymbolicTargets, low: FloatArray, high: FloatArray) -> FloatArray:
    """Upper bounds (n, d) on how far inputs are off in cells as inner terms of rests and factors are rounded.

    ``1e13*(x + 1) - 1e13*x`` is small, and loses what 1e13 loses. Infinite where factors lose so much that their
    inverse is not known.
    """
    agent, d = relation.agent, relation.agent.n_states
    entries = [tree for row in relation.form.factors for tree in row]
    with np.errstate(all="ignore"):
        leaves = leaves_of(agent, _variables(agent, low, high), np.zeros((len(low), 0)), False)
        lost = np.stack([computed_off(tree, leaves)[1] for tree in (*relation.form.rests, *entries)], axis=1)
        if not np.any(lost):
            return np.zeros((len(low), d))
        _, inverse, _ = _sizes(relation, low, high)
        of_factors = lost[:, d:].reshape(-1, d, d)
        largest = np.array([_largest(relation, name) for name in relation.columns])
        kept = np.einsum("njl,nlk->njk", inverse, of_factors).sum(axis=2).max(axis=1, initial=0.0) <= MOST_LOST
        off = PRODUCTS * np.einsum("njl,nl->nj", inverse, lost[:, :d] + of_factors @ largest)
    return np.where(kept[:, None] & np.isfinite(off), off, np.inf)


def _computed_off(relation: SymbolicTargets) -> float:
    """Share of their size by which v is off: each operation rounds, and so do angles, in which vectors turn."""
    angles = sum(_largest_angle(relation.agent, turn) for turn in relation.turns)
    return ROUNDED * (sum(map(operations_in, (*relation.agent.trees, *relation.trees))) + angles)


def _largest(relation: SymbolicTargets, name: str) -> float:
    """Largest size of an input, or of a component of a turn."""
    agent = relation.agent
    turned = [turn.size for turn in relation.turns if name in turn.names]
    j = turned[0] if turned else agent.inputs.index(name)
    return max(abs(float(agent.input_low[j])), abs(float(agent.input_high[j])))


def _variables(agent: Agent, low: FloatArray, high: FloatArray) -> FloatArray:
    """Boxes (v, 2, n): the axes of cells, and the neighbours that are communicated, anywhere in their workspaces."""
    around = [(np.full(len(low), a), np.full(len(low), b)) for a, b in agent.unknowns.values()]
    return np.array([*zip(low.T, high.T, strict=True), *around])


def _spans(
    relation: SymbolicTargets, trees: Sequence[Tree], targets: FloatArray, on: FloatArray, with_slopes: bool = False
) -> list[Span]:
    agent = relation.agent
    leaves = leaves_of(agent, on, np.zeros((on.shape[2], 0)), with_slopes)
    some = next(iter(leaves.values()))
    leaves |= {name: Span.of(row, row, some) for name, row in zip(relation.targets, targets.T, strict=True)}
    return [span(tree, leaves) for tree in trees]


def _inside(
    relation: SymbolicTargets, cells: tuple[FloatArray, FloatArray, FloatArray], targets: FloatArray, parts: int
) -> NDArray[np.bool_]:
    """Whether the solutions for targets (n, d) are inputs of the box on all of the closed cells.

    ``cells`` are their corners (n, d), and how far inputs are off in them by inner terms.
    """
    low, high, lost = cells
    inside, cuts = np.ones(len(low), dtype=bool), [low + (high - low) * (k / parts) for k in range(parts)] + [high]
    for part in itertools.product(range(parts), repeat=low.shape[1]):
        first, last = (np.stack([cuts[k + side][:, axis] for axis, k in enumerate(part)], axis=1) for side in (0, 1))
        with np.errstate(all="ignore"):
            ends = bounds(partial(_spans, relation, relation.trees, targets), _variables(relation.agent, first, last))
            spans = Enclosed(
                relation.trees,
                relation.agent,
                np.zeros((len(low), 0)),
                constants=dict(zip(relation.targets, targets.T, strict=True)),
            )
            unknown = [(np.full(len(low), a), np.full(len(low), b)) for a, b in relation.agent.unknowns.values()]
            state("spans", spans, (first, last), unknown, tuple(np.stack(ends, axis=-1)))
            wider = [own + np.stack([-off, off]) for own, off in zip(ends, lost.T, strict=True)]
            inside &= _admissible(relation, dict(zip(relation.columns, wider, strict=True)))
    return inside


def _admissible(relation: SymbolicTargets, ends: dict[str, FloatArray]) -> NDArray[np.bool_]:
    """Whether inputs lie in their intervals, and turns between their smallest and largest size; ends are (2, n)."""
    agent, inside = relation.agent, np.ones(next(iter(ends.values())).shape[1], dtype=bool)
    for name in agent.inputs:
        if name in ends:
            j = agent.inputs.index(name)
            spare = _computed_off(relation) * (abs(agent.input_low[j]) + abs(agent.input_high[j]))
            inside &= (ends[name][0] - spare >= agent.input_low[j]) & (ends[name][1] + spare <= agent.input_high[j])
    for turn in relation.turns:
        spare = _computed_off(relation) * (abs(agent.input_low[turn.size]) + abs(agent.input_high[turn.size]))
        east, north = (ends.get(name, np.zeros((2, 1))) + np.array([[-spare], [spare]]) for name in turn.names)
        inside &= turned_there(agent, turn, east, north)
    return inside


def turned_there(agent: Agent, turn: Turn, east: FloatArray, north: FloatArray) -> NDArray[np.bool_]:
    """Whether sizes and angles of their intervals give all vectors of boxes; ``east`` and ``north`` are (2, n)."""
    low, high = float(agent.input_low[turn.size]), float(agent.input_high[turn.size])
    around = float(agent.input_high[turn.angle]) - float(agent.input_low[turn.angle])
    farthest = np.sqrt(np.abs(east).max(axis=0) ** 2 + np.abs(north).max(axis=0) ** 2)
    apart = [np.where(side[0] * side[1] <= 0.0, 0.0, np.abs(side).min(axis=0)) for side in (east, north)]
    nearest = np.sqrt(apart[0] ** 2 + apart[1] ** 2)
    # With their sign, sizes go one way or the opposite one; a box may be reached by either of them alone.
    there = np.zeros(farthest.shape, dtype=bool)
    for sign, least, most in ((1.0, low, high), (-1.0, -high, -low)):
        sized = (farthest <= most) & ((nearest >= least) | (least <= 0.0)) & (most > 0.0)
        # The opposite of an interval begins with the opposite of its upper end.
        facing = (east, north) if sign > 0.0 else (-east[::-1], -north[::-1])
        there |= sized & _seen_within(agent, turn, *facing)
    # Angles over half a turn and more hold each direction or its opposite, which the other sign of the size gives.
    either = around >= np.pi and low < 0.0 < high
    return np.asarray(there | ((farthest <= min(high, -low)) & either))


def _seen_within(agent: Agent, turn: Turn, east: FloatArray, north: FloatArray) -> NDArray[np.bool_]:
    """Whether boxes (2, n) are seen from 0 under angles of the interval alone; not where they hold 0."""
    first, last = float(agent.input_low[turn.angle]), float(agent.input_high[turn.angle])
    if last - first >= WHOLE_TURN:
        return np.ones(np.broadcast_shapes(east.shape, north.shape)[1], dtype=bool)
    beside = (east[0] > 0.0) | (east[1] < 0.0) | (north[0] > 0.0) | (north[1] < 0.0)
    x, y = 0.5 * (east[0] + east[1]), 0.5 * (north[0] + north[1])
    # Angles from the middle of a box to its corners: less than half a turn, as the box does not hold 0.
    corners = [(east[i], north[j]) for i, j in itertools.product((0, 1), repeat=2)]
    off = np.stack([np.arctan2(x * b - y * a, x * a + y * b) for a, b in corners])
    middle, slack = np.arctan2(y, x), ROUNDED * _largest_angle(agent, turn)
    state("angles", (x, y), corners, (middle, off), 0.25 * slack)
    begin, end = middle + off.min(axis=0) - slack, middle + off.max(axis=0) + slack
    turns = 2.0 * np.pi * np.ceil((first - begin) / (2.0 * np.pi))
    return np.asarray(beside & (begin + turns >= first) & (end + turns <= last))


def _largest_angle(agent: Agent, turn: Turn) -> float:
    """Largest angle, or turns added to one: what rounding angles and pi is a share of."""
    return 2.0 * np.pi + max(abs(float(agent.input_low[turn.angle])), abs(float(agent.input_high[turn.angle])))
