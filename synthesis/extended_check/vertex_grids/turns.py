"""Angles on grids of vertices: windows of numbers, narrower than a turn, that stand for points of a circle.

Let dynamics, sizes of noise and outputs be those of points of a circle (``checker.angles``), and the grid of each time
be a window of numbers, along every angle narrower than a turn. At a state the controller takes the number in the window
that is the same point, if there is one, and it is the only one.

**Theorem.** If V is below its backups for numbers that never wrap, with regions that have a copy for every turn, and 0
outside of windows, then V at the number of the start is at most the probability that the task is satisfied.

*Proof.* By induction over T - t, V_t(q, X) is at most that probability from any state that is the same point as X. The
mean of the next number Y, from X, and that of the next state, from the state, are the same point for the same noise,
and so is its size. If Y lies in the next window it is the number that the controller takes there, with the letter of
its state; else V is 0, which is at most anything. QED

A number in the workspace is its state, exactly. Others are whole turns further on, off by ``OFF``: regions there have
room for it. Controllers round numbers by less than inputs may be off where cells have a least width.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np

from ...checker import CheckedProblem, Refused
from ...checker.angles import FARTHEST, OFF, check_angles
from ...checker.motions import cell_labels
from ...checker.problem import TURN, Proposition
from ...checker.rigorous import Array, Whole

ROOM = 1e-6  # by which windows are narrower than a turn
NARROWEST = 1e-3  # width of a cell along an angle: there 1e-13 counts for 1e-10 of an input


def check_windows(problem: CheckedProblem, edges: tuple[Array, ...]) -> None:
    """Raise ``Refused`` unless angles are points of a circle, and windows along them are narrower than a turn."""
    agent = problem.agents[0]
    check_angles(problem)
    for axis, state in zip(edges, agent.states, strict=True):
        if state in agent.angles:
            if not np.all(axis[..., -1] - axis[..., 0] <= TURN - ROOM) or not np.all(np.abs(axis) <= FARTHEST):
                raise Refused(f"a window is not narrower than a turn along `{state}`, or many turns away")
            if not np.all(np.diff(axis, axis=-1) >= NARROWEST):
                raise Refused(f"cells are too narrow along `{state}` for angles that are rounded")


def labels_of_copies(problem: CheckedProblem, edges: tuple[Array, ...]) -> Whole:
    """Return the labels (S, .) of cells of numbers, where regions along angles have a copy for every turn."""
    agent = problem.agents[0]
    axes = [k for k, state in enumerate(agent.states) if state in agent.angles]
    outputs = {k: [j for j, tree in enumerate(agent.outputs) if tree == agent.states[k]] for k in axes}
    turns = []
    for k in axes:
        first, last = agent.state_box[:, k].tolist()
        turns.append(range(math.floor((edges[k][0] - last) / TURN), math.ceil((edges[k][-1] - first) / TURN) + 1))
    holds, may = [], []
    for each in itertools.product(*turns):
        # where a copy surely is, and where it may be
        shifts = {j: n for k, n in zip(axes, each, strict=True) for j in outputs[k]}
        inner, outer = (cell_labels(_shifted(problem, shifts, off), 0, edges)[1] for off in (OFF, -OFF))
        holds.append(inner > 0)
        may.append(outer >= 0)
    return np.where(np.any(holds, axis=0), 1, np.where(np.any(may, axis=0), 0, -1))


def _shifted(problem: CheckedProblem, shifts: dict[int, int], off: float) -> CheckedProblem:
    """Return the problem with regions whole turns further on along outputs that are angles, narrower by ``off``."""
    agent, regions = problem.agents[0], list[Proposition]()
    for region in problem.regions:
        low, high = region.low.copy(), region.high.copy()
        for column, output in enumerate(region.outputs[0]):
            if output in shifts:
                first, last = agent.state_box[:, agent.states.index(str(agent.outputs[output]))]
                # a region without a limit ends where the turn does, and one of a whole turn is everywhere
                a, b = np.maximum(low[:, column], first), np.minimum(high[:, column], last)
                whole, room = b - a >= TURN - OFF, off * (shifts[output] != 0)
                low[:, column] = np.where(whole, -np.inf, a + TURN * shifts[output] + room)
                high[:, column] = np.where(whole, np.inf, b + TURN * shifts[output] - room)
        regions.append(replace(region, low=low, high=high))
    return replace(problem, regions=tuple(regions))


def numbers_in(places: Array, middle: float | Array) -> Array:
    """Return the numbers nearest to the middle of a window that stand for the same angles."""
    return np.asarray(places + TURN * np.round((middle - places) / TURN))
