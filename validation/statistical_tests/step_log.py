"""The bets of an audit: each claim has a wealth, whose expectation grows only if the claim is false."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...envs.tasks.problem import Problem

STAKES = np.concatenate([0.9 * 0.5 ** np.arange(12.0)] * 2)
"""Stakes of the bets, from .9 down to .9 / 2048 by halves, so that small and large falls both meet a fitting one.

The first half are shares of ``1 / (1 - Y)``, the second half are absolute.
"""


@dataclass(frozen=True, eq=False)
class StepLog:
    """Sums over episodes: logarithmic wealth per stake, numbers of episodes, and increments of the value.

    Parameters
    ----------
    start : (G,) array
        Logarithmic wealth of the bets on ``Y_0`` against the certified bound.
    wealth : (T, Q, G) array
        Logarithmic wealth of the bets on the step from time t in automaton state q.
    worlds, increments : (T, Q) arrays
        Number of undecided episodes in this state at this time, and the sum of their increments.
    contradictions : (T, Q) array
        Episodes in which the value fell below what the tree promises once the moves of all agents are known.
    split : tuple of (T, Q, C_i, G) arrays
        Logarithmic wealth of the bets on agent i's share of the step, over the episodes in which it stood in class c
        before. If the controller has a memory, the whole step stands in the place of the share.
    split_worlds, split_increments : tuples of (T, Q, C_i) arrays
        Number of those episodes, and the sum of their increments.
    """

    start: NDArray[Any]
    wealth: NDArray[Any]
    worlds: NDArray[Any]
    increments: NDArray[Any]
    contradictions: NDArray[Any]
    split: tuple[NDArray[Any], ...]
    split_worlds: tuple[NDArray[Any], ...]
    split_increments: tuple[NDArray[Any], ...]

    @classmethod
    def empty(cls, problem: Problem) -> StepLog:
        """Return the ledger without any episode."""
        # Logarithms of wealth begin at 0: every bet starts with a wealth of 1.
        T, Q, G = problem.horizon, problem.automaton.n_states, len(STAKES)
        classes = [len(classes_of_agent) for classes_of_agent in problem.labeling.classes]
        split = tuple(np.zeros((T, Q, c, G)) for c in classes)
        counts, sums = (tuple(np.zeros((T, Q, c)) for c in classes) for _ in range(2))
        return cls(
            np.zeros(G), np.zeros((T, Q, G)), np.zeros((T, Q)), np.zeros((T, Q)), np.zeros((T, Q)), split, counts, sums
        )

    def plus(self, other: StepLog) -> StepLog:
        """Return the sum of two ledgers."""
        plain = ("start", "wealth", "worlds", "increments", "contradictions")
        sums = [getattr(self, name) + getattr(other, name) for name in plain]
        pairs = ((getattr(self, n), getattr(other, n)) for n in ("split", "split_worlds", "split_increments"))
        return StepLog(*sums, *(tuple(a + b for a, b in zip(left, right, strict=True)) for left, right in pairs))
