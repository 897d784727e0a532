"""How runs of a problem are seen by the certificate on cells that its own one rests on.

A problem that names the time is written out without it: its automaton counts steps, and its agents may have a clock
among their inputs.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ....envs.tasks.problem import Problem
from ...relations.grids import FloatArray

Arrays = tuple[FloatArray, ...]
"""States or inputs (k_i, M) of M worlds, per agent."""


@dataclass(frozen=True, eq=False)
class RunProjection:
    """Runs of a problem as they are: the certificate is about the problem itself.

    Parameters
    ----------
    problem : Problem
        Whose runs are seen.
    """

    problem: Problem

    def inputs(self, inputs: Arrays, time: NDArray[np.int64]) -> Arrays:
        """Return inputs as those of the agents on cells, in worlds at times (M,)."""
        return inputs

    def given_back(self, inputs: Arrays) -> Arrays:
        """Return inputs of the agents on cells as those of the problem's agents."""
        return inputs

    def automaton_states(self, q: NDArray[np.int64], time: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return automaton states (M,) of the problem on cells; -1 for those that no run comes to at this time."""
        return q


@dataclass(frozen=True, eq=False)
class ProjectionInTime(RunProjection):
    """Runs of a problem that names the time, as those of the problem written out.

    Parameters
    ----------
    counted : (T + 1, Q) int array
        Automaton states of the problem written out, by time and automaton state; -1 for none.
    clocks : tuple of bool
        Whether the last input of each agent written out is the time.
    """

    counted: NDArray[np.int64]
    clocks: tuple[bool, ...]

    def inputs(self, inputs: Arrays, time: NDArray[np.int64]) -> Arrays:
        """Return inputs with the time where agents have a clock."""
        ticks = np.asarray(time, dtype=float)[None]
        return tuple(np.concatenate([u, ticks]) if clock else u for u, clock in zip(inputs, self.clocks, strict=True))

    def given_back(self, inputs: Arrays) -> Arrays:
        """Return inputs without clocks."""
        return tuple(u[:-1] if clock else u for u, clock in zip(inputs, self.clocks, strict=True))

    def automaton_states(self, q: NDArray[np.int64], time: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return the states of the automaton that counts."""
        return self.counted[np.minimum(time, len(self.counted) - 1), q]
