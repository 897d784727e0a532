"""Finite models of agents that networks move, under the relation ``linear``: choices are the modes of the network."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ....envs.tasks.problem import Problem
from ...relations.grids import (
    CellCounts,
    RelationRefused,
    agent_grid,
    cell_labels,
    cells_of_agent,
    refuse_angles,
    refuse_shared_noise,
    refuse_uneven_noise,
)
from ...relations.kinds import ON_CELLS, NetworkPolicy, network_linear_relation
from .action_tables import Policies
from .corner_model import lattice_model
from .finite_models import Abstraction, AgentModel

DEFAULT_CELLS = {1: 1000, 2: 100}
"""Cells per axis by dimension: more than elsewhere, since networks bend within cells and are cheap to enclose."""


def network_abstraction(
    problem: Problem,
    policies: Sequence[NetworkPolicy],
    cells: CellCounts = None,
    targets_per_cell: int | None = None,
) -> Abstraction:
    """Return finite models of agents that networks move.

    Parameters
    ----------
    problem : Problem
    policies : sequence of NetworkPolicy
        One per agent.
    cells : int, sequence of int or mapping from agent name, optional
        Cells per axis. Default: 1000 for scalar agents, 100 per axis for two dimensions, 24 for three.
    targets_per_cell : int, optional
        Lattice points per cell and axis at which values are read; by default as many as noise and cells ask for.

    Raises
    ------
    ValueError
        If there are too many maps, or noise has laws, or states are angles, that linear cells do not support.
    """
    models = []
    refuse_shared_noise(problem)
    for i, policy in enumerate(policies):
        try:
            models.append(_network_model(problem, i, policy, cells, targets_per_cell))
        except RelationRefused as refused:
            # Linear cells would name other relations; networks have the trajectory instead.
            why = str(refused).partition("; ask for")[0]
            raise RelationRefused(f"{why}; without `cells` a network is certified along its trajectory") from None
    settings: dict[str, object] = {
        "relation": "linear",
        "cells": [list(model.grid.shape) for model in models],
        "targets_per_cell": targets_per_cell,
        "raw": True,
    }
    return Abstraction(tuple(models), settings)


def _network_model(
    problem: Problem, i: int, policy: NetworkPolicy, cells: CellCounts, targets_per_cell: int | None
) -> AgentModel:
    """Return the finite model of an agent that a network moves."""
    agent = problem.agents[i]
    if policy.network.activation not in ON_CELLS:
        raise RelationRefused(f"networks on cells have {' or '.join(ON_CELLS)}, got {policy.network.activation}")
    refuse_angles(agent, "linear")
    refuse_uneven_noise(agent, "linear")
    asked = DEFAULT_CELLS.get(agent.n_states) if cells is None else cells
    grid = agent_grid(problem, i, cells_of_agent(agent, asked))
    labels = cell_labels(problem, i, grid)
    going = policy.modes_in(problem.automaton.n_states)[0, ~problem.automaton.absorbing]
    idle = np.setdiff1d(np.arange(policy.view.states), going).tolist()
    maps = network_linear_relation(agent, policy, 1, (0,) * agent.n_states, idle)
    relation, lattice, kernel, choices = lattice_model(agent, grid, maps, targets_per_cell)
    return AgentModel(grid, lattice, relation, kernel, choices, labels, labels)


def network_tables(problem: Problem, abstraction: Abstraction) -> Policies:
    """Return the policy tables (T, Q, S) of the networks: every cell does what the network does."""
    tables = []
    for model in abstraction.models:
        modes = model.relation.network.modes_in(problem.automaton.n_states)
        tables.append(np.repeat(modes[..., None], model.grid.n_cells, axis=2))
    return tuple(tables)
