"""Tiers of problems: what is left to learn on each, computed from the rows of a leaderboard.

*Known to be reachable* is the larger of the certified lower bound and the exact lower limits of all policies that were
judged, helped ones too. *Reached* is the largest share of successes of a learner without help. Then a problem is

- **solved** if what is reached is at most `NEAR` below what is known to be reachable: everybody is there;
- **hard** if less than half of what is known to be reachable is reached, or if next to nothing is known to be;
- **open** otherwise: learners get somewhere, and not as far as is known to be possible;
- **unrated** if no learner without help was judged.

Tiers say what today's learners do within the budgets of that leaderboard, not how hard a problem is in itself.
"""

from __future__ import annotations

from collections.abc import Iterable

from .standings import Standing

ALONE = ("ppo", "ippo", "mappo", "central-ppo", "sac")
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
    reached = [row.rate for row in rows if row.policy in ALONE]
    if not reached:
        return "unrated"
    known = max(max(row.low, row.lower_bound or 0.0) for row in rows)
    if known < NOTHING:
        return "hard"
    if max(reached) >= known - NEAR:
        return "solved"
    return "open" if max(reached) >= 0.5 * known else "hard"
