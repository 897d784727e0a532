"""Targets of agents with expressions: axes whose mean an input puts where it is wanted, exactly, on a whole cell.

Where the mean along an axis is ``a(x) + b(x) u`` with one input u and b without a zero, the input

    u(x) = (m - a(x)) / b(x)

puts it on the target m from every x. The controller computes u(x) from the state; the mean along all other axes is
enclosed with u(x) in place of u (docs/theory/boxes.md, "Boxes of expressions"). Disturbances are not measured, so an
axis that they move has no targets. States of neighbours that are communicated may stand in a and b: the input must then
be admissible for all of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ....envs.systems.agents import Agent, neighbour
from ....envs.systems.expressions import (
    Affine,
    Name,
    Number,
    Operation,
    Tree,
    computed,
    enclosed,
    names_in,
    split_at,
    substituted,
)
from ..grids import FloatArray


@dataclass(frozen=True, eq=False)
class Command:
    """An axis whose mean is ``rest + factor * input``.

    Parameters
    ----------
    axis, input : int
        Numbers of the state and of the input.
    rest, factor : Tree
        Expressions in the states, and in the states of others that the agent is told.
    """

    axis: int
    input: int
    rest: Tree
    factor: Tree

    @property
    def target(self) -> str:
        """Name of the target in expressions; no state has a name with a blank."""
        return f"target {self.axis}"

    @cached_property
    def tree(self) -> Tree:
        """The input as an expression in states and target."""
        return Operation("/", (Operation("-", (Name(self.target), self.rest)), self.factor))


def commands_of(agent: Agent) -> tuple[Command, ...]:
    """Return the axes that inputs command, at most one for each input: that which the input moves farthest.

    The distance is measured at the middle of the workspace, in shares of its width. There are none where inputs make
    the noise larger: what steers applies many of them in one cell.
    """
    commands: list[Command] = []
    if agent.has_clock:
        return ()  # the clock is an input that nobody may set
    if any(names_in(tree) & {*agent.inputs} for tree in agent.scale_trees):
        return ()
    middle = {state: np.array([x]) for state, x in zip(agent.states, agent.workspace.center.tolist(), strict=True)}
    middle |= {name: np.array([0.5 * low + 0.5 * high]) for name, (low, high) in agent.unknowns.items()}
    for j, name in enumerate(agent.inputs):
        best, farthest = None, 0.0
        for k, tree in enumerate(agent.trees):
            others = names_in(tree) & ({*agent.inputs, *agent.unknowns} - {name} - agent.measured)
            split = None if others or k in [command.axis for command in commands] else split_at(tree, name)
            if split is None or split[1] == Number(0.0) or not _never_zero(agent, split[1]):
                continue
            [factor] = computed([split[1]], middle)
            moved = abs(float(factor[0])) / (agent.state_high[k] - agent.state_low[k])
            if moved > farthest:
                best, farthest = Command(k, j, *split), moved
        if best is not None:
            commands.append(best)
    return tuple(commands)


def steered_trees(agent: Agent, commands: Sequence[Command]) -> tuple[Tree, ...]:
    """Return the means along all axes with commanded inputs put in; commanded axes are their targets."""
    inputs = {agent.inputs[command.input]: command.tree for command in commands}
    trees = [substituted(tree, inputs) for tree in agent.trees]
    for command in commands:
        trees[command.axis] = Name(command.target)
    return tuple(trees)


def _never_zero(agent: Agent, factor: Tree) -> bool:
    """Return whether a factor has one sign in the whole workspace."""
    names = {name: Affine(np.zeros(1), {k: np.ones(1)}) for k, name in enumerate((*agent.states, *agent.unknowns))}
    ends = [*zip(agent.state_low, agent.state_high, strict=True), *agent.unknowns.values()]
    box = [(np.array([low]), np.array([high])) for low, high in ends]
    [(least, most)] = enclosed([factor], names, box)
    return bool(least[0] > 0.0 or most[0] < 0.0)


def steered_inputs(
    agent: Agent,
    commands: Sequence[Command],
    centres: FloatArray,
    states: FloatArray,
    menu_inputs: FloatArray,
    beside: FloatArray | None = None,
) -> FloatArray:
    """Return inputs (m, ...) at states (d, ...) that put the means of commanded axes where the menu does at centres.

    They are moved into the input box, which changes nothing where a choice is admissible.

    Parameters
    ----------
    centres, states : (d, ...) arrays
        Centres of cells, and states in them.
    menu_inputs : (m, ...) array
        Inputs of the choices at the centres.
    beside : (l, ...) array, optional
        States of others that the dynamics name. Targets do not depend on them.

    Raises
    ------
    ValueError
        If an input depends on states of others, and they are not given.
    """
    means, inputs = agent.mean(centres, menu_inputs), menu_inputs.copy()
    for command in commands:
        values = dict(zip(agent.states, (np.atleast_1d(row) for row in states), strict=True))
        if beside is not None:
            values |= {neighbour(k): np.atleast_1d(row) for k, row in enumerate(beside)}
        elif agent.measured & names_in(command.tree):
            raise ValueError(f"`beside`: expected the states of others that agent {agent.name!r} is told, got none")
        values[command.target] = np.atleast_1d(means[command.axis])
        [asked] = computed([command.tree], values)
        low, high = agent.input_low[command.input], agent.input_high[command.input]
        # What is not a number becomes the middle of the box: controllers are total.
        asked = np.where(np.isnan(asked), 0.5 * low + 0.5 * high, asked).reshape(inputs[command.input].shape)
        inputs[command.input] = np.clip(asked, low, high)
    return inputs
