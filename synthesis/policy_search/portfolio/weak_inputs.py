"""Cells that are narrower along axes where inputs are scarce.

An agent that aims at a mean from a whole cell keeps input in reserve for it, as much as the cell is wide: half the
width along every axis, times A. What moves it is the rest. Where a region is hard to stay in along one axis and easy
along the other, as many cells in all are better spent on the first.
"""

from __future__ import annotations

import math

import numpy as np

from ....envs.systems.agents import with_matrices
from ....envs.tasks.problem import Problem
from ...relations.grids import FloatArray, cells_of_agent

MOST_UNEVEN = 2.0
"""Most that cells along one axis are multiplied by, and along another divided by."""

LEAST_SHARE = 0.25
"""Share of the reach of the inputs that counts at least, however little of it is left where a region is."""


def cells_where_scarce(problem: Problem) -> dict[str, tuple[int, ...]]:
    """Return cells per axis of linear agents, as many in all as by default, for those that have them uneven."""
    found = {}
    for i, agent in enumerate(problem.agents):
        if not agent.is_affine or agent.n_states == 1:
            continue
        usual, left = cells_of_agent(agent, None), left_of_inputs(problem, i)
        shares = np.prod(left) ** (1.0 / len(left)) / left
        factors = np.clip(shares, 1.0 / MOST_UNEVEN, MOST_UNEVEN)
        cells = tuple(max(1, math.floor(n * factor)) for n, factor in zip(usual, factors.tolist(), strict=True))
        if cells != usual:
            found[agent.name] = cells
    return found


def left_of_inputs(problem: Problem, i: int) -> FloatArray:
    """Return how far inputs move the mean of linear agent i along each state (n,), beyond what staying takes.

    The least over the middles of its regions, where the task has it come, stay or pass, and over its start.
    """
    agent = with_matrices(problem.agents[i])
    reach = np.abs(agent.B) @ (0.5 * (agent.input_high - agent.input_low))
    start = 0.5 * (agent.initial.low + agent.initial.high)
    middles = [start]
    for proposition in problem.propositions.values():
        if proposition.agent != agent.name:
            continue
        middle = start.copy()
        for output, side in enumerate(zip(proposition.low, proposition.high, strict=True)):
            axis = agent.output_axis(output)
            if axis is not None:
                k, factor = axis
                middle[k] = np.clip(np.array(side) / factor, agent.workspace.low[k], agent.workspace.high[k]).mean()
        middles.append(middle)
    drift = np.array(middles) @ (agent.A - np.eye(agent.n_states)).T + agent.offset
    drift += agent.B @ (0.5 * (agent.input_low + agent.input_high))
    return np.asarray(np.maximum((reach - np.abs(drift)).min(axis=0), LEAST_SHARE * reach))
