"""A certificate along a path, and where its plans come from: ways through the automaton with times of their jumps."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from itertools import chain, zip_longest

import numpy as np
from numpy.typing import NDArray

from ....envs.tasks.problem import Problem, crossed_starts
from ...certificates.proofs import Synthesis
from ...relations.grids import RelationRefused
from ..chance_constraints import LinearizationErrors, corners_along
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
from .nonlinear_team import nonlinear_certificate, refuse_other_noise

PACES = (1.0, 0.6, 0.8, 0.35)
"""Shares of the horizon up to which jumps are spread, in the order in which they are tried."""

MOST_ALIKE = 3
"""Ways of teams that may be read alike: each is another attempt, with feedbacks that are drawn anew."""


def path_certificate(problem: Problem, work: CountedWork | None = None) -> Synthesis:
    """Return a certificate along a path.

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
    return nonlinear_certificate(problem, SOURCES, work)


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
