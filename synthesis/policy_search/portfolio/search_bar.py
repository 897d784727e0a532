"""What a terminal shows of a search, in one line: the strategy under way, the best bound so far, what is left."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from dataclasses import dataclass, field

from tqdm import tqdm

from ...certificates.proofs import rounded_down, significant_up

BEGINS = "way: "
"""What begins texts of progress that name a strategy or a level; others name a start of a search."""

BAR, DESCRIBED = "[{elapsed}] {desc}{postfix}", "{desc}"
"""What bars show: how long something took so far, and what it does; or the line of a search."""

STEADY = 10.0
"""Seconds in which a core second is taken to be one before the pace so far says how long it is here."""

AS_SUCCESS = 0.99
"""Bound below which a success is shown; from there on a failure says more."""

LEAST_BAR, MOST_BAR, WIDTH = 4, 12, 80
"""Columns of the bar itself, as many as the line leaves, and columns of a line where no terminal says how many."""

Progress = Callable[[str, float], None]


class Way(str):
    """A text of progress about a strategy or a level, with its numbers.

    ``turn``: which strategy of how many; ``spent`` of ``limit``: the effort, or the seconds; ``taken``: what of the
    limit may not be begun any more.
    """

    turn: tuple[int, int] = (0, 0)
    spent = taken = limit = 0.0
    is_clock = False


@dataclass(eq=False)
class Status:
    """What was told of a search last, as a line."""

    began: float = field(default_factory=time.monotonic)
    way: Way = field(default_factory=lambda: Way(""))
    told_at: float = 0.0
    bound: float = 0.0
    search: float = 0.0

    def take(self, text: str, value: float) -> None:
        """Take what a search tells."""
        if not text.startswith(BEGINS):
            self.search = value
            return
        name = self.name
        self.way = text if isinstance(text, Way) else Way(text)
        self.bound, self.told_at = value, self.elapsed
        self.search = self.search if self.name == name else 0.0

    @property
    def elapsed(self) -> float:
        """Seconds so far."""
        return time.monotonic() - self.began

    @property
    def name(self) -> str:
        """The strategy under way."""
        return self.way.removeprefix(BEGINS).partition(",")[0].partition(" (")[0] or "the task is read"

    @property
    def strategy(self) -> str:
        """The strategy under way and which of how many it is."""
        number, of = self.way.turn
        return f"{number}/{of} {self.name}" if of else self.name

    @property
    def best(self) -> str:
        """The bound so far, rounded to the safe side, and the value of the search under way where it is larger."""
        proved = shown_bound(self.bound) if self.bound > 0.0 else ""
        if self.search <= max(self.bound, 5e-5):
            return proved or "nothing proved yet"
        return f"{proved}, in search {self.search:.4f}" if proved else f"in search {self.search:.4f}"

    @property
    def left(self) -> str:
        """The most that the effort leaves, in seconds at the pace so far."""
        limit, taken = self.way.limit, self.way.taken
        if not 0.0 < limit < float("inf"):
            return ""
        pace = 1.0 if self.way.is_clock else (self.told_at + STEADY) / (taken + STEADY)
        seconds = (limit - taken) * pace - (self.elapsed - self.told_at)
        return f", up to {max(5, 5 * round(seconds / 5))} s left"

    def line(self, width: int | None, is_ascii: bool = False) -> str:
        """Return the line, no longer than a terminal is wide: what counts stands in every one."""
        room = (width or WIDTH) - 1
        keeps = "; Ctrl-C keeps it" if self.bound > 0.0 else "; Ctrl-C stops"
        clock, result = f"[{tqdm.format_interval(self.elapsed)}] ", f"{self.strategy}: {self.best}"
        for rest in (f"{self.left}{keeps}", self.left, keeps, ""):
            for columns in range(MOST_BAR if self.way.limit else 0, LEAST_BAR - 1, -1):
                text = f"{clock}{self._bar(columns, is_ascii)} {result}{rest}"
                if len(text) <= room:
                    return text
            if len(text := f"{clock}{result}{rest}") <= room:
                return text
        return text[:room]

    def _bar(self, columns: int, is_ascii: bool) -> str:
        full, empty = ("#", "-") if is_ascii else ("\N{FULL BLOCK}", "\N{LIGHT SHADE}")
        share = min(1.0, self.way.spent / self.way.limit) if self.way.limit else 0.0
        return full * (count := round(share * columns)) + empty * (columns - count)


def shown_bound(bound: float) -> str:
    """Return a lower bound, in four digits, or as an upper bound on the failure, rounded to the safe side.

    Examples
    --------
    >>> shown_bound(0.98311), shown_bound(1.0 - 3.05e-3)
    ('P >= 0.9831', 'fails <= 0.0031')
    """
    if bound < AS_SUCCESS:
        return f"P >= {rounded_down(bound, 4)}"
    return f"fails <= {significant_up(1.0 - bound, 2)}"


def bar_of(text: str = BAR) -> tqdm:
    """Return the bar of a terminal; a bar that shows nothing where output goes to a file, or ``TERM=dumb``."""
    return tqdm(bar_format=text, leave=False, disable=(os.environ.get("TERM") == "dumb") or None)


def show(bar: tqdm, status: Status) -> None:
    """Show on a bar how a search stands."""
    if not bar.disable:
        bar.set_description_str(status.line(bar.ncols, bar.ascii is True))


def sweep_bar() -> Progress:
    """Return a bar of a search, for terminals and notebooks; it closes when nobody holds it any more."""
    status = Status()
    bar, last = tqdm(bar_format=DESCRIBED, leave=False), 0.0

    def report(text: str, value: float) -> None:
        nonlocal last
        status.take(text, value)
        if text.startswith(BEGINS) or status.elapsed - last > bar.mininterval:
            last = status.elapsed
            show(bar, status)

    return report
