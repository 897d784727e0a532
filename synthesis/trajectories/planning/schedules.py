"""Plans of runs that the automaton accepts, found by trying inputs: the agents of a team take turns.

Cars at a crossing, robots that share a press and drones before a gate have plans of many words, of which the automaton
says little: who goes first is for nobody to choose alone. So each agent is planned for itself, as those before it go.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import islice, permutations

import numpy as np
from numpy.typing import NDArray

from ....envs.systems.agents import AnyAgent, LinearAgent
from ....envs.tasks.automata import Automaton
from ....envs.tasks.problem import Problem
from ...relations.grids import FloatArray
from ..chance_constraints import LinearizationErrors, NonlinearModel, corners_along
from ..words import AutomatonPath, Cube, Plan, cubes_of, fastest_moves, spans_of, targets_of
from .candidate_runs import CELLS, LEVELS, Beside, Places, explored
from .counted_work import CountedWork

LEVELS_OF_POINTS = {1: 9, 2: 5, 3: 5}
"""Levels of each velocity of a point, which comes to as few places as there are levels."""

ENOUGH, FEW, MOST_ORDERS = 2, 4, 24
"""Plans that are handed over; agents up to which any order is tried, and how many are, at most."""

TIME_TO_SPARE = 0.04
"""Share of the horizon by which an agent may be early or late, at first: plans have to keep away from each other."""

SHARE_OF_SPEED = 0.5
"""Share of the fastest move of an agent of many states at which it counts as a point: it has to turn, and to brake."""


def plans_of_runs(problem: Problem, work: CountedWork) -> Iterator[Plan]:
    """Yield the plans of ``runs_in_turn``."""
    return (plan for plan, _ in runs_in_turn(problem, work))


def runs_in_turn(problem: Problem, work: CountedWork) -> Iterator[tuple[Plan, list[FloatArray]]]:
    """Yield plans of runs that the automaton accepts, as far as some are found, and outputs (T + 1, p) of each agent.

    The agents of a team are planned in turn, in several orders: each knows what those before it do, and reads what
    suits it of those after it. So who comes later waits, or goes first.
    """
    nobodys = LinearizationErrors(problem).agents
    steered = [i for i in range(problem.n_agents) if i not in nobodys]
    if problem.initial_q is None or not steered or any(agent.others for agent in problem.agents):
        return
    movers, found = {i: _mover_of(problem, i, len(steered) > 1) for i in steered}, 0
    in_time = 0 if len(steered) == 1 else max(1, round(TIME_TO_SPARE * problem.horizon))
    for early in dict.fromkeys((in_time, 0)):
        for order in _orders(steered):
            if found == ENOUGH:
                return
            read = _read_by_turns(problem, {i: movers[i] for i in order}, early, work)
            if read is not None:
                found += 1
                yield from ((plan, read[1]) for plan in _plan_along(problem, read[0]))


def _orders(agents: Sequence[int]) -> Iterator[Sequence[int]]:
    """Yield orders in which agents are planned: as they are, the other way round, and some or all others."""
    yield agents
    if len(agents) == 1:
        return
    yield agents[::-1]
    turned = ([*agents[k:], *agents[:k]] for k in range(1, len(agents)))
    others = permutations(agents) if len(agents) <= FEW else (one[::step] for one in turned for step in (1, -1))
    yield from (order for order in islice(others, MOST_ORDERS) if [*order] not in ([*agents], [*agents[::-1]]))


@dataclass(frozen=True, eq=False)
class _Mover:
    """An agent that tries inputs, its regions, where it starts (d,), and how many levels its inputs have.

    ``columns`` say at which place each output of the agent is among its own.
    """

    model: NonlinearModel
    places: Places
    start: FloatArray
    levels: dict[int, int]
    columns: dict[int, int]

    @classmethod
    def of(cls, problem: Problem, agent: AnyAgent) -> _Mover:
        """Return an agent as it is."""
        columns = {k: k for k in range(agent.n_outputs)}
        return cls(NonlinearModel(agent), Places(problem, agent), middle_of(agent), LEVELS, columns)

    def beside(self, problem: Problem, i: int, gone: dict[int, tuple[_Mover, FloatArray]]) -> Places:
        """Return the places of agent i, pairs with agents whose outputs are known included."""
        pairs = []
        for p, pair in enumerate(problem.labeling.pairs, start=problem.labeling.first_pair):
            for side, (own, other) in enumerate(((pair.first, pair.second), (pair.second, pair.first))):
                if own == i and other in gone:
                    mover, outputs = gone[other]
                    theirs = outputs[:, [mover.columns[k] for k in pair.outputs[1 - side]]]
                    mine = [self.columns[k] for k in pair.outputs[side]]
                    pairs.append(Beside(p, pair, 1.0 if side == 0 else -1.0, mine, theirs))
        return self.places.beside(pairs)

    def whole(self, agent: AnyAgent, outputs: FloatArray) -> FloatArray:
        """Return all outputs (T + 1, p) of an agent, of which those that no region limits stay what they are."""
        result = np.tile(agent.outputs(middle_of(agent)[:, None])[:, 0], (len(outputs), 1))
        result[:, [*self.columns]] = outputs[:, [*self.columns.values()]]
        return result

    def outputs(self, inputs: FloatArray) -> FloatArray:
        """Return the outputs (T + 1, p) of the run of inputs (T, m)."""
        x, result = self.start[:, None], [self.model.agent.outputs(self.start[:, None])[:, 0]]
        for t, u in enumerate(inputs):
            x = self.model.step(x, u[:, None], t)
            result.append(self.model.agent.outputs(x)[:, 0])
        return np.array(result)


def _mover_of(problem: Problem, i: int, in_team: bool) -> _Mover | None:
    """Return an agent as it is, if it has few states; one of a team may be a point that moves at some speed instead.

    A point has the outputs that regions limit for states. What its run reads is no more than a guess, like all words.
    """
    agent = problem.agents[i]
    if agent.n_states in CELLS and agent.n_inputs:
        return _Mover.of(problem, agent)
    low, high = (end[0] for end in agent.output_range(agent.state_low[None], agent.state_high[None]))
    own = problem.labeling.agent_propositions[i]
    corners = [corners_along(problem, problem.automaton.propositions[p], problem.horizon + 1) for p in own]
    compared = {
        k
        for pair in problem.labeling.pairs
        for one, outputs in zip((pair.first, pair.second), pair.outputs, strict=True)
        for k in (outputs if one == i else ())
    }
    asked = np.flatnonzero([
        k in compared or any(np.any((a[:, k] > low[k]) | (b[:, k] < high[k])) for a, b in corners)
        for k in range(len(low))
    ])  # fmt: skip
    bounded = np.all(np.isfinite(low[asked]) & np.isfinite(high[asked]) & (low[asked] < high[asked]))
    if not in_team or len(asked) not in CELLS or agent.added_outputs or not agent.n_inputs or not bounded:
        return None
    speed = SHARE_OF_SPEED * fastest_moves(agent)[asked] * spans_of(agent)[asked]
    if not np.all(speed > 0.0):
        return None
    start = agent.outputs(middle_of(agent)[:, None])[asked, 0]
    eye, box = np.eye(len(asked)), np.clip(start, low[asked], high[asked])
    point = LinearAgent(
        name=agent.name, A=eye, B=eye, noise_covariance=eye, state_low=low[asked], state_high=high[asked],
        input_low=-speed, input_high=speed, initial_state=box,
    )  # fmt: skip
    places = Places(problem, point, [(a[:, asked], b[:, asked]) for a, b in corners])
    columns = {int(k): place for place, k in enumerate(asked)}
    return _Mover(NonlinearModel(point), places, box, LEVELS_OF_POINTS, columns)


def _read_by_turns(
    problem: Problem, movers: dict[int, _Mover | None], early: int, work: CountedWork
) -> tuple[NDArray[np.bool_], list[FloatArray]] | None:
    """Return the letters (S + 1, P) that are read along runs that are accepted together, and outputs of all agents.

    None if an agent has no run in its turn. Agents without a mover here have no choice of inputs. Nobody breaks the
    task if others are so many steps earlier or later than they are.
    """
    automaton, linearization_errors, last = problem.automaton, LinearizationErrors(problem), 0
    told = linearization_errors.letters.copy()
    owned = list[NDArray[np.int64]]()
    gone = {
        i: (_Mover.of(problem, problem.agents[i]), linearization_errors.outputs(i)) for i in linearization_errors.agents
    }
    for i, mover in movers.items():
        if mover is None or work.is_over():
            return None
        alone, places = len(movers) == 1, mover.beside(problem, i, gone)
        fronts = explored(
            mover.model,
            (mover.start, int(problem.initial_q or 0)),
            problem.horizon,
            partial(_read_in_turn, automaton, _sooner_or_later(told, early, owned), places, {}),
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
        gone[i], last = (mover, mover.outputs(inputs)), len(inputs)
        for t in range(1, last + 1):
            depths = places.depths_of(t, gone[i][1][t][:, None])
            told[t, places.own] = [1 if depth[0] >= 0.0 else -1 for depth in depths]
        owned.append(places.own)
    return told[: last + 1] > 0, [gone[i][0].whole(problem.agents[i], gone[i][1]) for i in range(problem.n_agents)]


def _sooner_or_later(told: NDArray[np.int8], early: int, owned: Sequence[NDArray[np.int64]]) -> list[NDArray[np.int8]]:
    """Return letters (T + 1, P) as they are, and such that all that one agent reads begins sooner and ends later.

    Or the other way round. ``owned`` are the propositions of each agent whose run is known.
    """
    result = [told]
    padded = np.pad(told, ((early, early), (0, 0)), mode="edge")
    near = np.stack([padded[k : k + len(told)] for k in range(2 * early + 1)])
    for own in owned if early else ():
        for ends in (near.max(axis=0), near.min(axis=0)):
            result.append(told.copy())
            result[-1][:, own] = ends[:, own]
    return result


def _read_in_turn(
    automaton: Automaton,
    told: Sequence[NDArray[np.int8]],
    places: Places,
    known: dict[tuple[int, int, int], list[int]],
    t: int,
    x: FloatArray,
    q: NDArray[np.int64],
) -> tuple[NDArray[np.int64], FloatArray, NDArray[np.int64]]:
    """Return what may be read in states (d, n) of one agent: each with every state that letters of others lead to.

    Letters ``told`` (T + 1, P) say what others read, 0 where that is open; other letters than the first ones must not
    break the task.
    """
    depths = places.depths(t, x)
    # Whether regions are entered or not: where that is nearly the same a run says little.
    cost = places.cost(x, [np.abs(depth) for depth in depths])
    inside = np.array([depth >= 0.0 for depth in depths], dtype=bool).reshape(len(depths), x.shape[1])
    codes = np.zeros(x.shape[1], dtype=np.int64)
    for row in inside:
        codes = 2 * codes + row
    _, firsts, of = np.unique(codes * automaton.n_states + q, return_index=True, return_inverse=True)
    targets = list[list[int]]()
    for first in firsts.tolist():
        key = t, int(q[first]), int(codes[first])
        if key not in known:
            alive = list[list[int]]()
            for others in told:
                letter = others[t].copy()
                letter[places.own] = np.where(inside[:, first], 1, -1)
                reached = targets_of(automaton, int(q[first]), letter.tolist())
                alive.append(sorted(to for to in reached if not automaton.dead[to]))
            known[key] = alive[0] if all(alive) else []
        targets.append(known[key])
    counts = np.array([len(own) for own in targets])[of]
    rows = np.repeat(np.arange(len(q)), counts)
    return rows, cost[rows], np.array([to for k in of.tolist() for to in targets[k]], dtype=np.int64)


def middle_of(agent: AnyAgent) -> FloatArray:
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
        yield Plan(AutomatonPath(read, read[1:]), times, len(cubes))
