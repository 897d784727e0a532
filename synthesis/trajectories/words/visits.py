"""Visits that need not happen at a fixed time: a region is crossed within a window of times.

A plan asks that a goal holds at one step. Where noise is large against the region, many runs are there a step before or
after, or pass it on the way. With a window around that step the path may go on to the far side: what is asked is that
it is beyond the near face at last, and jumps over the region in no step (docs/theory/paths.md, "Regions that are
crossed").
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from ....envs.tasks.problem import Problem
from ...certificates.proofs import SOMETIME
from .accepted_words import is_accepted

HALVES = (2, 4, 8)
"""Halves of windows that are tried, in steps."""


def with_windows(problem: Problem, letters: NDArray[np.int8], half: int) -> NDArray[np.int8] | None:
    """Return letters that ask for visits at some time of a window, ``2 half`` steps long; None if there are none.

    Parameters
    ----------
    problem : Problem
    letters : (S + 1, P) int8 array
        Those of a plan. Where the last visit ends the task, letters that are returned may go on for up to ``half`` more
        steps.
    half : int
    """
    result = letters
    for t, p in visits_of(problem, letters):
        longer = _with_window(problem, result, (t, p), half)
        result = result if longer is None else longer
    return None if result is letters else result


def visits_of(problem: Problem, letters: NDArray[np.int8]) -> Iterator[tuple[int, int]]:
    """Yield times and numbers of regions that are to hold at one time, and not before or after it."""
    asked = np.pad(letters[:, : problem.labeling.first_pair] == 1, ((0, 1), (0, 0)))
    once = asked[1:-1] & ~asked[:-2] & ~asked[2:]
    for t, p in np.argwhere(once).tolist():
        yield t + 1, p


def _with_window(
    problem: Problem, letters: NDArray[np.int8], visit: tuple[int, int], half: int
) -> NDArray[np.int8] | None:
    """Return letters with a window around a visit; None if what is asked around it cannot be asked at once."""
    (t, p), steps = visit, len(letters) - 1
    ends = t == steps and problem.automaton.is_co_safe
    # Other visits keep their times: what is asked changes there.
    others = np.flatnonzero(np.any(letters[1:] != letters[:-1], axis=1)) + 1
    before = max((int(s) for s in others if s < t), default=1)
    after = min((int(s) for s in others if s > t + 1), default=steps + 1) - 1
    most = min(t + half, problem.horizon) if ends else min(t + half, after)
    first, last = max(before, most - 2 * half, 1), most
    if last <= first:
        return None
    longer = np.zeros((max(len(letters), last + 1), letters.shape[1]), dtype=letters.dtype)
    longer[: len(letters)] = letters
    window = slice(first, last + 1)
    around = [letters[s] for s in (t - 1, t, t + 1) if s <= steps]
    for k in (k for k in range(letters.shape[1]) if k != p):
        values = {int(row[k]) for row in around} | {int(value) for value in longer[window, k]}
        if len(values - {0}) > 1:
            return None
        longer[window, k] = max(values - {0}, default=0)
    longer[window, p] = SOMETIME
    return longer if is_accepted(problem, longer) else None
