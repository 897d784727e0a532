"""Where cells lead: the mean of the next state as an affine map of the state in each cell, and a box around the rest.

For every x of a closed cell with the middle c, under the input of a choice and whatever disturbances and other agents
do, the mean of the next state is ``z + G (x - c) + r`` with ``|r_k| <= rho_k``.

* An *input* h, the same in all of the cell: z, G and rho are computed by jets (``jets.off_linear``).
* A *target* z, for agents with the dynamics ``A x + B u + b``: the input is ``u = P (z - A x - b)`` with a matrix P of
  the file, and must lie in its box for all x of the cell. Then the mean is z, G = 0, and

      rho = |B P - I| (|z| + |A| |x| + |b|) + |B| (rounding of the input).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .expressions import names_in, plain_sum
from .fields import Refused
from .intervals import down, interval, up
from .jets import Jet, Memory, jet, off_linear
from .labels import cell_boxes
from .problem import Agent
from .rigorous import Array, U


@dataclass(frozen=True, eq=False)
class Maps:
    """By increasing numbers ``cell * A + input`` (K,): z (K, d), G (K, d, d) and rho (K, d)."""

    numbers: NDArray[np.int64]
    z: Array
    G: Array
    rho: Array


def maps_of_inputs(
    agent: Agent, others: Sequence[Agent], edges: Sequence[Array], inputs: Array, numbers: NDArray[np.int64]
) -> Maps:
    """Return the maps of pairs of a cell and an input (A, m), by their numbers.

    ``others`` are all agents of the problem: states and inputs of theirs are anywhere in their boxes.
    """
    _refuse_time(agent)
    if np.any(inputs < agent.input_box[0]) or np.any(inputs > agent.input_box[1]):
        raise Refused(f"an input that `{agent.name}` may choose is outside its box")
    cell, choice = np.divmod(numbers, max(1, len(inputs)))
    low, high = (corner[cell] for corner in cell_boxes(edges))
    unknown = _unknown(agent, others)
    n, d, v = len(numbers), low.shape[1], low.shape[1] + len(unknown)
    # Variables of a cell: its states, and everything that is unknown, around the middles of their ranges.
    ranges = np.array(list(unknown.values())).reshape(-1, 2)
    middle = np.concatenate([0.5 * low + 0.5 * high, np.repeat(ranges.mean(axis=1)[None], n, axis=0)], axis=1).T
    first = np.concatenate([low, np.repeat(ranges[None, :, 0], n, axis=0)], axis=1).T
    last = np.concatenate([high, np.repeat(ranges[None, :, 1], n, axis=0)], axis=1).T
    box = np.stack([down(first - middle), up(last - middle)])
    leaves = []
    for around in (np.zeros_like(box), box):
        ends = interval(middle) + around if not around.any() else np.stack([first, last])
        named = {
            name: Jet.variable(ends[:, k], np.repeat(np.eye(v)[k][:, None], n, 1))
            for k, name in enumerate((*agent.states, *unknown))
        }
        still = np.zeros((v, n))
        named |= {name: Jet.variable(interval(inputs[choice, j]), still) for j, name in enumerate(agent.inputs)}
        leaves.append(named)
    z, G, rho = np.empty((n, d)), np.empty((n, d, d)), np.empty((n, d))
    memories: tuple[Memory, Memory] = {}, {}
    # One output after the other: z and G at the middle, rho by what the jet leaves out.
    for k, tree in enumerate(agent.dynamics):
        centre, around_jet = (jet(tree, own, memory) for own, memory in zip(leaves, memories))
        row = np.broadcast_to(0.5 * (centre.slope[0] + centre.slope[1]), (v, n)).copy()
        row[d:] = 0.0
        rest = off_linear(centre, around_jet, box, row)
        ends = np.stack([centre.value[0] + rest[0], centre.value[1] + rest[1]])
        z[:, k], G[:, k] = 0.5 * ends[0] + 0.5 * ends[1], row[:d].T
        rho[:, k] = up(np.maximum(ends[1] - z[:, k], z[:, k] - ends[0])) + 4 * U * np.abs(ends).max(axis=0)
        # images are read around the middle of a cell, which is rounded here
        rho[:, k] += 2 * U * np.einsum("nj,nj->n", np.abs(G[:, k]), np.maximum(np.abs(low), np.abs(high)))
    return Maps(numbers, z, G, rho)


def _unknown(agent: Agent, others: Sequence[Agent]) -> dict[str, tuple[float, float]]:
    """Return ends of everything that moves the mean besides state and input."""
    named, unknown = names_in(agent.dynamics), dict(agent.disturbances)
    for places, boxes in ((agent.states_of_others, "state_box"), (agent.inputs_of_others, "input_box")):
        for name, (j, k) in places.items():
            if name in named:
                low, high = getattr(others[j], boxes)[:, k].tolist()
                unknown[name] = low, high
    return unknown


def _refuse_time(agent: Agent) -> None:
    if "t" in names_in(agent.dynamics) - {*agent.states, *agent.inputs, *agent.disturbances}:
        raise Refused(f"the dynamics of `{agent.name}` name the time, and cells know no time")


def check_targets(
    agent: Agent, edges: Sequence[Array], inverse: Array, cells: NDArray[np.int64], targets: Array
) -> Array:
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
    names = (*agent.states, *agent.inputs)
    rows, b = np.zeros((len(agent.states), len(names))), np.zeros(len(agent.states))
    for k, tree in enumerate(agent.dynamics):
        terms = plain_sum(tree)
        if terms is None or [name for _, name in terms].count("") > 1:
            raise Refused(f"`{agent.name}` has targets, and its dynamics are no sums of multiples")
        for factor, name in terms:
            if name and name not in names:
                raise Refused(f"`{agent.name}` has targets, and its mean depends on more than its state and its input")
            if name:
                rows[k, names.index(name)] = factor
            else:
                b[k] = factor
    return rows[:, : len(agent.states)], rows[:, len(agent.states) :], b
