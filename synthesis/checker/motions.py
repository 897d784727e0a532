"""Cells: where they lead, and what holds in them.

**Theorem.** For every x of a closed cell with the middle c, under the input of a choice and whatever disturbances and
other agents do, the mean of the next state is ``z + G (x - c) + r`` with ``|r_k| <= rho_k``.

* An *input* h, the same in all of the cell: z, G and rho are computed by ``jets``.
* A *target* z, for agents with the dynamics ``A x + B u + b``: the input is ``u = P (z - A x - b)`` with a matrix P of
  the file, and must lie in its box for all x of the cell. Then the mean is z, G = 0, and

      rho = |B P - I| (|z| + |A| |x| + |b|) + |B| (rounding of the input).

Regions hold everywhere in a box of states, nowhere, or neither is known. A cell is half-open, ``low <= x < high``, and
the last one along an axis holds its upper face. Labels of outputs that are states are exact; of other outputs they come
from intervals on the closed cell.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .expressions import names_in, plain_sum
from .fields import Refused
from .intervals import down, interval, up
from .jets import on_boxes, value_on
from .problem import Agent, Problem
from .rigorous import Array, Truth, U, Whole

# By cell and proposition of the agent: 1 holds in all of the cell, -1 nowhere in it, 0 not known.
Labels = NDArray[np.int8]


@dataclass(frozen=True, eq=False)
class Maps:
    """By increasing numbers ``cell * A + input`` (K,): z (K, d), G (K, d, d) and rho (K, d)."""

    numbers: Whole
    z: Array
    G: Array
    rho: Array


def maps_of_inputs(
    agent: Agent, others: Sequence[Agent], edges: Sequence[Array], inputs: Array, numbers: Whole
) -> Maps:
    """Return the maps of pairs of a cell and an input (A, m), by their numbers.

    ``others`` are all agents of the problem: states and inputs of theirs are anywhere in their boxes.
    """
    if "t" in names_in(agent.dynamics) - {*agent.states, *agent.inputs, *agent.disturbances}:
        raise Refused(f"the dynamics of `{agent.name}` name the time, and cells know no time")
    if np.any(inputs < agent.input_box[0]) or np.any(inputs > agent.input_box[1]):
        raise Refused(f"an input that `{agent.name}` may choose is outside its box")
    cell, choice = np.divmod(numbers, max(1, len(inputs)))
    low, high = (corner[cell] for corner in cell_boxes(edges))
    named, unknown, (n, d) = names_in(agent.dynamics), dict[str, Any](agent.disturbances), low.shape
    for at, boxes in ((agent.states_of_others, "state_box"), (agent.inputs_of_others, "input_box")):
        unknown |= {name: getattr(others[j], boxes)[:, k] for name, (j, k) in at.items() if name in named}
    # Variables of a cell: its states, and everything that is unknown, around the middles of their ranges.
    more = np.repeat(np.array(list(unknown.values())).reshape(-1, 2).T[:, :, None], n, axis=2)
    ranges = np.concatenate([np.stack([low.T, high.T]), more], axis=1)
    middle = 0.5 * ranges[0] + 0.5 * ranges[1]
    box = np.stack([down(ranges[0] - middle), up(ranges[1] - middle)])
    columns = {name: k for k, name in enumerate((*agent.states, *unknown))}
    still = {name: interval(inputs[choice, j]) for j, name in enumerate(agent.inputs)}
    # z and G at the middle, rho by what the jets leave out.
    matrix, ends = on_boxes(agent.dynamics, columns, still, (middle, box, ranges), d)
    z, G = 0.5 * ends[0] + 0.5 * ends[1], matrix[:, :d]
    rho = up(np.maximum(ends[1] - z, z - ends[0])) + 4 * U * np.abs(ends).max(axis=0)
    # images are read around the middle of a cell, which is rounded here
    rho += 2 * U * np.einsum("kjn,nj->kn", np.abs(G), np.maximum(np.abs(low), np.abs(high)))
    return Maps(numbers, z.T, G.transpose(2, 0, 1), rho.T)


def check_targets(agent: Agent, edges: Sequence[Array], inverse: Array, cells: Whole, targets: Array) -> Array:
    """Return rho (d,) of targets (n, d) from cells (n,); ``Refused`` where an input would leave its box."""
    A, B, b = affine_dynamics(agent)
    low, high = (corner[cells] for corner in cell_boxes(edges))
    middle, half = 0.5 * low + 0.5 * high, 0.5 * (high - low)
    size = np.abs(targets) + np.maximum(np.abs(low), np.abs(high)) @ np.abs(A).T + np.abs(b)
    # u = P (z - A x - b): products and sums of d + 3 numbers, and of m more
    d, m = A.shape[0], B.shape[1]
    rounding = (4.0 * d + 16.0) * U * size @ np.abs(inverse).T
    u = (targets - middle @ A.T - b) @ inverse.T
    spread = half @ np.abs(inverse @ A).T * (1.0 + (4.0 * d + 8.0) * U) + 2.0 * rounding
    wrong = np.argwhere((u - spread < agent.input_box[0]) | (u + spread > agent.input_box[1]))
    if len(wrong):
        name = agent.inputs[wrong[0, 1]]
        raise Refused(f"input `{name}` of `{agent.name}` leaves its box in cell {cells[wrong[0, 0]]} for a target")
    # B P is the identity up to rounding: what it lacks acts on all that is cancelled.
    missed = np.abs(B @ inverse - np.eye(d)) + (m + 2.0) * U * np.abs(B) @ np.abs(inverse)
    rest = size @ missed.T + rounding @ np.abs(B).T
    return np.asarray(rest.max(axis=0, initial=0.0) * (1.0 + 2.0**-40))


def affine_dynamics(agent: Agent) -> tuple[Array, Array, Array]:
    """Return A, B and b of dynamics ``A x + B u + b``; ``Refused`` unless they are sums of multiples, as they stand."""
    names = {name: k for k, name in enumerate((*agent.states, *agent.inputs, ""))}  # no name: a number
    rows = np.zeros((len(agent.states), len(names)))
    for k, tree in enumerate(agent.dynamics):
        terms = plain_sum(tree)
        if terms is None or [name for _, name in terms].count("") > 1:
            raise Refused(f"`{agent.name}` has targets, and its dynamics are no sums of multiples")
        for factor, name in terms:
            if name not in names:
                raise Refused(f"`{agent.name}` has targets, and its mean depends on more than its state and its input")
            rows[k, names[name]] = factor
    return rows[:, : len(agent.states)], rows[:, len(agent.states) : -1], rows[:, -1]


def cell_boxes(edges: Sequence[Array]) -> tuple[Array, Array]:
    """Return lower and upper corners (S, d) of all cells, the last axis running fastest."""
    sides = ([axis[:-1] for axis in edges], [axis[1:] for axis in edges])
    low, high = (np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(edges)) for axes in sides)
    return low, high


def cell_labels(problem: Problem, i: int, edges: Sequence[Array]) -> tuple[list[int], Labels]:
    """Return the propositions of agent i and their labels (S, .) in its cells; ``Refused`` where regions move."""
    low, high = cell_boxes(edges)
    last = high == np.array([axis[-1] for axis in edges])  # cells that hold their upper face
    mine = [p for p, region in enumerate(problem.regions) if region.agents == (i,)]
    least, most, reached = outputs_on(problem.agents[i], low, high, last)
    labels = np.zeros((len(low), len(mine)), dtype=np.int8)
    for column, p in enumerate(mine):
        region = problem.regions[p]
        if np.any(region.low != region.low[0]) or np.any(region.high != region.high[0]):
            raise Refused(f"`{region.name}` moves with the time, and cells know no time")
        a, b = region.low[0][:, None], region.high[0][:, None]
        holds = (a <= least) & np.where(reached, most < b, most <= b)
        never = np.where(reached, most < a, most <= a) | (b <= least) | (a >= b)
        labels[:, column] = np.where(never.any(axis=0), -1, np.where(holds.all(axis=0), 1, 0))
    return mine, labels


def outputs_on(agent: Agent, low: Array, high: Array, last: Truth) -> tuple[Array, Array, Truth]:
    """Return ends (p, S) of outputs on boxes (S, d), and whether upper ones are reached; ``last``: those of states."""
    names = {name: np.stack([low[:, k], high[:, k]]) for k, name in enumerate(agent.states)}
    ends, reached = np.zeros((2, len(agent.outputs), len(low))), np.ones((len(agent.outputs), len(low)), bool)
    for k, tree in enumerate(agent.outputs):
        ends[:, k] = value_on(tree, names)
        if isinstance(tree, str):
            reached[k] = last[:, agent.states.index(tree)]
    return ends[0], ends[1], reached
