"""What an action is worth on a grid of vertices: a lower bound on the expected value at the true state.

The value of a grid of vertices is below its backup under interpolated inputs (docs/theory/vertices.md). Under any other
input u the same means say what that is worth: ``Q_t(x, u) <= E V_(t+1)(x')`` at the true state, for all disturbances,
noise of any law and size (``Backups.means_at``). So a shield goes by it as it does on cells (docs/theory/shields.md).
"""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ....envs.systems.arguments import tree_text
from ...certificates.proofs import Certificate, VertexProof
from ...relations.grids import FloatArray
from ..claims import VertexValues

UNIT = 2.0**-53

MOST_TABLES = 4
"""Tables of values after a letter that are kept."""

NUMBERS = 60
"""Numbers that a question about one world holds for each edge of an axis, about."""


@dataclass(frozen=True, eq=False, repr=False)
class VertexActionValues:
    """Values of states and of inputs under a certificate on the grid of one agent; lower bounds up to rounding.

    Its methods are those of ``ActionValues``, for the one factor of the one agent.
    """

    certificate: Certificate[VertexProof]
    values: VertexValues
    _after: OrderedDict[tuple[int, int], FloatArray] = field(default_factory=OrderedDict)

    def __repr__(self) -> str:
        rows = [
            ("times", f"0 .. {self.certificate.problem.horizon - 1}"),
            ("cells", self.certificate.proof.grid.size_text),
        ]
        return tree_text(f"VertexActionValues of {self.certificate.problem.name!r}", rows)

    def of_states(self, states: tuple[FloatArray, ...], q: NDArray[np.int64], time: NDArray[np.int64]) -> FloatArray:
        """Return the values (M,) of states (d, M) in automaton states (M,) at times (M,); see ``ActionValues``."""
        problem = self.certificate.problem
        workspace, x = problem.agents[0].workspace, states[0]
        inside = np.all((workspace.low[:, None] <= x) & (x <= workspace.high[:, None]), axis=0)
        decided = problem.automaton.absorbing[q] | (time >= problem.horizon)
        values = np.where(decided, problem.automaton.accepting[q], 0.0) * inside
        going = np.flatnonzero(inside & ~decided)
        values[going] = self.values.at(x[:, going].T, q[going], problem.horizon - time[going])
        return values

    def expected(self, time: int, q: int, i: int, states: tuple[FloatArray, ...], inputs: FloatArray) -> FloatArray:
        """Return lower bounds (1, M) on the expected value of the next state from states (d, M), under inputs (m, M).

        The bound of an input that is no number, or of a next state of which nothing is known, is no number.
        """
        steps, key = self.values.steps, (time, q)
        if key not in self._after:
            later = self.values.tables[len(self.values.tables) - 2 - time]
            self._after[key] = steps.after_letter(*later, q, time + 1)
            if len(self._after) > MOST_TABLES:
                self._after.popitem(last=False)
        known = np.asarray(np.isfinite(inputs).all(axis=0) & np.isfinite(states[0]).all(axis=0))
        result = np.full(inputs.shape[1], np.nan)
        if known.any():
            with np.errstate(all="ignore"):
                found = steps.means_at(self._after[key], states[0][:, known], inputs[:, known].T, time)
            result[known] = np.where(found < 0.0, np.nan, found)
        return result[None]

    def of_inputs(
        self, time: int, q: int, states: tuple[FloatArray, ...], inputs: tuple[FloatArray, ...]
    ) -> FloatArray:
        """Return the same (M,), for inputs of all agents, of which there is one."""
        return np.asarray(self.expected(time, q, 0, states, inputs[0])[0])

    def certified_inputs(self, states: tuple[FloatArray, ...], q: int, time: int) -> tuple[FloatArray, ...]:
        """Return the inputs (m, M) of the certified controller at one time and in one automaton state."""
        same = np.full(states[0].shape[1], q)
        return (self.certificate.controller.inputs(0, states[0], same, time),)

    def work(self, time: int, q: int) -> int:
        """Return how many numbers a question about one world holds."""
        return NUMBERS * sum(axis.shape[-1] for axis in self.values.steps.edges)

    @property
    def relative_loss(self) -> float:
        """Upper bound on the share by which rounding may raise what is claimed, over a whole episode.

        Per step: weights and a sum of corners for a state on either side, and what is done to a budget. What means of
        an input are rounded by is in the bounds themselves.
        """
        n = self.certificate.problem.horizon * (8 * 2 ** len(self.values.steps.edges) + 64)
        return 2.0 * n * UNIT / (1.0 - n * UNIT)

    loss = 0.0
    """Probability that rounding decides: controllers have room for it at every vertex (``closed_loops``)."""
