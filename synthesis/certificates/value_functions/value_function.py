"""What value trees and tensor trains have in common: how a value function is read."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray


class ValueFunction(Protocol):
    """Value of every automaton state over the joint cells of all agents, at one time.

    ``Terms`` (sums of products), ``Trains`` (tensor trains) and ``Unread`` (before the first letter) are of this kind.
    What ``at`` and ``total`` return is a **lower bound** on the value that the record stands for, up to the rounding of
    sums of nonnegative numbers, which the reader takes off (docs/theory/numerics.md). Terms are read as they are, since
    they were pruned and united from below; trains subtract their certified error.
    """

    @property
    def rank(self) -> int:
        """Largest number of terms of one automaton state, or of columns of a bond (exact)."""

    def work(self, q: int) -> int:
        """Return how many numbers ``at`` holds per joint cell in state q, to read many cells in portions (exact)."""

    def at(self, q: int, cells: NDArray[np.integer]) -> NDArray:
        """Return lower bounds (M,) on the value of state q at joint cells (M, I)."""

    def total(self, q: int, weights: Sequence[NDArray]) -> float:
        """Return a lower bound on the value of state q, weighed with nonnegative weights (S_i,) per agent."""
