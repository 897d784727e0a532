"""Words of few cubes, each read for some time: for tasks in which the automaton itself says too little about them.

An automaton that counts steps has no stays: all of its ways are as long as the horizon, and far too many. And one that
waits does not say for what: ``!(lane & crossing)`` is kept beside the lane at first, and in it when nobody crosses.
So words are also looked for as a few cubes, each read from some time on; the automaton only judges them.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from itertools import combinations, pairwise, product, zip_longest

import numpy as np
from numpy.typing import NDArray

from ....envs.tasks.problem import Problem
from .accepted_words import course_of, targets_of
from .automaton_paths import AutomatonPath, Cube, cubes_of
from .exclusions import exclusions

MOST_CUBES = 8
"""Cubes that words are made of: those that ask for least, and of these the ones that most edges have."""

MOST_SEGMENTS = 3
"""Cubes of a word, at most."""

PARTS = {2: 16, 3: 8}
"""Times at which another cube may begin, by the number of cubes: this many, spread over the horizon."""

LATE = 0.75
"""Share of the horizon by which the last change is tried first, of tasks that are not over with it: there is time to
come, and time to stay."""

MOST_STATES = 1_000
"""States of the automaton, evenly spread, whose edges are looked at for cubes."""

MOST_READ = 5_000_000
"""Letters that are read, from a state each: thousands of states are followed for a second or two."""

States = int
"""States of the automaton that words which agree with what is read may lead to, as bits."""


def segmented_ways(problem: Problem) -> Iterator[tuple[AutomatonPath, tuple[int, ...]]]:
    """Yield ways of few cubes that the automaton accepts, with the times of their jumps: one of each number in turn."""
    if problem.initial_q is None:
        return
    words = _Words(problem)
    rows = [_of_number(words, n) for n in range(1, MOST_SEGMENTS + 1)]
    yield from (found for row in zip_longest(*rows) for found in row if found is not None)


def _of_number(words: _Words, n: int) -> Iterator[tuple[AutomatonPath, tuple[int, ...]]]:
    """Yield the ways of n cubes."""
    problem = words.problem
    late = problem.horizon * (1.0 if problem.automaton.is_co_safe else LATE)
    for times in _changes(problem.horizon, n, late):
        for cubes in product(words.pool, repeat=n):
            if words.read > MOST_READ:
                return
            if all(a != b for a, b in pairwise(cubes)):
                end = words.end(cubes, times)
                if end is not None:
                    yield way_of(problem, cubes, times, end)


def _changes(horizon: int, n: int, late: float) -> list[tuple[int, ...]]:
    """Return the times at which the cubes 2 to n of a word begin, with the last one near a time first."""
    if n == 1:
        return [()]
    parts = PARTS[n]
    grid = sorted({max(2, round(k * horizon / parts)) for k in range(1, parts + 1)})
    return sorted(combinations(grid, n - 1), key=lambda times: (abs(times[-1] - late), times))


class _Words:
    """What the automaton makes of words of few cubes; each stretch of one cube is followed once."""

    def __init__(self, problem: Problem) -> None:
        self.problem, self.automaton, self.course = problem, problem.automaton, course_of(problem.automaton)
        assert problem.initial_q is not None
        self.start, self.read = 1 << problem.initial_q, 0
        self.steps: dict[tuple[Cube, int], set[int]] = {}
        self.pool = self.cubes()
        self.stretches: dict[tuple[Cube, States, int], States] = {}

    def end(self, cubes: tuple[Cube, ...], times: tuple[int, ...]) -> int | None:
        """Return the step of acceptance; None where not all words that agree are accepted."""
        states, begins = self.start, (1, *times)
        for cube, begin, end in zip(cubes, begins, times):
            states = self.after(cube, states, end - begin)
            # What is over before the last cube begins is a word of fewer cubes.
            if self.is_lost(states) or (self.automaton.is_co_safe and self.accepts(states)):
                return None
        horizon = self.problem.horizon
        if not self.automaton.is_co_safe:
            states = self.after(cubes[-1], states, horizon + 1 - begins[-1])
            return None if self.is_lost(states) or not self.accepts(states) else horizon
        for t in range(begins[-1], horizon + 1):
            states = self.after(cubes[-1], states, 1)
            if self.is_lost(states):
                return None
            if self.accepts(states):
                return t
        return None

    def is_lost(self, states: States) -> bool:
        """Return whether some word is lost."""
        return bool(states & self.course.dead)

    def accepts(self, states: States) -> bool:
        """Return whether all words are accepted."""
        return not states & self.course.rejecting

    def after(self, cube: Cube, states: States, n: int) -> States:
        """Return the states after n letters that agree with a cube."""
        key = cube, states, n
        if key not in self.stretches:
            found, letter = states, self.letter(cube)
            for _ in range(n):
                self.read += found.bit_count()
                found = self.course.after(letter, found)
                if self.is_lost(found):
                    break
            self.stretches[key] = found
        return self.stretches[key]

    def letter(self, cube: Cube) -> NDArray[np.int8]:
        """Return the letter (P,) of a cube: 1, -1, or 0 of what it says nothing."""
        letter = np.zeros(len(self.automaton.propositions), dtype=np.int8)
        for p, holds in cube:
            letter[p] = 1 if holds else -1
        return letter

    def step(self, cube: Cube, q: int) -> set[int]:
        """Return the states to which letters that agree with a cube lead from one state."""
        if (cube, q) not in self.steps:
            self.steps[cube, q] = targets_of(self.automaton, q, self.letter(cube).tolist())
        return self.steps[cube, q]

    def cubes(self) -> list[Cube]:
        """Return the cubes of edges between states from which words are accepted, those that ask for least first."""
        found, apart = Counter[Cube](), exclusions(self.problem)
        alive = np.flatnonzero(~self.automaton.dead)
        for q in alive[:: -(-len(alive) // MOST_STATES)]:
            for cubes in cubes_of(self.problem, int(q), apart).values():
                found.update({self.least(tuple(sorted(cube)), int(q)) for cube in cubes})
        order = sorted(found, key=lambda cube: (-found[cube], _asks(cube)))
        return sorted(order[:MOST_CUBES], key=_asks)

    def least(self, cube: Cube, q: int) -> Cube:
        """Return a cube without what does not matter in a state: a diagram asks in its own order."""
        for literal in cube:
            less = tuple(other for other in cube if other != literal)
            if self.step(less, q) == self.step(cube, q):
                cube = less
        return cube


def way_of(
    problem: Problem, cubes: tuple[Cube, ...], times: tuple[int, ...], end: int
) -> tuple[AutomatonPath, tuple[int, ...]]:
    """Return the way of a word of cubes, the second and later ones from some times on, with the times of its jumps.

    The word ends at a step; after acceptance nothing is asked for.
    """
    if not problem.automaton.is_co_safe:
        return AutomatonPath(cubes, cubes[1:]), times
    if times and end == times[-1]:
        return AutomatonPath((*cubes[:-1], ()), cubes[1:]), times
    return AutomatonPath((*cubes, ()), (*cubes[1:], cubes[-1])), (*times, end)


def _asks(cube: Cube) -> tuple[int, int, Cube]:
    """Return how much a cube asks for: what is to hold, then what is not to, then in order of numbers."""
    return sum(holds for _, holds in cube), len(cube), cube
