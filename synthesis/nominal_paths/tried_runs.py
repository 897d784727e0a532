"""Runs found by trying inputs: the dynamics are asked, where ways around regions are drawn without them.

A battery that fills at one place alone is such a case: no slope leads there from afar, and no way on a grid of places
knows that it has to be passed. From every state that was come to a few inputs are tried, and held for some steps; of
the states that lie in one cell at the same time the cheapest is gone on with.
"""

from __future__ import annotations

from itertools import product

import numpy as np
from numpy.typing import NDArray

from ...envs.agents import AnyAgent
from ...envs.problem import Problem
from ..cells import FloatArray
from .counted_work import CountedWork
from .nonlinear_model import NonlinearModel
from .path_limits import corners_along
from .soft_costs import soft_costs

CELLS = {1: 200, 2: 60, 3: 24}
"""Cells per axis, by the number of states: of more states cells say too little of where one is."""

LEVELS, OFFERED = {1: 9, 2: 5}, 3
"""Levels of each input, by their number, and beyond."""

DECISIONS = 20
"""About how often inputs are chosen along a run."""

MOST_STEPS = 6_000_000
"""Steps of single states that are tried along a run, at most; with more of them cells are larger."""

SHARP = 0.02
"""Share of a range that counts as a deviation."""

EFFORT = 1e-3
"""Cost of an input at half its range, for each step."""

STEP = 2e-7
"""Work of a step of a single state."""


def tried_run(
    problem: Problem, model: NonlinearModel, letters: NDArray[np.int8], start: FloatArray, work: CountedWork
) -> FloatArray | None:
    """Return inputs (S, m) of a run that keeps letters (S + 1, P) as well as any that was tried, from a start (d,).

    None for agents of many states, and where all runs leave the workspace.
    """
    agent, steps = model.agent, len(letters) - 1
    if agent.n_states not in CELLS or not agent.n_inputs:
        return None
    menu, hold = _menu(agent), max(1, round(steps / DECISIONS))
    count = min(CELLS[agent.n_states], int((MOST_STEPS / (steps * menu.shape[1])) ** (1.0 / agent.n_states)))
    charges = _Charges(problem, agent, letters)
    low, size = agent.state_low[:, None], (agent.state_high - agent.state_low)[:, None] / count
    x, total, came = start[:, None], np.zeros(1), list[tuple[NDArray[np.int64], NDArray[np.int64]]]()
    effort = EFFORT * np.sum(((menu - charges.middle[:, None]) / charges.half[:, None]) ** 2, axis=0)
    for first in range(0, steps, hold):
        n = x.shape[1]
        u = np.tile(menu, n)
        x, total = np.repeat(x, menu.shape[1], axis=1), np.repeat(total, menu.shape[1])
        for t in range(first, min(first + hold, steps)):
            with np.errstate(all="ignore"):
                x = model.step(x, u, t)
            total = total + charges.at(t + 1, x) + np.tile(effort, n)
            work.spent += STEP * x.shape[1]
        usable = np.flatnonzero(np.isfinite(total))
        if not len(usable):
            return None
        cells = np.clip(np.floor((x[:, usable] - low) / size), 0, count - 1).astype(np.int64)
        numbers = np.ravel_multi_index(tuple(cells), (count,) * agent.n_states)
        # The cheapest of each cell comes first.
        order = usable[np.lexsort((total[usable], numbers))]
        _, firsts = np.unique(np.sort(numbers), return_index=True)
        kept = order[firsts]
        came.append((kept // menu.shape[1], kept % menu.shape[1]))
        x, total = x[:, kept], total[kept]
    at, inputs = int(np.argmin(total)), list[FloatArray]()
    for parents, chosen in reversed(came):
        inputs.append(menu[:, chosen[at]])
        at = int(parents[at])
    return np.repeat(np.array(inputs[::-1]), hold, axis=0)[:steps]


def _menu(agent: AnyAgent) -> FloatArray:
    """Return inputs (m, k) that are tried: evenly spaced ones."""
    levels = LEVELS.get(agent.n_inputs, OFFERED)
    axes = [np.unique(np.linspace(low, high, levels)) for low, high in zip(agent.input_low, agent.input_high)]
    return np.array([*product(*axes)]).T


class _Charges:
    """What it costs to be somewhere at a time: near the end of the workspace, or of what a letter asks."""

    def __init__(self, problem: Problem, agent: AnyAgent, letters: NDArray[np.int8]) -> None:
        self.agent, self.letters = agent, letters
        self.middle = 0.5 * (agent.input_low + agent.input_high)
        self.half = np.maximum(0.5 * (agent.input_high - agent.input_low), 1e-9)
        names = problem.automaton.propositions
        own = problem.labeling.agent_propositions[problem.agent_names.index(agent.name)]
        self.corners = {int(q): corners_along(problem, names[q], len(letters)) for q in own if letters[:, q].any()}
        low, high = agent.output_ends
        self.spans = np.where(np.isfinite(high - low) & (high > low), high - low, 1.0)[:, None]

    def at(self, t: int, x: FloatArray) -> FloatArray:
        """Return the costs (n,) of states (d, n) at a time; infinite outside of the workspace."""
        agent = self.agent
        width = (agent.state_high - agent.state_low)[:, None]
        within = np.minimum(x - agent.state_low[:, None], agent.state_high[:, None] - x) / width
        spare = [*within]
        if asked := [q for q in self.corners if self.letters[t, q]]:
            outputs = agent.outputs(x)
            for q in asked:
                low, high = (end[t][:, None] for end in self.corners[q])
                inside = np.min(np.minimum(outputs - low, high - outputs) / self.spans, axis=0)
                spare.append(inside if self.letters[t, q] > 0 else -inside)
        values = np.array(spare)[None]
        ends = np.zeros((1, len(spare))), np.full((1, len(spare)), np.inf)
        cost = soft_costs(values, ends, np.full(ends[0].shape, SHARP), np.zeros(ends[0].shape))[0][0].sum(axis=0)
        return np.where((within >= 0.0).all(axis=0) & np.isfinite(cost), cost, np.inf)
