"""Letters: which propositions hold at a time, what a trajectory promises of them, and what that asks of outputs.

A trajectory says of each proposition at each time 1 .. S that it holds (1), that it does not (-1), or nothing (0);
or that it holds at some time of a window (2).

* A region that is to hold asks for ``low <= y < high`` of every output.
* One that is not to hold asks for one side of it, its *face*: ``y_k < low_k`` (face 2k) or ``y_k >= high_k`` (2k + 1).
* A pair that is to hold asks for limits that only points of its box or ball satisfy. One that is not to hold asks for
  ``n.(y_a - y_b) >= max of n.z over the box or ball``, with the *normal* n that the trajectory names.

What follows is known, too: a region that holds nowhere at this time does not hold, nor does one that has no point in
common with a region of the same agent that holds. At time 0 letters are those that hold on the whole box of starts.

**Theorem** (windows). Let a region be ``low <= y < high``, and suppose that ``low_j <= y_j < high_j`` for all outputs j
other than k at all times a to b, that ``y_k < high_k`` at a and ``y_k >= low_k`` at b, and that
``y_k(t) - y_k(t - 1) < high_k(t) - low_k(t - 1)`` for all t from a + 1 to b. Then the region holds at some of these
times; and the same for the other face, signs changed. *Proof.* docs/theory/paths.md, Theorem Paths.10.

**Theorem** (``check_words``). Let every run satisfy what is known of its letters at times 0 .. S. If every word that
agrees with it has entered an accepting state by then (co-safe), or is in one at the horizon (finite-trace), then every
run satisfies the task. *Proof.* The set of states that such words can reach is followed letter by letter, with a note
of what was met in windows that are open; where a window ends without that there is no such run. QED
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from itertools import product

import numpy as np

from .automaton import Known, followed
from .fields import Refused
from .motions import outputs_on
from .problem import Problem, Proposition
from .rigorous import Array, U, Whole

# Factor on limits that lie within a ball: more than faces of a unit octagon are rounded by, which is 4 U.
INSIDE = 1.0 - 1e-12
SOMETIME = 2  # letter of a proposition that is to hold at some time of a window
Met = frozenset[int]
Window = tuple[Proposition, int, bool, bool, bool]

MOST_OPEN = 4  # most windows that are open at one time: each doubles the words that are followed


@dataclass(frozen=True, eq=False)
class Demand:
    """``low <= sum of factors times outputs < high``; ``parts`` are (agent, output, factor).

    ``avoided`` are the ends of a region along this output, where the demand is to keep away from it.
    """

    parts: tuple[tuple[int, int, float], ...]
    low: float
    high: float
    label: str
    avoided: tuple[float, float] | None = None


def known_at(problem: Problem, letter: Whole, t: int) -> dict[int, bool]:
    """Return what is known of a letter (P,) of a time t >= 1, by number of the proposition."""
    # what holds at some time of a window is not known to hold at this one
    known = {p: value == 1 for p, value in enumerate(letter.tolist()) if value in (-1, 1)}
    for p, region in enumerate(problem.regions):
        if p in known:
            continue
        # Regions of the same agent that hold, and have no point in common with this one.
        hold = [o for o, value in zip(problem.regions, letter) if value == 1 and o.agents == region.agents]
        apart = any(np.any((region.high[t] <= o.low[t]) | (o.high[t] <= region.low[t])) for o in hold)
        if np.any(region.low[t] >= region.high[t]) or apart:
            known[p] = False
    return known


def known_at_start(problem: Problem) -> dict[int, bool]:
    """Return what is known of the letter of time 0, for all starts in the box."""
    # Outputs on the closed box of starts, which is one cell; those that are states are exact.
    starts = [(own, own.start[:1], own.start[1:], np.ones((1, len(own.states)), bool)) for own in problem.agents]
    ends, known = [np.stack(outputs_on(*own)[:2])[:, :, 0] for own in starts], dict[int, bool]()
    for p, own in enumerate((*problem.regions, *problem.pairs)):
        first, *others = (ends[i][:, list(axes)] for i, axes in zip(own.agents, own.outputs, strict=True))
        held = _held(own, first, others[0] if others else 0.0 * first)
        if held is not None:
            known[p] = held
    return known


def _held(own: Proposition, first: Array, second: Array) -> bool | None:
    """Return whether a proposition holds at time 0 for all outputs between ends (2, p); None if that is not known.

    Starts may lie on a face, so differences are rational numbers; those that a simulator rounds lie between their ends.
    """
    if not np.all(np.isfinite([first, second])):
        return None
    ends = []
    for a_low, a_high, b_low, b_high in zip(*first.tolist(), *second.tolist(), strict=True):
        exact = Fraction(a_low) - Fraction(b_high), Fraction(a_high) - Fraction(b_low)
        ends.append((min(exact[0], Fraction(a_low - b_high)), max(exact[1], Fraction(a_high - b_low))))
    if own.radius is None:
        limits = list(zip(ends, own.low[0].tolist(), own.high[0].tolist(), strict=True))
        if all(a <= low and high < b for (low, high), a, b in limits):
            return True
        return False if any(high < a or b <= low or a >= b for (low, high), a, b in limits) else None
    radius = Fraction(float(own.radius[0]))
    # The shortest and the longest difference, squared.
    least = sum(0 if low <= 0 <= high else min(low * low, high * high) for low, high in ends)
    most = sum(max(low * low, high * high) for low, high in ends)
    # a simulator rounds squares and their sum: what is this near to the face is not known
    spare = 1 + Fraction(len(ends) + 4, 2**50)
    if radius <= 0 or least >= radius * radius * spare:
        return False
    return True if most * spare < radius * radius else None


def demands(problem: Problem, letters: Whole, faces: Whole, normals: Array, t: int) -> list[Demand]:
    """Return what the letter of a time t >= 1 asks of outputs; raise ``Refused`` if a side that is named is none."""
    asked: list[Demand] = []
    first, last = 0, 0
    for p, own in enumerate((*problem.regions, *problem.pairs)):
        value, label, is_pair = int(letters[t, p]), f"`{own.name}` at time {t}", len(own.agents) > 1
        # Pairs come after regions, and their normals stand one after the other.
        first, last = last, last + len(own.outputs[0]) * is_pair
        if value == 1:
            asked += _inside(own, label, t)
        elif value == -1 and is_pair:
            asked += _apart(own, normals[t, first:last], f"not {label}", t)
        # A region that is empty at this time does not hold, and nothing has to be avoided.
        elif value == -1 and np.all(own.low[t] < own.high[t]):
            limits = list(zip(own.low[t].tolist(), own.high[t].tolist(), strict=True))
            k, above = divmod(int(faces[t, p]), 2)
            if not 0 <= k < len(limits) or not np.isfinite(limits[k][above]):
                raise Refused(f"{label}: the side {faces[t, p]} that is kept away from has no limit")
            low, high = (limits[k][1], np.inf) if above else (-np.inf, limits[k][0])
            asked.append(Demand(((own.agents[0], k, 1.0),), low, high, f"not {label}", limits[k]))
    return asked


def _between(own: Proposition, factors: Array, low: float, high: float, label: str) -> Demand:
    """Return limits on ``factors.y``, or on ``factors.(y_a - y_b)``."""
    sides = zip(own.agents, own.outputs, (1.0, -1.0), strict=False)
    parts = [(i, k, sign * f) for i, axes, sign in sides for k, f in zip(axes, factors.tolist(), strict=True) if f]
    return Demand(tuple(parts), low, high, label)


def _inside(own: Proposition, label: str, t: int) -> list[Demand]:
    """Return limits which together hold in points of a box or ball alone."""
    count = len(own.outputs[0])
    faces, low, high = np.eye(count), own.low[t], own.high[t]
    if own.radius is not None:
        # in a disc a regular octagon: its corners are at the radius, its faces at radius times cos(pi / 8)
        turns = 0.25 * np.pi * np.arange(4)
        faces = np.column_stack([np.cos(turns), np.sin(turns)]) if count == 2 else faces
        limit = float(own.radius[t]) * INSIDE * (0.9238795325112867 if count == 2 else 1.0 / float(np.sqrt(count)))
        low, high = np.full(len(faces), -limit), np.full(len(faces), limit)
    limits = zip(faces, low.tolist(), high.tolist(), strict=True)
    return [_between(own, face, a, b, label) for face, a, b in limits if a > -np.inf or b < np.inf]


def _apart(pair: Proposition, normal: Array, label: str, t: int) -> list[Demand]:
    """Return the half-space beyond a pair in the direction of a normal; nothing where the pair is empty."""
    if pair.radius is None:
        low, high = pair.low[t], pair.high[t]
        if np.any(low >= high):
            return []
        # n.z on the closed box is largest at a corner; an infinite side times 0 asks for nothing
        with np.errstate(invalid="ignore"):
            corner = np.where(normal == 0.0, 0.0, np.maximum(normal * low, normal * high))
        largest = float(np.sum(corner)) + (len(normal) + 2.0) * U * float(np.sum(np.abs(corner)))
    else:
        radius = max(float(pair.radius[t]), 0.0)
        if radius == 0.0:
            return []
        largest = radius * float(np.sqrt(np.sum(normal * normal))) * (1.0 + (len(normal) + 8.0) * U)
    if not np.any(normal) or not np.isfinite(largest):
        raise Refused(f"{label}: the direction {normal.tolist()} leads out of no side of it")
    return [_between(pair, normal, largest, np.inf, label)]


def _one_window(letters: Whole, faces: Whole, t: int, p: int) -> bool:
    """Return whether times t and t + 1 belong to one window of a proposition; another side begins another one."""
    inside = 1 <= t < len(letters) - 1 and np.all(letters[t : t + 2, p] == SOMETIME)  # nothing is asked at time 0
    return bool(inside) and faces[t, p] == faces[t + 1, p]


def _in_windows(problem: Problem, letters: Whole, faces: Whole, t: int) -> Iterator[Window]:
    """Yield regions in a window at a time, output and side of the face, whether the window begins and ends here."""
    for p, region in enumerate(problem.regions):
        if letters[t, p] == SOMETIME:
            k, from_above = divmod(int(faces[t, p]), 2)
            if not 0 <= k < region.low.shape[1] or k in problem.agents[region.agents[0]].angle_outputs:
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
