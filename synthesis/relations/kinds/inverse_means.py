"""The exact relation of agents with expressions whose inputs reach every mean.

The proof is in docs/theory/relations.md, "Exact targets of expressions".

The mean is `a(x) + B(x) v`. The v are inputs, or pairs `r*cos(angle)`, `r*sin(angle)` of two inputs, which fill a disk
or a ring, or sectors of these where the angle does not go all the way round (``cones``). The controller solves
`a(x) + B(x) v = m` at the true state x, so the mean is the target m from everywhere in the cell. A target is admissible
in a cell if the enclosures of v over the closed cell lie in the boxes, disks, rings and sectors. States of others that
are communicated may stand in a and B: v then has to be admissible for all of them. Disturbances are not measured, so
agents that have them are refused.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....envs.systems.agents import Agent, AnyAgent, neighbour
from ....envs.systems.arguments import counted
from ....envs.systems.expressions import (
    Affine,
    AffineForm,
    Interval,
    Name,
    Number,
    Operation,
    Tree,
    affine_form,
    computed,
    enclosed,
    operations_in,
    roundings,
    solved,
    substituted,
)
from ..grids import FloatArray, Grid, RelationRefused, sharpness
from .cell_relation import ReadsCells
from .input_cones import input_cones_of, is_whole, largest_angle, polar_inputs, reached
from .input_forms import Turn, held, independent_columns, turned_inputs
from .rounding import DENSITY

ROUNDED = 8.0 * 2.0**-53
"""Share of their size by which each operation of an expression may put inputs off; the check allows for less."""

INNER = 4.0
"""Factor on what inner terms lose, for products of such losses; the check allows for half of it."""

MOST_LOST = 0.25
"""Share of B that may be lost to rounding, measured through its inverse: beyond, nothing is known of inputs."""

OUTWARD = 1e-12
"""Share of their size by which ranges of inputs are widened, as sums of enclosures round."""

MOST_GROWTH = 1e3
"""Largest entry of `|B^-1| |B|`: where B is nearer to singular, a cell has no targets."""

ZERO = Number(0.0)


@dataclass(frozen=True, eq=False)
class Asked:
    """What targets in cells ask of the inputs: `v_j` in `middle_j + sum_k slope_jk (m_k - centre_k)` (outer bounds).

    Parameters
    ----------
    centre : (n, d) array
        Targets at which `middle` is.
    middle : (2, n, d) array
        Ends of v.
    slope : (2, n, d, d) array
        Ends of the entries of the inverse of B.
    off : (n, d) array
        Upper bounds on how far the mean is off a target, as inputs are rounded.
    """

    centre: FloatArray
    middle: FloatArray
    slope: FloatArray
    off: FloatArray

    def of(self, cells: NDArray[np.int64], targets: FloatArray) -> FloatArray:
        """Return ends (2, ..., d) of v for targets (..., d) in cells (...)."""
        away = (targets - self.centre[cells])[..., None, :]
        middle = self.middle[:, cells]
        with np.errstate(invalid="ignore", over="ignore"):  # ends that are no numbers fit nowhere
            low, high = self.slope[0][cells] * away, self.slope[1][cells] * away
            ends = middle + np.stack([np.minimum(low, high).sum(axis=-1), np.maximum(low, high).sum(axis=-1)])
            sizes = np.abs(middle).max(axis=0) + np.maximum(np.abs(low), np.abs(high)).sum(axis=-1)
            return np.stack([ends[0] - OUTWARD * sizes, ends[1] + OUTWARD * sizes])


@dataclass(frozen=True, eq=False)
class SymbolicOnCells:
    """Targets that inputs reach from cells under the exact relation of expressions.

    Parameters
    ----------
    relation : WrittenTargets
    grid : Grid
    asked : Asked
        What targets ask of the inputs in each cell.
    """

    relation: SymbolicTargets
    grid: Grid
    asked: Asked

    @property
    def means(self) -> FloatArray:
        """Means (S, d) from the centres of cells, with the inputs in the middle."""
        return self.asked.centre

    @property
    def known(self) -> NDArray[np.bool_]:
        """In which cells (S,) the inputs can be solved for."""
        return np.asarray(np.all(np.isfinite(self.asked.middle), axis=(0, 2)))

    @property
    def reach(self) -> FloatArray:
        """How far (S, d) targets may be from these means."""
        return self.relation.reach(self.grid.centres)

    @property
    def farthest(self) -> tuple[FloatArray, FloatArray]:
        """Means (n, d) where they are known, and how far (d,) inputs move them at most."""
        known = self.known & np.all(np.isfinite(self.means), axis=1)
        if not np.any(known):
            raise RelationRefused(
                f"agent `{self.relation.agent.name}`: the exact relation found no cell in which its inputs can be "
                "solved for"
            )
        return self.means[known], self.relation.reach(self.grid.centres[known]).max(axis=0)

    def fits(self, cells: NDArray[Any], targets: FloatArray) -> NDArray[np.bool_]:
        """Return whether targets (.., d) are reached from all of cells (..); the two broadcast."""
        return self.relation.fits(self.asked.of(cells, targets))

    def leaves(self, share: float) -> bool:
        """Return whether every cell leaves this share of all inputs for the target; neighbours are not counted."""
        return self.relation.leaves(share, self.grid.edges)


@dataclass(frozen=True, eq=False, repr=False)
class SymbolicTargets(ReadsCells):
    """Target-mean interface of an agent with expressions (exact relation: delta = 0, epsilon = half a cell).

    Parameters
    ----------
    agent : Agent
    form : AffineForm
        Mean along each axis, affine in the d numbers v.
    columns : tuple of str
        Names of v: inputs, or components of turns.
    turns : tuple of Turn
    """

    agent: Agent
    form: AffineForm
    columns: tuple[str, ...]
    turns: tuple[Turn, ...]

    kind = "exact"
    delta = 0.0

    def describe(self) -> dict[str, Any]:
        """Return the description that files hold."""
        return {"kind": "exact"}

    def on(self, grid: Grid) -> SymbolicOnCells:
        """Return which targets inputs reach from the cells of a grid."""
        return SymbolicOnCells(self, grid, self.asked_on(grid.edges))

    def __repr__(self) -> str:
        turned = f", {counted(len(self.turns), 'turn')}" if self.turns else ""
        d, m = self.agent.n_states, self.agent.n_inputs
        return f"WrittenTargets({counted(d, 'state')}, {counted(m, 'input')}{turned}, delta 0)"

    @property
    def targets(self) -> tuple[str, ...]:
        """Names of the targets in trees."""
        return tuple(f"target {k}" for k in range(self.agent.n_states))

    @cached_property
    def trees(self) -> tuple[Tree, ...]:
        """The numbers v as expressions in states and targets."""
        return self._solved[0]

    @cached_property
    def inverse(self) -> tuple[tuple[Tree, ...], ...]:
        """Entries (d, d) of the inverse of B as expressions in states."""
        return self._solved[1]

    @cached_property
    def _solved(self) -> tuple[tuple[Tree, ...], tuple[tuple[Tree, ...], ...]]:
        solution = solved(self.form, self.targets)
        assert solution is not None  # else `symbolic_targets` refuses the agent
        return solution

    @cached_property
    def is_box(self) -> bool:
        """Whether the admissible targets of a cell are a box: every axis has an input of its own."""
        used = np.array([[entry != ZERO for entry in row] for row in self.inverse])
        return not self.turns and bool(np.all(used.sum(axis=0) == 1))

    def asked(self, low: FloatArray, high: FloatArray, around: bool = True) -> Asked:
        """Return what targets ask of the inputs in the closed cells ``[low, high]``, (n, d) each (outer bounds).

        Without ``around`` states of others are at the middles of their workspaces. Ends are not numbers where nothing
        is known, or B is nearly singular.
        """
        agent, d = self.agent, self.agent.n_states
        ranges = [(a, b) if around else (0.5 * a + 0.5 * b,) * 2 for a, b in agent.unknowns.values()]
        box: list[Interval] = [*zip(low.T, high.T, strict=True), *((np.array([a]), np.array([b])) for a, b in ranges)]
        centre = self._means(0.5 * (low + high))
        names = {name: Affine(np.zeros(1), {k: np.ones(1)}) for k, name in enumerate((*agent.states, *agent.unknowns))}
        names |= {name: Affine(row) for name, row in zip(self.targets, centre.T, strict=True)}
        found = np.empty((2, len(low), 2 * d + 2 * d * d))
        for k, (first, last) in enumerate(enclosed(self._all_trees, names, box)):
            found[0, :, k], found[1, :, k] = first, last
        entries = [tree for row in self.form.factors for tree in row]
        parts_off = np.empty((len(low), d + d * d))
        for k, lost in enumerate(roundings([*self.form.rests, *entries], names, box)):
            parts_off[:, k] = lost
        middle, rest, slope, B = np.split(found, np.cumsum([d, d, d * d]), axis=2)
        slope, B = (entries.reshape(2, -1, d, d) for entries in (slope, B))
        with np.errstate(invalid="ignore", over="ignore"):
            inverse, moved, parts = (np.abs(ends).max(axis=0) for ends in (slope, B, rest))
            growth = np.einsum("njk,nkl->njl", inverse, moved).sum(axis=2).max(axis=1)
            # v is off by a share of the parts of the solution, as cofactors cancel by the growth; B moves the mean.
            parts = 2.0 * parts + moved @ self._largest
            off = self.computed_off * growth[:, None] * np.einsum("nkj,njl,nl->nk", moved, inverse, parts)
            # Inner terms of a and B that are larger than these lose more: v is off by that through the inverse.
            B_off = parts_off[:, d:].reshape(-1, d, d)
            lost = parts_off[:, :d] + B_off @ self._largest
            kept = np.einsum("njl,nlk->njk", inverse, B_off).sum(axis=2).max(axis=1, initial=0.0) <= MOST_LOST
            moves_off = INNER * growth[:, None] * np.einsum("njl,nl->nj", inverse, lost)
            off = off + np.einsum("nkj,nj->nk", moved, moves_off)
            middle = middle + np.stack([-moves_off, moves_off])
        known = np.isfinite(middle).all(axis=(0, 2)) & (growth <= MOST_GROWTH) & kept & np.isfinite(off).all(axis=1)
        middle[:, ~known], off[~known] = np.nan, 0.0
        return Asked(centre, middle, slope, off)

    def asked_on(self, edges: Sequence[FloatArray], around: bool = True) -> Asked:
        """Return what targets ask in the cells of a grid, remembered."""
        key = (around, *(axis.tobytes() for axis in edges))
        if key not in self._known:
            cells = np.stack([mesh.ravel() for mesh in np.meshgrid(*(range(len(e) - 1) for e in edges), indexing="ij")])
            low, high = (
                np.stack([axis[k + side] for axis, k in zip(edges, cells, strict=True)], axis=1) for side in (0, 1)
            )
            self._known[key] = self.asked(low, high, around)
        return self._known[key]

    @cached_property
    def _known(self) -> dict[object, Asked]:
        return {}

    @cached_property
    def _all_trees(self) -> list[Tree]:
        """Solutions, rests, inverse and B: all that is enclosed."""
        rows = [tree for matrix in (self.inverse, self.form.factors) for row in matrix for tree in row]
        return [*self.trees, *self.form.rests, *rows]

    @cached_property
    def computed_off(self) -> float:
        """Share of their size by which inputs may be off as they are computed.

        An angle that is off by d moves a component by d times its size. Angles are rounded to a share of themselves,
        and so is pi in the turns that are added to them.
        """
        angles = sum(largest_angle(self.agent, turn) for turn in self.turns)
        return ROUNDED * (sum(map(operations_in, (*self.agent.trees, *self.trees))) + angles)

    @cached_property
    def _largest(self) -> FloatArray:
        """Largest size (d,) of each v; of both components of a turn, as its angle is rounded, the largest length."""
        agent = self.agent
        sizes = {name: agent.inputs[turn.size] for turn in self.turns for name in turn.names}
        which = [agent.inputs.index(sizes.get(name, name)) for name in self.columns]
        return np.asarray(np.maximum(np.abs(agent.input_low), np.abs(agent.input_high))[which])

    def _means(self, points: FloatArray) -> FloatArray:
        """Return the means (n, d) from points (n, d) under v in the middle, others in the middle of workspaces."""
        values = dict(zip(self.agent.states, np.ascontiguousarray(points.T), strict=True))
        values |= {name: np.full(1, 0.5 * a + 0.5 * b) for name, (a, b) in self.agent.unknowns.items()}
        values |= {name: np.full(1, self.held(name)) for name in self.columns}
        sums = []
        for rest, row in zip(self.form.rests, self.form.factors, strict=True):
            tree: Tree = rest
            for factor, name in zip(row, self.columns, strict=True):
                tree = Operation("+", (tree, Operation("*", (factor, Name(name)))))
            sums.append(tree)
        return np.stack(computed(sums, values), axis=1)

    def held(self, name: str) -> float:
        """Return the middle of an input, or of what a component of a turn can be."""
        low, high = self._ends(name)
        return 0.5 * low + 0.5 * high

    def reach(self, centres: FloatArray) -> FloatArray:
        """Return upper bounds (n, d) on how far targets of cells with ``centres`` (n, d) may be from ``Asked.centre``.

        A target of a cell is a mean from its centre, with v in the box around what it can be.
        """
        agent, low = self.agent, centres
        values = dict(zip(agent.states, np.ascontiguousarray(centres.T), strict=True))
        values |= {name: np.full(1, 0.5 * a + 0.5 * b) for name, (a, b) in agent.unknowns.items()}
        entries = computed([tree for row in self.form.factors for tree in row], values)
        B = np.abs(np.stack(entries, axis=1)).reshape(len(low), agent.n_states, -1)
        half = np.array([self.half_width(name) for name in self.columns])
        return np.asarray(B @ half * (1.0 + 1e-9))

    def half_width(self, name: str) -> float:
        """Return by how much an input, or a component of a turn, may be off its middle."""
        low, high = self._ends(name)
        return 0.5 * (high - low)

    def _ends(self, name: str) -> tuple[float, float]:
        """Return the least and the largest value of an input, or of a component of a turn."""
        for turn in self.turns:
            if name in turn.names:
                low, high = reached(self.agent, turn)[turn.names.index(name)].tolist()
                return low, high
        j = self.agent.inputs.index(name)
        return float(self.agent.input_low[j]), float(self.agent.input_high[j])

    def leaves(self, share: float, edges: Sequence[FloatArray]) -> bool:
        """Return whether in every cell the middle target leaves this share of all inputs; neighbours do not move.

        Not where turns do not go all the way round: cells cost more near the edges of sectors.
        """
        if not all(is_whole(self.agent, turn) for turn in self.turns):
            return False
        spread = np.diff(self.asked_on(edges, around=False).middle, axis=0)[0] * 0.5
        half = np.array([self.half_width(name) for name in self.columns])
        return bool(np.all(half - spread >= share * half))

    def fits(self, ends: FloatArray, which: Sequence[int] | None = None) -> NDArray[np.bool_]:
        """Return whether v with these ends (2, ..., d) lie where inputs can put them, with room for rounding.

        ``which`` numbers the v to be looked at where there are no turns.
        """
        agent, (low, high) = self.agent, ends
        inside = np.ones(low.shape[:-1], dtype=bool)
        turned = {name for turn in self.turns for name in turn.names}
        for k, name in enumerate(self.columns):
            if name not in turned and (which is None or k in which):
                j = agent.inputs.index(name)
                least, most = float(agent.input_low[j]), float(agent.input_high[j])
                spare = self.computed_off * (abs(least) + abs(most))
                inside &= (low[..., k] >= least + spare) & (high[..., k] <= most - spare)
        for turn in self.turns:
            spare = self.computed_off * float(abs(agent.input_low[turn.size]) + abs(agent.input_high[turn.size]))
            places = [self.columns.index(name) if name in self.columns else None for name in turn.names]
            # A component that reaches no mean is held at 0.
            east, north = ((0.0, 0.0) if k is None else (low[..., k], high[..., k]) for k in places)
            cones = [cone.holds(east, north, spare) for cone in input_cones_of(agent, turn)]
            inside &= np.logical_or.reduce(cones)
        return inside

    def mean_targets(self, targets: FloatArray) -> FloatArray:
        """Return target means (d, ...) as ``inputs`` takes them: as a new array."""
        return np.array(targets, dtype=float)

    def inputs(
        self, mean_targets: Sequence[FloatArray] | FloatArray, states: FloatArray, beside: FloatArray | None = None
    ) -> FloatArray:
        """Return the inputs (m, ...) that put the mean of the next state on targets, from ``states`` (d, ...).

        ``beside`` (l, ...) are the states of others that the dynamics name. Inputs are moved into their box, which
        changes nothing where a target is admissible.

        Raises
        ------
        ValueError
            If inputs depend on states of others, and they are not given.
        """
        agent, shape = self.agent, np.shape(states[0])
        values = {name: np.atleast_1d(row) for name, row in zip(agent.states, states, strict=True)}
        values |= {name: np.atleast_1d(row) for name, row in zip(self.targets, mean_targets, strict=True)}
        if beside is not None:
            values |= {neighbour(k): np.atleast_1d(row) for k, row in enumerate(beside)}
        elif agent.others:
            raise ValueError(f"`beside`: expected the states of others that agent {agent.name!r} is told, got none")
        found = dict(zip(self.columns, computed(self.trees, values), strict=True))
        inputs = np.empty((agent.n_inputs, *shape))
        inputs[:] = self.input_centre.reshape(-1, *[1] * len(shape))
        for name in self.columns:
            if name in agent.inputs:
                inputs[agent.inputs.index(name)] = found[name].reshape(shape)
        for turn in self.turns:
            east, north = (
                np.ascontiguousarray(found.get(name, np.zeros(np.atleast_1d(states[0]).shape))) for name in turn.names
            )
            size, angle = polar_inputs(agent, turn, east, north)
            inputs[turn.size], inputs[turn.angle] = size.reshape(shape), angle.reshape(shape)
        low, high = (side.reshape(-1, *[1] * len(shape)) for side in (agent.input_low, agent.input_high))
        centre = self.input_centre.reshape(low.shape)
        # What is not a number becomes the middle of the box: controllers are total.
        return np.clip(np.where(np.isnan(inputs), centre, inputs), low, high)

    @property
    def input_centre(self) -> FloatArray:
        """Middle (m,) of the input box."""
        return np.asarray(0.5 * (self.agent.input_low + self.agent.input_high))

    def rounding_loss(self, agent: AnyAgent, edges: Sequence[FloatArray]) -> float:
        """Return an upper bound on what carrying the relation out in floating point costs per step, a probability.

        Inputs are off by a share of their parts, which B turns into a shift of the mean.
        """
        off = self.asked_on(edges).off.max(axis=0, initial=0.0)
        shift = float(np.linalg.norm(off / sharpness(agent))) * (1 + 1e-9)
        return min(1.0, DENSITY * shift)

    @property
    def arrays(self) -> tuple[FloatArray, ...]:
        """All that targets depend on, for comparing relations."""
        return tuple(np.frombuffer(text, dtype=np.uint8) for text in self.agent.motion_key)


def symbolic_targets(agent: Agent) -> SymbolicTargets:
    """Return the exact relation of an agent with expressions.

    Raises
    ------
    RelationRefused
        If inputs are not seen to reach every mean, or something that is not measured moves the agent.
    """

    def refused(reason: str) -> RelationRefused:
        return RelationRefused(f"agent `{agent.name}`: the exact relation {reason}; ask for `boxes`")

    if agent.disturbances:
        raise refused("cancels what it measures, got disturbances")
    if any(agent.neighbour_inputs):
        raise refused(
            "cancels what it is told, and nobody is told of inputs of others, which are chosen in the same step"
        )
    told = {owner.split(".")[0] for owner in agent.others} - {*agent.communicated}
    if told:
        raise refused(f"cancels what it is told, and the states of {', '.join(sorted(told))} are not `communicated`")
    trees, turns = turned_inputs(agent)
    taken = {agent.inputs[j] for turn in turns for j in (turn.size, turn.angle)}
    names = [*(name for name in agent.inputs if name not in taken), *(name for turn in turns for name in turn.names)]
    form = affine_form(trees, names)
    if form is None:
        raise refused("of expressions needs means `a(x) + B(x) u`, which these are not seen to be")
    columns = independent_columns(agent, form, names)
    if columns is None:
        raise refused("needs as many independent inputs as states")
    kept = tuple(names[j] for j in columns)
    # All other inputs rest in the middle of their interval.
    resting = {name: Number(held(agent, name)) for name in names if name not in kept}
    square = affine_form([substituted(tree, resting) for tree in trees], kept)
    assert square is not None  # it was affine with more names
    if any(not is_whole(agent, turn) and not {*turn.names} <= {*kept} for turn in turns):
        raise refused("of expressions needs both components of polar inputs whose angle does not go all the way round")
    relation = SymbolicTargets(agent, square, kept, turns)
    if solved(square, relation.targets) is None:
        raise refused("of expressions solves up to three means at once, and more of these are tied together")
    return relation
