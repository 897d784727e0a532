"""Relation, lattice, kernel and choices of an agent under the relation ``linear``."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ....envs.systems.agents import AnyAgent
from ....envs.systems.distributions import Gaussian, Law
from ...relations.grids import FEWER, FloatArray, Grid, RelationRefused, grid_laws
from ...relations.kinds import AffineBoxes, MapRelation, map_relation
from ..kernels import BESIDE, LatticeKernel, MultilinearKernel, box_lattice, lattice_kernel_of
from .agent_models import reaches_every_mean
from .box_model import clock_input_set, with_rest
from .corner_choices import HANDICAP, HANDICAP_IN_TEAMS, CornerChoices

POINTS_PER_DEVIATION = {1: 12.0, 2: 8.0}
"""Lattice points per deviation of normal noise, at least, by dimension: the slack is then 1e-5 per axis and step."""

FEWER_PER_DEVIATION = 4.0
"""The same beyond: a slack of 1e-4."""

POINTS_PER_CELL = {1: 8, 2: 4, 3: 2}
"""Lattice points per cell and axis, at least, by dimension (2 beyond)."""

TARGETS_PER_CELL = {1: (32, 16), 2: (8, 4), 3: (4, 2)}
"""Lattice points per cell and axis where targets are chosen, by dimension (2 beyond): of wide cells, and of others."""

WIDE = 1.25
"""Deviations of the noise from which cells are wide."""

MOST_PER_CELL = {1: 64, 2: 16, 3: 4}
"""The same, at most."""

MOST_LATTICE = 8_000_000
"""Most lattice points of an agent: 64 MB for each of some ten columns of a factor."""

MOST_MASSES = 2**25
"""Most masses of cells around the lattice points of one axis, which the check holds at once: 270 MB."""

MOST_MAPS = 10_000_000
"""Most maps of an agent, cells times choices: 1 GB in three dimensions."""

PARTS = {1: 8, 2: 4, 3: 2}
"""Parts of each side of an image at most, by dimension (2 beyond): as many as lattice steps, if there are as few."""

CUTS = {1: 4, 2: 2, 3: 2}
"""Parts into which cells are cut along each axis to enclose what maps leave, by dimension (1 beyond): with two, slopes
of what is left have a sign in each part as a rule, and enclosures are next to exact."""

LEVELS_BESIDE_TARGETS = {1: 9, 2: 5, 3: 3}
"""Levels of each input beside targets, by the number of inputs; 2 beyond."""

LEVELS_ALONE = {1: 33, 2: 7, 3: 4}
"""Levels of each input where there are no targets, by the number of inputs; 3 beyond."""

MOST_REACH = 1000.0
"""Most lattice steps from the middle of an image to its ends: wider ones are worth nothing."""

CELLS_AT_ONCE = 4096
"""Cells whose maps are made at once."""


def corner_model(
    agent: AnyAgent, grid: Grid, per_cell: int | None = None, alone: bool = True
) -> tuple[MapRelation, tuple[FloatArray, ...], LatticeKernel, CornerChoices]:
    """Return relation, lattice, kernel and choices of an agent under the relation ``linear``.

    Agents whose inputs reach every mean choose among targets and a few inputs; all others among more inputs. ``alone``
    says that it has no team.

    Raises
    ------
    RelationRefused
        If its noise has laws for which nothing is known between lattice points, or there are too many maps or points.
    """
    numbers = 1, CUTS.get(agent.n_states, 1), (0,) * agent.n_states
    if agent.has_clock:
        input_set = clock_input_set(agent, LEVELS_ALONE)
        relation, lattice, kernel, choices = lattice_model(
            agent, grid, map_relation(agent, input_set, numbers), per_cell
        )
        return relation, lattice, kernel, replace(choices, n_times=int(agent.input_high[-1]) + 1)
    if reaches_every_mean(agent):
        input_set = with_rest(agent.input_box, LEVELS_BESIDE_TARGETS.get(agent.n_inputs, 2))
        relation = map_relation(agent, input_set, numbers, with_aims=True)
    else:
        input_set = with_rest(agent.input_box, LEVELS_ALONE.get(agent.n_inputs, 3))
        relation = map_relation(agent, input_set, numbers)
    relation, lattice, kernel, choices = lattice_model(agent, grid, relation, per_cell)
    return relation, lattice, kernel, replace(choices, handicap=HANDICAP if alone else HANDICAP_IN_TEAMS)


def lattice_model(
    agent: AnyAgent, grid: Grid, relation: MapRelation, per_cell: int | None
) -> tuple[MapRelation, tuple[FloatArray, ...], LatticeKernel, CornerChoices]:
    """Return a relation of affine maps with the parts and the reach that suit its maps, and what goes with it.

    Raises
    ------
    RelationRefused
        As for ``corner_model``.
    """
    laws, d = grid_laws(agent), agent.n_states
    _refuse_laws(agent, laws)
    if relation.mean_targets is not None and per_cell is None:
        points = _points_beside_targets(grid, laws)
    else:
        points = _points_per_cell(grid, laws, per_cell)
    if per_cell is None:
        points = tuple(min(k, max(2, MOST_MASSES // (2 * n * n))) for k, n in zip(points, grid.shape, strict=True))
    n_maps = grid.n_cells * len(relation.input_set)
    count = math.prod(n * k for n, k in zip(grid.shape, points, strict=True))
    if n_maps > MOST_MAPS or count > MOST_LATTICE:
        raise RelationRefused(
            f"agent `{agent.name}`: the relation `linear` needs at most {MOST_MAPS} maps and {MOST_LATTICE} lattice "
            f"points, got {n_maps} and {count}{FEWER}"
        )
    maps = _maps(relation, grid)
    half = np.einsum("sakj,sj->sak", np.abs(maps.gain), grid.half_widths)
    low, high = (_end(maps.centre, half + maps.rest, sign) for sign in (-1.0, 1.0))
    lattice = box_lattice(grid, np.array([law.std for law in laws]), points, low, high)
    lattice_spacing = np.array([(axis[-1] - axis[0]) / (len(axis) - 1) for axis in lattice])
    # How far images reach, and their sides: those few that are far wider than all others would blur what is read.
    reach = tuple(int(n) for n in np.ceil(_most_of((half + maps.rest) / lattice_spacing, 0.999) + BESIDE))
    steps = 2.0 * float(np.max(_most_of(half / lattice_spacing, 0.9)))
    relation = replace(relation, parts=int(np.clip(round(steps), 2, PARTS.get(d, 2))), reach=reach)
    kernel = lattice_kernel_of(grid, lattice, laws, reach)
    multilinear = MultilinearKernel(lattice, reach, parts=relation.parts)
    return relation, lattice, kernel, CornerChoices(grid, lattice, relation, max(points), maps, multilinear)


def _refuse_laws(agent: AnyAgent, laws: Sequence[Law]) -> None:
    """Refuse noise of which nothing is known between lattice points."""
    if not all(isinstance(law, Gaussian) for law in laws):
        raise RelationRefused(
            f"agent `{agent.name}`: the relation `linear` is for Gaussian noise, got other laws; ask for `boxes`"
        )


def _most_of(numbers: FloatArray, share: float) -> FloatArray:
    """Return along each axis (d,) what a share of the numbers (S, A, d) does not exceed, those aside that are none."""
    known = numbers[np.isfinite(numbers).all(axis=2)]
    if not len(known):
        return np.ones(numbers.shape[2])
    return np.asarray(np.minimum(np.quantile(known, share, axis=0), MOST_REACH))


def _maps(relation: MapRelation, grid: Grid) -> AffineBoxes:
    """Return the maps of all cells."""
    blocks = [
        relation.means.around(
            grid.low[first : first + CELLS_AT_ONCE], grid.high[first : first + CELLS_AT_ONCE], relation.input_set
        )
        for first in range(0, grid.n_cells, CELLS_AT_ONCE)
    ]
    return AffineBoxes(
        *(np.concatenate([getattr(block, name) for block in blocks]) for name in ("centre", "gain", "rest"))
    )


def _end(centre: FloatArray, extent: FloatArray, sign: float) -> FloatArray:
    """Return the least (sign -1) or largest (sign 1) means (d,) of all that are known."""
    ends = sign * centre + extent
    return np.asarray(sign * np.where(np.isfinite(ends), ends, -np.inf).max(axis=(0, 1)))


def _points_per_cell(grid: Grid, laws: Sequence[Law], per_cell: int | None) -> tuple[int, ...]:
    """Return lattice points per cell and axis: fine against the noise and against cells, as long as memory allows."""
    d, points = len(grid.shape), []
    for edges, n, law in zip(grid.edges, grid.shape, laws, strict=True):
        width = float(edges[-1] - edges[0]) / n
        wanted = width / law.std * POINTS_PER_DEVIATION.get(d, FEWER_PER_DEVIATION)
        fewest = per_cell or POINTS_PER_CELL.get(d, 2)
        points.append(max(fewest, math.ceil(min(wanted, max(fewest, MOST_PER_CELL.get(d, 2))))))
    return tuple(points)


def _points_beside_targets(grid: Grid, laws: Sequence[Law]) -> tuple[int, ...]:
    """Return fewer points where most cells choose targets, which lose nothing between lattice points."""
    widths = (float(edges[-1] - edges[0]) / n for edges, n in zip(grid.edges, grid.shape, strict=True))
    wide, narrow = TARGETS_PER_CELL.get(len(grid.shape), (2, 2))
    return tuple(wide if width > WIDE * law.std else narrow for width, law in zip(widths, laws, strict=True))
