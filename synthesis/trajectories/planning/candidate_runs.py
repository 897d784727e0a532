"""Runs found by trying inputs: the dynamics are asked, where ways around regions are drawn without them.

A battery that fills at one place alone is such a case: no slope leads there from afar, and no way on a grid of places
knows that it has to be passed. From every state that was come to a few inputs are tried, and held for some steps; of
the states that lie in one cell at the same time the cheapest is gone on with.

What is read on the way is told by given letters, or by the automaton itself: then a run is a word as well, whose visits
are when the agent has time for them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from copy import copy
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from ....envs.systems.agents import AnyAgent
from ....envs.tasks.problem import Problem
from ....envs.tasks.regions import PairRegion
from ...relations.grids import FloatArray
from ..chance_constraints import NonlinearModel, corners_along, soft_costs
from ..words import spans_of
from .counted_work import CountedWork

CELLS = {1: 200, 2: 60, 3: 24}
"""Cells per axis, by the number of states: of more states cells say too little of where one is."""

LEVELS, OFFERED = {1: 7, 2: 3}, 3
"""Levels of each input, by their number, and beyond."""

DECISIONS = 20
"""About how often inputs are chosen along a run."""

MOST_STEPS = 4_000_000
"""Steps of single states that are tried along a run, at most: cells are larger then, or the cheapest states alone are
gone on with."""

SHARP = 0.02
"""Share of a range that counts as a deviation."""

EFFORT = 3e-2
"""Cost of an input at half its range, for each step."""

STEP = 2e-7
"""Work of a step of a single state."""

Read = Callable[[int, FloatArray, NDArray[np.int64]], tuple[NDArray[np.int64], FloatArray, NDArray[np.int64]]]
"""What may be read in states (d, n) at a time, after automaton states (n,): the numbers (k,) of these states, once for
each automaton state that follows, their costs (k,), and what follows (k,)."""


def candidate_run(
    problem: Problem, model: NonlinearModel, letters: NDArray[np.int8], start: FloatArray, work: CountedWork
) -> FloatArray | None:
    """Return inputs (S, m) of a run that keeps letters (S + 1, P) as well as any that was tried, from a start (d,).

    None for agents of many states, and where all runs leave the workspace.
    """
    if model.agent.n_states not in CELLS or not model.agent.n_inputs:
        return None
    places = Places(problem, model.agent)

    def read(t: int, x: FloatArray, q: NDArray[np.int64]) -> tuple[NDArray[np.int64], FloatArray, NDArray[np.int64]]:
        spare = [within * wanted for within, wanted in zip(places.depths(t, x), letters[t, places.own]) if wanted]
        return np.arange(len(q)), places.cost(x, spare), q

    steps = len(letters) - 1
    fronts = [*explored(model, (start, 0), steps, read, work)]
    return fronts[-1].inputs(int(np.argmin(fronts[-1].total))) if len(fronts) == steps else None


@dataclass(frozen=True, eq=False)
class _Front:
    """Automaton states (n,) of runs that were come to at a time, what the runs cost (n,), and how they came, by steps:
    numbers of runs (n,) one step before, and inputs (m, n)."""

    q: NDArray[np.int64]
    total: FloatArray
    came: tuple[tuple[NDArray[np.int64], FloatArray], ...]

    def inputs(self, at: int) -> FloatArray:
        """Return the inputs (t, m) of one run."""
        found = list[FloatArray]()
        for parents, inputs in reversed(self.came):
            found.append(inputs[:, at])
            at = int(parents[at])
        return np.array(found[::-1])


def explored(
    model: NonlinearModel,
    start: tuple[FloatArray, int],
    steps: int,
    read: Read,
    work: CountedWork,
    over: NDArray[np.bool_] | None = None,
    levels: dict[int, int] | None = None,
) -> Iterator[_Front]:
    """Yield the runs after each step, as long as there are any.

    From automaton states that are ``over`` nothing is gone on with. ``levels`` of inputs are ``LEVELS`` as a rule.
    """
    agent = model.agent
    input_set, hold = _menu(agent, levels or LEVELS), max(1, round(steps / DECISIONS))
    k, d = input_set.shape[1], agent.n_states
    most = max(1, MOST_STEPS // (steps * k))
    count = min(CELLS[d], max(2, int(most ** (1.0 / d))))
    low, size = agent.state_low[:, None], (agent.state_high - agent.state_low)[:, None] / count
    half = np.maximum(0.5 * (agent.input_high - agent.input_low), 1e-9)[:, None]
    effort = EFFORT * np.sum(((input_set - 0.5 * (agent.input_low + agent.input_high)[:, None]) / half) ** 2, axis=0)
    x, q, total = start[0][:, None], np.array([start[1]]), np.zeros(1)
    came: list[tuple[NDArray[np.int64], FloatArray]] = []
    for t in range(1, steps + 1):
        if (t - 1) % hold == 0:
            # The cheapest of each cell comes first, and is gone on with under every input.
            cells = np.clip(np.floor((x - low) / size), 0, count - 1).astype(np.int64)
            numbers = np.ravel_multi_index((q, *cells), (int(q.max()) + 1, *(count,) * d))
            order = np.lexsort((total, numbers))
            kept = order[np.flatnonzero(np.diff(numbers[order], prepend=-1))]
            kept = kept[np.argsort(_ranks(q[kept], total[kept]), kind="stable")[:most]]
            parents = np.repeat(kept, k)
            u, push = np.tile(input_set, len(kept)), np.tile(effort, len(kept))
        else:
            parents = np.arange(x.shape[1])
        with np.errstate(all="ignore"):
            x = model.step(x[:, parents], u, t - 1)
        rows, cost, q = read(t, x, q[parents])
        work.count(STEP * x.shape[1])
        parents, x, u, push = parents[rows], x[:, rows], u[:, rows], push[rows]
        total = total[parents] + cost + push
        usable = np.isfinite(total)
        x, q, total, u, push = x[:, usable], q[usable], total[usable], u[:, usable], push[usable]
        if not len(total):
            return
        came.append((parents[usable], u))
        yield _Front(q, total, tuple(came))
        if over is not None and np.any(over[q]):
            going = ~over[q]
            if not going.any():
                return
            x, q, total, u, push = x[:, going], q[going], total[going], u[:, going], push[going]
            came[-1] = came[-1][0][going], u


def _ranks(q: NDArray[np.int64], total: FloatArray) -> NDArray[np.int64]:
    """Return how many runs (n,) in the same automaton state are cheaper: the cheapest of all wait where they are."""
    order = np.lexsort((total, q))
    firsts = np.flatnonzero(np.diff(q[order], prepend=-1))
    ranks = np.empty(len(q), dtype=np.int64)
    ranks[order] = np.arange(len(q)) - np.repeat(firsts, np.diff(firsts, append=len(q)))
    return ranks


def _menu(agent: AnyAgent, levels: dict[int, int]) -> FloatArray:
    """Return inputs (m, k) that are tried: evenly spaced ones."""
    count = levels.get(agent.n_inputs, OFFERED)
    ends = zip(agent.input_low, agent.input_high, strict=True)
    return np.array([*product(*(np.unique(np.linspace(low, high, count)) for low, high in ends))]).T


@dataclass(frozen=True, eq=False)
class Beside:
    """A pair of an agent and another one whose outputs (T + 1, p) are known: its proposition, the sign of the agent's
    outputs in the difference, and at which places they are."""

    proposition: int
    pair: PairRegion
    sign: float
    columns: list[int]
    other: FloatArray


class Places:
    """How far states of one agent are within its workspace and its regions, and what it costs to be near their ends."""

    def __init__(
        self, problem: Problem, agent: AnyAgent, corners: Sequence[tuple[FloatArray, FloatArray]] | None = None
    ) -> None:
        self.agent, names = agent, problem.automaton.propositions
        self.own = problem.labeling.agent_propositions[problem.agent_names.index(agent.name)]
        self.corners = corners or [corners_along(problem, names[q], problem.horizon + 1) for q in self.own]
        self.pairs = list[Beside]()
        self.spans = spans_of(agent)[:, None]

    def depths(self, t: int, x: FloatArray) -> list[FloatArray]:
        """Return how deep (n,) in each region states (d, n) are, as shares of ranges; below 0 outside."""
        return self.depths_of(t, self.agent.outputs(x))

    def depths_of(self, t: int, outputs: FloatArray) -> list[FloatArray]:
        """Return how deep (n,) in each region, and in each pair, outputs (p, n) are."""
        result = list[FloatArray]()
        for low, high in self.corners:
            beyond = np.minimum(outputs - low[t][:, None], high[t][:, None] - outputs) / self.spans
            result.append(beyond.min(axis=0))
        for beside in self.pairs:
            region, spans = beside.pair.at(t), self.spans[beside.columns]
            apart = beside.sign * (outputs[beside.columns] - beside.other[t][:, None])
            beyond = np.minimum(apart - region.low[:, None], region.high[:, None] - apart) / spans
            if region.radius < np.inf:
                beyond = np.append(
                    beyond, ((region.radius - np.linalg.norm(apart, axis=0)) / spans.max())[None], axis=0
                )
            result.append(beyond.min(axis=0))
        return result

    def beside(self, pairs: Sequence[Beside]) -> Places:
        """Return these places with the pairs of others whose runs are known."""
        result = copy(self)
        result.own = np.array([*self.own, *(one.proposition for one in pairs)], dtype=np.int64)
        result.pairs = list(pairs)
        return result

    def cost(self, x: FloatArray, spare: list[FloatArray]) -> FloatArray:
        """Return the costs (n,) of states with some distances (n,) to spare; infinite outside of the workspace."""
        agent = self.agent
        within = np.minimum(x - agent.state_low[:, None], agent.state_high[:, None] - x)
        values = np.array([*(within / (agent.state_high - agent.state_low)[:, None]), *spare])[None]
        ends = np.zeros(values.shape[:2]), np.full(values.shape[:2], np.inf)
        cost = soft_costs(values, ends, np.full(ends[0].shape, SHARP), ends[0])[0][0].sum(axis=0)
        return np.where((within >= 0.0).all(axis=0) & np.isfinite(cost), cost, np.inf)
