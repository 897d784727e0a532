"""Regions that are to be met at some time of a window: a path that crosses one meets it, whatever its pace.

A path comes to a region through a face, ``y_k >= low`` say. All other limits of the region hold at all times of the
window, ``y_k < high`` at the first one and ``y_k >= low`` at the last. So there is a first time at which
``y_k >= low``. If it is the first one of the window, the output is below ``high``; else it was below ``low`` a step
before, and it is in the region by now unless it rises by ``high - low`` or more in that one step. Such jumps are rows
like others: with ``e' = F e + r + w`` the difference of both outputs is ``(C' F - C) e + C' r + C' w``, where w is
independent of all that was before (docs/theory/paths.md, "Regions that are crossed").
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product

import numpy as np

from ...envs.agents import Proposition
from ..cells import FloatArray
from ..certificates import SOMETIME, AlongPath, PathProof
from .gaussian_inequalities import Inequalities, shortened
from .moment import Moment, of_copies
from .moving import NothingKnownError
from .own_regions import RegionSpan
from .roundings import TAIL, UNIT

MOST_OPEN = 4
"""Most regions that are to be met at some time, at one time."""

Limit = tuple[int, float, float]
"""An output, and what it is to be at least and at most."""

Met = frozenset[int]
"""Numbers of propositions that were met in the window that is open."""


def is_first(proof: PathProof, t: int, p: int) -> bool:
    """Whether a window of a proposition begins at time t; nothing is asked at time 0."""
    return t == 1 or not _go_together(proof, t - 1, t, p)


def is_last(proof: PathProof, t: int, p: int) -> bool:
    """Whether a window of a proposition ends at time t."""
    return t == proof.n_steps or not _go_together(proof, t, t + 1, p)


def _go_together(proof: PathProof, one: int, other: int, p: int) -> bool:
    """Whether two times belong to one window: a path that comes from another side begins another one."""
    return bool(np.all(proof.letters[[one, other], p] == SOMETIME) and proof.faces[one, p] == proof.faces[other, p])


def wrong_windows(certificate: AlongPath) -> list[str]:
    """What is wrong with regions that are to be met at some time: whose they are, sides, how many at a time."""
    problem, proof = certificate.problem, certificate.proof
    asked = proof.letters == SOMETIME
    for p in np.flatnonzero(asked.any(axis=0)).tolist():
        proposition = problem.propositions[problem.automaton.propositions[p]]
        if not isinstance(proposition, Proposition):
            return ["a pair is to hold at some time, and no path says when"]
        i = problem.agent_names.index(proposition.agent)
        sides = proof.faces[asked[:, p], p]
        if proof.paths[i].states is None:
            return ["a region is to be met at some time by an agent without nominal states"]
        if np.any((sides < 0) | (sides >= 2 * problem.agents[i].n_outputs)):
            return ["a region is to be met at some time and is come to from no side"]
    if np.any(asked.sum(axis=1) > MOST_OPEN):
        return [f"more than {MOST_OPEN} regions are to be met at some time, at one time"]
    return []


def readings(letter: list[int], met: Met) -> Iterator[tuple[list[int], Met]]:
    """Yield what a letter may say, of -1, 0 and 1, and what was met by then: regions hold at the time, or not yet."""
    is_open = [p for p, value in enumerate(letter) if value == SOMETIME]
    waiting = [p for p in is_open if p not in met]
    for each in product((False, True), repeat=len(waiting)):
        now = [0 if value == SOMETIME else value for value in letter]
        for p, holds in zip(waiting, each, strict=True):
            now[p] = 1 if holds else -1
        yield now, met | {p for p, holds in zip(waiting, each, strict=True) if holds}


def closed(proof: PathProof, t: int, met: Met) -> Met | None:
    """Return what was met in windows that go on after time t; None if one ends in which nothing was met."""
    ends = {p for p, value in enumerate(proof.letters[t].tolist()) if value == SOMETIME and is_last(proof, t, p)}
    return met - ends if ends <= met else None


def limits_of(proof: PathProof, t: int, p: int, limits: list[Limit]) -> list[Limit]:
    """Return limits (output, low, high) of a region that is to be met at some time, from those of being in it."""
    k, from_above = divmod(int(proof.faces[t, p]), 2)
    far, near = is_first(proof, t, p), is_last(proof, t, p)
    keeps_low, keeps_high = (far, near) if from_above else (near, far)
    return [
        (j, low if keeps_low else -np.inf, high if keeps_high else np.inf) if j == k else (j, low, high)
        for j, low, high in limits
    ]


def add_jumps(now: Moment, certificate: AlongPath, rows: Inequalities) -> None:
    """Add the inequalities that an agent jumps over no region in the step by which it arrived."""
    problem, proof, t = certificate.problem, certificate.proof, now.t
    asked = list[Limit]()
    was = now.arrival.was if now.arrival is not None else now
    for p in np.flatnonzero(proof.letters[t] == SOMETIME).tolist():
        region = problem.propositions[problem.automaton.propositions[p]]
        if region.agent != now.agent.name or is_first(proof, t, p):
            continue
        assert isinstance(region, Proposition)
        before, after = RegionSpan.of(region, t - 1), RegionSpan.of(region, t)
        k, from_above = divmod(int(proof.faces[t, p]), 2)
        # What the region is at least, where it moves; of angles the same copy, as far as runs are followed.
        _, *old = of_copies(was, k, float(before.low[1, k]), float(before.high[0, k]), holds=True)
        _, *new = of_copies(now, k, float(after.low[1, k]), float(after.high[0, k]), holds=True)
        if k in now.agent.angle_outputs and old != new:
            raise NothingKnownError(f"a region is crossed from one of its copies to another one at step {t}")
        # From outside of the face to beyond the far one.
        asked.append((k, new[0] - old[1], np.inf) if from_above else (k, -np.inf, new[1] - old[0]))
    if not asked:
        return
    low, high = np.array([ends for _, *ends in asked]).T
    shift, drift, variance, largest = _difference(now, [k for k, *_ in asked])
    ends = [found.values[:, [k for k, *_ in asked]] for found in (now.outputs, was.outputs)]
    least, most = ends[0].min(axis=0) - ends[1].max(axis=0), ends[0].max(axis=0) - ends[1].min(axis=0)
    spare = 8.0 * UNIT * (np.abs(ends[0]).max(axis=0) + np.abs(ends[1]).max(axis=0))
    below, above = (
        distance - spare - 8.0 * UNIT * np.where(np.isfinite(limit), np.abs(limit), 0.0)
        for distance, limit in ((least - low, low), (high - most, high))
    )
    rows.add(*shortened(below, above, shift, drift), np.full(len(asked), np.inf), variance, largest)


def _difference(now: Moment, k: list[int]) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return how outputs k (J,) move in the step before, beside nominal values: as ``Chain.drift`` and ``spreads`` do.

    Shifts (J,), what they may be off, variances of the linear deviation, and what one step adds to these at most.
    """
    arrival, d = now.arrival, len(now.at)
    assert arrival is not None
    was = arrival.was
    C, before = now.outputs.matrix[k], was.outputs.matrix[k]
    form = C @ arrival.closed - before
    # Forms are rounded, which acts on the deviation in the tube; outputs are off their forms at both times.
    rounded = (d + 4.0) * UNIT * (np.abs(C) @ np.abs(arrival.closed) + np.abs(before))
    shift, drift = arrival.chain.drift(form)
    sizes = np.abs(C) @ np.abs(arrival.middle)
    drift = drift + np.abs(C) @ arrival.remainder + rounded @ was.reach + (d + 4.0) * UNIT * (sizes + np.abs(shift))
    drift = (drift + now.outputs.off[k] + was.outputs.off[k]) * TAIL
    variance, largest = arrival.chain.spreads(form)
    size = np.einsum("jd,de,je->j", np.abs(C), np.abs(arrival.noise), np.abs(C))
    own = np.maximum(np.einsum("jd,de,je->j", C, arrival.noise, C), 0.0) + (2.0 * d + 4.0) * UNIT * size
    return shift + C @ arrival.middle, drift, (variance + own) * TAIL, np.maximum(largest, own) * TAIL
