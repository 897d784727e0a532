"""What an abstract agent can choose between in each cell: what all kinds of choices have in common.

A policy for one step, (S,), gives one choice per cell; -1 where there is none. Each kind says what its choices are
worth (``read``), which is best (``best``), which is nearest to what somebody else does (``nearest``), and which does
about what one did on other cells (``carried``). Nobody else asks of what kind choices are.

``TargetWindows``  the choice is the lattice point itself: every mean can be commanded.
``InputSet``      the choice is one of A abstract inputs, each of which leads to a lattice point.
``BoxChoices``     the choice is an input under which the mean is known to lie in a box.
``CornerChoices``  the choice is an input, under which the mean is affine in the state, or a lattice point.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....envs.systems.agents import AnyAgent
from ...relations.grids import FloatArray, Grid, grid_laws
from ...relations.kinds import describe_relation
from ..kernels import Kernel, law_table

StepPolicy = NDArray[np.int32]
"""(S,) choice of each cell for one step; -1 for none."""

Policies = tuple[NDArray[np.int32], ...]
"""Per agent (T, Q, S_i): choice of each cell by time and automaton state; -1 where none is admissible."""

MeansAt = Callable[[FloatArray], FloatArray]
"""Means (d, S) of the next states, from a point (S, d) of every cell."""

TIE = 1e-12
"""Relative improvement below which the incumbent stays: more than rounding, less than any policy is worth."""

CELLS_PER_BLOCK = 64
"""Cells per block: enough rows for a fast product, few enough that their windows overlap."""

NUMBERS_PER_BLOCK = 1 << 20
"""Numbers that a block may have on a device, which prefers a few large products."""


class ActionTable:
    """What can be chosen in each cell of a grid."""

    grid: Grid
    lattice: tuple[FloatArray, ...]
    relation: Any
    n_times: int = 1

    is_additive: bool = True
    """Whether a step takes a sum of factors to the sum of what it takes each to."""
    has_corners: bool = False
    """Whether factors are multilinear in every cell, with values at its corners."""
    is_read_at_length: bool = False
    """Whether reading takes so long that equal agents are read once."""
    read_per_second: float = 1e6
    """Cells that are read in a second with one term, about."""

    @property
    def resting_choice(self) -> StepPolicy:
        """(S,) choice whose mean stays nearest to the cell; -1 where there is none.

        It is for cells, states and times for which nothing better is known, and makes every policy total.
        """
        raise NotImplementedError

    @property
    def shape(self) -> tuple[int, ...]:
        """Lattice points per axis."""
        return tuple(len(axis) for axis in self.lattice)

    @property
    def input_set(self) -> NDArray[np.int32] | None:
        """Lattice points (S, A) that inputs lead to, where choices are inputs that lead to lattice points."""
        return None

    @property
    def n_choices(self) -> int:
        """Number of choices that are inputs of a menu."""
        return 0

    @property
    def at_times(self) -> tuple[ActionTable, ...]:
        """The choices of each step by themselves, numbered from 0."""
        return (self,)

    @property
    def cell_widths(self) -> FloatArray:
        """Mean width (d,) of cells along each axis."""
        return np.array([(axis[-1] - axis[0]) / (len(axis) - 1) for axis in self.grid.edges])

    def kernel_on(self, agent: AnyAgent, grid: Grid) -> Kernel:
        """Return the kernel from the lattice to other cells of the agent whose choices these are."""
        raise NotImplementedError

    def is_settled(self, share: float) -> bool:
        """Return whether every cell has a choice, and leaves this share of all inputs to it."""
        return False

    def points(self, policy: StepPolicy) -> NDArray[Any]:
        """Return the lattice points (S,) that masses are pushed to under a policy; -1 for none."""
        raise NotImplementedError

    def read(self, backed_up: Any, policy: StepPolicy, rough: bool = False) -> Any:
        """Return the value factors (n, places) of an agent under a policy, lower bounds, from smoothed ones.

        With ``rough`` they are about right, and no bounds, where bounds take longer.
        """
        raise NotImplementedError

    def best(self, weights: FloatArray, table: FloatArray, incumbent: StepPolicy) -> StepPolicy:
        """Return the choice (S,) of each cell with the largest weighted value; the incumbent stays among equals.

        Parameters
        ----------
        weights : (places, n) array, or (1, n) for the same weights everywhere
            Nonnegative weights of the objectives at each place.
        table : (n, ..) array
            Smoothed factors, one of each objective.
        incumbent : (S,) int32 array
            Current choices; -1 where a cell has none. They stay where nothing is better, and where nothing weighs.
        """
        raise NotImplementedError

    def nearest(self, means_at: MeansAt) -> StepPolicy:
        """Return the admissible choice (S,) of each cell whose means are nearest to given ones; -1 if there is none."""
        raise NotImplementedError

    def carried(self, before: Any, policy: NDArray[np.int32]) -> NDArray[np.int32]:
        """Return a policy (T, Q, S) that does about what one did with the choices ``before`` of other cells.

        ``policy`` holds, for each cell of this grid, the choice of the cell of the other grid around its centre.
        """
        alike = self.relation.nearest_choices(before.relation)
        kept = np.where(policy >= 0, alike[np.maximum(policy, 0)], -1)
        return np.where(kept >= 0, kept, self.resting_choice).astype(np.int32)

    def same_as(self, relation: Mapping[str, Any], input_set: NDArray[Any] | None) -> bool:
        """Return whether choices that were stored, with a relation's description, mean the same on equal cells."""
        return input_set is None and describe_relation(self.relation) == relation

    def largest(self, backed_up: FloatArray) -> FloatArray | None:
        """Return the largest values (S,) of a smoothed factor (Z,) over all choices, where that is quick; else None."""
        return None

    @property
    def dense_cost(self) -> int | None:
        """What a maximum over all choices costs per cell; None if dense programs do not know these choices."""
        return None

    def dense_best(self, values: FloatArray) -> FloatArray:
        """Return the largest (n, S) of values (n, Z), not negative, over all choices; 0 where there is none."""
        raise NotImplementedError


class PointChoices(ActionTable):
    """Choices whose means are lattice points, the same for the whole cell."""

    def kernel_on(self, agent: AnyAgent, grid: Grid) -> Kernel:
        """Return the masses of other cells around the lattice points."""
        laws = grid_laws(agent)
        found = [law_table(*axes) for axes in zip(self.lattice, grid.edges, laws, strict=True)]
        return Kernel(tuple(table for table, _ in found), sum(missing for _, missing in found))

    def read(self, backed_up: Any, policy: StepPolicy, rough: bool = False) -> Any:
        """Return smoothed factors (n, Z) at the chosen points; cells without a choice have value 0."""
        return gather(backed_up, self.points(policy))

    def best(self, weights: FloatArray, table: FloatArray, incumbent: StepPolicy) -> StepPolicy:
        """Return the choice (S,) that maximises ``weights[s] @ table[:, z]`` over the points z each cell can choose.

        The incumbent stays unless another choice is better by more than ``TIE``, relative. Ties go to the incumbent,
        then to the lowest index: the result is deterministic, and rounding noise never changes a policy.
        """
        n_cells, points = len(incumbent), self.points(incumbent)
        # The same weights everywhere make one objective of all.
        if len(weights) == 1:
            weights, table = np.ones((n_cells, 1)), weights @ table
        chosen = self._of_one_objective(table[0]) if len(table) == 1 else None
        if chosen is not None:
            # Which point is the largest does not depend on the weight.
            best, score = chosen, np.where(chosen >= 0, weights[:, 0] * table[0, chosen], -np.inf)
        else:
            # Block by block; blocks in which every cell has a choice and nothing weighs are left out.
            idle = (~np.any(weights != 0, axis=1)) & (points >= 0)
            best, score = np.full(n_cells, -1, dtype=np.int64), np.zeros(n_cells)
            for block in self._blocks(idle, table):
                best[block], score[block] = self._best_of(block, weights[block], table)
        # Compare with what the incumbents attain.
        mean_targets = table[:, np.maximum(points, 0)]
        current = np.einsum("sn,ns->s", weights, mean_targets)
        better = (best >= 0) & ((points < 0) | (score > current * (1 + TIE)))
        return np.where(better, best, incumbent).astype(np.int32)

    def _of_one_objective(self, values: FloatArray) -> NDArray[np.int64] | None:
        """Return the choices (S,) of the largest values (Z,), where there is a shortcut to them; None otherwise."""
        return None

    def _blocks(self, idle: NDArray[np.bool_], table: Any) -> list[NDArray[np.int64]]:
        """Return the cells that are not idle, and perhaps others, in blocks that are looked at together."""
        raise NotImplementedError

    def _best_of(self, block: NDArray[Any], weights: Any, table: Any) -> tuple[NDArray[Any], FloatArray]:
        """Return argmax and maximum of the objective over the choices of a block of cells."""
        raise NotImplementedError


def gather(backed_up: Any, points: NDArray[Any]) -> Any:
    """Return smoothed factors (n, Z) read at lattice points (S,); 0 where there is none (-1)."""
    values = backed_up[:, np.maximum(points, 0)]
    if np.any(points < 0):
        values[:, points < 0] = 0
    return values


def largest(scores: Any) -> tuple[NDArray[Any], FloatArray]:
    """Return the column of the first of the largest numbers of every row, and that number."""
    first = np.argmax(scores, axis=1)
    return first, scores[np.arange(len(scores)), first]


def bricks(shape: tuple[int, ...], size: int) -> list[NDArray[np.int64]]:
    """Return the cells of a grid, increasing, in cubes of at most ``size``.

    Examples
    --------
    >>> [brick.tolist() for brick in bricks((2, 3), 4)]
    [[0, 1, 3, 4], [2, 5]]
    """
    edge = max(1, int(size ** (1.0 / len(shape)) + 1e-9))
    cells = np.arange(math.prod(shape)).reshape(shape)
    corners = product(*(range(0, n, edge) for n in shape))
    return [cells[tuple(slice(a, a + edge) for a in corner)].ravel() for corner in corners]


def shifted(choices: StepPolicy, by: int) -> StepPolicy:
    """Return choices (S,) under numbers that begin elsewhere; -1 stays."""
    return np.where(choices >= 0, choices + by, -1).astype(np.int32)


def best_offered(
    offered: tuple[ActionTable, int], weights: FloatArray, table: FloatArray, incumbent: StepPolicy
) -> StepPolicy:
    """Return the best of choices that are offered, which are numbered from the second number on."""
    choices, first = offered
    if not first:
        return choices.best(weights, table, incumbent)
    return shifted(choices.best(weights, table, shifted(incumbent, -first)), first)
