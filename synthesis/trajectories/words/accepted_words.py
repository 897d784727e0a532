"""Which words the automaton accepts, and what a word need not ask for.

A letter says of some propositions that they hold (1), of others that they do not (-1), and nothing of the rest (0). So
a word leads to a set of automaton states, which is kept as the bits of one number: tasks of teams have thousands.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import lru_cache
from itertools import product

import numpy as np
from numpy.typing import NDArray

from ....envs.tasks.automata import Automaton
from ....envs.tasks.problem import Problem
from ...certificates.proofs import SOMETIME

MOST_LETTERS, MOST_KNOWN = 256, 20_000
"""Letters of which it is remembered where they lead, and sets of states from which it is: such numbers take room."""


class Course:
    """Where letters lead an automaton, for sets of its states as bits."""

    def __init__(self, automaton: Automaton) -> None:
        self.dead, self.rejecting = _bits(automaton.dead), _bits(~automaton.accepting)
        self.roots, self.variable = automaton.root.tolist(), automaton.variable.tolist()
        self.low, self.high = automaton.low.tolist(), automaton.high.tolist()
        self._reached: dict[bytes, dict[int, int]] = {}
        self._after: dict[tuple[bytes, int], int] = {}

    def after(self, letter: NDArray[np.int8], states: int) -> int:
        """Return the states to which all words lead that agree with a letter, from any of some states."""
        key = letter.tobytes(), states
        if key not in self._after:
            if len(self._after) >= MOST_KNOWN:
                self._after.clear()
            if key[0] not in self._reached and len(self._reached) >= MOST_LETTERS:
                self._reached.clear()
            holds, reached = letter.tolist(), self._reached.setdefault(key[0], {})
            result, left = 0, states
            while left:
                lowest = left & -left
                result |= self._from(self.roots[lowest.bit_length() - 1], holds, reached)
                left ^= lowest
            self._after[key] = result
        return self._after[key]

    def _from(self, node: int, holds: list[int], reached: dict[int, int]) -> int:
        """Return the states to which words lead from a node of the diagrams; ``reached`` are those that are known.

        Only nodes below the states that are asked about are looked at: of thousands a word is in a few.
        """
        if node < 0:
            return 1 << (-1 - node)
        if node not in reached:
            value, result = holds[self.variable[node]], 0
            if value >= 0:
                result |= self._from(self.high[node], holds, reached)
            if value <= 0:
                result |= self._from(self.low[node], holds, reached)
            reached[node] = result
        return reached[node]


@lru_cache(maxsize=4)
def course_of(automaton: Automaton) -> Course:
    """Return where letters lead an automaton; what was found out is kept for the automata that were asked last."""
    return Course(automaton)


def _bits(states: NDArray[np.bool_]) -> int:
    """Return the number whose bits are some states."""
    return sum(1 << q for q in np.flatnonzero(states).tolist())


def is_accepted(problem: Problem, letters: NDArray[np.int8]) -> bool:
    """Return whether every word that agrees with letters (S + 1, P) at times 1 to S is accepted."""
    course = course_of(problem.automaton)
    nothing = frozenset[int]()
    # By what was met in windows that are open, the states that are reached.
    reached = {} if problem.initial_q is None else {nothing: 1 << problem.initial_q}
    for t, letter in enumerate(letters[1:], start=1):
        goes_on = letters[t + 1] == SOMETIME if t + 1 < len(letters) else np.zeros(len(letter), dtype=bool)
        ending = frozenset(np.flatnonzero((letter == SOMETIME) & ~goes_on).tolist())
        after = dict[frozenset[int], int]()
        for met, states in reached.items():
            for read, by_now in _readings(letter, met):
                if ending <= by_now:  # else nothing was met in a window that ends here
                    left = by_now - ending
                    after[left] = after.get(left, 0) | course.after(read, states)
        reached = after
        # From a dead state no word is accepted.
        if any(states & course.dead for states in reached.values()):
            return False
    return not any(states & course.rejecting for states in reached.values())


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
        asked = [letters[:, p] == value for p in range(letters.shape[1])]
        parts = [(p, times) for p, times in enumerate(asked) if times.any()]
        while parts:
            letters, parts = _without_first(problem, letters, parts)
            if parts:
                (p, times), *parts = parts
                own = [(p, times & (stays == stay)) for stay in np.unique(stays[times])]
                while own:
                    letters, own = _without_first(problem, letters, own)
                    own = own[1:]
    return letters


Part = tuple[int, NDArray[np.bool_]]
"""A proposition, and the times (S + 1,) at which it may be left out."""


def _without_first(
    problem: Problem, letters: NDArray[np.int8], parts: Sequence[Part]
) -> tuple[NDArray[np.int8], list[Part]]:
    """Return letters without as many of the first parts as may be left out, and the other parts.

    A word that asks for more is accepted if one is that asks for less, so that the number may be looked for by halves.
    """

    def less(number: int) -> NDArray[np.int8]:
        result = letters.copy()
        for p, times in parts[:number]:
            result[times, p] = 0
        return result

    some, too_many, step = 0, len(parts) + 1, 1
    while too_many - some > 1:
        number = min(some + step, (some + too_many) // 2 if too_many <= len(parts) else len(parts))
        if is_accepted(problem, less(number)):
            some, step = number, 2 * step
        else:
            too_many = number
    return less(some), [*parts[some:]]
