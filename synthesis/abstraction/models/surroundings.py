"""Finite models whose cells go on beyond the workspaces, so that what leaves them arrives somewhere.

Opposite tasks read exits as letters (``problem.opposite``): an agent that is outside has decided the task, wherever it
is. So few cells are enough out there: one to either side of each axis, wide enough to hold what arrives. Where related
states lie around the centre of a cell, they are as wide as those inside, and go as far as most of
the noise does. Nobody chooses anything there; inside, choices are those of the models that are surrounded.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....envs.systems.agents import AnyAgent
from ....envs.tasks.problem import Problem
from ...relations.grids import (
    MOST_CELLS,
    FloatArray,
    Grid,
    RelationRefused,
    cell_labels,
    error_labels,
    grid_laws,
    points_by_axis,
)
from ..kernels import Kernel
from .action_tables import ActionTable, Policies, StepPolicy
from .finite_models import Abstraction, AgentModel

FAR, NEAR = 12.0, 6.0
"""Deviations of the noise by which single wide cells reach beyond the workspace, and how far many narrow ones do."""


@dataclass(frozen=True, eq=False, repr=False)
class InnerChoices(ActionTable):
    """What can be chosen in the cells of a grid that lie within another one; nothing in all others.

    Parameters
    ----------
    choices : Choices
        Of the cells within.
    grid : Grid
        All cells.
    within : tuple of slice
        Which cells along each axis lie within.
    """

    choices: ActionTable
    grid: Grid
    within: tuple[slice, ...]
    is_additive: bool
    has_corners: bool
    is_read_at_length: bool
    read_per_second: float

    @property
    def cells(self) -> NDArray[np.int64]:
        """Numbers (S',) of the cells within."""
        return np.arange(self.grid.n_cells).reshape(self.grid.shape)[self.within].ravel()

    @property
    def relation(self) -> Any:
        """That of the choices."""
        return self.choices.relation

    @property
    def lattice(self) -> tuple[FloatArray, ...]:  # type: ignore[override]
        """That of the choices."""
        return self.choices.lattice

    @property
    def n_choices(self) -> int:
        """Number of choices that are inputs of a menu."""
        return self.choices.n_choices

    @property
    def input_set(self) -> NDArray[np.int32] | None:
        """Lattice points (S, A) that inputs lead to; of no meaning in cells where there is no choice."""
        return None if self.choices.input_set is None else self._among(self.choices.input_set.T, 0).T

    @property
    def resting_choice(self) -> StepPolicy:
        """(S,) resting choices within, and -1 around."""
        return self.spread(self.choices.resting_choice)

    def spread(self, policy: NDArray[np.int32]) -> NDArray[np.int32]:
        """Return a policy (.., S) that does what one (.., S') does within, and has no choice around."""
        return self._among(policy, -1)

    def points(self, policy: StepPolicy) -> NDArray[Any]:
        """Return the lattice points (S,) that masses are pushed to under a policy; -1 for none."""
        return self._at_places(self.choices.points(policy[self.cells])[None], -1)[0]

    def read(self, backed_up: Any, policy: StepPolicy, rough: bool = False) -> Any:
        """Return the value factors (n, places) of an agent under a policy: 0 in cells where there is no choice."""
        values = self.choices.read(backed_up, policy[self.cells], rough)
        return self._at_places(values, 0.0)

    def _at_places(self, numbers: NDArray[Any], other: float) -> NDArray[Any]:
        """Return numbers (n, places) that are those given within: there are two places along each axis for corners."""
        width = 2 if self.has_corners else 1
        places = tuple(slice(width * s.start, width * s.stop) for s in self.within)
        result = np.full((len(numbers), *(width * n for n in self.grid.shape)), other, dtype=numbers.dtype)
        result[(slice(None), *places)] = numbers.reshape(len(numbers), *(s.stop - s.start for s in places))
        return result.reshape(len(numbers), width ** len(self.within) * self.grid.n_cells)

    def _among(self, numbers: NDArray[Any], other: int) -> NDArray[Any]:
        """Return numbers (.., S) that are those given (.., S') within."""
        result = np.full((*numbers.shape[:-1], self.grid.n_cells), other, dtype=numbers.dtype)
        result[..., self.cells] = numbers
        return result


def surrounded(problem: Problem, abstraction: Abstraction, policies: Policies) -> tuple[Abstraction, Policies]:
    """Return finite models for an opposite task, with cells around those of the models of the task itself.

    Also policies for them, which are those given inside, and choose nothing anywhere else.

    Raises
    ------
    RelationRefused
        If there would be too many cells.
    """
    known = dict[object, tuple[Grid, Kernel, InnerChoices]]()
    models, ordered, spread = dict[object, AgentModel](), [], []
    for i, (agent, model, policy) in enumerate(zip(problem.agents, abstraction.models, policies, strict=True)):
        # Agents that share a model share what is around it; those whose labels are equal, too, share all of it.
        shared = id(model.kernel), id(model.choices)
        if shared not in known:
            known[shared] = _around(agent, model)
        grid, kernel, choices = known[shared]
        relation = model.relation
        starting = arriving = cell_labels(problem, i, grid)
        if not relation.is_cell:
            arriving = error_labels(problem, i, grid, relation.state_reach)  # type: ignore[union-attr]
        key = (*shared, arriving.key, starting.key)
        if key not in models:
            models[key] = AgentModel(grid, model.lattice, relation, kernel, choices, arriving, starting)
        ordered.append(models[key])
        more = np.full((len(policy), problem.automaton.n_states - policy.shape[1], policy.shape[2]), -1, policy.dtype)
        spread.append(choices.spread(np.concatenate([policy, more], axis=1)))
    return Abstraction(tuple(ordered), abstraction.settings), tuple(spread)


def _around(agent: AnyAgent, model: AgentModel) -> tuple[Grid, Kernel, InnerChoices]:
    """Return the grid of an agent with cells around it, the kernel to its cells, and the choices inside."""
    inner = model.grid
    deviations = np.array([law.std for law in grid_laws(agent)])
    for axis, points in points_by_axis(agent, model.lattice).items() if agent.noise_scale is not None else ():
        if axis.is_logarithmic:
            deviations[axis.state] *= math.exp(points[-1])
    # Sets of errors are as wide as the widest cell.
    is_single = not model.relation.has_memory
    edges, within = [], []
    for k, own in enumerate(inner.edges):
        # Angles are not left, and lattices of states without noise number the cells that there are.
        if agent.wrapped_axes[k] or agent.still_axes[k]:
            below, above = own[:0], own[:0]
        elif is_single:
            far = FAR * deviations[k]
            below, above = own[:1] - far, own[-1:] + far
        else:
            step = float(np.max(np.diff(own))) * (1.0 - 1e-12)
            steps = step * np.arange(1, math.ceil(NEAR * deviations[k] / step) + 1)
            below, above = own[0] - steps[::-1], own[-1] + steps
        # Workspaces hold their upper faces: what is beyond begins at the next number. That makes a cell wider by as
        # much, for which probabilities of losing a relation have no room.
        is_wider = len(above) and model.delta == 0.0
        last = np.nextafter(own[-1:], np.inf) if is_wider else own[-1:]
        edges.append(np.concatenate([below, own[:-1], last, above]))
        within.append(slice(len(below), len(below) + len(own) - 1))
    if math.prod(len(own) - 1 for own in edges) > MOST_CELLS:
        raise RelationRefused(f"agent `{agent.name}`: there would be more than {MOST_CELLS} cells around its workspace")
    grid, choices = Grid(tuple(edges)), model.choices
    kinds = choices.is_additive, choices.has_corners, choices.is_read_at_length, choices.read_per_second
    return grid, choices.kernel_on(agent, grid), InnerChoices(choices, grid, tuple(within), *kinds)
