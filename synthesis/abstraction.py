"""Finite model of every agent: grid, relation, kernel, choices and labels of the cells.

``abstract`` turns a problem into one ``AgentModel`` per agent. Agents with the same dynamics and the same grid share
kernel and choices, and with the same labels the model object itself.

Grid coordinates: the kernel is separable when the noise covariance is diagonal. An agent with a full covariance is
gridded in coordinates ``x = L x_grid`` with ``Sigma = L D L'`` (L unit lower triangular), where the noise is diagonal;
its cells are then parallelepipeds, labels and workspace are judged on their bounding boxes, and the result is a lower
bound instead of an exact value (THEORY section 1).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from inspect import signature

import numpy as np

from ..envs.agent import LinearAgent
from ..envs.problem import Problem, checked_problem
from .agent_models import (
    Bare,
    Relation,
    cheapest_model,
    ellipsoid_model,
    exact_model,
    paper_model,
    tube_model,
)
from .choices import Choices
from .grid import FloatArray, Grid, aligned_edges
from .kernel import Kernel
from .labels import CellLabels, cell_labels, error_labels
from .relation_coupled import CoupledRelation
from .relation_exact import ExactRelation

DEFAULT_CELLS = {1: 500, 2: 80, 3: 24}
"""Cells per axis by state dimension when the caller names none; 10 from dimension 4 on."""

NEAREST = 0.1
"""Share of the room in a region that a start near its face leaves at least, where feedbacks are chosen."""

Cells = int | Sequence[int] | Mapping[str, int | Sequence[int]] | None
RELATIONS = ("auto", "exact", "ellipsoid", "paper", "tube")


@dataclass(frozen=True, eq=False)
class AgentModel:
    """Finite model of one agent: S cells, Z lattice points (means), a kernel between them.

    Parameters
    ----------
    grid : Grid
        Cells in grid coordinates.
    lattice : tuple of (Z_k,) arrays
        Means per axis, in grid coordinates; a point is numbered in C order.
    relation : Relation
        How the continuous agent follows the finite one, and how surely.
    kernel : Kernel
        Lower bounds on the cell masses around every lattice point.
    choices : Choices
        What can be chosen in each cell.
    labels : CellLabels
        Label set of each cell, for arriving in it.
    start_labels : CellLabels
        Label set of the points of each cell, for starting in it.
    """

    grid: Grid
    lattice: tuple[FloatArray, ...]
    relation: Relation
    kernel: Kernel
    choices: Choices
    labels: CellLabels
    start_labels: CellLabels

    @property
    def n_cells(self) -> int:
        """Number of cells S."""
        return self.grid.n_cells

    @property
    def delta(self) -> float:
        """Upper bound on the probability, per step, that the relation is lost."""
        return self.relation.delta

    @property
    def is_exact(self) -> bool:
        """Whether nothing at all is lost: exact relation, one certain class per cell."""
        return isinstance(self.relation, ExactRelation) and self.labels.is_certain


@dataclass(frozen=True, eq=False)
class Abstraction:
    """Finite models of all agents of a problem, in the order of its agents, and the settings they were made with."""

    models: tuple[AgentModel, ...]
    settings: Mapping[str, object]

    @property
    def is_exact(self) -> bool:
        """Whether values of this abstraction are probabilities of the continuous system, not just lower bounds."""
        return all(model.is_exact for model in self.models)


def abstract(
    problem: Problem,
    cells: Cells = None,
    *,
    relation: str = "auto",
    targets_per_cell: int | None = None,
    epsilon: float = 0.1,
    feedback: float = 0.0,
    inputs: int = 10,
    delta: float | None = None,
    share: float | None = None,
) -> Abstraction:
    """Finite models of the agents of ``problem``.

    Parameters
    ----------
    problem : Problem
    cells : int, sequence of int, or mapping from agent name to one of these, optional
        Cells per axis. Default: 500 for scalar agents, 80 per axis for two, 24 for three dimensions.
    relation : str
        ``"exact"``: B of full row rank, delta = 0. ``"tube"``: stabilisable agents, delta = 0. ``"ellipsoid"``: any
        agent that some ellipsoid can be found for, delta >= 0 (needs the extra ``lmi``). ``"paper"``: scalar agents,
        delta >= 0 in closed form. ``"auto"``: for each agent ``exact`` where it applies and the inputs are strong
        enough for the cells, else ``tube``.
    targets_per_cell : int
        ``exact``: lattice points per cell and axis; more of them lose less of the admissible inputs to rounding.
        Default: 2 for scalar agents, 1 for others.
    epsilon, feedback, inputs
        ``paper``: half width of the relation, K of the interface, number of abstract inputs.
    delta : float, optional
        ``paper``: a failure probability to be used instead of the (smaller) closed form. ``ellipsoid``: the largest
        failure probability per step and agent, in [0, 1), default 0; more of it makes labels and inputs lose less.
    share : float, optional
        ``ellipsoid``: share of the inputs that the feedback may use, in [0, 1); default: chosen (``ellipsoid_search``).

    Raises
    ------
    ValueError
        If the relation does not apply to an agent, or a number is out of range.
    """
    checked_problem(problem)
    _check_cells(cells, problem)
    number = 1 if targets_per_cell is None else targets_per_cell
    if isinstance(number, bool) or not isinstance(number, int) or number < 1:
        raise ValueError(f"`targets_per_cell`: expected a positive whole number, got {targets_per_cell!r}")
    if relation not in RELATIONS:
        raise ValueError(f"`relation`: expected one of {', '.join(RELATIONS)}, got {relation!r}")
    for name, value, allowed in (("delta", delta, ("ellipsoid", "paper")), ("share", share, ("ellipsoid",))):
        if value is not None and relation not in allowed:
            raise ValueError(f"`{name}`: expected none with relation `{relation}`, got {value!r}; ask for `ellipsoid`")
    paper = {"epsilon": epsilon, "feedback": feedback, "inputs": inputs, "delta": delta}
    bare: dict[object, Bare] = {}
    shared: dict[object, Bare] = {}
    whole: dict[object, AgentModel] = {}
    models = []
    for i, agent in enumerate(problem.agents):
        grid, coordinates = _grid(problem, i, _cells_of(agent, cells))
        room = _label_room(problem, i)
        alike = (*(a.tobytes() for a in _identity(agent)), *(e.tobytes() for e in grid.edges))
        minds_room = relation in ("tube", "ellipsoid") or np.linalg.matrix_rank(agent.B) < agent.n_states
        same = (*alike, room.tobytes() if minds_room else b"")
        if same not in bare:
            per_cell = targets_per_cell or (2 if agent.n_states == 1 else 1)
            if relation == "auto":
                found = cheapest_model(agent, grid, coordinates, per_cell, room)
            elif relation == "exact":
                found = exact_model(agent, grid, coordinates, per_cell)
            elif relation == "tube":
                found = tube_model(agent, grid, coordinates, room)
            elif relation == "ellipsoid":
                found = ellipsoid_model(agent, grid, coordinates, room, 0.0 if delta is None else delta, share)
            else:
                found = paper_model(agent, grid, paper)
            numbers = (*alike, *(a.tobytes() for a in found[0].arrays))
            bare[same] = shared.setdefault(numbers, found)  # rooms that differ often lead to the same relation
        start_labels = cell_labels(problem, i, grid, coordinates)
        labels = start_labels
        follows = bare[same][0]
        if isinstance(follows, CoupledRelation) and not follows.is_cell:
            labels = error_labels(problem, i, grid, coordinates, follows.state_reach)
        key = (id(bare[same]), labels.key, start_labels.key)
        if key not in whole:
            _, lattice, kernel, choices = bare[same]
            whole[key] = AgentModel(grid, lattice, follows, kernel, choices, labels, start_labels)
        models.append(whole[key])
    used: dict[str, object] = {"targets_per_cell": targets_per_cell}
    if relation in ("paper", "ellipsoid"):
        used = dict(paper) if relation == "paper" else {"delta": delta, "share": share}
    kinds = "/".join(sorted({model.relation.kind for model in models}))
    settings = {"relation": kinds, "cells": [list(m.grid.shape) for m in models], **used}
    return Abstraction(tuple(models), settings)


def _check_cells(cells: Cells, problem: Problem) -> None:
    """Refuse names that no agent has; agents that are left out get the default."""
    for name in cells if isinstance(cells, Mapping) else ():
        if name not in problem.agent_names:
            known = ", ".join(problem.agent_names[:8])
            raise ValueError(f"`cells`: expected names of agents among {known}, got {name!r}; correct the name")


def check_settings(settings: Mapping[str, object]) -> None:
    """Refuse settings of a relation that ``abstract`` does not have, with the nearest one that it has."""
    known = [*signature(abstract).parameters][2:]
    for name in settings:
        if name not in known:
            close = get_close_matches(name, ["cells", *known, "max_sweeps", "limits", "progress"], n=1)
            remedy = f"did you mean `{close[0]}`?" if close else f"settings are {', '.join(known)}"
            raise ValueError(f"`{name}`: expected a setting of the relation, got an unknown one; {remedy}")


def _identity(agent: LinearAgent) -> tuple[FloatArray, ...]:
    """Arrays that determine the model of an agent apart from its grid and labels."""
    box, inputs = agent.workspace, agent.input_box
    return (agent.A, agent.B, agent.offset, agent.noise_covariance, box.low, box.high, inputs.low, inputs.high)


def _grid(problem: Problem, i: int, cells: tuple[int, ...]) -> tuple[Grid, FloatArray]:
    """Grid of agent i and its coordinates (d, d)."""
    agent = problem.agents[i]
    coordinates = _noise_coordinates(agent)
    if np.array_equal(coordinates, np.eye(agent.n_states)):
        low, high = agent.workspace.low, agent.workspace.high
    else:
        inverse = np.linalg.inv(coordinates)
        centre = 0.5 * (agent.workspace.low + agent.workspace.high)
        middle, reach = inverse @ centre, np.abs(inverse) @ (0.5 * (agent.workspace.high - agent.workspace.low))
        low, high = middle - reach, middle + reach
    edges = []
    for k in range(agent.n_states):
        boundaries = region_boundaries(problem, i, k) if np.count_nonzero(coordinates[k]) == 1 else []
        edges.append(aligned_edges(float(low[k]), float(high[k]), cells[k], boundaries))
    return Grid(tuple(edges)), coordinates


def _noise_coordinates(agent: LinearAgent) -> FloatArray:
    """Unit lower triangular L with ``Sigma = L D L'``; the identity for a diagonal covariance."""
    covariance = agent.noise_covariance
    smallest = float(np.min(np.linalg.eigvalsh(covariance)))
    if smallest <= 1e-12 * float(np.max(np.diag(covariance))):
        raise ValueError(
            f"agent `{agent.name}`: the abstraction needs a positive definite `noise_covariance`, got the smallest "
            f"eigenvalue {smallest:.3g}; give every state some noise"
        )
    if np.count_nonzero(covariance - np.diag(np.diag(covariance))) == 0:
        return np.eye(agent.n_states)
    factor = np.linalg.cholesky(covariance)
    return np.asarray(np.tril(factor / np.diag(factor)))


def region_boundaries(problem: Problem, i: int, axis: int) -> list[float]:
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


def _label_room(problem: Problem, i: int) -> FloatArray:
    """Half width (d,), per state of agent i, of its narrowest region along that state, or of the workspace.

    A start near a face of the workspace, or of a region that it lies in, counts as less room.
    """
    agent = problem.agents[i]
    room = 0.5 * (agent.workspace.high - agent.workspace.low)
    near = np.minimum(agent.initial.low - agent.workspace.low, agent.workspace.high - agent.initial.high)
    for proposition in problem.propositions.values():
        if proposition.agent != agent.name:
            continue
        for row, low, high in zip(agent.output_matrix, proposition.low, proposition.high, strict=True):
            if np.count_nonzero(row) == 1:
                k = int(np.flatnonzero(row)[0])
                inside = np.clip(
                    np.sort([low / row[k], high / row[k]]), agent.workspace.low[k], agent.workspace.high[k]
                )
                if inside[1] > inside[0]:
                    room[k] = min(room[k], 0.5 * float(inside[1] - inside[0]))
                    left = min(agent.initial.low[k] - inside[0], inside[1] - agent.initial.high[k])
                    near[k] = min(near[k], left) if left >= 0 else near[k]
    return np.asarray(np.minimum(room, np.maximum(near, NEAREST * room)))


def _cells_of(agent: LinearAgent, cells: Cells) -> tuple[int, ...]:
    """Cells per axis of one agent."""
    wanted = cells.get(agent.name) if isinstance(cells, Mapping) else cells
    if wanted is None:
        wanted = DEFAULT_CELLS.get(agent.n_states, 10)
    per_axis = tuple(wanted) if isinstance(wanted, Sequence) else (wanted,) * agent.n_states
    whole = all(isinstance(n, int | np.integer) and not isinstance(n, bool) and n >= 1 for n in per_axis)
    if len(per_axis) != agent.n_states or not whole:
        raise ValueError(
            f"`cells`: expected a positive whole number or {agent.n_states} of them (cells per axis) for agent "
            f"`{agent.name}`, got {wanted!r}"
        )
    return tuple(int(n) for n in per_axis)
