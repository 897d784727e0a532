"""Ways around regions on a coarse grid: where a nonlinear path may run at each time, before it is planned.

The grid is one of outputs, as those are what regions are about. Where outputs were added for shapes, several of them
say where one point is: then it is one of the states that they depend on.

By dynamic programming over times and cells: short steps, far from what must not be met. Dynamics are not asked. A
second and a third way keep off the ones before, so that obstacles are passed on other sides.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from ....envs.systems.agents import Agent, AnyAgent
from ....envs.systems.expressions import names_in
from ....envs.tasks.problem import Problem
from ...relations.grids import FloatArray
from ..chance_constraints import corners_along

CELLS = {1: 120, 2: 40, 3: 16}
"""Cells per axis, by the number of outputs that are planned."""

MOST_GUESSES = 3
"""Ways that are tried."""

MOST_SHIFTS = 15_000
"""Moves between cells that are looked at, over all steps."""

NEAR = 2.0
"""Cells from regions within which a way is charged for being near."""

BESIDE = 4.0
"""Cells from an earlier way within which another one is charged."""


def guesses(problem: Problem, agent: AnyAgent, letters: NDArray[np.int8], start: FloatArray) -> Iterator[FloatArray]:
    """Yield outputs (S + 1, p) at times 0 to S along different ways; none if a region cannot be reached."""
    low, high = agent.output_range(agent.state_low[None], agent.state_high[None])
    low, high = low[0].copy(), high[0].copy()
    here = agent.outputs(start[:, None])[:, 0]
    axes = _limited(problem, agent, letters, low, high)
    if not axes:
        yield np.tile(here, (len(letters), 1))
        return
    spaces = [_of_states(agent, axes, start, []) or _of_outputs(axes[:3], low, high, here)]
    avoided = _limited(problem, agent, np.minimum(letters, 0), low, high)
    if not {*avoided} <= {*spaces[0].axes}:
        # What is avoided has to be seen: what is to hold besides, such as to be slow, is left to the planner.
        spaces.insert(0, _of_states(agent, axes, start, avoided) or _of_outputs(avoided[:3], low, high, here))
    for space in spaces:
        grid = _Grid(problem, agent, letters, space)
        charge = np.zeros(grid.shape)
        for _ in range(MOST_GUESSES):
            found = grid.way(space.here, charge)
            if found is None:
                break
            yield space.whole(found)
            charge = charge + grid.beside(found)


@dataclass(frozen=True, eq=False)
class _Space:
    """What a grid is one of: some outputs, or some states.

    Attributes
    ----------
    low, high, here : np.ndarray, shape (k,)
        Its ends, and where the start is.
    axes : list of int
        Outputs that tell regions there.
    told : callable
        From points (*S, k) to those outputs (*S, len(axes)).
    whole : callable
        From points (S + 1, k) to all outputs (S + 1, p).
    """

    low: FloatArray
    high: FloatArray
    here: FloatArray
    axes: list[int]
    told: Callable[[FloatArray], FloatArray]
    whole: Callable[[FloatArray], FloatArray]


def _of_outputs(narrowest: list[int], low: FloatArray, high: FloatArray, here: FloatArray) -> _Space:
    """Return the space of up to three outputs; all others stay what they are at the start."""
    axes = sorted(narrowest)

    def whole(points: FloatArray) -> FloatArray:
        full = np.tile(here, (len(points), 1))
        full[:, axes] = points
        return full

    return _Space(low[axes], high[axes], here[axes], axes, lambda points: points, whole)


def _of_states(agent: AnyAgent, axes: list[int], start: FloatArray, ahead: list[int]) -> _Space | None:
    """Return the space of up to three states on which outputs depend, first those ``ahead``.

    None for agents without added outputs.
    """
    if not agent.added_outputs or not isinstance(agent, Agent):
        return None
    names = {k: frozenset(names_in(agent.output_trees[k])) for k in axes}
    tied = [k for k in axes if len(names[k]) > 1]
    # Where not all states have a place, those of round and oblique regions come first, as they say what is where;
    # then the narrowest. What is about further states is left to the planner.
    if ahead:
        axes = [*ahead, *(k for k in axes if k not in ahead)]
    elif tied and len(frozenset().union(*names.values())) > len(CELLS):
        known = frozenset[str]().union(*(names[k] for k in tied))
        axes = [*tied, *(k for k in axes if k not in tied and names[k] <= known)]
    named, kept = frozenset[str](), list[int]()
    for k in axes:
        if len(own := named | names[k]) <= len(CELLS):
            named, kept = own, [*kept, k]
    states = sorted(agent.states.index(name) for name in named)
    if not states:
        return None

    def whole(points: FloatArray) -> FloatArray:
        full = np.empty((agent.n_states, *points.shape[:-1]))
        full[...] = start.reshape(-1, *[1] * (points.ndim - 1))
        full[states] = np.moveaxis(points, -1, 0)
        return np.moveaxis(agent.outputs(full), 0, -1)

    ends = agent.state_low[states], agent.state_high[states], start[states]
    return _Space(*ends, kept, lambda points: whole(points)[..., kept], whole)


def _limited(
    problem: Problem, agent: AnyAgent, letters: NDArray[np.int8], low: FloatArray, high: FloatArray
) -> list[int]:
    """Return the outputs that regions limit, the most narrowly limited ones first."""
    share = np.full(agent.n_outputs, np.inf)
    for q, name in enumerate(problem.automaton.propositions):
        if q < problem.labeling.first_pair and problem.propositions[name].agent == agent.name and letters[:, q].any():
            corners = corners_along(problem, name, len(letters))
            asked = letters[:, q] != 0
            inside = np.minimum(corners[1][asked], high) - np.maximum(corners[0][asked], low)
            with np.errstate(invalid="ignore"):
                share = np.fmin(share, np.where(inside < high - low, inside / (high - low), np.inf).min(axis=0))
    return [int(k) for k in np.argsort(share, kind="stable") if np.isfinite(share[k]) and np.isfinite(high - low)[k]]


class _Grid:
    """Cells of some outputs or states, and which of them letters allow at each time."""

    def __init__(self, problem: Problem, agent: AnyAgent, letters: NDArray[np.int8], space: _Space) -> None:
        axes = space.axes
        self.count = CELLS[len(space.low)]
        self.shape = (self.count,) * len(space.low)
        self.low, self.size = space.low, (space.high - space.low) / self.count
        middles = [a + (np.arange(self.count) + 0.5) * s for a, s in zip(self.low, self.size, strict=True)]
        self.points = np.stack(np.meshgrid(*middles, indexing="ij"), axis=-1)
        told, edges = space.told(self.points), (slice(1, -1),) * len(space.low)
        self.costs: list[FloatArray] = []
        known: dict[bytes, FloatArray] = {}
        names = problem.automaton.propositions
        own = [q for q in range(min(len(names), problem.labeling.first_pair))
               if problem.propositions[names[q]].agent == agent.name]  # fmt: skip
        corners = {q: corners_along(problem, names[q], len(letters)) for q in own}
        for t, letter in enumerate(letters):
            # Where regions move, equal letters ask for something else at each time.
            key = letter[own].tobytes() + b"".join(end[t].tobytes() for q in own if letter[q] for end in corners[q])
            if key not in known:
                allowed, far = np.ones(self.shape, dtype=bool), np.ones(self.shape, dtype=bool)
                for q in own:
                    low, high = (end[t, axes] for end in corners[q])
                    inside = np.all((told >= low) & (told < high), axis=-1)
                    if letter[q] > 0 and not inside.any():
                        inside = _nearest(told, low, high)  # a region between the middles of cells
                    if letter[q] > 0:
                        allowed &= inside
                    elif letter[q] < 0:
                        allowed &= ~inside
                        far &= ~inside
                distance = distance_transform_edt(np.pad(far, 1, constant_values=True)) if not far.all() else None
                near = 0.0 if distance is None else 4.0 * np.exp(-distance[edges] / NEAR)
                # Where something has to hold, its middle is better than its edge.
                deep = distance_transform_edt(np.pad(allowed, 1))[edges]
                edge = 4.0 * np.exp(-deep / NEAR) if np.any(letter[own] > 0) else 0.0
                known[key] = np.where(allowed, near + edge, np.inf)
            self.costs.append(known[key])

    def way(self, start: FloatArray, charge: FloatArray) -> FloatArray | None:
        """Return points (S + 1, k) of the cheapest way; None if there is none."""
        steps = len(self.costs) - 1
        reach = min(self.count, max(2, int(np.ceil(3.0 * self.count / steps))))
        while reach > 2 and (2 * reach + 1) ** len(self.shape) * steps > MOST_SHIFTS:
            reach -= 1
        shifts = np.array(list(product(range(-reach, reach + 1), repeat=len(self.shape))))
        # Long steps cost more than their share, so that ways are gone evenly.
        lengths = (shifts**2).sum(axis=1) * (steps / self.count) ** 2 * 0.5
        first = np.clip(((start - self.low) / self.size).astype(int), 0, self.count - 1)
        value, came = np.full(self.shape, np.inf), []
        value[tuple(first)] = 0.0
        for t in range(1, steps + 1):
            padded = np.pad(value, reach, constant_values=np.inf)
            best, which = np.full(self.shape, np.inf), np.zeros(self.shape, dtype=np.int32)
            for k, (shift, length) in enumerate(zip(shifts, lengths, strict=True)):
                window = tuple(slice(reach - s, reach - s + self.count) for s in shift)
                moved = padded[window] + length
                less = moved < best
                np.copyto(best, moved, where=less)
                np.copyto(which, k, where=less)
            value = best + self.costs[t] + charge
            came.append(which)
        if not np.isfinite(value.min()):
            return None
        cell = np.array(np.unravel_index(int(np.argmin(value)), self.shape))
        cells = [cell]
        for which in reversed(came):
            cell = cell - shifts[which[tuple(cell)]]
            cells.append(cell)
        points = self.low + (np.array(cells[::-1]) + 0.5) * self.size
        points[0] = start
        return _smoothed(points)

    def beside(self, points: FloatArray) -> FloatArray:
        """Return a charge for cells near the middle of a way: its ends are those of all."""
        middle = points[len(points) // 6 : -max(1, len(points) // 6)]
        scaled = (self.points[..., None, :] - middle) / self.size
        distance = np.sqrt((scaled**2).sum(axis=-1)).min(axis=-1)
        return np.where(distance < BESIDE, 3.0, 0.0)


def _nearest(told: FloatArray, low: FloatArray, high: FloatArray) -> NDArray[np.bool_]:
    """Return which cells are nearest to a box in which there is the middle of none, in ranges of the outputs."""
    spans = np.ptp(told.reshape(-1, told.shape[-1]), axis=0)
    short = np.maximum(np.maximum(low - told, told - high), 0.0) / np.where(spans > 0.0, spans, 1.0)
    away = short.max(axis=-1)
    return np.asarray(away <= away.min())


def _smoothed(points: FloatArray) -> FloatArray:
    """Return points without the steps of the grid."""
    smooth = points.copy()
    for _ in range(2):
        smooth[1:-1] = 0.25 * smooth[:-2] + 0.5 * smooth[1:-1] + 0.25 * smooth[2:]
    return smooth
