"""How much may be spent on a task: work, which is counted and the same everywhere, or seconds of the clock.

Work is estimated from sizes before anything is computed, in core seconds: what one core of 2024 does in about a second.
No clock decides what is tried, unless the caller gives ``seconds``: the same command gives the same certificate on any
machine.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

from ...certificates.proofs import BROKEN_OFF, rounded_up
from .search_bar import BEGINS, Way

EFFORT = 80.0
"""Core seconds that a task may take by default: a minute on one core, of what pays; the rest is for comparisons."""

SHARE_OF_LEVELS = 0.75
"""Share of the effort that cells of one kind may take, however fine they become: something is left to compare with."""

SHARE_ABOVE = 0.05
"""Share of the effort that it may take to bound a certificate from above, where nobody asked for it."""

LEADS = 0.85
"""Bound from which that is not held back: other ways rarely come near, and finer cells gain surely."""


FOR_LOST = 2.0
"""Core seconds that are spent on tasks that are out of reach."""

GIVEN_UP = 0.5
"""Share of what is left of the effort that a way that gave nothing takes from it."""


class OutOfTime(Exception):
    """What is under way is given up: the seconds are over, and there is something to return, or it takes too much."""


@dataclass(eq=False)
class Effort:
    """What a task may still take.

    Parameters
    ----------
    work : float, optional
        Work in all, in core seconds (see the module's text). The default is ``EFFORT``, or no limit where ``seconds``
        are given.
    seconds : float, optional
        Seconds of the clock, from now on. Ways that would take longer are left out, and those that are under way are
        given up, as soon as there is a certificate.
    progress : callable, optional
        Told which way or level begins, as ``"strategy: ..."``, with the largest bound so far.
    until : float, optional
        Lower bound in (0, 1] that is enough: nothing further is begun once a certificate has it.

    Raises
    ------
    ValueError
        If one of them is not a positive number, or ``until`` no probability.
    """

    work: float | None = None
    seconds: float | None = None
    spent: float = 0.0
    has_result: bool = False
    is_interrupted: bool = False
    """Whether the user broke off (Ctrl-C) after there was a certificate: nothing further is begun."""
    progress: Callable[[str, float], None] | None = None
    above: float = 1.0
    """Upper bound on what any controller does, as far as one is known."""
    no_run: str = ""
    """Why no run without noise satisfies the task, if that was looked for and none was found."""
    lost: str = ""
    """Why the task is out of reach of any controller, if that is known: then a run that comes near has to do."""
    left_out: dict[str, str] = field(default_factory=dict)
    """What was not begun for want of effort, by name, and why."""
    counted: float = 0.0
    """Work of sweeps as it is done, in core seconds: estimates do not know how many terms trees will have."""
    allowance: float = math.inf
    """What ``counted`` may become before what is under way is given up."""
    is_overdrawn: bool = False
    """Whether what was given up last took more work than it was allowed."""
    begun: tuple[str, float] = ("", 0.0)
    """Which way or level was told last, and the largest bound so far."""
    turn: tuple[int, int] = (0, 0)
    """Which way is under way, of how many."""
    under_way: float = 0.0
    """Work that the way under way took and that is not spent yet, in core seconds."""
    shown: float = 0.0
    """Work that was told last: it never falls, as estimates of work may that was not needed."""
    until: float | None = None

    def __post_init__(self) -> None:
        for name, value, what in (("effort", self.work, "of core seconds"), ("seconds", self.seconds, "of the clock")):
            number = isinstance(value, int | float) and not isinstance(value, bool)
            if value is not None and not (number and value > 0):
                raise ValueError(f"`{name}`: expected a positive number ({what}), got {value!r}; leave it out")
        number = isinstance(self.until, int | float) and not isinstance(self.until, bool)
        if self.until is not None and not (number and 0.0 < self.until <= 1.0):
            raise ValueError(f"`until`: expected a lower bound above 0, 1 at most, got {self.until!r}; leave it out")
        self.began, self.counted_before, self.spent_before = time.perf_counter(), 0.0, 0.0
        self.limit = self.work if self.work is not None else EFFORT if self.seconds is None else math.inf

    def give_up(self, why: str) -> None:
        """Leave nearly all work undone: no controller satisfies the task."""
        self.lost, self.limit = why, min(self.limit, self.spent + FOR_LOST)

    def anew(self) -> Effort:
        """Return the effort of another task: as much work, and the seconds that are left."""
        seconds = None if self.seconds is None else max(1e-9, self.seconds - self.elapsed)
        return Effort(self.work, seconds, progress=self.progress, until=self.until)

    def suffices(self, bound: float) -> bool:
        """Return whether a lower bound is what was asked for."""
        return self.until is not None and bound >= self.until

    @property
    def is_over(self) -> bool:
        """Whether the seconds are over; never where none were given."""
        return self.seconds is not None and self.elapsed > self.seconds

    @property
    def given_up(self) -> str:
        """Why what was under way was given up, in words."""
        if self.is_overdrawn:
            return "given up: it took far more work than was estimated"
        return f"given up: {BROKEN_OFF if self.is_interrupted else 'the `seconds` were over'}"

    def tell(self, what: str, bound: float) -> None:
        """Say which way or level begins, what may be left to gain and to spend, beside the largest bound so far."""
        self.begun = what, max(bound, self.begun[1])
        self.tell_again(0.0)

    def tell_bound(self, bound: float) -> None:
        """Say that the way under way has proved a bound, which is kept."""
        self.begun = self.begun[0], max(bound, self.begun[1])
        self.tell_again(self.under_way)

    def tell_hoped(self, value: float) -> None:
        """Say what the way under way hopes for, of which nothing is proved."""
        if self.progress is not None:
            self.progress("hoped for", value)

    def tell_again(self, more: float) -> None:
        """Say once more which way is under way, when it has taken so much work that is not counted as spent yet."""
        self.under_way, swept = more, self.spent_before + self.counted - self.counted_before
        self.shown = min(max(self.shown, self.spent + more, swept), self.limit)
        if self.progress is not None and self.begun[0]:
            what, bound = self.begun
            most = f", at most {rounded_up(self.above, 4)}" if self.above < 1.0 else ""
            by_clock = self.seconds is not None
            done, limit = (self.elapsed, self.seconds) if self.seconds is not None else (self.shown, self.limit)
            in_hand = f"{done:.0f} of {limit:.0f} s" if by_clock else f"effort {done:.0f} of {limit:.0f}"
            way = Way(f"{BEGINS}{what}{most}, {in_hand}")
            way.turn, way.is_clock = self.turn, by_clock
            way.spent, way.taken, way.limit = done, done if by_clock else self.spent + more, limit
            self.progress(way, bound)

    def begins(self, turn: tuple[int, int]) -> None:
        """Begin a way, the first or a later one of some."""
        self.turn, self.under_way = turn, 0.0
        self.counted_before, self.spent_before = self.counted, self.spent

    def charge(self, before: float, estimate: float, is_worthless: bool) -> None:
        """Count a way that is finished: its estimate, and what it took if nothing came of it.

        Half of what was left stays for the others, as long as there was any.
        """
        taken = min(self.under_way, GIVEN_UP * max(0.0, self.limit - before)) if is_worthless else 0.0
        self.spent = max(self.spent, before + max(estimate, taken))

    def count(self, work: float) -> None:
        """Count work of a sweep that is about to be done; raise OutOfTime if it is not allowed."""
        self.counted += work
        self.is_overdrawn = self.counted > self.allowance
        if self.is_overdrawn:
            raise OutOfTime

    @contextmanager
    def within(self, work: float) -> Iterator[None]:
        """Allow so much work for what is done in here, and no more than was allowed before."""
        before = self.allowance
        self.allowance = min(before, self.counted + work)
        try:
            yield
        finally:
            self.allowance = before

    @contextmanager
    def until_broken_off(self) -> Iterator[None]:
        """Turn what breaks work off, after there is a certificate, into ``OutOfTime``."""
        try:
            yield
        except KeyboardInterrupt:
            if not self.has_result:
                raise
            self.is_interrupted, self.is_overdrawn = True, False
            raise OutOfTime from None

    @property
    def elapsed(self) -> float:
        """Seconds of the clock since the beginning; nothing asks unless seconds were given."""
        return time.perf_counter() - self.began

    @property
    def left(self) -> float:
        """Work that may still be begun."""
        left = self.limit - self.spent
        if self.seconds is None:
            return left
        # The pace so far says what the seconds that are left are good for.
        pace = max(1.0, self.spent) / max(1e-3, self.elapsed)
        return min(left, (self.seconds - self.elapsed) * pace)

    def for_levels(self, bound: float, taken: float) -> float:
        """Return the work of finer cells of one kind that have certified ``bound`` so far and taken so much."""
        if bound >= LEADS or math.isinf(self.limit):
            return self.left
        return min(SHARE_OF_LEVELS * self.limit - taken, self.left)

    @property
    def for_above(self) -> float:
        """Work that an upper end may take that nobody asked for, beside what the task took."""
        return SHARE_ABOVE * min(EFFORT, self.limit)

    def refusal(self, work: float) -> str | None:
        """Return why work is not begun, in words; None if it may be. The first certificate is always computed."""
        if not self.has_result or work <= self.left:
            return None
        return self.too_much(work, self.left)

    def too_much(self, work: float, left: float) -> str:
        """Return that work is more than is left, in words."""
        option = "effort" if self.seconds is None else "seconds"
        left = max(0.0, left)
        return f"skipped: about {work:.3g} core seconds, {left:.3g} left; ask for more `{option}`"

    def heeding(self, progress: Callable[[str, float], None] | None) -> Callable[[str, float], None] | None:
        """Return what is told after each sweep: it gives up when the seconds are over and there is a certificate."""
        if self.seconds is None:
            return progress

        def told(text: str, value: float) -> None:
            if progress is not None:
                progress(text, value)
            if self.has_result and self.is_over:
                self.is_overdrawn = False
                raise OutOfTime

        return told
