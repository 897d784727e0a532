"""Runs found by trying inputs: the dynamics are asked, where ways around regions are drawn without them.

A battery that fills at one place alone is such a case: no slope leads there from afar, and no way on a grid of places
knows that it has to be passed. From every state that was come to a few inputs are tried, and held for some steps; of
the states that lie in one cell at the same time the cheapest is gone on with.

What is read on the way is told by given letters, or by the automaton itself: then a run is a word as well, whose visits
are when the agent has time for them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import product

import numpy as np
from numpy.typing import NDArray

from ...envs.agents import AnyAgent, LinearAgent
from ...envs.logic import Automaton
from ...envs.problem import Problem
from ..cells import FloatArray
from .accepted_words import targets_of
from .counted_work import CountedWork
from .drifts import Drifts
from .nonlinear_model import NonlinearModel
from .path_limits import corners_along
from .soft_costs import soft_costs
from .timed_words import fastest_moves, spans_of
from .words import Cube, Plan, Way, cubes_of

CELLS = {1: 200, 2: 60, 3: 24}
"""Cells per axis, by the number of states: of more states cells say too little of where one is."""

LEVELS, OFFERED = {1: 7, 2: 3}, 3
"""Levels of each input, by their number, and beyond."""

LEVELS_OF_POINTS = {1: 9, 2: 5, 3: 5}
"""Levels of each velocity of a point, which comes to as few places as there are levels."""

DECISIONS = 20
"""About how often inputs are chosen along a run."""

MOST_STEPS = 4_000_000
"""Steps of single states that are tried along a run, at most: cells are larger then, or the cheapest states alone are
gone on with."""

SHARP = 0.02
"""Share of a range that counts as a deviation."""

EFFORT = 3e-2
"""Cost of an input at half its range, for each step."""

SHARE_OF_SPEED = 0.5
"""Share of the fastest move of an agent of many states at which it counts as a point: it has to turn, and to brake."""

STEP = 2e-7
"""Work of a step of a single state."""

Read = Callable[[int, FloatArray, NDArray[np.int64]], tuple[NDArray[np.int64], FloatArray, NDArray[np.int64]]]
"""What may be read in states (d, n) at a time, after automaton states (n,): the numbers (k,) of these states, once for
each automaton state that follows, their costs (k,), and what follows (k,)."""


def tried_run(
    problem: Problem, model: NonlinearModel, letters: NDArray[np.int8], start: FloatArray, work: CountedWork
) -> FloatArray | None:
    """Return inputs (S, m) of a run that keeps letters (S + 1, P) as well as any that was tried, from a start (d,).

    None for agents of many states, and where all runs leave the workspace.
    """
    if model.agent.n_states not in CELLS or not model.agent.n_inputs:
        return None
    places = _Places(problem, model.agent)

    def read(t: int, x: FloatArray, q: NDArray[np.int64]) -> tuple[NDArray[np.int64], FloatArray, NDArray[np.int64]]:
        spare = [within * wanted for within, wanted in zip(places.depths(t, x), letters[t, places.own]) if wanted]
        return np.arange(len(q)), places.cost(x, spare), q

    steps = len(letters) - 1
    fronts = [*_explored(model, (start, 0), steps, read, work)]
    return fronts[-1].inputs(int(np.argmin(fronts[-1].total))) if len(fronts) == steps else None


def plans_of_runs(problem: Problem, work: CountedWork) -> Iterator[Plan]:
    """Yield plans of runs that the automaton accepts, as far as some are found.

    The agents of a team are planned in turn, in the order of the problem and in the opposite one: each knows what those
    before it do, and reads what suits it of those after it. So who comes later waits, or goes first.
    """
    agents, every = problem.agents, range(problem.n_agents)
    steered = [i for i in every if not np.array_equal(agents[i].input_low, agents[i].input_high)]
    if problem.labeling.pairs or problem.initial_q is None or not steered or any(agent.others for agent in agents):
        return
    movers = {i: _mover_of(problem, i, len(steered) > 1) for i in steered}
    for order in [steered] if len(steered) == 1 else [steered, steered[::-1]]:
        letters = _read_by_turns(problem, [movers[i] for i in order], work)
        if letters is not None:
            yield from _plan_along(problem, letters)


@dataclass(frozen=True, eq=False)
class _Mover:
    """An agent that tries inputs, its regions, where it starts (d,), and how many levels its inputs have."""

    model: NonlinearModel
    places: _Places
    start: FloatArray
    levels: dict[int, int]


def _mover_of(problem: Problem, i: int, in_team: bool) -> _Mover | None:
    """Return an agent as it is, if it has few states; one of a team may be a point that moves at some speed instead.

    A point has the outputs that regions limit for states. What its run reads is no more than a guess, like all words.
    """
    agent = problem.agents[i]
    if agent.n_states in CELLS and agent.n_inputs:
        return _Mover(NonlinearModel(agent), _Places(problem, agent), _middle(agent), LEVELS)
    low, high = (end[0] for end in agent.output_range(agent.state_low[None], agent.state_high[None]))
    own = problem.labeling.agent_propositions[i]
    corners = [corners_along(problem, problem.automaton.propositions[p], problem.horizon + 1) for p in own]
    asked = np.flatnonzero([
        any(np.any((a[:, k] > low[k]) | (b[:, k] < high[k])) for a, b in corners) for k in range(len(low))
    ])  # fmt: skip
    bounded = np.all(np.isfinite(low[asked]) & np.isfinite(high[asked]) & (low[asked] < high[asked]))
    if not in_team or len(asked) not in CELLS or agent.added_outputs or not agent.n_inputs or not bounded:
        return None
    speed = SHARE_OF_SPEED * fastest_moves(agent)[asked] * spans_of(agent)[asked]
    if not np.all(speed > 0.0):
        return None
    start = agent.outputs(_middle(agent)[:, None])[asked, 0]
    eye, box = np.eye(len(asked)), np.clip(start, low[asked], high[asked])
    point = LinearAgent(
        name=agent.name, A=eye, B=eye, noise_covariance=eye, state_low=low[asked], state_high=high[asked],
        input_low=-speed, input_high=speed, initial_state=box,
    )  # fmt: skip
    places = _Places(problem, point, [(a[:, asked], b[:, asked]) for a, b in corners])
    return _Mover(NonlinearModel(point), places, box, LEVELS_OF_POINTS)


def _read_by_turns(problem: Problem, movers: Sequence[_Mover | None], work: CountedWork) -> NDArray[np.bool_] | None:
    """Return the letters (S + 1, P) that are read along runs that are accepted together.

    None if an agent has no run in its turn. Agents without a mover here have no choice of inputs.
    """
    automaton, told, last = problem.automaton, Drifts(problem).letters.copy(), 0
    for mover in movers:
        if mover is None or work.is_over():
            return None
        alone = len(movers) == 1
        fronts = _explored(
            mover.model,
            (mover.start, int(problem.initial_q or 0)),
            problem.horizon,
            partial(_read_in_turn, automaton, told, mover.places, {}),
            work,
            automaton.finished if alone else None,
            mover.levels,
        )
        cheapest, inputs = np.inf, None
        for t, front in enumerate(fronts, start=1):
            # A team goes on until all are there.
            if t == problem.horizon or (alone and automaton.is_co_safe):
                total = np.where(automaton.accepting[front.q], front.total, np.inf)
                at = int(np.argmin(total))
                if total[at] < cheapest:
                    cheapest, inputs = float(total[at]), front.inputs(at)
        if inputs is None:
            return None
        x, last = mover.start, len(inputs)
        for t, u in enumerate(inputs, start=1):
            x = mover.model.step(x[:, None], u[:, None], t - 1)[:, 0]
            told[t, mover.places.own] = [1 if depth[0] >= 0.0 else -1 for depth in mover.places.depths(t, x[:, None])]
    return told[: last + 1] > 0


def _read_in_turn(
    automaton: Automaton,
    told: NDArray[np.int8],
    places: _Places,
    known: dict[tuple[int, int, int], list[int]],
    t: int,
    x: FloatArray,
    q: NDArray[np.int64],
) -> tuple[NDArray[np.int64], FloatArray, NDArray[np.int64]]:
    """Return what may be read in states (d, n) of one agent: each with every state that letters of others lead to.

    Letters ``told`` (T + 1, P) say what others read, 0 where that is open.
    """
    depths = places.depths(t, x)
    # Whether regions are entered or not: where that is nearly the same a run says little.
    cost = places.cost(x, [np.abs(depth) for depth in depths])
    inside = np.array([depth >= 0.0 for depth in depths]).reshape(len(depths), -1)
    codes = np.zeros(x.shape[1], dtype=np.int64)
    for row in inside:
        codes = 2 * codes + row
    _, firsts, of = np.unique(codes * automaton.n_states + q, return_index=True, return_inverse=True)
    targets = list[list[int]]()
    for first in firsts.tolist():
        key = t, int(q[first]), int(codes[first])
        if key not in known:
            letter = told[t].copy()
            letter[places.own] = np.where(inside[:, first], 1, -1)
            reached = targets_of(automaton, int(q[first]), letter.tolist())
            known[key] = sorted(to for to in reached if not automaton.dead[to])
        targets.append(known[key])
    counts = np.array([len(own) for own in targets])[of]
    rows = np.repeat(np.arange(len(q)), counts)
    return rows, cost[rows], np.array([to for k in of.tolist() for to in targets[k]], dtype=np.int64)


def _middle(agent: AnyAgent) -> FloatArray:
    """Return the middle (d,) of an agent's starts."""
    return np.asarray(0.5 * (agent.initial.low + agent.initial.high))


def _plan_along(problem: Problem, letters: NDArray[np.bool_]) -> Iterator[Plan]:
    """Yield the plan of letters (S + 1, P) that are accepted: a cube for each step, kept for as long as it may be."""
    automaton, q = problem.automaton, problem.initial_q
    assert q is not None
    cubes, known = list[Cube](), dict[int, dict[int, list[Cube]]]()
    for letter in letters[1:]:
        if automaton.finished[q]:
            break
        after = int(automaton.next_state(np.int64(q), letter))
        if q not in known:
            known[q] = cubes_of(problem, q)
        fitting = [cube for cube in known[q].get(after, []) if all(letter[p] == holds for p, holds in cube)]
        whole = tuple((p, bool(holds)) for p, holds in enumerate(letter))
        cubes.append(cubes[-1] if cubes and cubes[-1] in fitting else (*fitting, whole)[0])
        q = after
    if cubes:
        times = tuple(t for t in range(2, len(cubes) + 1) if cubes[t - 1] != cubes[t - 2])
        read = (cubes[0], *(cubes[t - 1] for t in times))
        yield Plan(Way(read, read[1:]), times, len(cubes))


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


def _explored(
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
    menu, hold = _menu(agent, levels or LEVELS), max(1, round(steps / DECISIONS))
    k, d = menu.shape[1], agent.n_states
    most = max(1, MOST_STEPS // (steps * k))
    count = min(CELLS[d], max(2, int(most ** (1.0 / d))))
    low, size = agent.state_low[:, None], (agent.state_high - agent.state_low)[:, None] / count
    half = np.maximum(0.5 * (agent.input_high - agent.input_low), 1e-9)[:, None]
    effort = EFFORT * np.sum(((menu - 0.5 * (agent.input_low + agent.input_high)[:, None]) / half) ** 2, axis=0)
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
            u, push = np.tile(menu, len(kept)), np.tile(effort, len(kept))
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


class _Places:
    """How far states of one agent are within its workspace and its regions, and what it costs to be near their ends."""

    def __init__(
        self, problem: Problem, agent: AnyAgent, corners: Sequence[tuple[FloatArray, FloatArray]] | None = None
    ) -> None:
        self.agent, names = agent, problem.automaton.propositions
        self.own = problem.labeling.agent_propositions[problem.agent_names.index(agent.name)]
        self.corners = corners or [corners_along(problem, names[q], problem.horizon + 1) for q in self.own]
        self.spans = spans_of(agent)[:, None]

    def depths(self, t: int, x: FloatArray) -> list[FloatArray]:
        """Return how deep (n,) in each region states (d, n) are, as shares of ranges; below 0 outside."""
        outputs, result = self.agent.outputs(x), list[FloatArray]()
        for low, high in self.corners:
            beyond = np.minimum(outputs - low[t][:, None], high[t][:, None] - outputs) / self.spans
            result.append(beyond.min(axis=0))
        return result

    def cost(self, x: FloatArray, spare: list[FloatArray]) -> FloatArray:
        """Return the costs (n,) of states with some distances (n,) to spare; infinite outside of the workspace."""
        agent = self.agent
        within = np.minimum(x - agent.state_low[:, None], agent.state_high[:, None] - x)
        values = np.array([*(within / (agent.state_high - agent.state_low)[:, None]), *spare])[None]
        ends = np.zeros(values.shape[:2]), np.full(values.shape[:2], np.inf)
        cost = soft_costs(values, ends, np.full(ends[0].shape, SHARP), ends[0])[0][0].sum(axis=0)
        return np.where((within >= 0.0).all(axis=0) & np.isfinite(cost), cost, np.inf)
