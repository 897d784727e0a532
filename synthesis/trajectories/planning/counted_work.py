"""Work of a search along paths: counted from sizes, never taken from a clock, in core seconds (see ``Effort``).

A search asks before each piece of work whether it may still be done. What was found first is always handed over: work
decides how long it is improved. The same problem and effort give the same certificate on every machine.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

STEP, CANDIDATE = 1.5e-4, 4e-6
"""Work of a step of a walk for each state, and what each candidate adds to that."""

ROUND = 7e-5
"""Work of a step of a round of planning; it doubles at ``DOUBLED`` states, and grows like a square."""

LEAST_TOLD = 1e-6
"""Smallest bound that is told: the terminal shows six digits."""

DOUBLED = 6.5
"""States at which a step of planning takes twice as long as at one."""


@dataclass(eq=False)
class CountedWork:
    """What a search may take, and what it took.

    Parameters
    ----------
    limit : float
        Work after which nothing is improved.
    is_broken_off : callable
        Whether what was found so far has to do for another reason, such as seconds that are over.
    told : callable
        Told each bound that is larger than all before.
    hoped : callable
        Told what a search hopes for, of which nothing is proved.
    counted : callable
        Told the work so far, once for each core second.
    is_hopeless : bool
        Whether it is known that the task is out of reach: then what comes near has to do.
    suffices : callable
        Whether a lower bound is what was asked for: then it is not improved.
    is_interrupted : bool
        Whether the user broke off (Ctrl-C), and what was found so far was returned.
    """

    limit: float = math.inf
    is_broken_off: Callable[[], bool] = lambda: False
    spent: float = 0.0
    told: Callable[[float], None] = lambda bound: None
    hoped: Callable[[float], None] = lambda value: None
    counted: Callable[[float], None] = lambda spent: None
    largest: float = 0.0
    is_hopeless: bool = False
    suffices: Callable[[float], bool] = lambda bound: False
    is_interrupted: bool = False

    def tell(self, failure: float) -> None:
        """Tell of a path that was found, by an upper bound on its probability of failing, if it is the best so far."""
        if 1.0 - failure > max(self.largest, LEAST_TOLD):
            self.largest = 1.0 - failure
            self.told(self.largest)

    def is_over(self) -> bool:
        """Return whether what was found so far has to do."""
        return not self.allows(0.0)

    def allows(self, work: float) -> bool:
        """Return whether further work may be done."""
        return self.spent + work <= self.limit and not self.is_broken_off() and not self.suffices(self.largest)

    @contextmanager
    def within(self, work: float) -> Iterator[None]:
        """Allow so much work for what is done in here, and no more than was allowed before."""
        before = self.limit
        self.limit = min(before, self.spent + work)
        try:
            yield
        finally:
            self.limit = before

    def walk(self, steps: int, states: int, candidates: int) -> None:
        """Count a walk along a path with some candidates of feedback."""
        self.count(work_of_walk(steps, states, candidates))

    def planned(self, steps: int, states: int, rounds: int) -> None:
        """Count some rounds of planning."""
        self.count(ROUND * steps * rounds * (1.0 + (states / DOUBLED) ** 2))

    def count(self, work: float) -> None:
        """Count work that is about to be done."""
        before, self.spent = self.spent, self.spent + work
        if int(before) < int(self.spent):
            self.counted(self.spent)


def work_of_walk(steps: int, states: int, candidates: int) -> float:
    """Return the work of a walk along a path with some candidates of feedback."""
    return steps * states * (STEP + CANDIDATE * candidates)
