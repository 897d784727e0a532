"""Regions that are met at some time of a window (letter 2): a run that crosses one meets it, whatever its pace.

Let the region be ``low <= y < high``, and let a trajectory come to it along output k through the face low_k.

**Theorem.** Suppose that ``low_j <= y_j < high_j`` for all outputs j other than k at all times a to b of a window, that
``y_k < high_k`` at a and ``y_k >= low_k`` at b, and that ``y_k(t) - y_k(t - 1) < high_k(t) - low_k(t - 1)`` for all t
from a + 1 to b. Then the region holds at some time of the window; and the same for the other face, signs changed.

*Proof.* There is a first time t with ``y_k >= low_k``, since b is one. If it is a, then ``y_k < high_k`` there. If not,
``y_k(t - 1) < low_k(t - 1)``, so that ``y_k(t) < high_k(t)``. QED

**Theorem** (``check_words``). Let every run satisfy what is known of its letters at times 0 .. S. If every word that
agrees with it has entered an accepting state by then (co-safe), or is in one at the horizon (finite-trace), then every
run satisfies the task. *Proof.* The set of states that such words can reach is followed letter by letter, with a note
of what was met in windows that are open; where a window ends without that there is no such run. QED
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product

import numpy as np

from .angles import angle_outputs
from .automaton import Known, followed
from .fields import Refused
from .letters import Demand, known_at, known_at_start
from .problem import Problem, Proposition
from .rigorous import Whole

SOMETIME = 2  # letter of a proposition that is to hold at some time of a window
Met = frozenset[int]
Window = tuple[Proposition, int, bool, bool, bool]

MOST_OPEN = 4  # most windows that are open at one time: each doubles the words that are followed


def _one_window(letters: Whole, faces: Whole, t: int, p: int) -> bool:
    """Return whether times t and t + 1 belong to one window of a proposition; another side begins another one."""
    inside = 1 <= t < len(letters) - 1 and np.all(letters[t : t + 2, p] == SOMETIME)  # nothing is asked at time 0
    return bool(inside) and faces[t, p] == faces[t + 1, p]


def _in_windows(problem: Problem, letters: Whole, faces: Whole, t: int) -> Iterator[Window]:
    """Yield regions in a window at a time, output and side of the face, whether the window begins and ends here."""
    for p, region in enumerate(problem.regions):
        if letters[t, p] == SOMETIME:
            k, from_above = divmod(int(faces[t, p]), 2)
            if not 0 <= k < region.low.shape[1] or k in angle_outputs(problem.agents[region.agents[0]]):
                raise Refused(f"`{region.name}` at time {t} is crossed from no side, or along an angle")
            ends = not _one_window(letters, faces, t - 1, p), not _one_window(letters, faces, t, p)
            yield region, k, bool(from_above), *ends


def crossed(problem: Problem, letters: Whole, faces: Whole, t: int) -> list[Demand]:
    """Return what regions that are met at some time of a window ask of outputs at a time in it."""
    asked = []
    for region, k, from_above, first, last in _in_windows(problem, letters, faces, t):
        keeps_low, keeps_high = (first, last) if from_above else (last, first)
        for j, (low, high) in enumerate(zip(region.low[t].tolist(), region.high[t].tolist(), strict=True)):
            ends = low if j != k or keeps_low else -np.inf, high if j != k or keeps_high else np.inf
            asked.append(Demand(((region.agents[0], j, 1.0),), *ends, f"`{region.name}` crossed at time {t}"))
    return asked


def jumps(problem: Problem, letters: Whole, faces: Whole, t: int) -> list[Demand]:
    """Return what is asked of *differences* of outputs from time t - 1 to t, so that no region is jumped over."""
    asked = []
    for region, k, from_above, first, _ in _in_windows(problem, letters, faces, t):
        if not first:
            # from outside of the face to beyond the far one; rounded inward
            most = float(np.nextafter(region.high[t, k] - region.low[t - 1, k], -np.inf))
            least = float(np.nextafter(region.low[t, k] - region.high[t - 1, k], np.inf))
            ends = (least, np.inf) if from_above else (-np.inf, most)
            asked.append(Demand(((region.agents[0], k, 1.0),), *ends, f"no jump over `{region.name}` at time {t}"))
    return asked


def check_words(problem: Problem, letters: Whole, faces: Whole) -> None:
    """Raise ``Refused`` unless every word that agrees with the letters is accepted."""
    automaton, windows = problem.automaton, letters[1:] == SOMETIME
    if np.any(windows[:, len(problem.regions) :]) or np.any(windows.sum(axis=1) > MOST_OPEN):
        raise Refused(f"a pair is crossed, or more than {MOST_OPEN} regions at one time")
    if len(letters) > problem.horizon + 1:
        raise Refused("the trajectory goes on after the horizon")
    if not automaton.is_co_safe and len(letters) != problem.horizon + 1:
        raise Refused("the trajectory ends before the horizon, where the task is judged")
    # States by what was met in windows that are still open; a co-safe task may be satisfied before any letter.
    reached: dict[Met, set[int]] = {frozenset(): followed(automaton, {automaton.initial}, known_at_start(problem))}
    for t in range(1, len(letters)):
        ends = {p for p in np.flatnonzero(letters[t] == SOMETIME).tolist() if not _one_window(letters, faces, t, p)}
        after: dict[Met, set[int]] = {}
        for met, states in reached.items():
            for known, now in _readings(problem, letters[t], t, met):
                if ends <= now:  # where a window ends and nothing was met in it, no run is
                    after.setdefault(now - ends, set()).update(followed(automaton, states, known))
        reached = after
    if not all(automaton.accepting[q] for states in reached.values() for q in states):
        raise Refused("a word that agrees with the letters of the trajectory is not accepted")


def _readings(problem: Problem, letter: Whole, t: int, met: Met) -> Iterator[tuple[Known, Met]]:
    """Yield what the letter of a time may say, and what was met by then: open regions hold at the time, or not yet."""
    waiting = [p for p in np.flatnonzero(letter == SOMETIME).tolist() if p not in met]
    for holds in product((False, True), repeat=len(waiting)):
        now = letter.copy()
        now[waiting] = [1 if each else -1 for each in holds]
        yield known_at(problem, now, t), met | {p for p, each in zip(waiting, holds, strict=True) if each}
