"""The bets of an audit: a wealth per claim, which grows only if the claim is false."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...envs.problem import Problem

STAKES = np.concatenate([0.9 * 0.5 ** np.arange(12.0)] * 2)
"""Stakes: the first half in shares of ``1 / (1 - Y)``, the second half absolute."""


@dataclass(frozen=True, eq=False)
class Ledger:
    """Sums over episodes: logarithmic wealth per stake, numbers and increments.

    Parameters
    ----------
    start : (G,) array
        Of ``Y_0`` against the certified bound.
    wealth : (T, Q, G) array
    worlds, increments : (T, Q) arrays
        Undecided episodes met, and the sums of their increments.
    contradictions : (T, Q) array
        Episodes in which the value fell below what the tree promises after the moves of all agents were known.
    split : tuple of (T, Q, C_i, G) arrays
        The wealth of agent i's part of the step, over the episodes in which it stood in class c before. (Of the whole
        step if the controller has a memory.)
    split_worlds, split_increments : tuples of (T, Q, C_i) arrays
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
    def empty(cls, problem: Problem) -> Ledger:
        """No episode yet."""
        T, Q, G = problem.horizon, problem.automaton.n_states, len(STAKES)
        classes = [len(own) for own in problem.labeling.classes]
        split = tuple(np.zeros((T, Q, c, G)) for c in classes)
        counts, sums = (tuple(np.zeros((T, Q, c)) for c in classes) for _ in range(2))
        return cls(
            np.zeros(G), np.zeros((T, Q, G)), np.zeros((T, Q)), np.zeros((T, Q)), np.zeros((T, Q)), split, counts, sums
        )

    def plus(self, other: Ledger) -> Ledger:
        """Sum of two ledgers."""
        plain = ("start", "wealth", "worlds", "increments", "contradictions")
        arrays = [getattr(self, name) + getattr(other, name) for name in plain]
        pairs = ((getattr(self, n), getattr(other, n)) for n in ("split", "split_worlds", "split_increments"))
        return Ledger(*arrays, *(tuple(a + b for a, b in zip(mine, yours, strict=True)) for mine, yours in pairs))
