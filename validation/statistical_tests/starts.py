"""Sets of joint initial states at which a certificate is tested: corners, slices, random points.

All points lie inside the workspaces. The bound is constant over a joint cell, so one start in a cell stands for all of
its starts; slices take the centres of equal parts, which avoids the edges of cells.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...envs.tasks.problem import Problem
from ...synthesis.certificates.proofs import Certificate

Box = tuple[Any, Any]
"""Both corners (D,) of a box of joint states."""

INSET = 1e-6
"""Share of the width of a box by which corners are moved inwards, so that rounding leaves none of them outside."""

MOST_BITS = 62
"""Axes whose corners are told apart: as many as fit into an int64 with room to spare."""


def workspace_box(problem: Problem) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return both corners (D,) of the product of all workspaces."""
    boxes = [agent.workspace for agent in problem.agents]
    return np.concatenate([box.low for box in boxes]), np.concatenate([box.high for box in boxes])


def start_box(problem: Problem) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return both corners (D,) of the box of starts; they are equal if the start is a point."""
    boxes = [agent.initial for agent in problem.agents]
    return np.concatenate([box.low for box in boxes]), np.concatenate([box.high for box in boxes])


def corner_starts(problem: Problem, most: int = 64, box: Box | None = None) -> NDArray[Any]:
    """Return corners (N, D) of a box (default: all workspaces), moved inwards by 1e-6 of its width.

    If the box has more than ``most`` corners, ``most`` of them are returned, evenly spread over a fixed order.
    """
    low, high = _checked_box(problem, box)
    inset = INSET * (high - low)
    # The bits of a corner's number say, axis by axis, which of both faces it is on.
    n = min(len(low), MOST_BITS)
    numbers = np.unique(np.linspace(0, 2**n - 1, min(most, 2**n)).astype(np.int64))
    chosen = (numbers[:, None] >> np.arange(len(low))[None, :] % MOST_BITS) & 1
    return np.where(chosen == 1, high - inset, low + inset)


def random_starts(problem: Problem, count: int, seed: int = 0, box: Box | None = None) -> NDArray[Any]:
    """Return uniform random states (count, D) of a box (default: all workspaces)."""
    low, high = _checked_box(problem, box)
    # The key lies beyond the numbers of chunks: starts and rollouts share no random numbers.
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(2**31,)))
    return np.asarray(low + (high - low) * rng.random((count, len(low))))


def slice_starts(
    problem: Problem, axes: Sequence[int], shape: Sequence[int], base: Any = None, box: Box | None = None
) -> NDArray[Any]:
    """Return a grid (prod(shape), D) of states that differ from ``base`` in one or two joint coordinates.

    Parameters
    ----------
    problem : Problem
    axes : sequence of int
        Which joint coordinates vary.
    shape : sequence of int
        Points per axis; they are the centres of so many equal parts.
    base : optional
        Joint state (D,) that gives the other coordinates; default: the middle of the problem's start.
    box : (low, high), optional
        Range (D,) of the axes; default: all workspaces.

    Raises
    ------
    ValueError
        If axes, base or box do not fit the problem.
    """
    low, high = _checked_box(problem, box)
    if len(axes) != len(shape) or not axes or any(not 0 <= axis < problem.n_states for axis in axes):
        raise ValueError(f"`axes`: expected joint coordinates from 0 to {problem.n_states - 1}, got {list(axes)}")
    middle = 0.5 * np.sum(start_box(problem), axis=0) if base is None else np.asarray(base, dtype=float)
    if middle.shape != (problem.n_states,):
        raise ValueError(f"`base`: expected a joint state of {problem.n_states} numbers, got shape {middle.shape}")
    # Centres of equal parts of each axis; every other coordinate stays at its value in `base`.
    lines = [low[a] + (high[a] - low[a]) * (np.arange(n) + 0.5) / n for a, n in zip(axes, shape, strict=True)]
    points = np.tile(middle, (int(np.prod(shape)), 1))
    for row, values in enumerate(itertools.product(*lines)):
        points[row, list(axes)] = values
    return points


def slice_axes(problem: Problem, axes: Sequence[int] | None) -> tuple[int, ...]:
    """Return the joint coordinates of a slice; default: the first coordinate of each of the first two agents.

    Raises
    ------
    ValueError
        If `axes` are not one or two different joint coordinates.
    """
    if axes is None:
        firsts = tuple(columns.start for columns in problem.columns[:2])
        return firsts if problem.n_agents > 1 else tuple(range(min(2, problem.n_states)))
    if not 1 <= len(axes) <= 2 or len(set(axes)) != len(axes) or not all(0 <= k < problem.n_states for k in axes):
        raise ValueError(
            f"`axes`: expected one or two different joint coordinates from 0 to {problem.n_states - 1}, got "
            f"{list(axes)}"
        )
    return tuple(int(k) for k in axes)


def neighbours(
    certificate: Certificate,
    states: NDArray[Any],
    rng: np.random.Generator,
) -> NDArray[Any]:
    """Return one neighbour of each state (N, D): one random coordinate is moved by up to two cells of its grid.

    Neighbours stay inside the workspaces.
    """
    low, high = workspace_box(certificate.problem)
    width = np.concatenate([2.0 * agent.grid.half_widths.max(axis=0) for agent in certificate.proof.agents])
    moved, rows = states.copy(), np.arange(len(states))
    axis = rng.integers(states.shape[1], size=len(states))
    moved[rows, axis] += 2.0 * width[axis] * rng.uniform(-1.0, 1.0, size=len(states))
    return np.clip(moved, low, high)


def _checked_box(problem: Problem, box: Box | None) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return both corners of a box (default: all workspaces) as arrays; raise ValueError if they do not fit."""
    if box is None:
        return workspace_box(problem)
    low, high = (np.asarray(corner, dtype=float) for corner in box)
    if low.shape != (problem.n_states,) or high.shape != low.shape or np.any(low > high):
        raise ValueError(
            f"`box`: expected corners low <= high of {problem.n_states} numbers each, got {low} and {high}"
        )
    return low, high
