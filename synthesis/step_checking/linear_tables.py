"""Tables of the relation ``linear`` by code of the check's own: masses of hats, and how far images may bend.

What is computed is the same as in the search, to the last rounding, and in other words: unions from below take small
differences of factors, so that a stored factor can only be proved by what agrees with it (docs/theory/linear.md,
"Stored factors"). Second and fourth derivatives are differences of values at lattice points; what these miss is a
matter of higher derivatives, which are large only where a factor varies ("The loss").
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import erfc

from ...envs.agents import LinearAgent
from ..cells import FloatArray
from ..masses import AgentPart, grid_noise, state

HALF_NORMS = (1.40031, 0.60241, 0.46840)
"""Half the L1 norms of ``phi''''``, ``phi''' phi'`` and ``phi'' phi''``, rounded up in the fifth digit."""

HALF_SIXTH = (6.9078, 1.35533, 0.45336)
"""The same of sixth derivatives: all along one axis, two of them along another one, and two along each of three."""

NEAR, FAR, FAR_SIXTH = 4.5, 2.49e-3, 3.21e-2
"""Deviations within which a factor must vary for its high derivatives to be large, and the L1 norms of fourth and of
sixth derivatives of the density beyond them on one axis, rounded up."""

ENLARGED = 1e-6
"""Deviations by which the cells that are looked at reach farther, as they do in the search: an edge that lies where
they end must not decide."""

SECOND_HALF = 0.48395
"""Half the L1 norm of ``phi''``, rounded up."""

PRODUCTS = 9e-14
"""Share of the largest value by which a sum of products may be off."""

TOGETHER = 4
"""Neighbouring lattice points of an axis for which the variation is read at once."""

ASIDE = 1e-12
"""Share of a step that may lie beside an axis without it being one in another direction; ``ROUNDING`` covers it."""

ROUNDING = 3.99e-9
"""Share of the largest value that is taken off for rounding: derivatives, times the steps, are right to some 1e-13, and
points that count as lattice points are off by ``ON_LATTICE``, which moves values by less than half of that."""

ON_LATTICE = 4.00001e-9
"""Lattice steps within which a point counts as one of the lattice: a little more than for the search, so that no point
is read here with the bends of more neighbours."""

EVEN = 2.00001e-9
"""Lattice steps by which widths may differ for cells to count as equal, so that images lie on the lattice."""

LONGEST = 1e6
"""Standard deviations at which steps are cut: bends are far above 1 all the same."""

UNIT = 2.0**-53

FAINT = 1e-280
"""What is taken off every mass: numbers near the smallest double have few digits, and relative errors miss that."""


@dataclass(frozen=True, eq=False)
class LinearTables:
    """Hat masses (Z, 2 S) of every axis, from below, and what images bend.

    ``moves`` are the steps (K, d) between points that are read, in lattice steps, and ``shares`` theirs in what an
    image bends; ``between`` says whether points between those of the lattice are read, and paid for. ``fourth`` says
    what fourth differences along pairs of axes count for, if all steps lie along axes, and ``bounds`` how large they
    can be. Bends may be larger than differences say by ``slack`` times the largest value of a factor and ``vary`` times
    its variation in ``runs``, the cells around a point; ``around`` are the lattice steps from a point to all others of
    its part, and one more. ``most`` is what images can bend at most.
    """

    masses: list[FloatArray]
    moves: FloatArray
    shares: FloatArray
    fourth: dict[tuple[int, int], float]
    bounds: dict[tuple[int, int], float]
    most: float
    around: list[int]
    parts: int
    slack: float
    vary: float
    runs: list[tuple[NDArray[np.int64], NDArray[np.bool_], NDArray[np.int64]]]
    between: bool


def linear_tables(agent: LinearAgent, part: AgentPart) -> LinearTables:
    """Compute the tables of one agent anew."""
    deviations = np.sqrt(np.diag(grid_noise(agent.noise_covariance, part.coordinates)))
    targets = not len(part.relation["menu"])
    widths = [np.diff(edges) for edges in part.grid.edges]
    widest = np.array([float(w.max()) for w in widths])
    pitch = np.array([(axis[-1] - axis[0]) / (len(axis) - 1) for axis in part.lattice])
    per_cell = np.rint(widest / pitch)
    even = all(float(np.ptp(w)) <= EVEN * step for w, step in zip(widths, pitch.tolist(), strict=True))
    parts = int(part.relation["parts"])
    aligned = bool(targets and even and np.all((per_cell % 2 == 0) & (per_cell % parts == 0)))
    gain = np.eye(len(widest)) if targets else grid_matrix(agent, part)
    steps = (gain * widest).T / parts
    if not aligned:
        steps = np.concatenate([steps, np.diag(pitch)])
    sizes = np.minimum(np.abs(steps / deviations), LONGEST)
    moves = np.where(sizes > ASIDE * sizes.max(axis=1, keepdims=True), steps / pitch, 0.0)
    straight = bool(np.all(np.count_nonzero(moves, axis=1) <= 1))
    around = np.ceil(np.abs(steps).sum(axis=0) / pitch - 1e-6) + 1.0
    step = np.minimum(pitch / deviations, LONGEST)
    fourth = _fourth_shares(np.sum(moves**2, axis=0)) if straight else {}
    bounds = {(i, j): HALF_NORMS[0 if i == j else 2] * float(step[i] * step[j]) ** 2 for i, j in fourth}
    vary, beyond = _sixth(fourth, step) if straight else _fourth_slack(np.sign(moves) * sizes, step)
    lengths = np.sum(sizes**2, axis=1)
    shares = lengths / lengths.sum()
    masses, lost = [], 0.0
    for edges, axis, deviation in zip(part.grid.edges, part.lattice, deviations.tolist(), strict=True):
        table, missing = normal_hats(axis, edges, deviation)
        masses.append(table)
        lost += missing
    state("hats", agent, part, masses, lost)
    count = sum(float(np.sum(np.abs(move)) ** 2) / share for move, share in zip(moves, shares, strict=True) if share)
    count = 0.5 * count + 16.0 * sum(fourth.values())
    slack = ROUNDING * (2.0 + float(np.sum(step))) + len(deviations) * beyond + count * (lost + PRODUCTS)
    reach = (NEAR + ENLARGED) * deviations + (around + 2.0) * pitch
    runs = [_runs(*axis) for axis in zip(part.lattice, part.grid.edges, reach.tolist(), strict=True)]
    most, near = SECOND_HALF * float(lengths.sum()) / 8.0, around.astype(int).tolist()
    return LinearTables(masses, moves, shares, fourth, bounds, most, near, parts, slack, vary, runs, not aligned)


def grid_matrix(agent: LinearAgent, part: AgentPart) -> FloatArray:
    """``A`` in grid coordinates."""
    return np.asarray(np.linalg.solve(part.coordinates, agent.A @ part.coordinates))


def normal_hats(axis: FloatArray, edges: FloatArray, sigma: float) -> tuple[FloatArray, float]:
    """Masses (Z, 2 S) of both hats of every cell around every lattice point, from below, and what rows lack at most."""
    t = (edges - axis[:, None]) / sigma
    width = np.diff(edges) / sigma
    phi = np.exp(-0.5 * t**2) * (1.0 / math.sqrt(2.0 * math.pi))
    above = 0.5 * erfc(t / math.sqrt(2.0))  # P(y > edge)
    below = 0.5 * erfc(-t / math.sqrt(2.0))
    a, b = t[:, :-1], t[:, 1:]
    mass = np.where(a + b > 0, above[:, :-1] - above[:, 1:], below[:, 1:] - below[:, :-1])
    first = phi[:, :-1] - phi[:, 1:] - a * mass  # E (y - left end)^+ inside the cell, in deviations
    # Errors of densities and tails at both edges, each on the side where it is small; then of what is made of them.
    density, tail = (40.0 + 6.0 * t**2) * phi, (30.0 + 8.0 * t**2) * np.minimum(above, below)
    of_mass = tail[:, :-1] + tail[:, 1:] + 4.0 * mass
    of_first = density[:, :-1] + density[:, 1:] + (1.0 + np.abs(a)) * of_mass
    off_right = UNIT * (of_first / width + 4.0 * mass) + FAINT
    off_left = UNIT * (of_first / width + of_mass + 8.0 * mass) + FAINT
    right = np.maximum(first / width - off_right, 0.0)
    left = np.maximum(mass - first / width - off_left, 0.0)
    # Errors are on either side of the truth: a number may lack twice of what is taken off.
    lost = 2.0 * float(np.max(np.sum(off_left + off_right, axis=1)))
    return np.stack((left, right), axis=-1).reshape(len(axis), -1), lost


def _fourth_shares(squares: FloatArray) -> dict[tuple[int, int], float]:
    """What fourth differences along pairs of axes count for, given squared lattice steps (d,) along each."""
    shares = {}
    for i, j in itertools.combinations_with_replacement(range(len(squares)), 2):
        if squares[i] * squares[j] > 0.0:
            shares[i, j] = float(squares[i] * squares[j]) / (64.0 if i == j else 32.0)
            # A second difference is a mean of second derivatives around a point.
            shares[i, j] += float(squares[i]) / 96.0 if i == j else 0.0
    return shares


def _sixth(fourth: dict[tuple[int, int], float], step: FloatArray) -> tuple[float, float]:
    """What fourth differences may miss: times the variation, and times the largest value. Steps in deviations."""
    inside = beyond = 0.0
    for (i, j), share in fourth.items():
        size = share * float(step[i] ** 2 * step[j] ** 2)
        for k in range(len(step)):
            # As means around their point they miss 1/12 for each second difference, and 1/8 between lattice points.
            missed = size * float(step[k] ** 2) * (((k == i) + (k == j)) / 12.0 + 0.125)
            inside += missed * HALF_SIXTH[len({i, j, k}) - 1]
            beyond += missed * FAR_SIXTH
    return inside, beyond


def _fourth_slack(steps: FloatArray, step: FloatArray) -> tuple[float, float]:
    """The same where only second differences are formed, for steps (K, d) in any direction, all in deviations."""
    inside = sum(_fourth(u, e) for u in steps for e in steps) / 64.0
    beyond = FAR / 64.0 * float(sum(np.abs(u).sum() ** 2 for u in steps)) ** 2
    for u in steps:
        straight = float(np.dot(u**2, step**2)) / 12.0
        mixed = sum(
            2.0 * abs(u[i] * u[j]) * (step[i] ** 2 + step[j] ** 2) / 6.0
            for i, j in itertools.combinations(range(len(u)), 2)
        )
        inside += (HALF_NORMS[0] * straight + HALF_NORMS[1] * float(mixed)) / 8.0
        beyond += FAR * (straight + float(mixed)) / 8.0
    return float(inside), float(beyond)


def _runs(
    axis: FloatArray, edges: FloatArray, reach: float
) -> tuple[NDArray[np.int64], NDArray[np.bool_], NDArray[np.int64]]:
    """Ends (2 G,) of runs of numbers around groups of lattice points, which leave the grid, and the group of each."""
    groups = np.array_split(axis, range(TOGETHER, len(axis), TOGETHER))
    low, high = np.array([g[0] for g in groups]) - reach, np.array([g[-1] for g in groups]) + reach
    # Cell s is [edge s, edge s + 1]; it counts if the run meets its inside.
    begin = np.minimum(np.sum(edges[1:-1, None] <= low, axis=0), len(edges) - 2)
    end = np.maximum(np.sum(edges[:-1, None] < high, axis=0), begin + 1)
    outside = (low < edges[0]) | (high > edges[-1])
    return np.stack([2 * begin, 2 * end], axis=1).ravel(), outside, np.arange(len(axis)) // TOGETHER


def variation(factors: FloatArray, tables: LinearTables) -> FloatArray:
    """How much factors (n, places) vary around every lattice point: (n, Z_1, ...)."""
    shape = [table.shape[1] for table in tables.masses]
    top = bottom = factors.reshape(len(factors), *shape)
    for k, (ends, outside, _) in enumerate(tables.runs):
        top, bottom = np.moveaxis(top, k + 1, -1), np.moveaxis(bottom, k + 1, -1)
        spare = [(0, 0)] * (top.ndim - 1) + [(0, 1)]  # a run may end behind the last number
        top = np.maximum.reduceat(np.pad(top, spare), ends, axis=-1)[..., ::2]
        bottom = np.where(outside, 0.0, np.minimum.reduceat(np.pad(bottom, spare), ends, axis=-1)[..., ::2])
        top, bottom = np.moveaxis(top, -1, k + 1), np.moveaxis(bottom, -1, k + 1)
    groups = np.ix_(np.arange(len(factors)), *(group for *_, group in tables.runs))
    return np.asarray((top - bottom)[groups])


def _fourth(u: FloatArray, e: FloatArray) -> float:
    """Bound on ``|e|^2 |u|^2 d_e^2 d_u^2`` of a smoothed factor of at most 1, in deviations."""
    size = math.hypot(*e.tolist())
    if size == 0.0:
        return 0.0
    along = abs(float(np.dot(u, e))) / size
    # The areas that u and e span in each plane; nothing large is subtracted. Rounded up.
    areas = [u[i] * e[j] - u[j] * e[i] for i, j in itertools.combinations(range(len(u)), 2)]
    across = math.hypot(*areas) / size + 1e-14 * math.hypot(*u.tolist())
    straight, mixed, square = HALF_NORMS
    return size * size * (straight * along * along + 2.0 * mixed * along * across + square * across * across)


def applied(factors: FloatArray, tables: list[FloatArray]) -> FloatArray:
    """Factors (n, places) summed against one table per axis: (n, Z)."""
    tensor = factors.reshape(len(factors), *(table.shape[1] for table in tables))
    for k, table in enumerate(tables):
        tensor = np.moveaxis(np.tensordot(tensor, table, axes=(k + 1, 1)), -1, k + 1)
    return tensor.reshape(len(factors), -1)


def values_and_bends(tables: LinearTables, factors: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Values (n, Z) of factors (n, places) at the lattice, from below, and from above how far images bend."""
    values, shape = applied(factors, tables.masses), [len(mass) for mass in tables.masses]
    d, tensor = len(shape), values.reshape(len(values), *shape)
    bends, largest = np.zeros_like(tensor), factors.max(axis=1, initial=0.0).reshape(-1, *(1,) * d)
    pairs = list(itertools.combinations_with_replacement(range(d), 2))
    seconds = {(i, j): _difference(tensor, i, j) for i, j in pairs if np.any(tables.moves[:, i] * tables.moves[:, j])}
    # Each direction bends most at a point of its own: with shares that sum to 1, the largest s_k / share_k over points
    # and directions is at least the sum of the largest s_k.
    for u, share in zip(tables.moves, tables.shares, strict=True):
        if share > 0.0:
            along = sum((1.0 + (i != j)) * u[i] * u[j] * second for (i, j), second in seconds.items())
            bends = np.maximum(bends, along / (8.0 * share))
    # Two points from the border differences are not known.
    known = np.zeros(shape, dtype=bool)
    known[(slice(2, -2),) * d] = True
    bends = np.where(known, bends, tables.most * largest)
    for (i, j), share in tables.fourth.items():
        negative = np.maximum(-_difference(seconds[i, i], j, j), 0.0)
        negative = np.where(known, negative, tables.bounds[i, j] * largest)
        bends += share * _largest_around(negative, tables.around)
    bends += tables.slack * largest + tables.vary * variation(factors, tables)
    return values, bends.reshape(values.shape)


def _difference(tensor: FloatArray, i: int, j: int) -> FloatArray:
    """Second differences of numbers (n, Z_1, ...) along axes i and j; wrong at the border."""
    up, down = np.roll(tensor, -1, axis=i + 1), np.roll(tensor, 1, axis=i + 1)
    if i == j:
        return up + down - 2.0 * tensor
    straight = np.roll(up, -1, axis=j + 1) + np.roll(down, 1, axis=j + 1)
    return 0.25 * (straight - np.roll(up, 1, axis=j + 1) - np.roll(down, -1, axis=j + 1))


def _largest_around(tensor: FloatArray, around: list[int]) -> FloatArray:
    """The largest of the numbers (n, Z_1, ...) within some lattice steps of every point."""
    for axis, reach in enumerate(around, start=1):
        ends = [(reach, reach) if k == axis else (0, 0) for k in range(tensor.ndim)]
        padded, size = np.pad(tensor, ends, mode="edge"), tensor.shape[axis]
        moved = [np.take(padded, np.arange(step, step + size), axis=axis) for step in range(2 * reach + 1)]
        tensor = np.maximum.reduce(moved)
    return tensor
