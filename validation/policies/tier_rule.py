"""Tiers of problems: what is left to learn on each, computed from the rows of a leaderboard.

*Known to be reachable* is the larger of the certified lower bound and the exact lower limits of all policies that were
judged, submitted ones too. *Reached* is the largest share of successes of a learner without help. Then a problem is

- **solved** if what is reached is at most `NEAR` below what is known to be reachable: everybody is there;
- **hard** if less than half of what is known to be reachable is reached, or if next to nothing is known to be;
- **open** otherwise: learners get somewhere, and not as far as is known to be possible;
- **unrated** if no learner without help was judged.

Tiers say what today's learners do within the budgets of that leaderboard, not how hard a problem is in itself.
"""

from __future__ import annotations

from collections.abc import Iterable

from .ranking import Standing
from .training import ALGORITHMS

ALONE = ALGORITHMS
"""Learners without help from any certificate."""

NEAR = 0.01
"""A gap that small is left out: it is within what another seed may bring."""

NOTHING = 1e-3
"""A success probability below it is next to nothing: no learner could tell it from 0."""


def tier_of(rows: Iterable[Standing]) -> str:
    """Return the tier of the problem that these rows are about.

    Examples
    --------
    >>> tier_of([])
    'unrated'
    """
    rows = list(rows)
    known, reached = known_of(rows), reached_of(rows)
    if reached is None:
        return "unrated"
    if known < NOTHING:
        return "hard"
    if reached >= known - NEAR:
        return "solved"
    return "open" if reached >= 0.5 * known else "hard"


def known_of(rows: Iterable[Standing]) -> float:
    """Return what is known to be reachable: the largest certified bound or exact lower limit; 0 without any row."""
    return max((max(row.low, row.lower_bound or 0.0) for row in rows), default=0.0)


def reached_of(rows: Iterable[Standing]) -> float | None:
    """Return the largest share of successes of a learner without help; None if none was judged."""
    return max((row.rate for row in rows if row.policy in ALONE), default=None)


def left_of(rows: Iterable[Standing]) -> float | None:
    """Return what is known to be reachable and not reached by any learner without help; None if none was judged."""
    rows = list(rows)
    reached = reached_of(rows)
    return None if reached is None else max(known_of(rows) - reached, 0.0)
