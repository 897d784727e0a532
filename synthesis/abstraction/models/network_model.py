"""Finite models of agents that networks move, under the relations ``linear`` and ``boxes``.

The choices are the modes of the network. Under ``linear`` there are no others. Under ``boxes`` there may be the inputs
that the relation offers by default: with these a network can be repaired where it is poor.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from ....envs.systems.agents import AnyAgent
from ....envs.tasks.problem import Problem
from ...relations.grids import (
    CellCounts,
    FloatArray,
    Grid,
    RelationRefused,
    agent_grid,
    cell_labels,
    cells_of_agent,
    refuse_angles,
    refuse_shared_noise,
    refuse_uneven_noise,
)
from ...relations.kinds import ON_CELLS, BoxRelation, NetworkPolicy, box_relation, network_linear_relation
from .action_tables import Policies, StepPolicy
from .box_choices import BoxChoices
from .box_model import MOST_CUTS, PARTS, box_model, relation_of
from .corner_model import CUTS, lattice_model
from .finite_models import Abstraction, AgentModel

DEFAULT_CELLS = {1: 1000, 2: 100}
"""Cells per axis by dimension: more than elsewhere, since networks bend within cells and are cheap to enclose."""

LEAST_SHRINKAGE = 0.1
"""By how much boxes must shrink, on average, for cells to be cut into more parts."""

SAMPLED_CELLS = 200
"""Cells by which that is judged, in all modes."""

WORTHWHILE = 1e-9
"""Share by which another choice must be better than the network to count: far above rounding."""


@dataclass(frozen=True, eq=False, repr=False)
class NetworkChoices(BoxChoices):
    """The modes of a network, and inputs to repair it with.

    Parameters
    ----------
    n_modes : int
        The first choices are modes, each for one time and automaton state.
    """

    n_modes: int

    def best(self, weights: FloatArray, table: FloatArray, incumbent: StepPolicy) -> StepPolicy:
        """Return the incumbents (S,), modes of this time, where they are best, and the best inputs elsewhere.

        Modes of other times are not on offer.
        """
        if np.all(incumbent < 0):
            return incumbent  # nothing is left to decide
        weights = np.broadcast_to(weights, (len(incumbent), len(table)))
        other = self._beside(int(incumbent.max())).best(weights, table, np.full(len(incumbent), -1, dtype=np.int32))
        worth = [np.einsum("sn,ns->s", weights, self.read(table, choice)) for choice in (incumbent, other)]
        better = (other >= 0) & (worth[1] > worth[0] * (1.0 + WORTHWHILE))
        return np.where(better, other, incumbent).astype(np.int32)

    def _beside(self, mode: int) -> BoxChoices:
        """Return the same choices without the modes; where there is a clock, those that set it as a mode does."""
        size, input_set = self.size.copy(), self.relation.input_set
        size[:, : self.n_modes] = -1
        if self.relation.network.has_clock:
            size[:, input_set[:, -1] != input_set[mode, -1]] = -1
        shared = {field.name: getattr(self, field.name) for field in fields(BoxChoices)}
        return BoxChoices(**{**shared, "size": size})


def network_abstraction(
    problem: Problem,
    policies: Sequence[NetworkPolicy],
    cells: CellCounts = None,
    targets_per_cell: int | None = None,
    relation: str = "linear",
    with_menu: bool = False,
) -> Abstraction:
    """Return finite models of agents that networks move.

    Parameters
    ----------
    problem : Problem
        With agents whose dynamics are matrices for ``linear``; any for ``boxes``.
    policies : sequence of NetworkPolicy
        One per agent.
    cells : int, sequence of int or mapping from agent name, optional
        Cells per axis. Default: 1000 for scalar agents, 100 per axis for two dimensions, 24 for three.
    targets_per_cell : int, optional
        Lattice points per cell and axis at which values are read; by default as many as noise and cells ask for.
    relation : "linear" or "boxes"
        Affine maps with what they leave, or boxes around means.
    with_menu : bool
        Whether inputs are offered besides the modes, which needs ``boxes``.

    Raises
    ------
    ValueError
        If the relation is ``linear`` and the dynamics of an agent are not, if there are too many boxes or maps, or if
        its noise has laws that the relation does not know.
    """
    models = []
    refuse_shared_noise(problem)
    for i, (agent, policy) in enumerate(zip(problem.agents, policies, strict=True)):
        if policy.network.activation not in ON_CELLS:
            raise RelationRefused(
                f"networks with {policy.network.activation} are certified along their run without noise alone; on "
                f"cells they have {' or '.join(ON_CELLS)}"
            )
        if relation == "linear":
            refuse_angles(agent, relation)
            refuse_uneven_noise(agent, relation)
        asked = DEFAULT_CELLS.get(agent.n_states) if cells is None else cells
        grid, coordinates = agent_grid(problem, i, cells_of_agent(agent, asked))
        labels = cell_labels(problem, i, grid, coordinates)
        if relation == "linear":
            going = policy.modes_in(problem.automaton.n_states)[0, ~problem.automaton.absorbing]
            idle = np.setdiff1d(np.arange(policy.view.states), going).tolist()
            # What matrices leave is what the network leaves, in parts of a cell hardly less; expressions leave more.
            cuts = 1 if agent.is_affine else CUTS.get(agent.n_states, 1)
            maps = network_linear_relation(agent, coordinates, policy, (1, cuts, (0,) * agent.n_states), idle)
            affine = lattice_model(agent, grid, maps, targets_per_cell)
            models.append(AgentModel(grid, affine[1], affine[0], affine[2], affine[3], labels, labels))
            continue
        boxes = network_relation(agent, grid, coordinates, policy, with_menu)
        parts = box_model(agent, grid, coordinates, targets_per_cell, boxes)
        shared = {field.name: getattr(parts[3], field.name) for field in fields(BoxChoices)}
        choices = NetworkChoices(**{**shared, "n_times": 1}, n_modes=policy.n_modes)
        models.append(AgentModel(grid, parts[1], boxes, parts[2], choices, labels, labels))
    settings: dict[str, object] = {
        "relation": relation,
        "cells": [list(model.grid.shape) for model in models],
        "targets_per_cell": targets_per_cell,
        "raw": True,
    }
    return Abstraction(tuple(models), settings)


def network_relation(
    agent: AnyAgent, grid: Grid, coordinates: FloatArray, policy: NetworkPolicy, with_menu: bool
) -> BoxRelation:
    """Return the relation of boxes whose first choices are the modes of a network.

    Cells are cut into as many parts as make boxes noticeably smaller: where the network bends within a cell.
    """
    input_set = policy.idle_menu
    gains = np.zeros((len(input_set), agent.n_inputs, agent.n_states))
    if with_menu:
        offered = relation_of(agent, grid, coordinates)
        plain = ~np.array(offered.means.description.get("steer") or [False] * len(offered.input_set), dtype=bool)
        input_set = np.concatenate([input_set, offered.input_set[plain]])
        gains = np.concatenate([gains, offered.gains[plain]])
    some = np.unique(np.linspace(0, grid.n_cells - 1, SAMPLED_CELLS).astype(np.int64))
    best, width = None, np.inf
    for parts in (number for number in PARTS if number**agent.n_states <= MOST_CUTS):
        written = {"network": policy.description, "parts": parts}
        relation = box_relation(agent, coordinates, input_set, gains, written)
        boxes = relation.mean_boxes(grid.low[some], grid.high[some])
        mean = float(np.mean((boxes.high - boxes.low)[:, : policy.n_modes] / np.mean(grid.half_widths, axis=0)))
        if not mean < width * (1.0 - LEAST_SHRINKAGE):
            break
        best, width = relation, mean
    assert best is not None
    return best


def network_tables(problem: Problem, abstraction: Abstraction) -> Policies:
    """Return the policy tables (T, Q, S) of the networks: every cell does what the network does."""
    tables = []
    for model in abstraction.models:
        modes = model.relation.network.modes_in(problem.automaton.n_states)
        tables.append(np.repeat(modes[..., None], model.grid.n_cells, axis=2))
    return tuple(tables)
