"""Shaped rewards: a potential read off the task automaton; every step pays the difference of the potential.

**"shaped"** pays what no policy can influence in the end. With the potential Phi of a state, a step from s to s' pays
`r + discount Phi(s') - Phi(s)`, and Phi is 0 once the episode has ended. The discounted sum over an episode of T steps
is then

    sum_t discount^t r_t  -  Phi(s_0).

This is the sparse return less a number that no policy influences, so the same policies are optimal (Ng, Harada and
Russell 1999). Termination and truncation both count as an end: the observation holds the time left, so the decision
problem ends at the horizon as well.

Phi lies in [0, 1]. It is 1 in accepting states, and 0 where acceptance is out of reach or an agent has left its
workspace. Elsewhere it counts the automaton steps that are still needed; between two of them it rises as agents come
closer to the regions of a letter that takes the next step. It estimates progress; no guarantee rests on it.

A consequence of the zero at the end: **all failing episodes have the same return**, -Phi(s_0). A learner that has never
succeeded learns nothing from it.

**"progress"** tells a good failure from a bad one. It pays the same differences, but of a level that is kept to the
end: when a task is lost, the level stays what it was. The undiscounted return is satisfaction plus the progress made,
so the optimal policies may differ from those of the task; learn with it first and with "sparse" afterwards. Tasks that
are judged at the horizon count the time survived, too: their level is the mean of Phi and of the share of time gone by.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import islice

import numpy as np

from ..agents import linear
from ..dynamics import Dynamics, Worlds
from ..logic import Automaton

REWARDS = ("sparse", "shaped", "progress")
# Limits that keep the potential cheap to evaluate; a shorter list makes the guess coarser, and nothing else.
_STATE_PATHS = 2000  # paths of a state's diagram that are read
_STATE_LETTERS = 32  # letters of a state that are used: those that ask for the fewest propositions


@dataclass(frozen=True, eq=False)
class Potential:
    """The potential of a problem.

    Attributes
    ----------
    dynamics : Dynamics
    steps : np.ndarray of float, shape (Q,)
        Fewest automaton steps to acceptance; infinite if there is no way.
    wanted : tuple of tuple of np.ndarray of int
        Per automaton state: the propositions of the letters that take a step forward, one array per letter.
    """

    dynamics: Dynamics
    steps: np.ndarray
    wanted: tuple[tuple[np.ndarray, ...], ...]

    @classmethod
    def of(cls, dynamics: Dynamics) -> Potential:
        """Return the potential of a problem, read off its automaton."""
        automaton = dynamics.problem.automaton
        steps = _steps(automaton)
        manager, roots = automaton.diagrams()
        wanted = []
        for q, root in enumerate(roots):
            letters = set()
            # A letter is named by the propositions that have to hold; those that must not hold are ignored.
            for assignment, target in islice(manager.paths(root), _STATE_PATHS):
                if steps[target] < steps[q]:
                    letters.add(frozenset(p for p, holds in assignment.items() if holds))
            simplest = sorted(letters, key=lambda letter: (len(letter), sorted(letter)))[:_STATE_LETTERS]
            wanted.append(tuple(np.array(sorted(letter), dtype=int) for letter in simplest))
        return cls(dynamics, steps, tuple(wanted))

    def at(self, worlds: Worlds) -> np.ndarray:
        """Return the potential of each world, float (M,), between 0 and 1."""
        finite = self.steps[np.isfinite(self.steps)]
        most = finite.max() if finite.size else 0.0
        result = np.zeros(worlds.n_worlds)
        gaps = self._gaps(worlds)
        for q in np.unique(worlds.q):
            here = np.flatnonzero(worlds.q == q)
            if np.isfinite(self.steps[q]):
                result[here] = (most - self.steps[q] + self._closeness(int(q), gaps[:, here])) / (most + 1.0)
        return np.where(worlds.failed, 0.0, result)

    def kept(self, worlds: Worlds, before: np.ndarray) -> np.ndarray:
        """Return the level of the reward "progress", float (M,) in [0, 1]; lost tasks keep the level `before`."""
        problem = self.dynamics.problem
        levels = self.at(worlds)
        if not problem.automaton.is_co_safe:
            levels = 0.5 * (levels + np.asarray(worlds.time) / problem.horizon)
        return np.where(worlds.failed | problem.automaton.dead[worlds.q], before, levels)

    def _closeness(self, q: int, gaps: np.ndarray) -> np.ndarray:
        """Return how close the agents are to a letter that takes a step forward: float (M,), between 0 and 1."""
        if self.steps[q] == 0 or not self.wanted[q]:
            return np.full(gaps.shape[1], 1.0 if self.steps[q] == 0 else 0.0)
        best = np.zeros(gaps.shape[1])
        for letter in self.wanted[q]:
            best = np.maximum(best, 1.0 - gaps[letter].mean(axis=0) if letter.size else 1.0)
        return best

    def _gaps(self, worlds: Worlds) -> np.ndarray:
        """Return how far the owner of each proposition is from its region, in workspace widths: (P, M) in [0, 1]."""
        result = np.zeros((len(self.dynamics.problem.propositions), worlds.n_worlds))
        for block, x in zip(self.dynamics.blocks, worlds.states):
            if block.propositions.size:
                with np.errstate(over="ignore", invalid="ignore"):
                    y = (x if block.identity_output else linear(block.C, x))[:, block.owners]
                    # The width is that of the outputs of the workspace; the largest gap of all axes counts.
                    extent = (block.state_high - block.state_low)[None]
                    width = (np.abs(block.C) * extent).sum(axis=1)[:, block.owners]
                    gap = np.maximum(np.maximum(block.region_low - y, y - block.region_high), 0.0) / width
                result[block.propositions] = np.nan_to_num(np.minimum(gap, 1.0), nan=1.0).max(axis=0)
        return result


def _steps(automaton: Automaton) -> np.ndarray:
    """Return the fewest transitions from each automaton state to an accepting one, infinite if there is no way."""
    manager, roots = automaton.diagrams()
    following = [manager.leaves(root) for root in roots]
    steps = np.where(automaton.accepting, 0.0, np.inf)
    # Bellman-Ford: shortest ways are at most as long as there are states.
    for _ in range(automaton.n_states):
        shorter = np.array([min((steps[t] + 1.0 for t in targets), default=np.inf) for targets in following])
        if (shorter >= steps).all():
            break
        steps = np.minimum(steps, shorter)
    return steps
