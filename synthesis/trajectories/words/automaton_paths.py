"""Words that the automaton accepts, as ways through its states: which cube of letters is read, and how long.

A *cube* says of some propositions that they hold and of others that they do not. A way is a sequence of different
automaton states from that after the first letter to an accepting one; it stays in a state while cubes of its loop are
read, and leaves it at a time of its own.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from heapq import heappop, heappush
from itertools import islice, product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ....envs.tasks.automata import Automaton
from ....envs.tasks.problem import Problem
from ....envs.tasks.regions import Proposition
from .accepted_words import is_accepted, without_needless
from .exclusions import exclusions

MOST_STEPS = 20_000
"""Steps of the search for cubes of a state."""

CUBES_KEPT = 3
"""Cubes of an edge, those that ask for least, among which a way chooses."""

MOST_WAYS, MOST_CHOICES = 12, 60
"""Ways through the automaton that are tried, the shortest ones first, and choices of cubes for all of them."""

MOST_SEQUENCES = 20_000
"""Beginnings of ways that are looked at: an automaton that counts steps has more of them than there are steps to take.
Its words are found by ``timed_words`` and ``segments``."""

MOST_JUMPS = 10
"""Jumps of the shortest ways of an automaton with more beginnings than that: agents with errands of their own do them
side by side."""

Cube = tuple[tuple[int, bool], ...]
"""Propositions by their number, and whether they hold."""


@dataclass(frozen=True)
class AutomatonPath:
    """What is read: the cube of each stay (None where there is none), and of each jump from one stay to the next.

    As a rule stays and jumps are those in the automaton. Where another cube is read from some time on, though, that is
    a jump, too: one waits beside a lane until nobody else is in it, for instance.
    """

    stays: tuple[Cube | None, ...]
    jumps: tuple[Cube, ...]

    @property
    def groups(self) -> list[range]:
        """Jumps by their numbers, those together between which there is no stay: each is a step after the other."""
        firsts = [k for k in range(len(self.jumps)) if k == 0 or self.stays[k] is not None]
        return [range(a, b) for a, b in zip(firsts, [*firsts[1:], len(self.jumps)])]

    def spread(self, last: int) -> tuple[int, ...]:
        """Return times of the jumps, up to a last one: groups begin evenly spread."""
        groups, times = self.groups, list[int]()
        free = last - (len(self.jumps) - len(groups))
        for number, group in enumerate(groups):
            first = max(len(times) + 1, round((number + 1) * free / len(groups)) + len(times) - number)
            times += range(first, first + len(group))
        return tuple(times)

    def moved(self, times: tuple[int, ...], group: range, by: int) -> tuple[int, ...]:
        """Return times of which those of a group are others."""
        return tuple(time + by * (k in group) for k, time in enumerate(times))

    def letters(self, times: tuple[int, ...], steps: int, n_propositions: int) -> NDArray[np.int8] | None:
        """Return the letters (steps + 1, P) of a way that jumps at some times; None if it cannot stay where it must."""
        letters = np.zeros((steps + 1, n_propositions), dtype=np.int8)
        state = 0
        for t in range(1, steps + 1):
            jumps_now = state < len(times) and t == times[state]
            cube = self.jumps[state] if jumps_now else self.stays[state]
            if cube is None:
                return None
            for p, holds in cube:
                letters[t, p] = 1 if holds else -1
            state += jumps_now
        return letters


class Plan(NamedTuple):
    """A way with the times of its jumps, over some steps."""

    way: AutomatonPath
    times: tuple[int, ...]
    steps: int


def automaton_paths_of(problem: Problem) -> Iterator[AutomatonPath]:
    """Yield ways from the state after the first letter to acceptance, the shortest first."""
    automaton = problem.automaton
    start = problem.initial_q
    if start is None:
        return  # outside a workspace no word is accepted
    apart = exclusions(problem)
    cubes = {int(q): cubes_of(problem, int(q), apart) for q in np.flatnonzero(~automaton.dead)}
    for states in _state_sequences(problem, cubes, start):
        loops: list[list[Cube | None]] = [[*cubes[q].get(q, [])[:CUBES_KEPT]] or [None] for q in states]
        if automaton.is_co_safe and automaton.accepting[states[-1]]:
            loops[-1] = [()]  # what is read after acceptance does not matter
        edges = [cubes[a][b] for a, b in zip(states, states[1:])]
        for number, choice in enumerate(product(*loops, *edges)):
            if number >= MOST_CHOICES:
                break
            yield AutomatonPath(choice[: len(loops)], choice[len(loops) :])  # type: ignore[arg-type]


def _state_sequences(problem: Problem, cubes: dict[int, dict[int, list[Cube]]], start: int) -> list[tuple[int, ...]]:
    """Return sequences of different states that end in acceptance, the shortest first."""
    automaton = problem.automaton
    found: list[tuple[int, ...]] = []
    queue = deque[tuple[int, ...]]([(start,)])
    for _ in range(MOST_SEQUENCES):
        if not queue or len(found) >= MOST_WAYS:
            break
        path = queue.popleft()
        if automaton.accepting[path[-1]]:
            found.append(path)
            if automaton.is_co_safe:
                continue
        if len(path) > problem.horizon:
            continue
        queue.extend((*path, q) for q in cubes.get(path[-1], {}) if q not in path and q in cubes)
    return found or [*islice(_shortest_sequences(automaton, cubes, start), MOST_WAYS)]


def _shortest_sequences(
    automaton: Automaton, cubes: dict[int, dict[int, list[Cube]]], start: int
) -> Iterator[tuple[int, ...]]:
    """Yield the sequences of fewest jumps to acceptance, if these are few; beginnings of longer ones are not tried."""
    left = _jumps_left(automaton, cubes)
    if left.get(start, MOST_JUMPS + 1) > MOST_JUMPS:
        return
    stack: list[tuple[int, ...]] = [(start,)]
    while stack:
        path = stack.pop()
        if not left[path[-1]]:
            yield path
            continue
        nearer = [q for q in cubes[path[-1]] if left.get(q) == left[path[-1]] - 1]
        stack += [(*path, q) for q in reversed(nearer)]


def _jumps_left(automaton: Automaton, cubes: dict[int, dict[int, list[Cube]]]) -> dict[int, int]:
    """Return the fewest jumps to acceptance, by the state; states from which there are none are left out."""
    before: dict[int, list[int]] = {}
    for q, targets in cubes.items():
        for target in targets:
            before.setdefault(target, []).append(q)
    left = {q: 0 for q in cubes if automaton.accepting[q]}
    queue = deque(left)
    while queue:
        target = queue.popleft()
        for q in before.get(target, ()):
            if q not in left:
                left[q] = left[target] + 1
                queue.append(q)
    return left


def cubes_of(problem: Problem, q: int, apart: NDArray[np.bool_] | None = None) -> dict[int, list[Cube]]:
    """Return, by target, a few cubes of letters that lead from state q there, those that ask for least first.

    What is asked for least is few propositions that must hold, then few that must not. Dead states are no targets, and
    of propositions that never hold together (`apart`, bool (P, P)) no cube asks for two.
    """
    automaton = problem.automaton
    found: dict[int, list[Cube]] = {}
    wanted = set(np.flatnonzero(~automaton.dead).tolist())
    leads_to = _leads_to(automaton, int(automaton.root[q]))
    heap: list[tuple[int, int, int, int, Cube]] = [(0, 0, 0, int(automaton.root[q]), ())]
    for number in range(1, MOST_STEPS):
        if not heap:
            break
        hold, fail, _, entry, cube = heappop(heap)
        if entry < 0:
            if -1 - entry in wanted:
                cubes = found.setdefault(-1 - entry, [])
                cubes.append(cube)
                wanted -= {-1 - entry} if len(cubes) == CUBES_KEPT else set()
            continue
        # With many propositions most of a diagram leads to states of which enough cubes are known.
        if not leads_to[entry] & wanted:
            continue
        p = int(automaton.variable[entry])
        heappush(heap, (hold, fail + 1, 2 * number, int(automaton.low[entry]), (*cube, (p, False))))
        if apart is None or not any(holds and apart[p, other] for other, holds in cube):
            heappush(heap, (hold + 1, fail, 2 * number + 1, int(automaton.high[entry]), (*cube, (p, True))))
    return found


def _leads_to(automaton: Automaton, root: int) -> dict[int, set[int]]:
    """Return the states to which each node below a root leads."""
    result: dict[int, set[int]] = {}
    stack = [root] if root >= 0 else []
    while stack:
        entry = stack[-1]
        children = [int(automaton.low[entry]), int(automaton.high[entry])]
        missing = [child for child in children if child >= 0 and child not in result]
        if missing:
            stack += missing
            continue
        stack.pop()
        result[entry] = set().union(*({-1 - child} if child < 0 else result[child] for child in children))
    return result


def without_implied(problem: Problem, letters: NDArray[np.int8]) -> NDArray[np.int8] | None:
    """Return letters without what follows from the rest; None if they contradict each other.

    A proposition does not hold where its region and one that is to hold do not meet, or where it is empty.
    """
    letters = letters.copy()
    names, times = problem.automaton.propositions, np.arange(len(letters), dtype=float)
    for name, region in problem.labeling.moving.items():
        p, (low, high) = names.index(name), region.over(times)
        empty = np.any(high <= low, axis=0)
        empty[0] = False  # the letter of the start is what it is
        if np.any(letters[empty, p] > 0):
            return None
        letters[empty, p] = 0
    for p, pair in enumerate(problem.labeling.pairs, start=problem.labeling.first_pair):
        low, high, _ = pair.over(times)
        if np.any(letters[1:, p][np.any(high <= low, axis=0)[1:]] > 0):
            return None
    # Pairs are compared with nothing; regions with those of the same agent.
    for p, q in ((p, q) for own in problem.labeling.agent_propositions for p in own for q in own if p != q):
        first, second = problem.propositions[names[p]], problem.propositions[names[q]]
        assert isinstance(first, Proposition) and isinstance(second, Proposition)
        (low, high), (other_low, other_high) = first.over(times), second.over(times)
        apart = np.any((high <= other_low) | (other_high <= low), axis=0)
        if np.any(apart):
            both = apart & (letters[:, p] != 0) & (letters[:, q] > 0)
            if np.any(letters[both, p] > 0):
                return None
            letters[both, p] = 0
    return letters


def letters_of(problem: Problem, plan: Plan) -> NDArray[np.int8] | None:
    """Return the letters (S + 1, P) of a plan, less what follows or is not needed.

    None if they contradict each other, or are not accepted: times may be moved although a task counts steps.
    """
    letters = plan.way.letters(plan.times, plan.steps, len(problem.automaton.propositions))
    if letters is None or not is_accepted(problem, letters):
        return None
    return without_implied(problem, without_needless(problem, letters))
