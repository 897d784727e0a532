"""The relation ``linear``, once more, by code of the check's own: of matrices, of expressions, and of networks.

In a cell with centre c, under the input of a choice, the mean from x is ``z + G (x - c) + r`` with ``|r_k| <= rho_k``;
what is left of it is enclosed with the spans of ``step_intervals``, under every disturbance. On the lattice the
interpolant I of the values is known, so that its slopes and bends are differences of neighbouring numbers; the largest
ones around an image are taken, as far around as the certificate says, after it was seen that the image reaches no
farther. How far expected values are below I depends on the noise (docs/theory/linear.md, "One reading for all").
A target is one lattice point for all of a cell: its value is read, and nothing is lost.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....envs.systems.agents import AnyAgent, LinearAgent, with_expressions
from ...certificates.cell_probabilities import UNIT, AgentRecord, applied, normal_hats, state
from ...relations.grids import FloatArray, linear_agent
from .geometry import cell_boxes
from .map_enclosures import Maps, maps_of
from .mean_enclosures import Enclosed
from .network_enclosures import network_maps

ROUNDING = 2.999e-9
"""Share of the largest value that is taken off for rounding and lattices that are uneven by 1e-9 of a step."""

STRAIGHT, CROSSED = 1.40031, 0.46840
"""Half the L1 norms of ``phi''''`` and ``phi'' phi''``, rounded up."""

LOOK, BESIDE = 0.37, 1.63
"""What is added to a position, in lattice steps, before it is rounded down to where differences are read, and how far
it is off then, the next lattice point included. A half would leave it to rounding which point that is."""

LONGEST = 1e6
"""Deviations at which lattice steps are cut."""

NOTHING = 1e-50
"""Values below this count as 0: numbers without all their digits are slow to compute with."""


@dataclass(frozen=True, eq=False)
class MatrixMaps:
    """The same of matrices: one slope for all cells, and nothing but rounding is left.

    ``off`` (d,) is what means are off by in floating point; what is computed here is off by as little.
    """

    agent: LinearAgent
    part: AgentRecord
    off: FloatArray

    def at(self, numbers: NDArray[np.int64]) -> tuple[FloatArray, FloatArray, FloatArray]:
        """The maps with some numbers (C,)."""
        input_set, d = np.array(self.part.relation["menu"], dtype=float), len(self.off)
        cells, choices = np.divmod(numbers, len(input_set))
        low, high = cell_boxes(self.part)
        slope, pushed = self.agent.A, self.agent.offset + input_set @ self.agent.B.T
        z = (0.5 * (low + high))[cells] @ slope.T + pushed[choices]
        return z, np.broadcast_to(slope, (len(cells), d, d)), np.broadcast_to(2.0 * self.off, (len(cells), d))


@dataclass(frozen=True, eq=False)
class NetworkMaps:
    """The same under the modes of a network, made when they are asked for: every step asks for one mode.

    ``off`` (d,) is what means are off by in floating point besides the network.
    """

    agent: LinearAgent
    part: AgentRecord
    off: FloatArray

    def at(self, numbers: NDArray[np.int64]) -> tuple[FloatArray, FloatArray, FloatArray]:
        """The maps with some numbers (C,)."""
        cells, modes = np.divmod(numbers, len(self.part.relation["menu"]))
        d = len(self.off)
        z, gain, rho = np.zeros((len(cells), d)), np.zeros((len(cells), d, d)), np.zeros((len(cells), d))
        for mode in np.unique(modes).tolist():
            here = modes == mode
            z[here], gain[here], rho[here] = network_maps(self.agent, self.part, cells[here], mode)
        return z, gain, rho + self.off


@dataclass(frozen=True, eq=False)
class SymbolicTables:
    """What a step needs of one agent.

    ``masses`` are hat masses (Z_k, 2 S_k) of every axis, from below; ``slack`` is what is taken off per unit of the
    largest value.
    """

    masses: list[FloatArray]
    maps: Maps | MatrixMaps | NetworkMaps
    slack: float


def symbolic_tables(agent: AnyAgent, part: AgentRecord, off: FloatArray) -> SymbolicTables:
    """Compute the tables of one agent anew; ``off`` is as for ``NetworkMaps``.

    Raises
    ------
    ValueError
        If its noise has laws for which the relation does not hold.
    """
    deviations = np.sqrt(np.diag(agent.noise_covariance))
    if any(law.name != "gaussian" for law in agent.laws or ()):
        raise ValueError("linear cells are for Gaussian noise")
    masses, lost = [], 0.0
    lattice_spacing = np.array([(a[-1] - a[0]) / (len(a) - 1) for a in part.lattice])
    # Nothing is known between lattice points that are far apart: what is taken off is far above 1 as it is.
    ratios = np.minimum(lattice_spacing, LONGEST * deviations) / deviations
    for k, (edges, axis) in enumerate(zip(part.grid.edges, part.lattice, strict=True)):
        table, missing = normal_hats(axis, edges, float(deviations[k]))
        masses.append(table)
        lost += missing
    state("hats", agent, part, masses, lost)
    slack = ROUNDING * (1.0 + float(ratios.sum())) + lost
    for k in range(len(ratios)):
        # An eighth of: a twelfth of fourth derivatives, and an eighth of them along each axis between lattice points.
        r = float(ratios[k])
        slack += STRAIGHT * r**4 / 96.0
        slack += sum((STRAIGHT if e == k else CROSSED) * (r * float(ratios[e])) ** 2 / 64.0 for e in range(len(ratios)))
    maps: Maps | MatrixMaps | NetworkMaps
    if not agent.is_affine:
        maps = maps_of(with_expressions(agent), part, _asked(part))
    else:
        kind = NetworkMaps if "network" in part.relation else MatrixMaps
        maps = kind(linear_agent(agent, "linear"), part, off)
        if kind is MatrixMaps:
            # Maps are off by twice this; half of it is for controllers and simulators, which add up the same numbers.
            state_maps(linear_agent(agent, "linear"), part, maps.at, 0.5 * off)
    return SymbolicTables(masses, maps, slack)


def _asked(part: AgentRecord) -> NDArray[np.int64]:
    """Numbers (K,) ``cell * A + choice`` of the inputs that policies choose."""
    count = len(part.relation["menu"])
    cells = np.broadcast_to(np.arange(part.policy.shape[-1]), part.policy.shape)
    asked = (part.policy >= 0) & (part.policy < count)
    return np.unique(cells[asked] * np.int64(count) + part.policy[asked])


def state_maps(agent: LinearAgent, part: AgentRecord, at: Any, rho: FloatArray) -> None:
    """State that maps of matrices, as ``at`` gives them, are off by no more than rho (d,)."""
    input_set, numbers = np.array(part.relation["menu"], dtype=float), _asked(part)
    z, gain = at(numbers)[:2]
    cells, choices = np.divmod(numbers, len(input_set))
    spans = Enclosed(None, agent, input_set[choices], (z, gain))
    corners = tuple(corner[cells] for corner in cell_boxes(part))
    state("spans", spans, corners, [], tuple(np.broadcast_to(side * rho, z.shape) for side in (-1.0, 1.0)))


def written_values(part: AgentRecord, tables: SymbolicTables, factors: FloatArray) -> list[FloatArray]:
    """Values (n, Z_1, ..) of factors (n, places) on the lattice, from below, and largest differences around each point.

    Second differences of every axis that are positive, mixed ones of every pair of axes, and first ones of every axis;
    all without a sign.
    """
    d, shape = len(part.lattice), [len(axis) for axis in part.lattice]
    values = applied(factors, tables.masses).reshape(len(factors), *shape)
    values[values < NOTHING] = 0.0
    found = []
    for k in range(1, d + 1):
        found.append(_placed(np.maximum(np.diff(values, 2, axis=k), 0.0), values.shape, (k,), 1))
    for i, j in itertools.combinations(range(1, d + 1), 2):
        found.append(_placed(np.abs(np.diff(np.diff(values, axis=i), axis=j)), values.shape, (i, j), 0))
    for k in range(1, d + 1):
        found.append(_placed(np.abs(np.diff(values, axis=k)), values.shape, (k,), 0))
    return [values, *(_largest(table, part.relation["reach"], _blocks(part)) for table in found)]


def _placed(table: FloatArray, shape: tuple[int, ...], axes: tuple[int, ...], first: int) -> FloatArray:
    """Differences along some axes, the first of them standing at number ``first``; 0 where neighbours are missing."""
    result = np.zeros(shape)
    where = tuple(slice(first, first + n) if k in axes else slice(None) for k, n in enumerate(table.shape))
    result[where] = table
    return result


def _largest(table: FloatArray, reach: list[int], sizes: list[int]) -> FloatArray:
    """The largest of the numbers (n, Z_1, ..) around every block of points: of it, and of all blocks within reach."""
    # Blocks along all axes first: what is left is small.
    for axis, size in enumerate(sizes, start=1):
        count = table.shape[axis]
        blocks = _along(table, axis, slice(0, None, size)).copy()
        for k in range(1, min(size, count)):
            others = _along(table, axis, slice(k, None, size))
            front = _along(blocks, axis, slice(0, others.shape[axis]))
            np.maximum(front, others, out=front)
        table = blocks
    for axis, (radius, size) in enumerate(zip(reach, sizes, strict=True), start=1):
        around, count = -(-radius // size), table.shape[axis]
        wide = table.copy()
        for k in range(1, min(around, count - 1) + 1):
            for here, there in ((slice(0, -k), slice(k, None)), (slice(k, None), slice(0, -k))):
                front = _along(wide, axis, here)
                np.maximum(front, _along(table, axis, there), out=front)
        table = wide
    return table


def _along(table: FloatArray, axis: int, part: slice) -> FloatArray:
    """The view of a part along one axis."""
    return table[(slice(None),) * axis + (part,)]


def _blocks(part: AgentRecord) -> list[int]:
    """Lattice points of a block along each axis: any numbers will do, as long as all of them within reach are seen."""
    return part.relation.get("blocks") or [max(1, reach // 3) for reach in part.relation["reach"]]


def image_values(
    part: AgentRecord,
    tables: SymbolicTables,
    around: list[FloatArray],
    largest: FloatArray,
    cells: NDArray[np.int64],
    choices: NDArray[np.integer],
    share: FloatArray,
) -> tuple[FloatArray, FloatArray, NDArray[np.bool_]]:
    """Values (n, C, K) at the images of points ``share`` (K, d) of cells, what they may lack (n, C), and images inside.

    ``around`` is made by ``written_values``; ``largest`` (n,) are the largest numbers of the factors. The image of a
    target is one lattice point: its value is that of all its points, and lacks nothing.
    """
    targets = choices >= len(part.relation["menu"])
    at = np.zeros((len(largest), len(cells), len(share)))
    lacking, inside = np.zeros(at.shape[:2]), np.ones(len(cells), dtype=bool)
    points = choices[targets] - len(part.relation["menu"])
    at[:, targets] = around[0].reshape(len(largest), -1)[:, points][:, :, None]
    moving = np.flatnonzero(~targets)
    if len(moving):
        found = _moving_images(part, tables, around, largest, cells[moving], choices[moving], share)
        at[:, moving], lacking[:, moving], inside[moving] = found
    return at, lacking, inside


def _moving_images(
    part: AgentRecord,
    tables: SymbolicTables,
    around: list[FloatArray],
    largest: FloatArray,
    cells: NDArray[np.int64],
    choices: NDArray[np.integer],
    share: FloatArray,
) -> tuple[FloatArray, FloatArray, NDArray[np.bool_]]:
    """The same of inputs, whose means move with the state."""
    d, shape = len(part.lattice), around[0].shape[1:]
    z, gain, rho = tables.maps.at(cells * len(part.relation["menu"]) + choices)
    places = np.unravel_index(cells, part.grid.shape)
    half = 0.5 * np.stack([np.diff(edges)[k] for edges, k in zip(part.grid.edges, places, strict=True)], axis=1)
    first = np.array([axis[0] for axis in part.lattice])
    lattice_spacing = np.array([(axis[-1] - axis[0]) / (len(axis) - 1) for axis in part.lattice])
    position, rest = (z - first) / lattice_spacing, rho / lattice_spacing
    moved = gain * half[:, None, :] / lattice_spacing[:, None]  # along axis i for side k of the cell
    extent = np.abs(moved).sum(axis=2) + rest
    with np.errstate(invalid="ignore"):
        inside = np.all((position - extent >= 1.0) & (position + extent <= np.array(shape) - 2.0), axis=1)
        inside &= np.all(extent + BESIDE <= np.array(part.relation["reach"]), axis=1)
    position, moved, rest = (np.where(_like(inside, x), x, 1.0) for x in (position, moved, rest))
    moved[~inside] = 0.0
    at = _interpolated(around[0], [position[:, k, None] + moved[:, k] @ (2.0 * share.T - 1.0) for k in range(d)])
    steps = 2.0 * np.abs(moved) / int(part.relation["parts"])
    second_derivatives = np.where(steps < 1.0, steps / 4.0, (steps * steps + 1.0) / 8.0).sum(axis=2)
    weights = [second_derivatives[:, k] + 0.125 for k in range(d)]
    weights += [(steps[:, i] * steps[:, j]).sum(axis=1) / 4.0 for i, j in itertools.combinations(range(d), 2)]
    weights += [rest[:, k] for k in range(d)]
    sizes = np.array(_blocks(part))
    looked = tuple((np.floor(position + LOOK).astype(np.int64) // sizes).T)
    lacking = np.repeat(tables.slack * largest[:, None], len(cells), axis=1)
    for weight, table in zip(weights, around[1:], strict=True):
        lacking += weight * table[(slice(None), *looked)]
    return at, lacking * (1.0 + 4.0 * UNIT), inside


def _like(flags: NDArray[np.bool_], array: FloatArray) -> NDArray[np.bool_]:
    """Flags (C,) that broadcast to an array (C, ..)."""
    return flags.reshape(-1, *[1] * (array.ndim - 1))


def _interpolated(values: FloatArray, position: list[FloatArray]) -> FloatArray:
    """The multilinear interpolant (n, C, K) of numbers (n, Z_1, ..) at positions in lattice steps, (C, K) per axis."""
    shape, rows = values.shape[1:], values.reshape(len(values), -1)
    base = [np.minimum(np.maximum(np.floor(x), 0.0), n - 2.0) for x, n in zip(position, shape, strict=True)]
    share = [x - low for x, low in zip(position, base, strict=True)]
    first = np.ravel_multi_index(tuple(low.astype(np.int64) for low in base), shape)
    result = np.zeros((len(values), *first.shape))
    for corner in itertools.product((0, 1), repeat=len(shape)):
        weight = math.prod(own if side else 1.0 - own for own, side in zip(share, corner, strict=True))
        places = first + int(np.ravel_multi_index(corner, shape))
        for row, own in zip(result, rows, strict=True):
            row += weight * own.take(places, mode="clip")  # none is clipped, which takes less time
    return result
