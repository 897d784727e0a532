"""Words of visits at times of their own: for tasks that ask for something again and again, or by a time.

An automaton that counts steps has next to no stays, and a word of few cubes cannot go to and fro. So words are looked
for as visits, one letter each, with one letter read in between; what counts is how fast agents have to be: the squares
of the distances between regions over the steps that are left for them. The automaton judges each word, letter by
letter, and the cheapest ones come first (Dijkstra's search over time, automaton state and letter).
"""

from __future__ import annotations

from collections.abc import Iterator
from heapq import heappop, heappush
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ....envs.systems.agents import AnyAgent
from ....envs.tasks.problem import Problem
from ...relations.grids import FloatArray
from ..chance_constraints import LinearizationErrors, NonlinearModel, corners_along
from .accepted_words import targets_of
from .automaton_paths import AutomatonPath, cubes_of
from .exclusions import exclusions
from .segments import way_of

MOST_LETTERS, MOST_BETWEEN = 16, 4
"""Letters of visits: those that ask for least; and of these, letters that may be read between visits."""

MOST_EDGES = 40_000
"""Visits that are looked at."""

MOST_WORDS = 4
"""Words that are handed over."""

VISIT = 1e-3
"""Cost of a visit, so that there are no needless ones; going from one end of a range to the other within one step
costs 1."""

INWARD = 0.25
"""Share of a region by which visits are farther in on each side than its faces."""

SAMPLES, FASTER = 2_000, 1.2
"""Random states and inputs from which the largest move within a step is known, and by what factor it may be larger."""


def timed_ways(problem: Problem) -> Iterator[tuple[AutomatonPath, tuple[int, ...]]]:
    """Yield ways of visits that the automaton accepts, with the times of their jumps, those of slow agents first."""
    if problem.initial_q is None:
        return
    search = _Visits(problem)
    seen = set[tuple[bytes, ...]]()
    for letters in search.words():
        changes = [0, *(np.flatnonzero(np.any(letters[1:] != letters[:-1], axis=1)) + 1).tolist()]
        visits = tuple(letters[t].tobytes() for t in changes)
        if visits in seen:
            continue
        seen.add(visits)
        cubes = tuple(tuple((p, bool(value > 0)) for p, value in enumerate(letters[t].tolist())) for t in changes)
        yield way_of(problem, cubes, tuple(t + 1 for t in changes[1:]), len(letters))
        if len(seen) == MOST_WORDS:
            return


class _Visit(NamedTuple):
    """A node of the search: what was read last, and where all outputs were last asked to be.

    ``low``, ``high`` and ``since`` (outputs of all agents) say between which ends, and at which time; ``between`` is
    the letter of all times after the node before it.
    """

    t: int
    state: int
    letter: int
    between: int
    before: _Visit | None
    low: FloatArray
    high: FloatArray
    since: FloatArray

    @property
    def key(self) -> tuple[int, int, int, bytes, bytes]:
        """What two nodes have in common of which the cheaper one is gone on with."""
        return self.t, self.state, self.letter, self.low.tobytes(), self.high.tobytes()


class _Visits:
    """The graph of visits."""

    def __init__(self, problem: Problem) -> None:
        self.problem, self.automaton = problem, problem.automaton
        self.told = LinearizationErrors(problem).letters
        self.letters = self._letters()
        self.low, self.high = self._regions()
        self.asks = np.isfinite(self.low) | np.isfinite(self.high)
        about_pairs = np.any(self.letters[:, problem.labeling.first_pair :] > 0, axis=1)
        self.visits = np.flatnonzero(self.asks.any(axis=(0, 2)) | about_pairs)
        self.between = range(min(len(self.letters), MOST_BETWEEN))
        self.fastest = np.concatenate([fastest_moves(agent) for agent in problem.agents])
        self._next: dict[tuple[int, int, bytes], int] = {}

    def words(self) -> Iterator[NDArray[np.int8]]:
        """Yield accepted words, as letters (S, P) of times 1 to S, in the order of what they cost."""
        horizon, co_safe, made = self.problem.horizon, self.automaton.is_co_safe, 0
        heap, known = [(0.0, 0, self._start())], set[tuple[int, int, int, bytes, bytes]]()
        while heap:
            cost, _, node = heappop(heap)
            if node.t == horizon if not co_safe else node.t > 0 and self.automaton.accepting[node.state]:
                if self.automaton.accepting[node.state]:
                    yield self._read(node)
                continue
            if node.key in known:
                continue
            known.add(node.key)
            for between in self.between:
                state = node.state
                if not self._meets(node, between, node.t):
                    continue
                for later in range(node.t + 1, horizon + 1):
                    if made >= MOST_EDGES or self.automaton.dead[state]:
                        break
                    price = self._prices(node, between, later)
                    for visit in self.visits[np.isfinite(price)].tolist():
                        made += 1
                        after = self._after(node, between, visit, state, later)
                        if not self.automaton.dead[after.state] and after.key not in known:
                            heappush(heap, (cost + float(price[np.searchsorted(self.visits, visit)]), made, after))
                    state = self._step(state, between, later)
                else:
                    if not co_safe and self.automaton.accepting[state]:
                        made += 1
                        heappush(heap, (cost, made, node._replace(
                            t=horizon, state=state, letter=between, between=between, before=node)))  # fmt: skip

    def _start(self) -> _Visit:
        """Return the start."""
        assert self.problem.initial_q is not None
        here = [agent.outputs((0.5 * (agent.initial.low + agent.initial.high))[:, None])[:, 0] / spans_of(agent)
                for agent in self.problem.agents]  # fmt: skip
        at = np.concatenate(here)
        return _Visit(0, self.problem.initial_q, -1, 0, None, at, at, np.zeros(len(at)))

    def _after(self, node: _Visit, between: int, visit: int, state: int, later: int) -> _Visit:
        """Return the node of a visit."""
        asks = self.asks[later, visit]
        low, high, since = (
            np.where(asks, new, old)
            for new, old in (
                (self.low[later, visit], node.low), (self.high[later, visit], node.high), (float(later), node.since),
            )
        )  # fmt: skip
        return _Visit(later, self._step(state, visit, later), visit, between, node, low, high, since)

    def _read(self, node: _Visit) -> NDArray[np.int8]:
        """Return the letters (S, P) of times 1 to S that lead to a node."""
        rows: list[NDArray[np.int8]] = []
        while node.before is not None:
            rows.append(self._at(node.letter, node.t))
            rows += [self._at(node.between, k) for k in range(node.t - 1, node.before.t, -1)]
            node = node.before
        return np.array(rows[::-1])

    def _at(self, letter: int, t: int) -> NDArray[np.int8]:
        """Return a letter (P,) as it is read at a time: what nobody steers is what it is."""
        return np.where(self.told[t] != 0, self.told[t], self.letters[letter])

    def _step(self, q: int, letter: int, t: int) -> int:
        """Return the state after a letter at a time."""
        key = (q, letter, self.told[t].tobytes())
        if key not in self._next:
            (self._next[key],) = targets_of(self.automaton, q, self._at(letter, t).tolist())
        return self._next[key]

    def _prices(self, node: _Visit, between: int, later: int) -> FloatArray:
        """Return the cost of each visit at a later time; infinite where agents are not that fast.

        What is read in between asks for no way of its own: its regions meet those before and after it.
        """
        low, high = self.low[later, self.visits], self.high[later, self.visits]
        away = np.maximum(np.maximum(low - node.high, node.low - high), 0.0)
        steps = later - node.since
        price = np.sum(away**2 / steps, axis=1) + VISIT
        possible = ~np.any(away > self.fastest * steps, axis=1)
        if later == node.t + 1:
            price[self.visits == node.letter] -= VISIT
        else:
            possible &= np.all((low <= self.high[later, between]) & (self.low[later, between] <= high), axis=1)
        return np.where(possible, price, np.inf)

    def _meets(self, node: _Visit, letter: int, t: int) -> bool:
        """Return whether the regions of a letter meet those where outputs were last asked to be."""
        return bool(np.all((self.low[t, letter] <= node.high) & (node.low <= self.high[t, letter])))

    def _letters(self) -> NDArray[np.int8]:
        """Return the letters (R, P) of visits, -1 or 1 each: cubes of the automaton, with all that follows from them.

        What is not asked for does not hold; the first letter is that nothing does.
        """
        count, first = len(self.automaton.propositions), self.problem.labeling.first_pair
        apart, within = exclusions(self.problem), self._within()
        found: dict[tuple[int, ...], int] = {(): 0}
        for q in np.flatnonzero(~self.automaton.dead).tolist():
            for cubes in cubes_of(self.problem, q, apart).values():
                for cube in cubes:
                    holds = {p for p, value in cube if value}
                    holds |= {int(k) for p in holds if p < first for k in np.flatnonzero(within[p])}
                    key = tuple(sorted(holds))
                    found[key] = found.get(key, 0) + 1
        order = sorted(found, key=lambda holds: (len(holds), -found[holds], holds))[:MOST_LETTERS]
        letters = np.full((len(order), count), -1, dtype=np.int8)
        for row, propositions in zip(letters, order, strict=True):
            row[list(propositions)] = 1
        return letters

    def _within(self) -> NDArray[np.bool_]:
        """Return which regions that stand still lie in which others of the same agent: bool (P, P)."""
        labeling, names = self.problem.labeling, self.automaton.propositions
        result = np.zeros((len(names), len(names)), dtype=bool)
        for own in labeling.agent_propositions:
            still = [int(p) for p in own if not self.problem.propositions[names[p]].moves]
            ends = {p: corners_along(self.problem, names[p], 1) for p in still}
            for p in still:
                for q in still:
                    result[p, q] = bool(np.all((ends[q][0] <= ends[p][0]) & (ends[p][1] <= ends[q][1])))
        return result

    def _regions(self) -> tuple[FloatArray, FloatArray]:
        """Return where outputs are at each time under each letter: ends (T + 1, R, outputs of all agents).

        They are shares of the range of an output; without a region there are no ends.
        """
        problem, labeling = self.problem, self.problem.labeling
        times, rows = problem.horizon + 1, len(self.letters)
        lows, highs = list[FloatArray](), list[FloatArray]()
        for agent, own in zip(problem.agents, labeling.agent_propositions, strict=True):
            low = np.full((times, rows, agent.n_outputs), -np.inf)
            high = -low
            for p in own:
                first, last = corners_along(problem, labeling.names[p], times)
                width = np.where(np.isfinite(last - first), last - first, 0.0)
                asked = np.flatnonzero(self.letters[:, p] > 0)
                low[:, asked] = np.maximum(low[:, asked], (first + INWARD * width)[:, None])
                high[:, asked] = np.minimum(high[:, asked], (last - INWARD * width)[:, None])
            lows.append(low / spans_of(agent))
            highs.append(high / spans_of(agent))
        low, high = np.concatenate(lows, axis=2), np.concatenate(highs, axis=2)
        # Regions that meet nowhere farther in do so nearer to their faces, or are refused by the planner.
        return np.minimum(low, high), np.maximum(low, high)


def spans_of(agent: AnyAgent) -> FloatArray:
    """Return the ranges (p,) of outputs over the workspace; 1 where they have none."""
    low, high = (end[0] for end in agent.output_range(agent.state_low[None], agent.state_high[None]))
    return np.where(np.isfinite(high - low) & (high > low), high - low, 1.0)


def fastest_moves(agent: AnyAgent) -> FloatArray:
    """Return the largest move (p,) of outputs within one step, as shares of their ranges, as far as samples tell."""
    rng = np.random.default_rng(20261125)
    states = rng.uniform(agent.state_low[:, None], agent.state_high[:, None], (agent.n_states, SAMPLES))
    inputs = rng.uniform(agent.input_low[:, None], agent.input_high[:, None], (agent.n_inputs, SAMPLES))
    after = NonlinearModel(agent).step(states, inputs, 0)
    with np.errstate(all="ignore"):
        move = np.abs(agent.outputs(after) - agent.outputs(states))
    return FASTER * np.max(np.where(np.isfinite(move), move, 0.0), axis=1) / spans_of(agent)
