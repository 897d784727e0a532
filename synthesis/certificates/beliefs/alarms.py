"""Numbers that search and checker compute by code of their own, and that are one quantity: they have to agree.

A search looks for what the checker proves, and so walks into whatever the checker gets wrong: a claim that is too good
is the first thing that it finds. Then the search, which computes the same by other code, believes something else.

Compared is, along a trajectory and at each time, the standard deviation of every state from its nominal value, to first
order; where dynamics are linear, and so nothing is charged for linearization, also how many deviations the nearest
limit is away. Of the total: constraints fail together at least as probably as the most probable one, so that the
failure that is proved is at least the normal tail beyond the nearest limit. On cells it is the value at the start.

Nothing that is proved rests on this comparison: a file may leave out what was believed, and then nothing is compared.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ...checker import Contents, Verdict

FAR = 37.0
"""Deviations beyond which normal numbers have no tail in floating point: what is farther is equal."""

SHARE = 1e-4
"""Share of themselves by which deviations, how far limits are away, and failures may differ: search and checker charge
what they round by factors of their own, and 1e-5 is the most that was met."""

SMALL = 1e-7
"""Deviations that may differ by as much: roots of what variances of 0 are rounded to."""

OFF_VALUE = 1e-8
"""How far values at the start may differ: their reserves for rounding are smaller."""

MOST = 20_000
"""Deviations that are stored, some 200 KB of text: those of larger teams are not."""


def believed_along(failure: float, spreads: Any, nearest: Mapping[int, float] | None) -> dict[str, Any]:
    """Return what a search believed of a trajectory, for its certificate: plain values.

    ``failure`` is an upper bound on the probability that a constraint fails; ``spreads`` (S + 1, D) are standard
    deviations of all states; ``nearest`` says by times how many deviations the nearest limit is away, if that is known.
    """
    believed: dict[str, Any] = {"failure": failure}
    if spreads.size <= MOST:
        believed["deviations"] = [[float(f"{own:.7g}") for own in row] for row in spreads.tolist()]
    if nearest is not None:
        away = [nearest.get(t, FAR) for t in range(len(spreads))]
        believed["nearest"] = [float(f"{min(max(z, -FAR), FAR):.7g}") for z in away]
    return believed


def believed_on_cells(value: float) -> dict[str, Any]:
    """Return what a search believed of cells: the value at the start of its policies, before reserves are taken off."""
    return {"value": value}


def alarm(believed: Any, verdict: Verdict) -> str:
    """Return how what a search believed differs from what the checker recomputed, in words; nothing if it does not.

    What is believed is text of a file, and may be anything.
    """
    if believed is None or verdict.recomputed >= 1.0:  # where nothing is proved the verdict says why
        return ""
    try:
        if "value" in believed:
            value = float(believed["value"])
            found = _differing(value, 1.0 - verdict.recomputed, OFF_VALUE, 12)
            return found and f"{found} as the value at the start"
        spreads = np.array(believed.get("deviations", []), dtype=float)
        away = np.array(believed.get("nearest", []), dtype=float)
        return next(_along(spreads, away, verdict), "")
    except (TypeError, ValueError, AttributeError, IndexError, OverflowError):
        return "ALARM: what the search believed is not readable, or of other steps"


def alarm_in(contents: Contents, verdict: Verdict) -> str:
    """Return the alarm of a file in canonical form, whose notes may say what the search believed."""
    notes = contents.header.get("notes")
    return alarm(notes.get("believed") if isinstance(notes, dict) else None, verdict)


def _along(spreads: Any, away: Any, verdict: Verdict) -> Iterator[str]:
    """Yield what differs along a trajectory, step by step."""
    steps: Sequence[tuple[float, str, Any]] = verdict.steps
    for numbers in (spreads, away):
        if len(numbers) not in (0, len(steps)):
            raise ValueError
    for t, (nearest, label, deviations) in enumerate(steps):
        for k in range(len(deviations) if len(spreads) else 0):
            size = max(spreads[t, k], deviations[k])
            if found := _differing(spreads[t, k], float(deviations[k]), SMALL + SHARE * size, 7):
                yield f"{found} as the deviation of state {k} at step {t}"
        if len(away):
            far = min(max(nearest, -FAR), FAR)
            if found := _differing(away[t], far, SHARE * max(1.0, abs(far)), 7):
                yield f"{found} deviations to the nearest limit ({label}) at step {t}"
    least = 0.5 * math.erfc(away.min(initial=FAR) / math.sqrt(2.0)) * (1.0 - 100.0 * SHARE)
    if verdict.recomputed < least:
        yield (
            f"ALARM: the search believed that one constraint alone fails with probability {least:.6g}, the checker "
            f"recomputes {verdict.recomputed:.6g} for all of them"
        )


def _differing(believed: float, recomputed: float, most: float, digits: int) -> str:
    if abs(believed - recomputed) <= most:  # nan is never as near
        return ""
    return f"ALARM: the search believed {believed:.{digits}g}, the checker recomputes {recomputed:.{digits}g}"


def is_canonical(path: str | Path) -> bool:
    """Return whether a file begins as one of the checker's format does: with a stored member ``header.json``."""
    with open(path, "rb") as file:
        start = file.read(41)
    return start[:4] == b"PK\x03\x04" and start[30:41] == b"header.json"
