"""Finite model of every agent: grid, relation, kernel, choices and labels of the cells.

``abstraction_of`` turns a problem into one ``AgentModel`` per agent. Agents with the same dynamics and the same grid
share kernel and choices; those with the same labels, too, share the model object itself.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....envs.systems.agents import AnyAgent
from ....envs.systems.arguments import checked_count, counted, near, tree_text
from ....envs.tasks.problem import Problem
from ...relations.grids import (
    DEFAULT_TARGETS,
    CellCounts,
    CellLabels,
    FloatArray,
    Grid,
    RelationRefused,
    agent_grid,
    alike_text,
    cell_labels,
    cells_of_agent,
    error_labels,
    hat_share,
    linear_agent,
    of_cells,
    refuse_angles,
    refuse_shared_noise,
    refuse_uneven_noise,
    shape_text,
    spread,
)
from ...relations.kinds import GONE, Relation
from ..kernels import Kernel
from .action_tables import ActionTable, shifted
from .agent_models import (
    STRANDED_CELLS,
    SharedModel,
    exact_model,
    paper_model,
    reaches_every_mean,
)
from .box_model import box_model
from .corner_model import corner_model

Relations = str | Mapping[str, str]
"""Relation of all agents, or of each by its name."""

RELATIONS = ("auto", "boxes", "exact", "linear", "paper", "quick")
"""Relations that can be asked for."""

TIME_REFUSAL = (
    "`problem`: expected one that is the same at every step, got one whose dynamics or regions name the time `t`, of "
    "which finite models know nothing; `synthesize`, `check`, `validate`, `rollout` and `report` know it"
)
"""What is said where only problems without the time have finite models."""


@dataclass(frozen=True, eq=False, repr=False)
class AgentModel:
    """Finite model of one agent: S cells, Z lattice points (means), a kernel between them.

    Parameters
    ----------
    grid : Grid
        Cells.
    lattice : tuple of (Z_k,) arrays
        Means per axis; a point is numbered in C order.
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
    choices: ActionTable
    labels: CellLabels
    start_labels: CellLabels

    def __repr__(self) -> str:
        rows = [
            ("grid", self.grid),
            ("delta", f"at most {self.delta:.3g} per step"),
            ("kernel", self.kernel),
            ("choices", self.choices),
            ("labels", self.labels),
        ]
        return tree_text(f"AgentModel: {self.relation.kind} relation", rows)

    @property
    def n_cells(self) -> int:
        """Number of places at which factors have values: the cells S, or their 2^d S corners (``linear``)."""
        return math.prod(self.kernel.shape)

    def offered(self, time: int) -> tuple[ActionTable, int]:
        """Return what may be chosen at a step, and the number of the first of these choices."""
        if self.choices.n_times == 1:
            return self.choices, 0
        now = self.choices.at_times[time]
        return now, time * now.n_choices

    def resting_at(self, time: int) -> NDArray[np.int32]:
        """Return the choices (S,) that stay nearest to each cell at a step; -1 where there are none."""
        choices, first = self.offered(time)
        return shifted(choices.resting_choice, first)

    def resting_policy(self, horizon: int) -> NDArray[np.int32]:
        """Return these choices (T, S) for every step."""
        return np.array([self.resting_at(time) for time in range(horizon)])

    @property
    def is_linear(self) -> bool:
        """Whether factors are multilinear in every cell, with values at its corners."""
        return self.choices.has_corners

    @property
    def is_additive(self) -> bool:
        """Whether a step takes a sum of factors to the sum of what it takes each to.

        Where it takes least values (``boxes``) or what bends (``linear``), a sum is worth more than its terms: these
        are lower bounds one by one, for nonnegative factors alone.
        """
        return self.choices.is_additive

    def spread(self, numbers: NDArray[Any]) -> NDArray[Any]:
        """Return numbers of cells (.., S) at all places of factors."""
        return spread(numbers, self.grid.shape) if self.is_linear else numbers

    def of_cells(self, numbers: NDArray[Any]) -> NDArray[Any]:
        """Return numbers of cells (.., S) that were spread to all places."""
        return of_cells(numbers, self.grid.shape)[..., 0] if self.is_linear else numbers

    def summed(self, masses: NDArray[Any]) -> NDArray[Any]:
        """Return the masses (.., S) of cells from those of all places."""
        return of_cells(masses, self.grid.shape).sum(axis=-1) if self.is_linear else masses

    def share(self, low: FloatArray, high: FloatArray) -> FloatArray:
        """Return the weight of every place under a start that is uniform on a box, or a point, of states."""
        if not self.is_linear:
            return self.grid.overlap(low, high)
        return hat_share(self.grid, low, high)

    @property
    def delta(self) -> float:
        """Upper bound on the probability, per step, that the relation is lost."""
        return self.relation.delta

    @property
    def is_exact(self) -> bool:
        """Whether nothing is lost: exact relation, and one certain class per cell."""
        return self.relation.kind == "exact" and self.labels.is_certain


@dataclass(frozen=True, eq=False, repr=False)
class Abstraction:
    """Finite models of all agents of a problem, in the order of its agents, and the settings they were made with."""

    models: tuple[AgentModel, ...]
    settings: Mapping[str, object]

    def __repr__(self) -> str:
        different = {id(model): model for model in self.models}
        exact = all(model.is_exact for model in different.values())
        rows: list[tuple[str, object]] = [
            ("relation", alike_text(model.relation.kind for model in self.models)),
            ("cells", alike_text(shape_text(model.grid.shape) for model in self.models)),
            ("lattice", alike_text(shape_text(model.kernel.lattice_shape) for model in self.models)),
            ("delta", f"at most {max(model.delta for model in self.models):.3g} per step and agent"),
            ("values", "exact" if exact else "lower bounds"),
            ("distinct", counted(len(different), "model")),
        ]
        return tree_text(f"Abstraction: {counted(len(self.models), 'agent')}", rows)

    @property
    def is_exact(self) -> bool:
        """Whether values of this abstraction are probabilities of the continuous system, not only lower bounds."""
        return all(model.is_exact for model in self.models)


@dataclass(frozen=True)
class Settings:
    """Settings of relations.

    Parameters
    ----------
    targets_per_cell : int, optional
        ``exact``: lattice points per cell and axis; with more of them rounding wastes fewer of the admissible inputs.
        Default: 2 for agents of one or two states, 1 for others. ``linear``, ``boxes``: points at which values are
        read; by default 4, and as many as noise and cells ask for.
    epsilon, feedback, inputs
        ``paper``: half width of the relation, K of the interface, number of abstract inputs.
    delta : float, optional
        ``paper``: a failure probability to be used in place of the (smaller) closed form, in [0, 1).

    Raises
    ------
    ValueError
        If a number is out of range.
    """

    targets_per_cell: int | None = None
    epsilon: float = 0.1
    feedback: float = 0.0
    inputs: int = 10
    delta: float | None = None

    def __post_init__(self) -> None:
        if self.targets_per_cell is not None:
            object.__setattr__(self, "targets_per_cell", checked_count(self.targets_per_cell, "targets_per_cell"))
        value = self.delta
        if value is not None and (isinstance(value, bool) or not isinstance(value, int | float) or not 0 <= value < 1):
            raise ValueError(f"`delta`: expected a number of at least 0 and below 1, got {value!r}")

    def of_kinds(self, kinds: Sequence[str]) -> Settings:
        """Return the settings without those that no relation of these kinds has."""
        return self if "paper" in kinds else replace(self, delta=None)

    def refuse_foreign(self, kinds: Sequence[str]) -> None:
        """Refuse a setting that no relation of these kinds has."""
        if self.delta is not None and not {"paper", "best"} & {*kinds}:
            asked = "/".join(sorted({*kinds}))
            raise ValueError(f"`delta`: expected none with relation `{asked}`, got {self.delta!r}; ask for `paper`")

    def used_by(self, models: Sequence[AgentModel]) -> dict[str, object]:
        """Return relations and cells of the models, and the settings that some of them depend on, as plain values."""
        kinds = sorted({model.relation.kind for model in models})
        used: dict[str, object] = {"relation": "/".join(kinds), "cells": [list(model.grid.shape) for model in models]}
        for kind in kinds:
            names = ("epsilon", "feedback", "inputs", "delta") if kind == "paper" else ("targets_per_cell",)
            used |= {name: getattr(self, name) for name in names}
        return used


def abstraction_of(problem: Problem, cells: CellCounts, kinds: Sequence[str], settings: Settings) -> Abstraction:
    """Return finite models under one kind of relation per agent; settings that no agent uses are refused."""
    refuse_shared_noise(problem)
    if problem.names_time:
        raise RelationRefused(TIME_REFUSAL)
    settings.refuse_foreign(kinds)
    models = models_of(problem, cells, dict(enumerate(kinds)), settings)
    ordered = tuple(models[i] for i in range(problem.n_agents))
    if why := lost_beside(ordered):
        raise ValueError(why)
    return Abstraction(ordered, settings.used_by(ordered))


def lost_beside(models: Sequence[AgentModel]) -> str:
    """Return why models cannot be those of one team, as relations may be lost beside others; nothing if they can."""
    lossy = sorted({model.relation.kind for model in models if model.delta > 0})
    beside = sorted({model.relation.kind for model in models if not model.is_additive})
    if not (lossy and beside):
        return ""
    return f"`relation`: expected relations that are never lost beside `{beside[0]}`, got `{lossy[0]}`; ask for `exact`"


def relations_of(problem: Problem, relation: Relations) -> list[str]:
    """Return the relation that is asked for of each agent; ``"auto"`` where a mapping leaves one out.

    Raises
    ------
    ValueError
        If an agent or a relation is not known.
    """
    check_names("relation", relation, problem)
    asked = relation if isinstance(relation, Mapping) else dict.fromkeys(problem.agent_names, relation)
    for name in asked.values():
        if name in (*GONE, "coupled"):
            raise ValueError(f"`relation`: {name!r} is gone since 0.4; write 'linear', or 'paper' for scalar agents")
        if name not in RELATIONS:
            meant = near(str(name), (*RELATIONS, "path", "vertices", "best"))
            remedy = f"; did you mean {meant!r}?" if meant else ""
            raise ValueError(f"`relation`: expected one of {', '.join(RELATIONS)}, got {name!r}{remedy}")
    return [asked.get(name, "auto") for name in problem.agent_names]


def models_of(
    problem: Problem, cells: CellCounts, kinds: Mapping[int, str], settings: Settings
) -> dict[int, AgentModel]:
    """Return finite models of some agents, by their number, each under the relation that ``kinds`` asks for."""
    by_wish: dict[object, SharedModel] = {}
    by_relation: dict[object, SharedModel] = {}
    by_labels: dict[object, AgentModel] = {}
    models = {}
    for i, kind in kinds.items():
        agent = problem.agents[i]
        grid = agent_grid(problem, i, cells_of_agent(agent, cells))
        # Agents with equal dynamics, grids and wishes share a model.
        wish = (kind, *agent.model_key, *(e.tobytes() for e in grid.edges))
        if wish not in by_wish:
            model = _shared_model(agent, kind, grid, settings, problem.n_agents == 1)
            numbers = (*wish, *(a.tobytes() for a in model[0].arrays))
            by_wish[wish] = by_relation.setdefault(numbers, model)
        relation, lattice, kernel, choices = by_wish[wish]
        # Arriving in a cell an agent may be anywhere within E of its centre; at the start it is in the cell itself.
        start_labels = cell_labels(problem, i, grid)
        labels = start_labels
        if not relation.is_cell:
            labels = error_labels(problem, i, grid, relation.state_reach)  # type: ignore[union-attr]
        # With equal labels, too, agents share the whole model: searches recognise it by its identity.
        key = (id(by_wish[wish]), labels.key, start_labels.key)
        if key not in by_labels:
            by_labels[key] = AgentModel(grid, lattice, relation, kernel, choices, labels, start_labels)
        models[i] = by_labels[key]
    return models


def _shared_model(agent: AnyAgent, kind: str, grid: Grid, settings: Settings, alone: bool) -> SharedModel:
    """Return relation, lattice, kernel and choices of one agent, which may have no team."""
    per_cell = settings.targets_per_cell or DEFAULT_TARGETS.get(agent.n_states, 1)
    # Agents whose dynamics are expressions are enclosed in boxes unless their inputs reach every mean in most cells.
    is_any = kind in ("auto", "quick")
    if agent.has_clock and kind not in ("boxes", "linear") and not is_any:
        raise RelationRefused(
            f"agent `{agent.name}`: the relation `{kind}` is for dynamics that are the same at every step, got some "
            "that name the time `t`; ask for `linear`, `boxes` or `path`"
        )
    if kind != "boxes" and not is_any:
        refuse_angles(agent, kind)
    if is_any and (agent.has_clock or agent.angles or not agent.has_plain_noise):
        kind = "boxes"
    elif kind != "boxes":
        refuse_uneven_noise(agent, kind)
    if kind == "boxes":
        return box_model(agent, grid, settings.targets_per_cell)
    if is_any and agent.is_affine and agent.laws is not None:
        kind = "exact" if agent.has_full_rank else "boxes"
        return _shared_model(agent, kind, grid, settings, alone)
    if is_any:
        # Exact targets, unless weak inputs leave many cells without one.
        if reaches_every_mean(agent):
            exact = exact_model(agent, grid, per_cell)
            if np.mean(exact[3].resting_choice < 0) <= STRANDED_CELLS:
                return exact
        kind = "linear" if agent.is_affine else "boxes"
        return _shared_model(agent, kind, grid, settings, alone)
    if kind == "linear":
        return corner_model(agent, grid, settings.targets_per_cell, alone)
    if kind == "exact":
        return exact_model(agent, grid, per_cell)
    names = ("epsilon", "feedback", "inputs", "delta")
    return paper_model(linear_agent(agent, kind), grid, {name: getattr(settings, name) for name in names})


def check_names(argument: str, value: object, problem: Problem) -> None:
    """Raise ValueError if a mapping has keys that are no agents; agents that are left out get the default."""
    for name in value if isinstance(value, Mapping) else ():
        if name not in problem.agent_names:
            known = ", ".join(problem.agent_names[:8])
            raise ValueError(f"`{argument}`: expected names of agents among {known}, got {name!r}; correct the name")
