"""Finite model of every agent: grid, relation, kernel, admissible targets and labels of the cells.

``abstract`` turns a problem into one ``AgentModel`` per agent. Agents with the same dynamics and the same grid share
one model object, and with it one kernel.

Grid coordinates: the kernel is separable when the noise covariance is diagonal. An agent with a full covariance is
gridded in coordinates ``x = L x_grid`` with ``Sigma = L D L'`` (L unit lower triangular), where the noise is diagonal;
its cells are then parallelepipeds, labels and workspace are judged on their bounding boxes, and the result is a lower
bound instead of an exact value (THEORY section 1).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ..envs.agent import LinearAgent
from ..envs.problem import Problem
from .grid import FloatArray, Grid, aligned_edges
from .kernel import Kernel, gaussian_masses
from .relation import ExactRelation, exact_relation

DEFAULT_CELLS = {1: 500, 2: 80, 3: 24}
"""Cells per axis by state dimension when the caller names none; 10 from dimension 4 on."""

Cells = int | Sequence[int] | Mapping[str, int | Sequence[int]] | None


@dataclass(frozen=True, eq=False)
class AgentModel:
    """Finite model of one agent: S cells, Z lattice points (target means), a kernel between them.

    Parameters
    ----------
    grid : Grid
        Cells in grid coordinates.
    lattice : tuple of (Z_k,) arrays
        Target means per axis, in grid coordinates; a target is numbered in C order.
    relation : ExactRelation
        Interface between a target and the input of the continuous agent.
    kernel : Kernel
        Lower bounds on the cell masses around every lattice point.
    window_low, window_high : (S, d) int32 arrays
        Bounding box ``window_low <= index < window_high`` of the admissible targets of each cell.
    labels : (S,) int32 array
        Label set of each cell, an index into ``label_sets``; -1 where a point of the cell is outside the workspace.
    label_sets : (n, C) bool array
        Sets of classes of the agent that the points of one cell can have; a single class when the grid is aligned.
    """

    grid: Grid
    lattice: tuple[FloatArray, ...]
    relation: ExactRelation
    kernel: Kernel
    window_low: NDArray[np.int32]
    window_high: NDArray[np.int32]
    labels: NDArray[np.int32]
    label_sets: NDArray[np.bool_]

    @property
    def n_cells(self) -> int:
        """Number of cells S."""
        return self.grid.n_cells

    @property
    def lattice_shape(self) -> tuple[int, ...]:
        """Lattice points per axis."""
        return tuple(len(axis) for axis in self.lattice)

    @property
    def is_aligned(self) -> bool:
        """Whether every cell lies inside the workspace and has one class only, so that no value is lost at edges."""
        return bool(np.all(self.labels >= 0) and np.all(self.label_sets.sum(axis=1) == 1))

    @cached_property
    def reserve(self) -> FloatArray:
        """(S, m) input half widths left for the target in each cell."""
        return self.relation.reserve(self.grid.half_widths)

    @cached_property
    def central_means(self) -> FloatArray:
        """(S, d) mean from the cell centre under the central input."""
        return self.relation.means(self.grid.centres)

    @cached_property
    def resting_law(self) -> NDArray[np.int32]:
        """(S,) admissible target nearest to the cell itself (stay where you are); -1 where no target is admissible.

        The choice at cells, states and times for which nothing better is known; it makes every policy total.
        """
        targets = []
        for k, axis in enumerate(self.lattice):
            nearest = np.clip(np.searchsorted(axis, self.grid.centres[:, k]), 0, len(axis) - 1)
            targets.append(np.clip(nearest, self.window_low[:, k], self.window_high[:, k] - 1))
        empty = np.any(self.window_low >= self.window_high, axis=1)
        flat = np.ravel_multi_index([np.where(empty, 0, t) for t in targets], self.lattice_shape)
        admissible = ~empty & self.admissible(np.arange(self.n_cells), flat)
        return np.where(admissible, flat, -1).astype(np.int32)

    def targets(self, law: NDArray[np.integer]) -> FloatArray:
        """Coordinates (d, ...) of lattice points given by their flat index."""
        indices = np.unravel_index(law, self.lattice_shape)
        return np.stack([axis[index] for axis, index in zip(self.lattice, indices, strict=True)])

    def admissible(self, cells: NDArray[np.integer], law: NDArray[np.integer]) -> NDArray[np.bool_]:
        """Whether flat lattice point ``law`` is an admissible target of ``cells``; the two broadcast."""
        gap = np.moveaxis(self.targets(law), 0, -1) - self.central_means[cells]
        wanted = np.abs(gap @ self.relation.right_inverse.T)
        return np.all(wanted <= self.reserve[cells], axis=-1)


@dataclass(frozen=True, eq=False)
class Abstraction:
    """Finite models of all agents of a problem, in the order of its agents; equal agents share one model object."""

    models: tuple[AgentModel, ...]
    settings: Mapping[str, object]

    @property
    def is_exact(self) -> bool:
        """Whether values of this abstraction are probabilities of the continuous system, not just lower bounds."""
        return all(model.is_aligned for model in self.models)


def abstract(problem: Problem, cells: Cells = None, targets_per_cell: int = 1) -> Abstraction:
    """Finite models of the agents of ``problem`` under the ``exact`` relation.

    Parameters
    ----------
    problem : Problem
    cells : int, sequence of int, or mapping from agent name to one of these, optional
        Cells per axis. Default: 500 for scalar agents, 80 per axis for two, 24 for three dimensions.
    targets_per_cell : int
        Lattice points per cell and axis. More of them lose less of the admissible inputs to rounding.

    Raises
    ------
    ValueError
        If an agent's ``B`` lacks full row rank, its noise is singular, or a number of cells is too small.
    """
    if isinstance(targets_per_cell, bool) or not isinstance(targets_per_cell, int) or targets_per_cell < 1:
        raise ValueError(f"`targets_per_cell`: expected a positive whole number, got {targets_per_cell!r}")
    shared: dict[object, AgentModel] = {}
    models = []
    for i, agent in enumerate(problem.agents):
        grid, coordinates = _grid(problem, i, _cells_of(agent, cells))
        labels, label_sets = _label_cells(problem, i, grid, coordinates)
        key = (*(a.tobytes() for a in _identity(agent)), *(e.tobytes() for e in grid.edges), labels.tobytes(),
               label_sets.tobytes(), label_sets.shape)  # fmt: skip
        if key not in shared:
            similar = next((m for k, m in shared.items() if k[:-3] == key[:-3]), None)  # type: ignore[index]
            shared[key] = _model(agent, grid, coordinates, labels, label_sets, targets_per_cell, similar)
        models.append(shared[key])
    settings = {
        "cells": [list(m.grid.shape) for m in models],
        "targets_per_cell": targets_per_cell,
        "relation": "exact",
    }
    return Abstraction(tuple(models), settings)


def _identity(agent: LinearAgent) -> tuple[FloatArray, ...]:
    """Arrays that determine the model of an agent apart from its grid and labels."""
    box, inputs = agent.workspace, agent.input_box
    return (agent.A, agent.B, agent.offset, agent.noise_covariance, box.low, box.high, inputs.low, inputs.high)


def _model(
    agent: LinearAgent,
    grid: Grid,
    coordinates: FloatArray,
    labels: NDArray[np.int32],
    label_sets: NDArray[np.bool_],
    targets_per_cell: int,
    similar: AgentModel | None,
) -> AgentModel:
    """Model of one agent; ``similar`` has the same dynamics and grid and lends its kernel."""
    if similar is not None:
        return AgentModel(
            grid, similar.lattice, similar.relation, similar.kernel, similar.window_low, similar.window_high,
            labels, label_sets,
        )  # fmt: skip
    relation = exact_relation(agent, coordinates)
    reach = np.abs(relation.B) @ relation.input_half_width
    means = relation.means(grid.centres)
    inverse = np.linalg.inv(coordinates)
    variances = np.diag(inverse @ agent.noise_covariance @ inverse.T)
    lattice, tables, loss = [], [], 0.0
    for k, edges in enumerate(grid.edges):
        axis = _lattice_axis(edges, targets_per_cell, means[:, k].min() - reach[k], means[:, k].max() + reach[k],
                             3.0 * np.sqrt(variances[k]))  # fmt: skip
        table, missing = gaussian_masses(axis, edges, float(np.sqrt(variances[k])))
        lattice.append(axis)
        tables.append(table)
        loss += missing
    window_low, window_high = _windows(relation, grid, tuple(lattice), means)
    return AgentModel(
        grid, tuple(lattice), relation, Kernel(tuple(tables), loss), window_low, window_high, labels, label_sets
    )


def _windows(
    relation: ExactRelation, grid: Grid, lattice: tuple[FloatArray, ...], means: FloatArray
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Index boxes (S, d) around the admissible targets of each cell; empty where the input reserve is used up.

    ``z - mean = B v`` with ``|v|_j <= reserve_j`` bounds each axis; for a scaled permutation the box is the window.
    """
    reserve = relation.reserve(grid.half_widths)
    reach = np.maximum(reserve, 0.0) @ np.abs(relation.B).T
    low = np.empty(means.shape, dtype=np.int32)
    high = np.empty(means.shape, dtype=np.int32)
    for k, axis in enumerate(lattice):
        low[:, k] = np.searchsorted(axis, means[:, k] - reach[:, k], side="left")
        high[:, k] = np.searchsorted(axis, means[:, k] + reach[:, k], side="right")
    if relation.is_box:
        # the comparison above rounds; the admissible ones are decided by the same inequality everywhere
        _trim(relation, means, reserve, lattice, low, high)
    high = np.where(np.any(reserve < 0, axis=1)[:, None], low, high)
    return low, high


def _trim(
    relation: ExactRelation,
    means: FloatArray,
    reserve: FloatArray,
    lattice: tuple[FloatArray, ...],
    low: NDArray[np.int32],
    high: NDArray[np.int32],
) -> None:
    """Shrink box windows by one point wherever their first or last one misses the input reserve by rounding."""
    for k, axis in enumerate(lattice):
        j = int(np.flatnonzero(relation.right_inverse[:, k])[0])
        gain = abs(relation.right_inverse[j, k])
        for index, step in ((low, 1), (high, -1)):
            edge = np.clip(index[:, k] if step == 1 else index[:, k] - 1, 0, len(axis) - 1)
            index[:, k] += step * (np.abs(axis[edge] - means[:, k]) * gain > reserve[:, j])


def _lattice_axis(edges: FloatArray, per_cell: int, lowest: float, highest: float, beyond: float) -> FloatArray:
    """Target means of one axis: ``per_cell`` per cell, continued outside the grid as far as means can get (3 sigma)."""
    widths = np.diff(edges)
    offsets = (np.arange(per_cell) + 0.5) / per_cell
    inside = (edges[:-1, None] + widths[:, None] * offsets).ravel()
    first, last = widths[0] / per_cell, widths[-1] / per_cell
    below = int(np.ceil(max(0.0, min(edges[0] - lowest, beyond)) / first))
    above = int(np.ceil(max(0.0, min(highest - edges[-1], beyond)) / last))
    return np.concatenate(
        [inside[0] - first * np.arange(below, 0, -1), inside, inside[-1] + last * np.arange(1, above + 1)]
    )


def _grid(problem: Problem, i: int, cells: tuple[int, ...]) -> tuple[Grid, FloatArray]:
    """Grid of agent i and its coordinates (d, d)."""
    agent = problem.agents[i]
    coordinates = _noise_coordinates(agent)
    inverse = np.linalg.inv(coordinates)
    centre = 0.5 * (agent.workspace.low + agent.workspace.high)
    half = 0.5 * (agent.workspace.high - agent.workspace.low)
    if np.array_equal(coordinates, np.eye(agent.n_states)):
        low, high = agent.workspace.low, agent.workspace.high
    else:
        middle, reach = inverse @ centre, np.abs(inverse) @ half
        low, high = middle - reach, middle + reach
    edges = []
    for k in range(agent.n_states):
        boundaries = _boundaries(problem, i, k) if np.count_nonzero(coordinates[k]) == 1 else []
        edges.append(aligned_edges(float(low[k]), float(high[k]), cells[k], boundaries))
    return Grid(tuple(edges)), coordinates


def _noise_coordinates(agent: LinearAgent) -> FloatArray:
    """Unit lower triangular L with ``Sigma = L D L'``; the identity for a diagonal covariance."""
    covariance = agent.noise_covariance
    smallest = float(np.min(np.linalg.eigvalsh(covariance)))
    if smallest <= 1e-12 * float(np.max(np.diag(covariance))):
        raise ValueError(
            f"agent `{agent.name}`: the exact relation needs a positive definite `noise_covariance`, got the smallest "
            f"eigenvalue {smallest:.3g}; give every state some noise"
        )
    if np.count_nonzero(covariance - np.diag(np.diag(covariance))) == 0:
        return np.eye(agent.n_states)
    factor = np.linalg.cholesky(covariance)
    return np.tril(factor / np.diag(factor))


def _boundaries(problem: Problem, i: int, axis: int) -> list[float]:
    """Region boundaries of agent i that are hyperplanes of one state coordinate."""
    agent = problem.agents[i]
    found = []
    for proposition in problem.propositions.values():
        if proposition.agent != agent.name:
            continue
        for row, low, high in zip(agent.output_matrix, proposition.low, proposition.high, strict=True):
            if np.count_nonzero(row) == 1 and row[axis] != 0:
                found += [float(low / row[axis]), float(high / row[axis])]
    return found


def _label_cells(
    problem: Problem, i: int, grid: Grid, coordinates: FloatArray
) -> tuple[NDArray[np.int32], NDArray[np.bool_]]:
    """Label set of each cell (-1: may be outside the workspace) and the distinct sets that occur."""
    agent = problem.agents[i]
    low, high = grid.low, grid.high
    outside = np.zeros(grid.n_cells, dtype=bool)
    if not np.array_equal(coordinates, np.eye(agent.n_states)):
        centre, reach = grid.centres @ coordinates.T, grid.half_widths @ np.abs(coordinates).T
        slack = 1e-12 * (np.abs(centre) + reach)
        low, high = centre - reach - slack, centre + reach + slack
        outside = np.any((low < agent.workspace.low) | (high > agent.workspace.high), axis=1)
    possible = problem.labeling.box_classes(i, low, high)
    label_sets, labels = np.unique(possible[~outside], axis=0, return_inverse=True)
    if len(label_sets) == 0:
        raise ValueError(f"agent `{agent.name}`: no cell lies inside the workspace; ask for more `cells`")
    every = np.full(grid.n_cells, -1, dtype=np.int32)
    every[~outside] = labels.ravel()
    return every, label_sets.astype(bool)


def _cells_of(agent: LinearAgent, cells: Cells) -> tuple[int, ...]:
    """Cells per axis of one agent."""
    wanted = cells.get(agent.name) if isinstance(cells, Mapping) else cells
    if wanted is None:
        wanted = DEFAULT_CELLS.get(agent.n_states, 10)
    per_axis = tuple(wanted) if isinstance(wanted, Sequence) else (wanted,) * agent.n_states
    whole = all(isinstance(n, int | np.integer) and not isinstance(n, bool) and n >= 1 for n in per_axis)
    if len(per_axis) != agent.n_states or not whole:
        raise ValueError(
            f"`cells`: expected a positive whole number or {agent.n_states} of them for agent `{agent.name}`, "
            f"got {wanted!r}"
        )
    return tuple(int(n) for n in per_axis)
