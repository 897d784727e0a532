"""Batches of worlds of which some begin anywhere: a learner sees what comes late before it can do what comes first.

Else it comes there with little time left, and when it has become too sure to try anything else.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from ...envs.interfaces import ProblemVectorEnv
from ...envs.simulation import Worlds, letters
from ...envs.tasks.problem import Problem

TRIES = 10
"""How often a start is drawn again that loses or settles the task at once; most tasks need one or two draws."""


class ScatteredVectorEnv(ProblemVectorEnv):
    """Batch of worlds, a share of which begins anywhere; success rates of those say nothing about the problem.

    States are uniform in the workspaces, automaton states among those that do not settle the task, and times from 0 to
    the last one before the horizon. Worlds for which all draws are settled begin at the start, and so do all where the
    task is to survive: it has no later stages.

    Parameters
    ----------
    problem : Problem
    spread : float
        Share of such episodes.
    num_envs, **options
        As for `ProblemVectorEnv`.

    Attributes
    ----------
    scattered : np.ndarray of bool, shape (M,)
        Which worlds began anywhere.
    """

    def __init__(self, problem: Problem, spread: float, num_envs: int = 1, **options: Any) -> None:
        super().__init__(problem, num_envs, **options)
        self.spread, self.scattered = spread, np.zeros(num_envs, dtype=bool)
        self._is_plain = False
        self.has_stages = self._potential is None or not self._potential.is_survival

    def _begun(self, worlds: Worlds, which: np.ndarray) -> Worlds:
        automaton, rng, horizon = self.problem.automaton, self.np_random, self.problem.horizon
        undecided = np.flatnonzero(~automaton.absorbing)
        chosen = which & (rng.random(self.num_envs) < self.spread * self.has_stages)
        states, q, time = tuple(x.copy() for x in worlds.states), worlds.q.copy(), np.array(worlds.time)
        left = np.flatnonzero(chosen)
        for _ in range(TRIES if left.size and undecided.size else 0):
            ends = ((block.state_low, block.state_high - block.state_low) for block in self._dynamics.blocks)
            drawn = tuple(low + width * rng.random((*width.shape[:2], left.size)) for low, width in ends)
            times = rng.integers(0, horizon, left.size)
            # The automaton reads the letter of the new state, so that states agree with what has been seen.
            following = automaton.next_state(rng.choice(undecided, left.size), letters(self._dynamics, drawn, times))
            good = ~automaton.absorbing[following]
            for x, new in zip(states, drawn):
                x[..., left[good]] = new[..., good]
            q[left[good]], time[left[good]] = following[good], times[good]
            left = left[~good]
        chosen[left] = False
        self.scattered = np.where(which, chosen, self.scattered)
        marks = {name: getattr(worlds, name) & ~chosen for name in ("failed", "accepted")}
        return replace(worlds, states=states, q=q, time=time, **marks)

    def _relevel(self, which: np.ndarray, begun: bool = False) -> None:
        super()._relevel(which)  # starts differ, also where the problem has a single one
