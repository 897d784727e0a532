"""Edges of cells: narrow where noise is small and runs pass, along all axes in proportion to the noise, at faces."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from ....envs.systems.agents import TURN
from ...checker import CheckedProblem, plain_sum
from ...extended_check.vertex_grids import images_at
from ...relations.grids import FloatArray

SAMPLES, PIECES = 512, 400
"""Points at which the noise is looked at, and pieces of an axis."""

FEWEST = 4
"""Cells of an axis at least."""

OUTSIDE = 0.1
"""How dense cells are where no run came, as a share of how dense they are elsewhere."""

CORNERS = ("abs", "min", "max")
"""Functions that have a corner; ``clip`` is read as two of them."""

NEAREST = 0.35
"""Share of a cell from which an edge is moved to a face of a region."""


def spreads_of(problem: CheckedProblem) -> FloatArray:
    """Return the size of the noise (d, ``PIECES``) along each axis, in the middle of pieces of it (no bound).

    It is a mean over the other states and inputs, or what others bring to the state in a step, if that is more.
    """
    agent, rng = problem.agents[0], np.random.default_rng(20261127)
    (low, high), box, d = agent.state_box, agent.input_box, len(agent.states)
    states = rng.uniform(low[:, None], high[:, None], (d, SAMPLES))
    inputs = rng.uniform(box[0], box[1], (SAMPLES, len(agent.inputs)))
    result = np.empty((d, PIECES))
    for k in range(d):
        middles = low[k] + (high[k] - low[k]) * (np.arange(PIECES) + 0.5) / PIECES
        sizes = np.empty((d, PIECES))
        for p, x in enumerate(middles[:: PIECES // 40]):
            here = states[:, :64].copy()
            here[k] = x
            sizes[:, p] = np.nanmean(np.abs(images_at(agent, here, inputs[:64], 0)[0][d:]), axis=1)
        result[k] = np.repeat(sizes[k, :40], PIECES // 40)
    # What moves with others, in a step: differences of means along each axis, times the noise there.
    own = images_at(agent, states, inputs, 0)[0]
    brought = np.zeros(d)
    for j in range(d):
        step, moved = 1e-4 * (high[j] - low[j]), states.copy()
        moved[j] = np.minimum(moved[j] + step, high[j])
        slope = np.abs(images_at(agent, moved, inputs, 0)[0][:d] - own[:d]) / step
        brought += (np.arange(d) != j) * np.nan_to_num(np.median(slope, axis=1)) * np.nanmean(np.abs(own[d + j]))
    least = np.maximum(brought, 1e-3 * (high - low))[:, None]
    return np.maximum(np.nan_to_num(result), least)


def grid_of(
    problem: CheckedProblem,
    spreads: FloatArray,
    vertices: int,
    window: FloatArray,
    finer: FloatArray | float = 1.0,
) -> tuple[FloatArray, ...]:
    """Return edges of about so many vertices, most of them in a window (2, d), ``finer`` (d,) along some axes."""
    agent = problem.agents[0]
    (low, high), d = agent.state_box, len(agent.states)
    density = 1.0 / spreads
    for k in range(d):
        middles = low[k] + (high[k] - low[k]) * (np.arange(PIECES) + 0.5) / PIECES
        density[k] *= np.where((middles >= window[0, k]) & (middles <= window[1, k]), 1.0, OUTSIDE)
    # cells of an axis, one for each deviation
    lengths = finer * density.sum(axis=1) * (high - low) / PIECES
    counts = _counts(lengths, vertices)
    return tuple(_axis(problem, k, density[k], round(counts[k])) for k in range(d))


def moving_grid_of(
    problem: CheckedProblem,
    spreads: FloatArray,
    vertices: int,
    windows: FloatArray,
    finer: FloatArray | float = 1.0,
) -> tuple[FloatArray, ...]:
    """Return edges (T + 1, n + 1) of grids of about so many vertices, one in the window (2, d) of each time."""
    lengths = finer * np.mean((windows[:, 1] - windows[:, 0]) / spreads_in(problem, spreads, windows), axis=0)
    counts = _counts(lengths, vertices)
    result = []
    for k, count in enumerate(counts):
        shares = np.linspace(0.0, 1.0, round(count) + 1)
        edges = windows[:, 0, k, None] * (1.0 - shares) + windows[:, 1, k, None] * shares
        edges[:, -1] = windows[:, 1, k]
        _move_off(edges[0], *problem.agents[0].start[:, k])
        for t, axis in enumerate(edges):
            _move_to_faces(axis, [face for face in _faces(problem, k, t) if axis[0] < face < axis[-1]])
        result.append(edges)
    return tuple(result)


def spreads_in(problem: CheckedProblem, spreads: FloatArray, windows: FloatArray) -> FloatArray:
    """Return the size of the noise (T + 1, d) along each axis in the middle of windows (T + 1, 2, d)."""
    low, high = problem.agents[0].state_box
    # angles may be turns away
    place = np.floor((windows.mean(axis=1) - low) / (high - low) * PIECES).astype(int) % PIECES
    return np.stack([own[at] for own, at in zip(spreads, place.T, strict=True)], axis=-1)


def _move_off(axis: FloatArray, low: float, high: float) -> None:
    """Move an inner edge that lies at a start which is known up to rounding a quarter of a cell on."""
    if low < high:
        place = int(np.argmin(np.abs(axis - low)))
        if 0 < place < len(axis) - 1 and low - NEXT * (high - low) <= axis[place] <= high + NEXT * (high - low):
            axis[place] += 0.25 * (axis[place + 1] - axis[place])


def _move_to_faces(axis: FloatArray, faces: Sequence[float]) -> None:
    """Move the inner edge that is nearest to each face there, unless it lies at another one: their number stays."""
    taken = {0, len(axis) - 1}
    for face in faces:
        nearest = int(np.argmin(np.abs(axis - face)))
        if nearest not in taken:
            axis[nearest] = face
            taken.add(nearest)


def _counts(lengths: FloatArray, vertices: int) -> FloatArray:
    """Return numbers (d,) of cells, as many for each deviation along every axis, unless one has too few already."""
    d = len(lengths)
    counts, free = np.full(d, float(FEWEST)), list(range(d))
    while free:
        share = (vertices / np.prod(counts[[k for k in range(d) if k not in free]] + 1.0)) ** (1.0 / len(free))
        factor = share / np.prod(lengths[free]) ** (1.0 / len(free))
        few = [k for k in free if factor * lengths[k] < FEWEST]
        if not few:
            counts[free] = factor * lengths[free]
            break
        free = [k for k in free if k not in few]
    return counts


def _axis(problem: CheckedProblem, k: int, density: FloatArray, cells: int) -> FloatArray:
    """Return edges along axis k, with as much density in every cell, and edges at faces of regions."""
    agent = problem.agents[0]
    low, high = agent.state_box[:, k].tolist()
    grid = low + (high - low) * np.arange(PIECES + 1) / PIECES
    edges = np.interp(
        np.linspace(0.0, 1.0, cells + 1), np.concatenate([[0.0], np.cumsum(density)]) / density.sum(), grid
    )
    edges[0], edges[-1] = low, high
    faces = _faces(problem, k)
    for face in faces:
        width = np.interp(face, 0.5 * (edges[1:] + edges[:-1]), np.diff(edges))
        nearest = int(np.argmin(np.abs(edges - face)))
        is_free = 0 < nearest < len(edges) - 1 and edges[nearest] not in faces
        if is_free and abs(edges[nearest] - face) <= NEAREST * width:
            edges[nearest] = face
        elif np.abs(edges - face).min() > 0.0:
            edges = np.sort(np.append(edges, face))
    wide = np.concatenate([[True], np.diff(edges) > 1e-6 * (high - low)])
    edges = edges[wide]
    edges[-1] = high
    return edges


def _faces(problem: CheckedProblem, k: int, t: int | None = None) -> Sequence[float]:
    """Return the faces of regions across axis k that lie inside of the workspace, and where the dynamics have corners.

    They are those of a time, or of all times. A cell that has a corner inside is charged for it.
    """
    agent, times = problem.agents[0], slice(None) if t is None else slice(t, t + 1)
    faces = set[float]()
    for region in problem.regions:
        for column, output in enumerate(region.outputs[0]):
            if agent.outputs[output] == agent.states[k]:
                faces |= {*region.low[times, column].tolist(), *region.high[times, column].tolist()}
    if agent.states[k] in agent.angles:  # and copies of them
        faces = {at + TURN * n for at in faces for n in range(-MOST_TURNS, MOST_TURNS + 1)}
    corners = {at for tree in (*agent.dynamics, *agent.scale) for at in _corners(tree, agent.states[k])}
    low, high = agent.state_box[:, k].tolist()
    if agent.states[k] in agent.angles:
        low, high = -np.inf, np.inf
    inside = [sorted(at for at in own if low < at < high)[:MOST_FACES] for own in (faces, corners)]
    return sorted({*inside[0], *inside[1]})


def _corners(tree: Any, name: str) -> Iterator[float]:
    """Yield values of a state at which an expression has a corner (abs, min, max), whatever other states are."""
    if isinstance(tree, tuple):
        for argument in tree[1:]:
            yield from _corners(argument, name)
        if tree[0] in CORNERS:
            difference = tree[1] if tree[0] == "abs" else ("-", tree[1], tree[2])
            terms = plain_sum(difference) or ()
            if {own for _, own in terms if own} == {name}:
                factor = sum(f for f, own in terms if own)
                if factor:
                    yield -sum(f for f, own in terms if not own) / factor


NEXT = 100.0
"""Widths of what a start is known up to within which an edge lies at it."""

MOST_TURNS = 2
"""Turns to either side in which regions along an angle have copies that edges are moved to."""

MOST_FACES = 24
"""Faces of an axis that edges are moved to: regions that move have one for each time."""
