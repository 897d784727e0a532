"""Choices under the relation ``linear``: constant inputs and targets, compared as they are read.

Under a constant input the mean is affine in the state up to a box (``kernels.multilinear_kernel``). A target puts it on
one lattice point from the whole cell: its value is that of the point, and nothing is lost. It keeps input in reserve
for all of the cell; constant inputs, which keep none, are better near the limits of the inputs and in wide cells.
Choices are compared as they are certified, whatever they are.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....envs.systems.agents import AnyAgent
from ...relations.grids import FloatArray, Grid, corner_sides, grid_laws, of_cells, shape_text, to_places
from ...relations.kinds import AffineBoxes, MapRelation
from ..kernels import FAR, Images, LatticeKernel, MultilinearKernel, in_chunks, lattice_kernel_of
from .action_tables import ActionTable, MeansAt, StepPolicy
from .target_windows import TargetWindows, windows_of

FINALISTS = 2
"""Inputs of a menu whose loss is computed before one is chosen."""

LEAST_SHARE = 1e-12
"""Share of the largest weight below which a cell is not worth a decision: it keeps what it has."""

HANDICAP, HANDICAP_IN_TEAMS = 0.002, 0.0002
"""Share of its value by which a target has to be better than an input, of one agent alone and in teams.

Cells with one value each make steps at their faces, which cost all that is read across them one step earlier. Alone the
optimum is found in one sweep, and steps are its only harm. Teams climb: a share that is given away in every step hides
from an agent what the others could do with the rest (20 steps of `meeting-v0`: .972 with the large share, .990)."""

INSIDE = 0.999
"""Share of the way from the centre of a cell to a corner at which a policy is asked: corners are of several cells."""

PREFERENCE = 1e-9
"""Relative improvement below which the incumbent stays."""


@dataclass(frozen=True, eq=False, repr=False)
class CornerChoices(ActionTable):
    """What can be chosen in each cell: inputs of a menu, by their numbers, and lattice points beyond these.

    Parameters
    ----------
    grid : Grid
    lattice : tuple of (Z_k,) arrays
        Evenly spaced lattice axes.
    relation : MapRelation
    per_cell : int
        Lattice points per cell and axis, at most.
    maps : AffineBoxes
        Means of all cells and inputs, (S, A, ..).
    reading : CornerReading
    n_times : int
        Parts of equal length in which the inputs come, one for each step, in which alone these may be chosen; 1 if all
        may be chosen at every step. There are no targets then.
    handicap : float
        Share of its value by which a target has to be better than an input: what is chosen, never what it is worth.
    """

    grid: Grid
    lattice: tuple[FloatArray, ...]
    relation: MapRelation
    per_cell: int
    maps: AffineBoxes
    multilinear: MultilinearKernel
    memory: dict[str, object] = field(default_factory=dict, repr=False)
    n_times: int = 1
    handicap: float = HANDICAP

    is_additive = False
    has_corners = True
    is_read_at_length = True

    def __repr__(self) -> str:
        mean_targets = "" if self.relation.mean_targets is None else " and targets"
        of_each = f"{self.n_inputs} inputs{mean_targets}"
        return f"CornerChoices({self.grid.n_cells} cells, {of_each}, {shape_text(self.shape)} lattice points)"

    def kernel_on(self, agent: AnyAgent, grid: Grid) -> LatticeKernel:
        """Return the kernel from the lattice to other cells."""
        return lattice_kernel_of(grid, self.lattice, grid_laws(agent), self.multilinear.reach)

    @cached_property
    def windows(self) -> TargetWindows | None:
        """The lattice points that each cell can choose, if there are targets; made when they are first asked for."""
        mean_targets = self.relation.mean_targets
        return None if mean_targets is None else windows_of(mean_targets, self.grid, self.lattice)

    @property
    def n_places(self) -> int:
        """Number of places 2^d S."""
        return self.grid.n_cells * 2 ** len(self.lattice)

    @property
    def n_inputs(self) -> int:
        """Number of inputs A."""
        return len(self.relation.input_set)

    @property
    def n_choices(self) -> int:
        """Number of choices but targets."""
        return self.n_inputs

    @cached_property
    def at_times(self) -> tuple[CornerChoices, ...]:
        """The choices of each step by themselves, numbered from 0."""
        if self.n_times == 1:
            return (self,)
        found, length = [], self.n_inputs // self.n_times
        for time in range(self.n_times):
            own = slice(time * length, (time + 1) * length)
            gain, rest = (each[:, own] if each.shape[1] > 1 else each for each in (self.maps.gain, self.maps.rest))
            maps = AffineBoxes(self.maps.centre[:, own], gain, rest)
            relation = replace(self.relation, input_set=self.relation.input_set[own])
            found.append(replace(self, relation=relation, maps=maps, memory={}, n_times=1))
        return tuple(found)

    @property
    def n_points(self) -> int:
        """Number of lattice points Z."""
        return self.multilinear.n_points

    @cached_property
    def _admissible(self) -> NDArray[np.bool_]:
        """(S, A) whether the image of the cell is known and lies inside the lattice, what is left of it included."""
        maps, half = self.maps, self.grid.half_widths[:, None]
        return self.multilinear.holds(maps.centre, maps.gain, maps.rest, half)

    def images(self, cells: NDArray[np.int64], choices: NDArray) -> Images:
        """Return where inputs (C,) take cells (C,)."""
        gain, rest = (each[cells, choices if each.shape[1] > 1 else 0] for each in (self.maps.gain, self.maps.rest))
        return Images(self.maps.centre[cells, choices], gain, rest, self._half[cells])

    def targets(self, choices: NDArray) -> NDArray[np.bool_]:
        """Return which choices put the mean on one lattice point for the whole cell."""
        return np.asarray(choices >= self.n_inputs)

    def centres(self, cells: NDArray[np.int64], policy: StepPolicy) -> FloatArray:
        """Return the means (C, d) of the centres of cells under choices (C,); far away where they are not known."""
        index = np.unravel_index(np.clip(policy - self.n_inputs, 0, self.n_points - 1), self.shape)
        points = np.stack([axis[k] for axis, k in zip(self.lattice, index, strict=True)], axis=1)
        means = self._input_centres(cells, np.minimum(policy, self.n_inputs - 1))
        return np.where(self.targets(policy)[:, None], points, means)

    def points(self, policy: StepPolicy) -> NDArray[np.int64]:
        """Return the lattice point nearest to the mean of each place (2^d S,); -1 where there is no choice.

        Masses are pushed to them: a heuristic where means lie between lattice points.
        """
        cells, chosen = np.arange(self.grid.n_cells), np.clip(policy, 0, self.n_inputs - 1)
        flat = self.multilinear.corners(self.images(cells, chosen)).astype(np.int64)
        known = (policy >= 0) & self._admissible[cells, chosen]
        flat = np.where(known[:, None], flat, -1)
        return to_places(
            np.where(self.targets(policy)[:, None], policy[:, None] - self.n_inputs, flat), self.grid.shape
        )

    def _input_centres(self, cells: NDArray[np.int64], choices: NDArray) -> FloatArray:
        """Return ``centres`` of inputs alone."""
        return np.nan_to_num(self.maps.centre[cells, choices], nan=FAR)

    @cached_property
    def _half(self) -> FloatArray:
        return np.asarray(self.grid.half_widths)

    def read(self, backed_up: Any, policy: StepPolicy, rough: bool = False) -> Any:
        """Return lower bounds (n, 2^d S) at all places under a policy, from values and bends (n, 2 Z).

        Images are read at few points if ``rough``: about right, and no bounds.
        """
        table, cells = backed_up, np.flatnonzero(policy >= 0)
        values = np.zeros((len(table), self.grid.n_cells, 2 ** len(self.lattice)))
        values[:, cells] = self.at(table, cells, policy[cells], rough)
        return to_places(values, self.grid.shape)

    def at(self, table: FloatArray, cells: NDArray[np.int64], choices: NDArray, rough: bool = False) -> FloatArray:
        """Return lower bounds (n, C, 2^d) at the corners of cells (C,) under choices (C,); about right if ``rough``."""
        values = np.empty((len(table), len(cells), 2 ** len(self.lattice)))
        fixed = self.targets(choices)
        values[:, fixed] = table[:, choices[fixed] - self.n_inputs][..., None]
        moved, inputs = cells[~fixed], choices[~fixed]
        images = self.images(moved, inputs)
        values[:, ~fixed] = self.multilinear.backup_lower(table, images, self._admissible[moved, inputs], rough)
        return values

    def best(self, weights: FloatArray, table: FloatArray, incumbent: StepPolicy) -> StepPolicy:
        """Return the choices (S,) of the largest weighted value, losses taken off; the incumbent stays among equals.

        Parameters
        ----------
        weights : (2^d S, n) array
            Weights of the objectives at all places.
        table : (n, 2 Z) array
            Values and bends of every lattice point under each objective.
        incumbent : (S,) int32 array
        """
        n_places = weights.shape[0] if len(weights) > 1 else self.n_places
        weights = np.broadcast_to(weights, (n_places, len(table)))
        at_corners = of_cells(weights.T, self.grid.shape)  # (n, S, 2^d)
        heavy = at_corners.sum(axis=(0, 2))
        cells = np.flatnonzero((heavy > LEAST_SHARE * heavy.max(initial=0.0)) | (incumbent < 0))
        result = incumbent.copy()
        if not len(cells) or not heavy.any():
            return result
        here = np.ascontiguousarray(at_corners[:, cells])
        finalists = self._inputs(here, table, cells)
        if self.windows is not None:
            finalists.append(self._best_targets(self.windows, here, table, cells, incumbent))
        current = incumbent[cells]
        best, score = current.copy(), self._score(here, table, cells, current) * (1.0 + PREFERENCE)
        score = np.where(self.targets(current), score * (1.0 - self.handicap), score)
        for candidate in finalists:
            value = self._score(here, table, cells, np.where(candidate == current, -1, candidate))
            value = np.where(self.targets(candidate), value * (1.0 - self.handicap), value)
            better = (candidate >= 0) & ((best < 0) | (value > score))
            best, score = np.where(better, candidate, best), np.where(better, value, score)
        result[cells] = best
        return result

    def nearest(self, means_at: MeansAt) -> StepPolicy:
        """Return the choice (S,) of each cell whose means are nearest to those at its centre and near its corners.

        The input and the target that are nearest at the centre; the corners decide between these.
        """
        scale, cells, half = self.cell_widths, np.arange(self.grid.n_cells), self.grid.half_widths
        means = means_at(self.grid.centres)
        offered = [self.centres(cells, np.full(len(cells), a)) for a in range(self.n_inputs)]
        distances = np.stack([(((centres - means.T) / scale) ** 2).sum(axis=1) for centres in offered])
        inputs = np.argmin(distances, axis=0).astype(np.int32)
        if self.windows is None:
            return inputs
        targets = self.windows.nearest_to(means)
        gains = self.images(cells, inputs).gain
        mean_targets = self.centres(cells, np.maximum(targets, 0) + self.n_inputs)
        moved, aimed = np.zeros(len(cells)), np.where(targets >= 0, 0.0, np.inf)
        for side in 2.0 * corner_sides(len(scale)) - 1.0:
            goal = means_at(self.grid.centres + INSIDE * side * half)
            here = self.centres(cells, inputs) + INSIDE * np.einsum("sij,sj->si", gains, side * half)
            moved += (((here - goal.T) / scale) ** 2).sum(axis=1)
            aimed += (((mean_targets - goal.T) / scale) ** 2).sum(axis=1)
        return np.where(aimed <= moved, targets + self.n_inputs, inputs).astype(np.int32)

    def carried(self, before: CornerChoices, policy: NDArray[np.int32]) -> NDArray[np.int32]:
        """Return a policy (T, Q, S) of the same inputs, whose menus are the same on all cells, and nearest targets."""
        if self.windows is None or before.windows is None:
            return np.where(policy >= 0, policy, self.resting_choice).astype(np.int32)
        first = before.n_inputs
        mean_targets = self.windows.carried(before.windows, np.where(policy < first, -1, policy - first))
        aimed = np.where(mean_targets >= 0, mean_targets + self.n_inputs, self.resting_choice)
        return np.where((policy < 0) | (policy >= first), aimed, policy).astype(np.int32)

    def _score(self, weights: FloatArray, table: FloatArray, cells: NDArray[np.int64], choices: NDArray) -> FloatArray:
        """Return weighted values (C,) of choices with their losses; minus infinity where there is no choice."""
        score = np.full(len(cells), -np.inf)
        for rows in in_chunks(np.flatnonzero(choices >= 0), len(table) * self.multilinear.numbers(rough=True)):
            values = self.at(table, cells[rows], choices[rows], rough=True)
            score[rows] = np.einsum("nsc,nsc->s", weights[:, rows], values)
        return score

    def _best_targets(
        self,
        windows: TargetWindows,
        weights: FloatArray,
        table: FloatArray,
        cells: NDArray[np.int64],
        incumbent: StepPolicy,
    ) -> NDArray[np.int64]:
        """Return the best target (C,) of cells with weights (n, C, 2^d), as choices: coarse first, then fine."""
        total = np.ascontiguousarray(weights.sum(axis=2).T)
        points = self._coarse(total, table, cells)
        # Resting choices stand in where no coarse point is admissible, and where the window is narrow.
        points = np.where(points < 0, windows.resting_choice[cells], points)
        current = incumbent[cells] - self.n_inputs
        points = np.where((points < 0) & (current >= 0), current, points)
        step = max(1, self.per_cell // 2)
        while True:
            points = self._refined(windows, total, table, cells, points, step)
            if step == 1:
                return np.where(points >= 0, points + self.n_inputs, -1)
            step = max(1, step // 2)

    def _coarse(self, total: FloatArray, table: FloatArray, cells: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return the best point of each cell (C,) on every ``per_cell``-th lattice point; -1 where there is none."""
        windows, fine = self._coarse_windows
        values = np.ascontiguousarray(table[:, : self.n_points][:, fine])
        weights = np.zeros((self.grid.n_cells, len(table)))
        weights[cells] = total
        wanted = np.zeros(self.grid.n_cells, dtype=bool)
        wanted[cells] = True
        best = np.full(self.grid.n_cells, -1, dtype=np.int64)
        for block in windows.blocks(64):
            if not wanted[block].any():
                continue
            flat, allowed = windows.band(block)
            if len(flat):
                scores = np.where(allowed, weights[block] @ values[:, flat], -np.inf)
                first = scores.argmax(axis=1)
                best[block] = np.where(allowed[np.arange(len(block)), first], fine[flat[first]], -1)
        return best[cells]

    @cached_property
    def _coarse_windows(self) -> tuple[TargetWindows, NDArray[np.int64]]:
        """The windows on every ``per_cell``-th lattice point, and which lattice points these are."""
        first = self.per_cell // 2
        index = [np.arange(first, n, self.per_cell) if n > first else np.arange(1) for n in self.shape]
        lattice = tuple(axis[k] for axis, k in zip(self.lattice, index, strict=True))
        fine = np.ravel_multi_index(np.meshgrid(*index, indexing="ij"), self.shape).ravel()
        assert self.relation.mean_targets is not None
        windows = windows_of(self.relation.mean_targets, self.grid, lattice)
        return windows, fine

    def _refined(
        self,
        windows: TargetWindows,
        total: FloatArray,
        table: FloatArray,
        cells: NDArray[np.int64],
        points: NDArray[np.int64],
        step: int,
    ) -> NDArray[np.int64]:
        """Return the best of each point and its neighbours ``step`` away that its cell can choose."""
        shape = np.array(self.shape)
        index = np.stack(np.unravel_index(np.maximum(points, 0), self.shape), axis=1)
        low, high = windows.low[cells], windows.high[cells] - 1
        best, score = points.copy(), np.full(len(cells), -np.inf)
        for move in sorted(product((-step, 0, step), repeat=len(shape)), key=lambda move: sum(map(abs, move))):
            moved = np.clip(index + np.array(move), low, np.maximum(high, low))
            flat = np.ravel_multi_index(tuple(np.clip(moved, 0, shape - 1).T), self.shape)
            allowed = (points >= 0) & np.all((low <= moved) & (moved <= high), axis=1)
            if not windows.relation.is_box:
                allowed &= windows.admissible(cells, flat)
            value = np.einsum("sn,ns->s", total, table[:, flat])
            better = allowed & (value > score)
            best, score = np.where(better, flat, best), np.where(better, value, score)
        return best

    def _inputs(self, weights: FloatArray, table: FloatArray, cells: NDArray[np.int64]) -> list[NDArray]:
        """Return the inputs (C,) of the largest weighted values at the corners' images, losses aside, best first."""
        names = np.full((FINALISTS, len(cells)), -1)
        scores = np.full((FINALISTS, len(cells)), -np.inf)
        of_corners = np.ascontiguousarray(np.moveaxis(weights, 2, 1))
        for a in range(self.n_inputs):
            corners, value = self._corner_table[a][:, cells], np.zeros(len(cells))
            for own, weight in zip(table, of_corners, strict=True):
                pairs = zip(weight, corners, strict=True)
                value += sum(share * own.take(corner, mode="clip") for share, corner in pairs)
            # Into the list of the best, which stays in order, where it gets there.
            rows = np.flatnonzero(self._admissible[cells, a] & (value > scores[-1]))
            name, value = np.full(len(rows), a), value[rows]
            for k in range(FINALISTS):
                was, best = names[k, rows], scores[k, rows]
                better = value > best
                names[k, rows], name = np.where(better, name, was), np.where(better, was, name)
                scores[k, rows], value = np.where(better, value, best), np.where(better, best, value)
        return list(names)

    @cached_property
    def _corner_table(self) -> list[NDArray[np.int32]]:
        """Lattice points (2^d, S) nearest to the images of corners, for every input."""
        cells, inputs = np.arange(self.grid.n_cells), range(self.n_inputs)
        images = (self.images(cells, np.full(len(cells), a)) for a in inputs)
        return [np.ascontiguousarray(self.multilinear.corners(own).T) for own in images]

    @cached_property
    def resting_choice(self) -> StepPolicy:
        """(S,) choice whose mean stays nearest to the cell, targets first; -1 where there is none."""
        best, nearest = np.full(self.grid.n_cells, -1, dtype=np.int32), np.full(self.grid.n_cells, np.inf)
        cells = np.arange(self.grid.n_cells)
        for a in range(self.n_inputs):
            away = (
                self._input_centres(cells, np.full(len(cells), a)) - self.grid.centres
            ) / self.multilinear.lattice_spacing
            distance = np.where(self._admissible[:, a], np.sum(away**2, axis=1), np.inf)
            closer = distance < nearest
            nearest, best = np.where(closer, distance, nearest), np.where(closer, a, best).astype(np.int32)
        if self.windows is None:
            return best
        fixed = self.windows.resting_choice
        return np.where(fixed >= 0, fixed + self.n_inputs, best).astype(np.int32)
