"""How inputs enter the means of agents with expressions: one by one, or as turns; and which of them to solve for.

A *turn* is a pair of inputs that occur as `size*cos(angle)` and `size*sin(angle)` alone. Its two components are then
numbers like inputs, which fill a disk, a ring, or sectors of these (``cones``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import qr

from ....envs.systems.agents import Agent
from ....envs.systems.expressions import (
    AffineForm,
    Name,
    Number,
    Operation,
    Tree,
    computed,
    names_in,
    replaced,
    split_at,
)

SMALLEST = 1e-9
"""Share of the largest pivot of B, at the middle of the workspace, below which inputs count as dependent."""

ZERO = Number(0.0)


@dataclass(frozen=True)
class Turn:
    """Two inputs that occur as `size*cos(angle)` and `size*sin(angle)` alone."""

    size: int
    angle: int

    @property
    def names(self) -> tuple[str, str]:
        """Names of the two components in trees; no input has a name with a blank."""
        return f"east {self.size}", f"north {self.size}"


def held(agent: Agent, name: str) -> float:
    """Return the middle of an input, or 0 for a component of a turn."""
    if name not in agent.inputs:
        return 0.0
    j = agent.inputs.index(name)
    return 0.5 * float(agent.input_low[j]) + 0.5 * float(agent.input_high[j])


def turned_inputs(agent: Agent) -> tuple[tuple[Tree, ...], tuple[Turn, ...]]:
    """Return the dynamics with components of turns put in where two inputs occur as such alone, and the turns."""
    trees, turns = agent.trees, list[Turn]()
    for angle, name in enumerate(agent.inputs):
        east, north = f"cosine of {name}", f"sine of {name}"
        parts: dict[Tree, Tree] = {
            Operation("cos", (Name(name),)): Name(east),
            Operation("sin", (Name(name),)): Name(north),
        }
        turned = [replaced(tree, parts) for tree in trees]
        if any(name in names_in(tree) for tree in turned):
            continue
        for size in range(agent.n_inputs):
            turn = Turn(size, angle)
            found = [_with_components(tree, (east, north), agent.inputs[size], turn.names) for tree in turned]
            known = tuple(tree for tree in found if tree is not None)
            if size == angle or len(known) < len(found):
                continue
            if any(names_in(tree) & {*turn.names} for tree in known):
                trees, turns = known, [*turns, turn]
                break
    return tuple(trees), tuple(turns)


def _with_components(tree: Tree, directions: tuple[str, str], size: str, names: tuple[str, str]) -> Tree | None:
    """Return a tree in which `size` times cosine or sine is named; None if one of the three occurs in another way."""
    for direction, name in zip(directions, names, strict=True):
        split = split_at(tree, direction)
        if split is None:
            return None
        tree, factor = split
        along = split_at(factor, size)
        if along is None or along[0] != ZERO or names_in(along[1]) & {size, *directions}:
            return None
        if along[1] != ZERO:
            tree = Operation("+", (tree, Operation("*", (along[1], Name(name)))))
    return None if names_in(tree) & {size, *directions} else tree


def independent_columns(agent: Agent, form: AffineForm, names: Sequence[str]) -> list[int] | None:
    """Return the numbers of as many independent columns of B as there are states, those that move means farthest.

    They are judged at the middle of the workspace, states in shares of its width, inputs in shares of theirs.
    """
    middle = {state: np.array([x]) for state, x in zip(agent.states, agent.workspace.center.tolist(), strict=True)}
    middle |= {name: np.array([0.5 * low + 0.5 * high]) for name, (low, high) in agent.unknowns.items()}
    d, m = agent.n_states, len(names)
    B = np.array([float(x[0]) for x in computed([tree for row in form.factors for tree in row], middle)]).reshape(d, m)
    spans = [float(agent.input_high[j] - agent.input_low[j]) for j in range(agent.n_inputs)]
    sizes = [spans[agent.inputs.index(name)] if name in agent.inputs else 1.0 for name in names]
    scaled = B * np.array(sizes) / (agent.state_high - agent.state_low)[:, None]
    if m < d or not np.all(np.isfinite(scaled)):
        return None
    *_, triangle, order = qr(scaled, mode="economic", pivoting=True)
    pivots = np.abs(np.diag(triangle))
    return sorted(order[:d].tolist()) if pivots[d - 1] > SMALLEST * pivots[0] else None
