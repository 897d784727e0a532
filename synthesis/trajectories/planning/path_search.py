"""The best path that is found: ways through the automaton, times of the jumps, feedbacks, and nominal inputs."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Iterator
from contextlib import suppress
from functools import partial
from itertools import chain, islice, zip_longest
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import LinAlgError, solve_discrete_are

from ....envs.systems.agents import LinearAgent, with_matrices
from ....envs.tasks.problem import Problem, crossed_starts
from ...certificates.beliefs import believed_along
from ...certificates.controllers import covariances_of, nominal_states
from ...certificates.proofs import AgentPath, Certificate, PathProof, Synthesis
from ...relations.grids import FloatArray, NoRunFound, RelationRefused
from ..chance_constraints import (
    LinearizationErrors,
    StripConstraints,
    corners_along,
    failure_of,
    farthest_sides,
    input_strips,
    least_by_times,
    limits_of,
    nearest_by_times,
    state_strips,
    without_far_ends,
)
from ..words import (
    AutomatonPath,
    Cube,
    Plan,
    Reach,
    automaton_paths_of,
    letters_of,
    segmented_ways,
    timed_ways,
    whatever_others_do,
    without_needless,
)
from .angle_paths import along_angles
from .counted_work import CountedWork
from .nominal import ENOUGH, Response, nominal_inputs
from .nonlinear_team import any_failure, nonlinear_certificate, refuse_other_noise
from .schedules import plans_of_runs

GAIN_COSTS = (1.0, 1e-2, 100.0, 0.1, 10.0, 1e3)
"""Costs of inputs, against states, of the feedbacks that are tried."""

FACE_ROUNDS = 4
"""How often the sides on which regions are passed are chosen anew."""

MOST_PLANS = 40
"""Ways with times that are tried, and as many words of few cubes."""

GOOD = 1e-3
"""Probability of failing from which no words of few cubes are tried."""

PLENTY = 1e-8
"""Probability of failing from which nobody needs another plan, or other times."""

PACES = (1.0, 0.6, 0.8, 0.35)
"""Shares of the horizon up to which jumps are spread, in the order in which they are tried."""

MOST_ALIKE = 3
"""Ways of teams that may be read alike: each is another attempt, with feedbacks that are drawn anew."""

NARROWEST = 1e-12
"""Least width of a region in which it is measured how far a path is beyond it: one that moves may be empty."""

FAINT = 0.5
"""Probability of failing from which another feedback does not make a plan a good one."""

HOPELESS = 1.0 - 1e-12
"""Probability of failing from which a plan counts as impossible."""

PATIENCE = 1.0 / 32.0
"""Share of what the search may take, for each state of the largest agent, that plans may take as long as none works."""


def path_certificate(problem: Problem, work: CountedWork | None = None) -> Synthesis:
    """Return a certificate along a path; along nonlinear ones where an agent is not linear from a point.

    ``work`` says what the search may take: nothing is improved after that.

    Raises
    ------
    RelationRefused
        If no normal law is above the noise of an agent, or a start is outside its workspace; NoRunFound if no run
        without noise was found that satisfies the task.
    """
    work = CountedWork() if work is None else work
    refuse_without_path(problem)
    if any(agent.angles for agent in problem.agents):
        return along_angles(problem, path_certificate, work)
    linear = all(agent.is_linear_gaussian and agent.initial.is_point for agent in problem.agents)
    if problem.labeling.pairs or not linear or work.is_hopeless:
        return nonlinear_certificate(problem, SOURCES, work)
    found = linear_certificate(problem, work)
    if found is None:
        # Planned with soft limits instead there may be one that claims nothing, or a word on what is missed. Of teams
        # it is in none of the words that were tried: agents take turns first.
        turns = [partial(plans_of_runs, work=work)] if problem.n_agents > 1 else []
        return nonlinear_certificate(problem, [*turns, *SOURCES], work)
    straight, plan = found
    if not GOOD < straight.certificate.proof.failure < FAINT or work.is_over():
        return straight
    # Feedbacks that change with the time, and visits at times of their own, may be worth more.
    with suppress(NoRunFound):
        bent = nonlinear_certificate(problem, [lambda _: [plan]], work)
        if bent.certificate.lower_bound > straight.certificate.lower_bound:
            return bent
    return straight


def linear_certificate(problem: Problem, work: CountedWork) -> tuple[Synthesis, Plan] | None:
    """Return a certificate along paths of linear agents with one feedback for all times, and its plan; or None.

    Agents start from points, and the task speaks of no pairs.
    """
    began = time.perf_counter()
    finder = _Finder(problem, work)
    best: tuple[float, Plan, Any] | None = None
    patience = work.spent + PATIENCE * max(agent.n_states for agent in problem.agents) * work.limit
    for plans, enough in zip((source(problem) for source in SOURCES), (GOOD, PLENTY, GOOD, GOOD), strict=True):
        if best is not None and best[0] <= enough:
            continue  # even to look for a first word may take seconds
        for plan in islice(plans, MOST_PLANS):
            if work.spent > patience if best is None else best[0] <= enough or work.is_over():
                break
            found = finder.of_plan(plan)
            if found is not None and (best is None or found[0] < best[0]):
                best = found[0], plan, found[1]
                work.tell(found[0])
        best = best if best is None or work.is_over() else _with_better_times(finder, best)
    if best is None or best[0] >= HOPELESS:
        return None
    failure, plan, (paths, letters, faces) = best
    nearest = [finder.nearest(i, path, letters, faces) for i, path in enumerate(paths)]
    each = zip(problem.agents, paths, strict=True)
    covariances = [covariances_of(with_matrices(agent), path.gain, path.n_steps) for agent, path in each]
    spreads = [np.sqrt(np.maximum(np.diagonal(own, axis1=1, axis2=2), 0.0)) for own in covariances]
    believed = believed_along(failure, np.concatenate(spreads, axis=1), least_by_times(nearest))
    settings = {"relation": "path", "jumps": list(plan.times), "plans": finder.tried, "believed": believed}
    certificate = Certificate(problem, PathProof(tuple(paths), letters, faces, failure), settings)
    seconds = {"abstract": 0.0, "synthesize": time.perf_counter() - began}
    unknown = dict.fromkeys(("abstract_upper_bound", "continuous_upper_bound", "unilateral_gain"))
    stats: dict[str, Any] = {"seconds": seconds, "rank": 1, "sweeps": [], "starts": {}, "dropped": 0.0, **unknown}
    return Synthesis(certificate, certificate.controller, stats), plan


def refuse_without_path(problem: Problem) -> None:
    """Raise RelationRefused where it is known before any search that there is no certificate along a path."""
    for name in problem.starts_outside:
        raise RelationRefused(
            f"agent `{name}`: its start is outside its workspace, and no task is satisfied from there"
        )
    for agent in problem.agents:
        refuse_other_noise(agent)
    if problem.initial_q is None:
        why = crossed_starts(problem) or "agents may be near at the start, or not"
        raise RelationRefused(
            f"paths are for starts that have one first letter, or several that lead to one state: {why}"
        )


def _plans(problem: Problem) -> Iterator[Plan]:
    """Yield ways with times of their jumps: evenly spread, or as early or as late as possible.

    Where regions move, jumps are at the nearest times at which what they ask for can hold. The next way is begun before
    further times of those before it: a way may ask for something that cannot be.
    """
    linearization_errors = LinearizationErrors(problem)
    begun = list[Iterator[Plan]]()
    ways: Iterator[Iterator[Plan]] = (_timed(problem, linearization_errors, way) for way in automaton_paths_of(problem))
    # Plans of teams that are compared take seconds: no two ways that are read alike.
    ways = _different(problem, ways) if problem.labeling.pairs else ways
    while True:
        if (way := next(ways, None)) is not None:
            begun.insert(0, way)
        elif not begun:
            return
        for plans in [*begun]:
            if (plan := next(plans, None)) is not None:
                yield plan
            else:
                begun.remove(plans)


def _different(problem: Problem, ways: Iterator[Iterator[Plan]]) -> Iterator[Iterator[Plan]]:
    """Yield ways whose first plans are read as different letters: cubes may differ in what nobody needs."""
    known = Counter[bytes]()
    for plans in ways:
        first = next(plans, None)
        letters = None if first is None else letters_of(problem, first)
        if first is not None and letters is not None and known[letters.tobytes()] < MOST_ALIKE:
            known[letters.tobytes()] += 1
            yield chain([first], plans)


def _timed(problem: Problem, linearization_errors: LinearizationErrors, way: AutomatonPath) -> Iterator[Plan]:
    """Yield a way with times of its jumps."""
    n, seen = len(way.jumps), set[tuple[int, ...]]()
    if n > problem.horizon or (n == 0 and problem.automaton.is_co_safe):
        return
    # Plans of teams with pairs take seconds, and the last share is for where waiting adds noise alone.
    for share in PACES[: -1 if problem.labeling.pairs else None]:
        times = way.spread(max(n, round(share * problem.horizon)))
        if problem.labeling.moves:
            times = _nearest_times(problem, way, times)
        if len(times) == n and times not in seen and all(a < b for a, b in zip(times, times[1:])):
            seen.add(times)
            yield from _possible(problem, linearization_errors, way, times)


def _timed_plans(problem: Problem) -> Iterator[Plan]:
    """Yield words of visits at times of their own."""
    linearization_errors = LinearizationErrors(problem)
    for way, times in timed_ways(problem):
        yield from _possible(problem, linearization_errors, way, times)


def _segmented_plans(problem: Problem) -> Iterator[Plan]:
    """Yield words of few cubes, each read from some time on."""
    linearization_errors = LinearizationErrors(problem)
    for way, times in segmented_ways(problem):
        yield from _possible(problem, linearization_errors, way, times)


def _plans_whatever_others_do(problem: Problem) -> Iterator[Plan]:
    """Yield plans that ask nothing of agents nobody steers, if there are such agents: one of each kind in turn."""
    freed = whatever_others_do(problem)
    if freed is not None:
        rows = [source(freed) for source in (_segmented_plans, _plans, _timed_plans)]
        reach = Reach(freed)
        yield from (plan for row in zip_longest(*rows) for plan in row if plan is not None and reach.has(plan))


SOURCES = (_plans_whatever_others_do, _plans, _segmented_plans, _timed_plans)
"""Where plans come from, in the order in which they are asked: the next one only where those before gave too little."""


def _possible(
    problem: Problem, linearization_errors: LinearizationErrors, way: AutomatonPath, times: tuple[int, ...]
) -> Iterator[Plan]:
    """Yield the plan of a way with times, unless agents that nobody steers rule it out."""
    steps = times[-1] if problem.automaton.is_co_safe else problem.horizon
    letters = way.letters(times, steps, len(problem.automaton.propositions))
    if letters is not None and linearization_errors.may_read(without_needless(problem, letters)):
        yield Plan(way, times, steps)


def _nearest_times(problem: Problem, way: AutomatonPath, times: tuple[int, ...]) -> tuple[int, ...]:
    """Return the times nearest to those of jumps at which what they ask for does not pass or close; or fewer."""
    found: list[int] = []
    for cube, wanted in zip(way.jumps, times, strict=True):
        possible = np.ones(problem.horizon + 1, dtype=bool)
        for p, holds in cube:
            if holds and p < problem.labeling.first_pair:
                possible &= _holds_somewhere(problem, problem.automaton.propositions[p])
            elif p >= problem.labeling.first_pair:
                possible &= _may_be_read(problem, cube, p, holds)
        later = np.flatnonzero(possible)
        later = later[later > (found[-1] if found else 0)]
        if not len(later):
            break
        found.append(int(later[np.argmin(np.abs(later - wanted))]))
    return tuple(found)


def _holds_somewhere(problem: Problem, name: str) -> NDArray[np.bool_]:
    """Return at which times (T + 1,) a region is not empty, and may be in the workspace."""
    agent = problem.agents[problem.agent_names.index(problem.propositions[name].agent)]
    low, high = corners_along(problem, name, problem.horizon + 1)
    bottom, top = (end[0] for end in agent.output_range(agent.state_low[None], agent.state_high[None]))
    return np.asarray(np.all((low < high) & (low < top) & (bottom < high), axis=1))


def _may_be_read(problem: Problem, cube: Cube, p: int, holds: bool) -> NDArray[np.bool_]:
    """Return at which times (T + 1,) a pair may hold, or not, where its agents are in the regions that a cube asks for.

    What is asked is all known where the pair stands still.
    """
    labeling, times = problem.labeling, problem.horizon + 1
    pair = labeling.pairs[p - labeling.first_pair]
    if not pair.moves:
        return np.ones(times, dtype=bool)
    ends = []
    for i in (pair.first, pair.second):
        low, high = (np.tile(end, (times, 1)) for end in problem.agents[i].output_ends)
        for k in (k for k, wanted in cube if wanted and k in labeling.agent_propositions[i]):
            corners = corners_along(problem, problem.automaton.propositions[k], times)
            low, high = np.maximum(low, corners[0]), np.minimum(high, corners[1])
        ends.append((low, high))
    (low_a, high_a), (low_b, high_b) = ends
    return np.array([
        holds in pair.at(t).possible((low_a[t], high_a[t]), (low_b[t], high_b[t])) for t in range(times)
    ])  # fmt: skip


def _with_better_times(finder: _Finder, best: tuple[float, Plan, Any]) -> tuple[float, Plan, Any]:
    """Return the best plan after moves of single jumps, as long as they help."""
    step = max(1, finder.problem.horizon // 8)
    while step and best[0] > PLENTY:
        improved = False
        for group in best[1].way.groups:
            for move in (-step, step):
                times = best[1].way.moved(best[1].times, group, move)
                is_last = group[-1] == len(times) - 1
                fits = 1 <= times[0] and times[-1] <= finder.problem.horizon
                if not fits or any(a >= b for a, b in zip(times, times[1:])):
                    continue
                steps = times[-1] if is_last and finder.problem.automaton.is_co_safe else best[1].steps
                plan = Plan(best[1].way, times, steps)
                found = finder.of_plan(plan)
                if found is not None and found[0] < best[0]:
                    best, improved = (found[0], plan, found[1]), True
        step = step if improved else step // 2
    return best


class _Finder:
    """Paths for plans; what depends on steps and feedback alone is computed once."""

    def __init__(self, problem: Problem, work: CountedWork) -> None:
        self.problem, self.work, self.tried = problem, work, 0
        self.gains: dict[tuple[int, int], FloatArray | None] = {}
        self.known: dict[object, Any] = {}

    def of_plan(self, plan: Plan) -> tuple[float, Any] | None:
        """Return failure, paths, letters and faces of a plan; None if it cannot be followed."""
        self.tried += 1
        problem = self.problem
        letters = letters_of(problem, plan)
        if letters is None:
            return None
        faces = np.full(letters.shape, -1)
        failures, paths = list[float](), []
        for i in range(problem.n_agents):
            failure, path = self._of_agent(i, letters, faces)
            if path is None or failure >= 1.0:
                return None
            failures.append(failure)
            paths.append(path)
        return any_failure(problem, failures) * (1.0 + 1e-12), (paths, letters, faces)

    def _of_agent(self, i: int, letters: NDArray[np.int8], faces: NDArray[np.int64]) -> tuple[float, AgentPath | None]:
        """Return failure and path of one agent; its columns of ``faces`` are set."""
        own = [p for p, name in enumerate(self.problem.automaton.propositions)
               if self.problem.propositions[name].agent == self.problem.agents[i].name]  # fmt: skip
        key = (i, letters[:, own].tobytes(), len(letters))
        if key not in self.known:
            self.known[key] = self._solved(i, letters, own)
        failure, path, chosen = self.known[key]
        faces[:, own] = chosen
        return failure, path

    def nearest(self, i: int, path: AgentPath, letters: NDArray[np.int8], faces: NDArray[np.int64]) -> dict[int, float]:
        """Return, by times, how many deviations the nearest limit of an agent is away along its path."""
        agent, steps = with_matrices(self.problem.agents[i]), path.n_steps
        covariances, x = covariances_of(agent, path.gain, steps), nominal_states(agent, path.inputs)
        states = state_strips(limits_of(self.problem, i, letters, faces), covariances)
        inputs = input_strips(agent, path.gain, covariances, steps)
        at = np.einsum("jd,jd->j", states.rows, x[states.times]), path.inputs.ravel()
        moved = inputs.deviations > 0.0
        # times, distances to either limit and variances of states, and of inputs that a feedback moves
        each = [
            (own.times[some], (value - own.low)[some], (own.high - value)[some], own.deviations[some] ** 2)
            for own, value, some in zip((states, inputs), at, (np.full(len(states.times), True), moved), strict=True)
        ]
        times, low, high, variance = (np.concatenate(parts) for parts in zip(*each, strict=True))
        return nearest_by_times(times.tolist(), low, high, np.full(len(low), np.inf), variance)

    def gain(self, i: int, number: int) -> FloatArray | None:
        """Return a feedback of agent i, made when it is asked for."""
        if (i, number) not in self.gains:
            self.gains[i, number] = feedback(self.problem.agents[i], number)  # type: ignore[arg-type]
        return self.gains[i, number]

    def _solved(self, i: int, letters: NDArray[np.int8], own: list[int]) -> tuple[float, AgentPath | None, Any]:
        agent, steps = with_matrices(self.problem.agents[i]), len(letters) - 1
        response = Response.of(agent, steps)
        best: tuple[float, AgentPath | None, Any] = (1.0, None, np.full((len(letters), len(own)), -1))
        for number in range(len(GAIN_COSTS) + 1):
            gain = self.gain(i, number)
            if gain is None:
                continue
            covariances = covariances_of(agent, gain, steps)
            if not np.all(np.isfinite(covariances)):
                continue
            inputs = input_strips(agent, gain, covariances, steps)
            u: FloatArray | None = None
            avoided = bool(np.any(letters[1:, own] < 0))
            for _ in range(FACE_ROUNDS if avoided else 1):
                faces = chosen_faces(self.problem, i, letters, agent, u)
                states = state_strips(limits_of(self.problem, i, letters, faces), covariances)
                if np.any(states.are_empty):
                    continue  # regions that do not meet, or hardly, on this side
                # Without noise in a limit only the nominal path counts; the start is exact.
                u = nominal_inputs(agent, states, inputs, response)
                self.work.programmed(u.size)
                failure = failure_along(agent, u, states, inputs)
                if failure < best[0]:
                    best = failure, AgentPath(u, gain), faces[:, own]
            if best[0] <= ENOUGH:
                break
        return best


def failure_along(agent: LinearAgent, u: FloatArray, states: StripConstraints, inputs: StripConstraints) -> float:
    """Return an upper bound on the probability that an inequality fails along the path of nominal inputs (S, m)."""
    path = nominal_states(agent, u)
    size = np.abs(path).max(axis=0)
    at = np.einsum("jd,jd->j", states.rows, path[states.times])
    off = np.abs(states.rows) @ size
    tails = [states.failure(at, off), inputs.failure(u.ravel(), np.abs(u.ravel()) * (inputs.deviations > 0.0))]
    # Inputs that no feedback moves are admissible if they are in their box, limits included.
    flat = inputs.deviations <= 0.0
    inside = (inputs.low <= u.ravel()) & (u.ravel() <= inputs.high)
    below, above = tails[1]
    below[flat], above[flat] = np.where(inside[flat], 0.0, 1.0), 0.0
    return failure_of(tails)


def feedback(agent: LinearAgent, number: int) -> FloatArray | None:
    """Return a feedback to try: none for 0, else one that keeps states near the nominal path; None if there is none."""
    if number == 0:
        return np.zeros((agent.n_inputs, agent.n_states))
    width = 1.0 / (agent.state_high - agent.state_low) ** 2
    reach = 1.0 / np.maximum(0.5 * (agent.input_high - agent.input_low), 1e-9) ** 2
    R = GAIN_COSTS[number - 1] * np.diag(reach)
    try:
        P = solve_discrete_are(agent.A, agent.B, np.diag(width), R)
    except (LinAlgError, ValueError):
        return None
    K = -np.linalg.solve(R + agent.B.T @ P @ agent.B, agent.B.T @ P @ agent.A)
    return np.asarray(K) if np.all(np.isfinite(K)) else None


def chosen_faces(
    problem: Problem, i: int, letters: NDArray[np.int8], agent: LinearAgent, u: FloatArray | None
) -> NDArray[np.int64]:
    """Return the sides on which regions are passed: those that the path is farthest beyond, against their size."""
    faces = np.full(letters.shape, -1)
    if u is not None:
        path = nominal_states(agent, u)
    else:
        # A straight line from the start to the middle of what is to hold last.
        path = np.linspace(agent.initial.low, _aim(problem, i, letters, agent), len(letters))
    outputs = path @ agent.output_matrix.T
    for p, name in enumerate(problem.automaton.propositions):
        if problem.propositions[name].agent != agent.name:
            continue
        low, high = corners_along(problem, name, len(letters))
        width = np.maximum(high - low, NARROWEST)
        best = farthest_sides(agent, low, high, outputs, width)
        faces[letters[:, p] < 0, p] = best[letters[:, p] < 0]
    return faces


def _into_the_middle(rows: FloatArray, low: FloatArray, high: FloatArray, x: FloatArray) -> FloatArray:
    """Return the move that takes a state to the middle between limits; to a face where there is one limit alone.

    Where a state is within a single limit it stays there.
    """
    limited = np.isfinite(low) | np.isfinite(high)
    rows, low, high = rows[limited], low[limited], high[limited]
    at = rows @ x
    both = np.isfinite(low) & np.isfinite(high)
    with np.errstate(invalid="ignore"):
        middle = np.where(both, 0.5 * (low + high), np.clip(at, low, high))
    return np.asarray(np.linalg.pinv(rows) @ (middle - at))


def _aim(problem: Problem, i: int, letters: NDArray[np.int8], agent: LinearAgent) -> FloatArray:
    """Return a state in the middle of what is to hold at the end."""
    aim = np.array(agent.initial.low, dtype=float)
    for p, name in enumerate(problem.automaton.propositions):
        if problem.propositions[name].agent == agent.name and letters[-1, p] > 0:
            region = problem.propositions[name].at(len(letters) - 1)
            low, high = without_far_ends(agent, region.low, region.high)
            aim = aim + _into_the_middle(agent.output_matrix, low, high, aim)
    return aim
