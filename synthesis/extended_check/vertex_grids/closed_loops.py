"""Closed loops on grids whose vertices have inputs: where cells lead, how large their noise is, how fast both bend.

Inside a cell the input u(x) is the multilinear interpolation of those of its vertices, so no input leaves its box. A
step leads to the *image* y(x): the means of the next state, and the size of the noise of each.

**Theorem.** (a) At a point y is within ``rho`` of ``centre``, however inputs are rounded and whatever disturbances do
that are not given. Points are vertices, or vertices beside numbers of disturbances (``disturbances``). (b) On a cell y
lies between ``ends``, and along axis k, for any fixed disturbance and rounding, its first and second derivatives, times
the side of the cell and its square, are at most ``slopes[k]`` and ``bends[k]`` in size. (c) Where a component of y has
kinks (abs, min, max), (b) holds for the multilinear interpolation of its corners instead, and it is within ``off`` of
that.

*Proof.* Along axis k, u is linear: its slope is between those of the 2^(d-1) edges along that axis, and its second
derivative is 0. So jets with the one direction k enclose y and both derivatives (``jets``). For (b) every point of a
cell is reached from each corner along one axis after the other, so that all of these ranges hold, too. For (c) let
difference quotients along an axis be in [l, u]: at the share s of the way a function is at most ``g(0) + u s`` and
``g(1) - l (1 - s)``, so at most ``(u - l) s (1 - s)`` above its chord, and as little below. Interpolating along one
axis after the other adds up ``(u - l) / 4``, or an eighth of second derivatives, and leaves the slopes of edges. QED
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace

import numpy as np

from ...checker.angles import OFF
from ...checker.expressions import names_in
from ...checker.intervals import add, down, interval, mul, neg, up
from ...checker.jets import Jet, Memory, jet
from ...checker.motions import cell_boxes
from ...checker.problem import Agent
from ...checker.rigorous import Array, U

INPUT_OFF = 1e-9  # of the size of an input: by how much controllers may differ from the interpolation of vertices


@dataclass(frozen=True, eq=False)
class ClosedLoop:
    """Images, means first and sizes after.

    ``centre`` and ``rho`` (2 d, V) are of points; of cells between them ``ends`` (2, 2 d, S) and ``off`` (2 d, S), and
    along each of n axes ends of ``slopes`` (n, 2, 2 d, S), and sizes of ``bends`` (n, 2 d, S). Points are arranged as
    ``points``, whose first n axes are those of cells: vertices of a grid, or what is next to each of them.
    """

    centre: Array
    rho: Array
    ends: Array
    slopes: Array
    bends: Array
    off: Array
    points: tuple[int, ...]

    def over(self, units: Array) -> ClosedLoop:
        """Return the same in units (d,) of each axis, powers of 2."""
        both = np.tile(units, 2)[:, None]
        names = ("centre", "rho", "ends", "slopes", "bends", "off")
        return replace(self, **{name: getattr(self, name) / both for name in names})

    @property
    def cells(self) -> tuple[int, ...]:
        """How cells are arranged."""
        n = len(self.slopes)
        return (*(count - 1 for count in self.points[:n]), *self.points[n:])

    def at_corners(self, numbers: Array) -> Array:
        """Return numbers (S, 2^n) at the corners of cells, from those of points (V,)."""
        return corners_of(numbers.reshape(self.points), len(self.slopes)).reshape(self.ends.shape[2], -1)


def corners_of(values: Array, d: int) -> Array:
    """Return numbers (.., 2, .., 2) at the corners of all cells along the first d axes of a table (n_1 + 1, ..)."""
    for k in range(d):
        ends = (np.take(values, range(side, values.shape[k] - 1 + side), axis=k) for side in (0, 1))
        values = np.stack([*ends], axis=-1)
    return values


def vertices_of(edges: tuple[Array, ...]) -> Array:
    """Return the vertices (d, V) of a grid, the last axis running fastest."""
    return np.stack(np.meshgrid(*edges, indexing="ij")).reshape(len(edges), -1)


def closed_loop(agent: Agent, edges: tuple[Array, ...], inputs: Array, t: int) -> ClosedLoop:
    """Return the closed loop of a time, for inputs (V, m) at the vertices of a grid; what is unknown is nan."""
    d, shape = len(edges), tuple(len(axis) for axis in edges)
    off = INPUT_OFF * np.abs(agent.input_box).max(axis=0)
    centre, rho = images_at(agent, vertices_of(edges), inputs, t)
    # On cells, along one axis after the other: states have the slope 1 on it, inputs those of edges.
    low, high = (corner.T for corner in cell_boxes(edges))
    corners = np.stack([corners_of(own.reshape(shape), d).reshape(-1, *(2,) * d) for own in inputs.T])
    flat = corners.reshape(*corners.shape[:2], -1)
    wide = np.stack([down(flat.min(axis=2) - off[:, None]), up(flat.max(axis=2) + off[:, None])])
    ways = []
    for k in range(d):
        change = np.diff(corners, axis=2 + k).reshape(*corners.shape[:2], -1)
        moves = np.zeros((2, d + len(off) + len(agent.disturbances), 1, low.shape[1]))
        moves[:, k, 0] = down(high[k] - low[k]), up(high[k] - low[k])
        moves[:, d : d + len(off), 0] = down(change.min(axis=2)), up(change.max(axis=2))
        ways.append(moves)
    ranges = np.concatenate([np.stack([low, high]), wide, unknown_of(agent, low.shape[1])], axis=1)
    return enclosed(agent, (centre, rho), shape, ranges, ways, t)


def enclosed(
    agent: Agent, images: tuple[Array, Array], points: tuple[int, ...], ranges: Array, ways: list[Array], t: int
) -> ClosedLoop:
    """Return the closed loop of ``images`` of points, and of cells between them, which move along n ``ways``.

    States, inputs and disturbances of cells have ``ranges``.
    """
    (centre, rho), slopes, bends = images, list[Array](), list[Array]()
    for moves in ways:
        on_cells, slope, bend = _image(agent, ranges, moves, t)
        slopes.append(slope[:, :, 0])
        bends.append(np.abs(bend[:, :, 0, 0]).max(axis=0))
    loop = ClosedLoop(centre, rho, on_cells, np.stack(slopes), np.stack(bends), np.zeros(0), points)
    # From every corner as far as slopes lead: tighter where what acts on a state cancels.
    least, most = (np.stack([loop.at_corners(own) for own in end]) for end in (down(centre - rho), up(centre + rho)))
    for v, corner in enumerate(itertools.product((0, 1), repeat=len(ways))):
        reached = np.stack([least[..., v], most[..., v]])
        for slope, side in zip(slopes, corner, strict=True):
            way = neg(slope) if side else slope
            reached = add(reached, np.stack([np.minimum(way[0], 0.0), np.maximum(way[1], 0.0)]))
        on_cells = np.stack([np.maximum(on_cells[0], reached[0]), np.minimum(on_cells[1], reached[1])])
    rates, curves, off_chords = _across_kinks(loop)
    return replace(loop, ends=on_cells, slopes=rates, bends=curves, off=off_chords)


def _across_kinks(loop: ClosedLoop) -> tuple[Array, Array, Array]:
    """Return slopes, bends and ``off`` where components with kinks are interpolated from corners, by part (c)."""
    slopes, bends, n = loop.slopes, loop.bends, len(loop.slopes)
    wide = up(slopes[:, 1] - slopes[:, 0])
    kinked = np.any(np.isnan(bends), axis=0) & np.all(np.isfinite(wide), axis=0)
    if not kinked.any():
        return slopes, bends, np.zeros(kinked.shape)
    along = up(np.fmin(0.25 * wide, up(0.125 * bends)))
    off = np.where(kinked, along.sum(axis=0) * (1.0 + n * U), 0.0)
    slopes, values, errors = (
        slopes.copy(),
        *(
            np.stack([loop.at_corners(own).reshape(-1, *(2,) * n) for own in table])
            for table in (loop.centre, loop.rho)
        ),
    )
    for k in range(n):
        # what edges rise by, for the same disturbance and rounding at both ends
        (first, last), (before, after) = (np.moveaxis(own, 2 + k, 0) for own in (values, errors))
        less = up(before + after)
        low, high = (own.reshape(*kinked.shape, -1) for own in (down(last - first), up(last - first)))
        less = less.reshape(*kinked.shape, -1)
        edges = down(low - less).min(axis=2), up(high + less).max(axis=2)
        slopes[k, 0] = np.where(kinked, np.fmax(slopes[k, 0], edges[0]), slopes[k, 0])
        slopes[k, 1] = np.where(kinked, np.fmin(slopes[k, 1], edges[1]), slopes[k, 1])
    return slopes, np.where(kinked, 0.0, bends), off


def unknown_of(agent: Agent, n: int) -> Array:
    """Return the intervals of disturbances (2, k, n), as many times as there are points."""
    ends = np.array(list(agent.disturbances.values()), dtype=float).reshape(-1, 2)
    return np.repeat(ends.T[:, :, None], n, axis=2)


def images_at(agent: Agent, states: Array, inputs: Array, t: int, unknown: Array | None = None) -> tuple[Array, Array]:
    """Return centre and rho (2 d, n) of the images of points (d, n) under inputs (n, m): nothing moves there.

    Disturbances are numbers ``unknown`` (k, n), or anywhere in their intervals (None).
    """
    off = INPUT_OFF * np.abs(agent.input_box).max(axis=0)
    given = np.stack([down(inputs - off), up(inputs + off)]).transpose(0, 2, 1)
    acting = unknown_of(agent, states.shape[1]) if unknown is None else interval(unknown)
    ranges = np.concatenate([interval(states), given, acting], axis=1)
    # no direction at all: values alone
    ends = _image(agent, ranges, np.zeros((2, ranges.shape[1], 0, states.shape[1])), t)[0]
    centre = 0.5 * ends[0] + 0.5 * ends[1]
    return centre, np.maximum(up(ends[1] - centre), up(centre - ends[0]))


def _image(agent: Agent, ranges: Array, moves: Array, t: int) -> tuple[Array, Array, Array]:
    """Return ends of images (2, 2 d, n), of slopes (2, 2 d, v, n) and second derivatives (2, 2 d, v, v, n).

    States, inputs and disturbances have ``ranges`` (2, d + m + k, n), and move by ``moves`` (2, d + m + k, v, n) along
    v directions.
    """
    v, n = moves.shape[2:]
    flat = np.zeros((2, v, v, n))
    names = (*agent.states, *agent.inputs, *agent.disturbances)
    if agent.angles:  # whole turns are rounded
        off = OFF * np.array([name in agent.angles for name in names])[:, None]
        ranges = np.stack([down(ranges[0] - off), up(ranges[1] + off)])
    leaves = {name: Jet(ranges[:, k], moves[:, k], flat) for k, name in enumerate(names)}
    leaves.setdefault("t", Jet.variable(np.full((2, n), float(t)), np.zeros((v, n))))
    # The size of each component is its deviation, times its scale.
    memory: Memory = {}
    made = [jet(tree, leaves, memory) for tree in (*agent.dynamics, *agent.scale)]
    none = np.zeros((2, n)), np.zeros((2, v, n)), flat
    parts = [(own.value + none[0], own.slope + none[1], own.bend + none[2]) for own in made]
    # One source of noise at most moves each state (``Backups``).
    sources = np.array([envelope.deviation for envelope in agent.envelopes])
    deviations = mul(interval(np.abs(agent.noise)), interval(sources)).sum(axis=2)
    each = [interval(np.full(n, least), np.full(n, most)) for least, most in deviations.T]
    if not agent.scale:
        parts += [(deviation, *none[1:]) for deviation in each]
    else:
        sized = zip(each, parts[len(each) :], strict=True)
        parts[len(each) :] = [(mul(s, a), mul(s[:, None], b), mul(s[:, None, None], c)) for s, (a, b, c) in sized]
    value, slope, bend = (np.stack(each, axis=1) for each in zip(*parts, strict=True))
    return value, slope, bend


def names_time(agent: Agent) -> bool:
    """Return whether dynamics or scales of an agent name the time."""
    own = {*agent.states, *agent.inputs, *agent.disturbances}
    return "t" in names_in((*agent.dynamics, *agent.scale)) - own
