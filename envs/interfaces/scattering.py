"""Starts anywhere: episodes of learners that begin at random states, automaton states and times.

A learner that always begins at the start of the problem sees what comes late only after it has learned what comes
first. With starts anywhere it sees all of the task at once, near the goal and near the horizon, too.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from ..simulation import Dynamics, Worlds
from ..simulation import batch_simulator as core

TRIES = 10
"""How often a start is drawn again that loses or settles the task at once; most tasks need one or two draws."""


def scattered(dynamics: Dynamics, worlds: Worlds, chosen: np.ndarray, rng: np.random.Generator) -> Worlds:
    """Return the worlds, with those of `chosen`, bool (M,), put anywhere; each must have a time of its own.

    States are uniform in the workspaces, automaton states uniform among those that do not settle the task, and times
    uniform between 0 and the last one before the horizon. The automaton reads the letter of the new state. Starts that
    it settles are drawn again; worlds for which all draws fail stay where they are.
    """
    automaton = dynamics.problem.automaton
    undecided = np.flatnonzero(~automaton.absorbing)
    if not undecided.size or not chosen.any():
        return worlds
    # Restarted worlds have arrays of their own, but marks are read-only.
    states = tuple(x.copy() for x in worlds.states)
    q, time = worlds.q.copy(), np.array(worlds.time)
    left = np.flatnonzero(chosen)
    for _ in range(TRIES):
        drawn = tuple(_uniform(block, left.size, rng) for block in dynamics.blocks)
        # Where regions move, letters depend on the time; else a time is drawn for those alone that are put somewhere.
        moves = dynamics.problem.labeling.moves
        times = rng.integers(0, dynamics.problem.horizon, left.size) if moves else np.zeros(left.size, dtype=int)
        following = automaton.next_state(rng.choice(undecided, left.size), core.letters(dynamics, drawn, times))
        good = ~automaton.absorbing[following]
        for x, new in zip(states, drawn):
            x[..., left[good]] = new[..., good]
        q[left[good]] = following[good]
        time[left[good]] = times[good] if moves else rng.integers(0, dynamics.problem.horizon, int(good.sum()))
        left = left[~good]
        if not left.size:
            break
    # A start of the problem may have settled the task; one that was drawn has not.
    placed = chosen.copy()
    placed[left] = False
    return replace(
        worlds, states=states, q=q, time=time, failed=worlds.failed & ~placed, accepted=worlds.accepted & ~placed
    )


def checked_share(value: Any) -> float:
    """Return the share of episodes that begin anywhere as a float, or raise ValueError."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0.0 <= value <= 1.0:
        raise ValueError(f"`spread`: expected a number from 0 to 1, got {value!r}")
    return float(value)


def _uniform(block: Any, count: int, rng: np.random.Generator) -> np.ndarray:
    """Return states uniform in the workspaces of a block: (d, n, count)."""
    width = block.state_high - block.state_low
    return np.asarray(block.state_low + width * rng.random((*width.shape[:2], count)))
