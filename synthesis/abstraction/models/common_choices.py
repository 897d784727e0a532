"""Inputs that move several agents, chosen in common: by time and automaton state alone (docs/theory/boxes.md, "Inputs
that move several agents").

All agents that name such an input, and the one that owns it, form a *group*. At each time and in each automaton state a
group has one *number*: a row with a value for each of its common inputs. A choice of a member is a pair, the number as
far as the member names or owns the inputs, and what it chooses besides; so choices come in parts, one for each number.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ....envs.systems.agents import Agent
from ....envs.tasks.problem import Problem
from ...relations.grids import FloatArray, Grid, RelationRefused
from ...relations.kinds import BoxRelation, CommonInputs, Relation
from .action_tables import ActionTable, Policies, StepPolicy
from .box_model import INPUT_LEVELS, evenly_with_rest, in_fitting_parts, with_rest

MOST_NUMBERS = 128
"""Most numbers of a group: the search answers to each of them."""


def common_inputs_of(problem: Problem) -> dict[int, CommonInputs]:
    """Return the inputs that are chosen in common, by the agents that name or own them; nothing if no input is named.

    Raises
    ------
    RelationRefused
        If a group has more than ``MOST_NUMBERS`` numbers.
    """
    agents = {agent.name: agent for agent in problem.agents if isinstance(agent, Agent)}
    named = {
        agent.name: [name for name, flag in zip(agent.others, agent.neighbour_inputs, strict=True) if flag]
        for agent in agents.values()
    }
    all_names = {name for names in named.values() for name in names}
    for name, agent in agents.items():
        own = [f"{name}.{own_input}" for own_input in agent.inputs]
        named[name] = [*(x for x in own if x in all_names), *named[name]]
    levels: dict[str, FloatArray] = {}
    for together in _linked([names for names in named.values() if names]):
        count = INPUT_LEVELS.get(len(together), 3)
        for name in together:
            owner, own_input = agents[name.split(".")[0]], name.split(".")[1]
            j = owner.inputs.index(own_input)
            levels[name] = evenly_with_rest(float(owner.input_low[j]), float(owner.input_high[j]), count)
        size = math.prod(len(levels[name]) for name in together)
        if size > MOST_NUMBERS:
            raise RelationRefused(
                f"inputs {', '.join(together)}: expected at most {MOST_NUMBERS} numbers to choose in common, got {size}"
            )
    return {
        i: CommonInputs(tuple(names), np.array(list(product(*(levels[name] for name in names)))))
        for i, agent in enumerate(problem.agents)
        if (names := named.get(agent.name))
    }


def _linked(sets: Sequence[Sequence[str]]) -> list[list[str]]:
    """Return the names of sets that overlap, directly or by others, put together, in order."""
    groups: list[set[str]] = []
    for names in sets:
        overlapping = [group for group in groups if group & {*names}]
        groups = [group for group in groups if not group & {*names}] + [{*names}.union(*overlapping)]
    return [sorted(group) for group in groups]


def common_relation(agent: Agent, grid: Grid, coordinates: FloatArray, common: CommonInputs) -> BoxRelation:
    """Return the relation of mean boxes whose choices are pairs: numbers of common inputs, and the inputs left.

    Choices of agents without common inputs of their own are offered twice where inputs command axes for every number:
    as they are, and with targets for these axes.
    """
    own, left = common.own(agent), with_rest(agent.input_box, INPUT_LEVELS.get(agent.n_inputs, 3))
    for j in own.values():
        left[:, j] = 0.0
    left = np.unique(left, axis=0)
    input_set = np.repeat(left[None], len(common.numbers), axis=0)
    for column, j in own.items():
        input_set[:, :, j] = common.numbers[:, column, None]
    written = {"common": common.description}
    if not own:
        steering = np.arange(2 * left.shape[0]) >= left.shape[0]
        doubled = np.concatenate([input_set, input_set], axis=1).reshape(-1, agent.n_inputs)
        steer = np.tile(steering, len(common.numbers))
        try:
            return in_fitting_parts(agent, grid, coordinates, doubled, {**written, "steer": steer})
        except RelationRefused:  # no input commands an axis
            pass
    return in_fitting_parts(agent, grid, coordinates, input_set.reshape(-1, agent.n_inputs), written)


@dataclass(frozen=True, eq=False)
class CommonGroup:
    """Agents whose choices share a number at each time and in each automaton state.

    Parameters
    ----------
    members : tuple of int
        Numbers of the agents.
    names : tuple of str
        The common inputs.
    numbers : (K, n) array
    parts : tuple of (K,) int arrays
        Per member: which part of its choices belongs to each number.
    """

    members: tuple[int, ...]
    names: tuple[str, ...]
    numbers: FloatArray
    parts: tuple[NDArray[np.int64], ...]

    def number_of(self, policies: Sequence[StepPolicy], offered: Sequence[ActionTable]) -> int:
        """Return the number that the members' choices (S_i,) at one time and automaton state share."""
        fits = np.ones(len(self.numbers), dtype=bool)
        for policy, choices, part in zip(policies, offered, self.parts, strict=True):
            used = policy[policy >= 0]
            if len(used):
                fits &= part == used[0] // choices.part_length
        return int(fits.argmax())


class _Modelled(Protocol):
    """What is read of a finite model."""

    @property
    def relation(self) -> Relation: ...


def common_groups(models: Sequence[_Modelled]) -> tuple[CommonGroup, ...]:
    """Return the groups of models whose relations have inputs that are chosen in common.

    Raises
    ------
    ValueError
        If members of a group have different numbers for the same input.
    """
    common = {i: model.relation.common for i, model in enumerate(models) if model.relation.common is not None}
    groups = []
    for names in _linked([inputs.names for inputs in common.values()]):
        members = [i for i, inputs in common.items() if {*inputs.names} & {*names}]
        levels: dict[str, FloatArray] = {}
        for inputs in (common[i] for i in members):
            for column, name in enumerate(inputs.names):
                values = np.unique(inputs.numbers[:, column])
                if not np.array_equal(levels.setdefault(name, values), values):
                    raise ValueError(f"`models`: expected the same numbers of {name!r} for all agents, got others")
        numbers = np.array(list(product(*(levels[name] for name in names))))
        places = {name: column for column, name in enumerate(names)}
        parts = []
        for inputs in (common[i] for i in members):
            seen = numbers[:, [places[name] for name in inputs.names]]
            same = np.all(seen[:, None] == inputs.numbers[None], axis=2)
            if not np.all(same.any(axis=1)):
                raise ValueError("`models`: expected all combinations of common inputs, got models without some")
            parts.append(same.argmax(axis=1))
        groups.append(CommonGroup(tuple(members), tuple(names), numbers, tuple(parts)))
    return tuple(groups)


def agreed(groups: Sequence[CommonGroup], offered: Sequence[ActionTable], policies: Policies) -> Policies:
    """Return policies (T, Q, S_i) whose members of each group share a number at each time and automaton state.

    Where they do not, the number that most cells of the members choose is taken. ``offered`` are the choices of all
    agents. Everything that is evaluated has to pass here: values of other policies would be wrong.
    """
    result = list(policies)
    for group in groups:
        tables = [_parts_chosen(offered[i], policies[i]) for i in group.members]
        # Cells (T, Q, K) whose choice goes with each number.
        votes = sum(table[..., part] for table, part in zip(tables, group.parts, strict=True))
        assert isinstance(votes, np.ndarray)
        number = votes.argmax(axis=-1)
        for i, table, part in zip(group.members, tables, group.parts, strict=True):
            choices = offered[i]
            wanted = part[number]
            kept = np.take_along_axis(table, wanted[..., None], axis=-1)[..., 0] == table.sum(axis=-1)
            if np.all(kept):
                continue
            changed = result[i].copy()
            for t, q in np.argwhere(~kept).tolist():
                changed[t, q] = choices.with_part(changed[t, q], int(wanted[t, q]))
            result[i] = changed
    return tuple(result)


def _parts_chosen(choices: ActionTable, policy: NDArray[np.int32]) -> NDArray[np.int64]:
    """Return how many cells (T, Q, L) choose from each part."""
    chosen = np.where(policy >= 0, policy // choices.part_length, -1)
    return np.stack([np.count_nonzero(chosen == part, axis=-1) for part in range(choices.n_parts)], axis=-1)
