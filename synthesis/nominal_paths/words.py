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
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...envs.agents import Proposition
from ...envs.logic import Automaton
from ...envs.problem import Problem
from ..certificates import SOMETIME
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

Cube = tuple[tuple[int, bool], ...]
"""Propositions by their number, and whether they hold."""


@dataclass(frozen=True)
class Way:
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

    way: Way
    times: tuple[int, ...]
    steps: int


def ways_of(problem: Problem) -> Iterator[Way]:
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
            yield Way(choice[: len(loops)], choice[len(loops) :])  # type: ignore[arg-type]


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
    return found


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


def is_accepted(problem: Problem, letters: NDArray[np.int8]) -> bool:
    """Return whether every word that agrees with letters (S + 1, P) at times 1 to S is accepted."""
    automaton = problem.automaton
    nothing = frozenset[int]()
    reached = set() if problem.initial_q is None else {(problem.initial_q, nothing)}
    known: dict[tuple[int, bytes], set[int]] = {}
    for t, letter in enumerate(letters[1:], start=1):
        goes_on = letters[t + 1] == SOMETIME if t + 1 < len(letters) else np.zeros(len(letter), dtype=bool)
        ending = {*np.flatnonzero((letter == SOMETIME) & ~goes_on).tolist()}
        after = set[tuple[int, frozenset[int]]]()
        for q, met in reached:
            for read, by_now in _readings(letter, met):
                if not ending <= by_now:
                    continue  # nothing was met in a window that ends here
                key = q, read.tobytes()
                if key not in known:
                    known[key] = targets_of(automaton, q, read.tolist())
                after |= {(target, by_now - ending) for target in known[key]}
        reached = after
        # From a dead state no word is accepted.
        if any(automaton.dead[q] for q, _ in reached):
            return False
    return all(automaton.accepting[q] for q, _ in reached)


def _readings(letter: NDArray[np.int8], met: frozenset[int]) -> Iterator[tuple[NDArray[np.int8], frozenset[int]]]:
    """Yield letters (P,) that may be read, and what was met in windows by then: it holds now, or not yet."""
    is_open = letter == SOMETIME
    if not is_open.any():
        yield letter, met
        return
    waiting = [p for p in np.flatnonzero(is_open).tolist() if p not in met]
    for each in product((-1, 1), repeat=len(waiting)):
        read = np.where(is_open, 0, letter).astype(np.int8)
        read[waiting] = each
        yield read, met | {p for p, value in zip(waiting, each, strict=True) if value > 0}


def targets_of(automaton: Automaton, q: int, letter: list[int]) -> set[int]:
    """Return the states to which letters lead that agree with one, -1, 0 or 1 for each proposition."""
    entries, seen, targets = [int(automaton.root[q])], set[int](), set[int]()
    while entries:
        entry = entries.pop()
        if entry < 0:
            targets.add(-1 - entry)
        elif entry not in seen:
            seen.add(entry)
            holds = letter[automaton.variable[entry]]
            entries += [int(automaton.high[entry])] if holds >= 0 else []
            entries += [int(automaton.low[entry])] if holds <= 0 else []
    return targets


def without_needless(problem: Problem, letters: NDArray[np.int8]) -> NDArray[np.int8]:
    """Return letters that ask for less, as long as every word that agrees with them is accepted.

    A diagram asks that a goal does not hold while one waits for it; a task seldom does, and often only up to a jump: a
    proposition is left out at all times, or else between two times at which other letters are asked for.
    """
    changes = np.flatnonzero(np.any(letters[1:] != letters[:-1], axis=1)) + 1
    stays = np.searchsorted(changes, np.arange(len(letters)), side="right")
    for value in (-1, 1):
        for p in range(letters.shape[1]):
            asked = letters[:, p] == value
            if not asked.any():
                continue
            for times in (asked, *(asked & (stays == stay) for stay in np.unique(stays[asked]))):
                less = letters.copy()
                less[times, p] = 0
                if is_accepted(problem, less):
                    letters = less
                    if times is asked:
                        break
    return letters


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
