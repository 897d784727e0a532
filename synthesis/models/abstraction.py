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
from dataclasses import dataclass, field, fields, replace
from difflib import get_close_matches
from typing import Any

import numpy as np

from ...envs.agents import LinearAgent
from ...envs.problem import Problem, checked_problem
from ..cells import (
    CellCounts,
    CellLabels,
    FloatArray,
    Grid,
    agent_grid,
    cell_labels,
    cells_of_agent,
    error_labels,
    label_room,
)
from ..relations import CoupledRelation, ExactRelation, Relation
from ..values import Residents
from .agent_models import Bare, cheapest_model, ellipsoid_model, exact_model, paper_model, tube_model
from .choices import Choices
from .kernel import Kernel

Relations = str | Mapping[str, str]
FOR_KINDS = {"delta": {"ellipsoid", "paper"}, "share": {"ellipsoid"}}
"""Settings that only these relations have; refused with all others."""

RELATIONS = ("auto", "exact", "ellipsoid", "paper", "quick", "tube")


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
    residents : Residents
        Masks of its cells on devices.
    """

    grid: Grid
    lattice: tuple[FloatArray, ...]
    relation: Relation
    kernel: Kernel
    choices: Choices
    labels: CellLabels
    start_labels: CellLabels
    residents: Residents = field(default_factory=Residents, repr=False)

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


@dataclass(frozen=True)
class Settings:
    """Settings of relations.

    Parameters
    ----------
    targets_per_cell : int, optional
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
        If a number is out of range.
    """

    targets_per_cell: int | None = None
    epsilon: float = 0.1
    feedback: float = 0.0
    inputs: int = 10
    delta: float | None = None
    share: float | None = None

    def __post_init__(self) -> None:
        number = 1 if self.targets_per_cell is None else self.targets_per_cell
        if isinstance(number, bool) or not isinstance(number, int) or number < 1:
            raise ValueError(f"`targets_per_cell`: expected a positive whole number, got {self.targets_per_cell!r}")
        for name in ("delta", "share"):
            value = getattr(self, name)
            if value is not None and (
                isinstance(value, bool) or not isinstance(value, int | float) or not 0 <= value < 1
            ):
                raise ValueError(f"`{name}`: expected a number of at least 0 and below 1, got {value!r}")

    @property
    def given(self) -> tuple[str, ...]:
        """Names of the settings that only some relations have and that were given."""
        return tuple(name for name in FOR_KINDS if getattr(self, name) is not None)

    def of_kinds(self, kinds: Sequence[str]) -> Settings:
        """The settings without those that no relation of these kinds has."""
        unused: dict[str, Any] = {name: None for name in self.given if not FOR_KINDS[name] & {*kinds}}
        return replace(self, **unused)

    def used_by(self, models: Sequence[AgentModel]) -> dict[str, object]:
        """Relations and cells of the models, and the settings that some of them depend on."""
        kinds = sorted({model.relation.kind for model in models})
        used: dict[str, object] = {"relation": "/".join(kinds), "cells": [list(model.grid.shape) for model in models]}
        names = {"paper": ("epsilon", "feedback", "inputs", "delta"), "ellipsoid": ("delta", "share")}
        for kind in kinds:
            used |= {name: getattr(self, name) for name in names.get(kind, ("targets_per_cell",))}
        return used


def abstract(
    problem: Problem, cells: CellCounts = None, *, relation: Relations = "auto", **settings: Any
) -> Abstraction:
    """Finite models of the agents of ``problem``.

    Parameters
    ----------
    problem : Problem
    cells : int, sequence of int, or mapping from agent name to one of these, optional
        Cells per axis. Default: 500 for scalar agents, 80 per axis for two, 24 for three dimensions.
    relation : str, or mapping from agent name to str
        ``"exact"``: B of full row rank, delta = 0. ``"tube"``: stabilisable agents, delta = 0. ``"ellipsoid"``: any
        agent that some ellipsoid can be found for, delta >= 0 (needs the extra ``lmi``). ``"paper"``: scalar agents,
        delta >= 0 in closed form. ``"quick"``: for each agent ``exact`` where it applies and the inputs are strong
        enough for the cells, else ``tube``; so are agents that a mapping leaves out. ``"auto"`` is the same here: which
        relation certifies most only a synthesis can tell (see ``synthesize``).
    **settings
        Of the relations, see ``Settings``.

    Raises
    ------
    ValueError
        If the relation does not apply to an agent, or a number is out of range.
    """
    checked_problem(problem)
    check_names("cells", cells, problem)
    check_settings(settings)
    return abstraction_of(problem, cells, relations_of(problem, relation), Settings(**settings))


def abstraction_of(problem: Problem, cells: CellCounts, kinds: Sequence[str], settings: Settings) -> Abstraction:
    """Finite models under one kind of relation per agent; settings that no agent has a use for are refused."""
    foreign = set(settings.given) - set(settings.of_kinds(kinds).given)
    for name in sorted(foreign):
        asked, value = "/".join(sorted({*kinds})), getattr(settings, name)
        raise ValueError(f"`{name}`: expected none with relation `{asked}`, got {value!r}; ask for `ellipsoid`")
    models = models_of(problem, cells, dict(enumerate(kinds)), settings)
    ordered = tuple(models[i] for i in range(problem.n_agents))
    return Abstraction(ordered, settings.used_by(ordered))


def relations_of(problem: Problem, relation: Relations) -> list[str]:
    """What is asked for of each agent; ``"auto"`` where a mapping leaves one out.

    Raises
    ------
    ValueError
        If an agent or a relation is not known.
    """
    check_names("relation", relation, problem)
    asked = relation if isinstance(relation, Mapping) else dict.fromkeys(problem.agent_names, relation)
    for name in asked.values():
        if name not in RELATIONS:
            raise ValueError(f"`relation`: expected one of {', '.join(RELATIONS)}, got {name!r}")
    return [asked.get(name, "auto") for name in problem.agent_names]


def models_of(
    problem: Problem, cells: CellCounts, kinds: Mapping[int, str], settings: Settings
) -> dict[int, AgentModel]:  # fmt: skip
    """Finite models of some agents, by their number, each under the relation that ``kinds`` asks for."""
    bare: dict[object, Bare] = {}
    shared: dict[object, Bare] = {}
    whole: dict[object, AgentModel] = {}
    models = {}
    for i, kind in kinds.items():
        agent = problem.agents[i]
        grid, coordinates = agent_grid(problem, i, cells_of_agent(agent, cells))
        room = label_room(problem, i)
        alike = (kind, *alike_arrays(agent), *(e.tobytes() for e in grid.edges))
        minds_room = kind in ("tube", "ellipsoid") or not has_full_rank(agent)
        same = (*alike, room.tobytes() if minds_room else b"")
        if same not in bare:
            found = _bare(agent, kind, grid, coordinates, room, settings)
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
        models[i] = whole[key]
    return models


def _bare(
    agent: LinearAgent, kind: str, grid: Grid, coordinates: FloatArray, room: FloatArray, settings: Settings
) -> Bare:  # fmt: skip
    """Relation, lattice, kernel and choices of one agent."""
    per_cell = settings.targets_per_cell or (2 if agent.n_states == 1 else 1)
    if kind == "exact":
        return exact_model(agent, grid, coordinates, per_cell)
    if kind == "tube":
        return tube_model(agent, grid, coordinates, room)
    if kind == "ellipsoid":
        delta = 0.0 if settings.delta is None else settings.delta
        return ellipsoid_model(agent, grid, coordinates, room, delta, settings.share)
    if kind == "paper":
        names = ("epsilon", "feedback", "inputs", "delta")
        return paper_model(agent, grid, {name: getattr(settings, name) for name in names})
    return cheapest_model(agent, grid, coordinates, per_cell, room)


def check_names(argument: str, given: object, problem: Problem) -> None:
    """Refuse keys of a mapping that are no agents; agents that are left out get the default."""
    for name in given if isinstance(given, Mapping) else ():
        if name not in problem.agent_names:
            known = ", ".join(problem.agent_names[:8])
            raise ValueError(f"`{argument}`: expected names of agents among {known}, got {name!r}; correct the name")


def check_settings(settings: Mapping[str, object]) -> None:
    """Refuse settings of a relation that ``abstract`` does not have, with the nearest one that it has."""
    known = ["relation", *(field.name for field in fields(Settings))]
    for name in settings:
        if name not in known:
            close = get_close_matches(name, ["cells", *known, "max_sweeps", "limits", "progress"], n=1)
            remedy = f"did you mean `{close[0]}`?" if close else f"settings are {', '.join(known)}"
            raise ValueError(f"`{name}`: expected a setting of the relation, got an unknown one; {remedy}")


def alike_arrays(agent: LinearAgent) -> tuple[bytes, ...]:
    """Arrays that determine the model of an agent apart from its relation, grid and labels, as bytes."""
    box, inputs = agent.workspace, agent.input_box
    found = (agent.A, agent.B, agent.offset, agent.noise_covariance, box.low, box.high, inputs.low, inputs.high)
    return tuple(array.tobytes() for array in found)


def has_full_rank(agent: LinearAgent) -> bool:
    """Whether B has full row rank: every mean can be commanded."""
    return bool(np.linalg.matrix_rank(agent.B) == agent.n_states)
