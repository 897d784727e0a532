"""Affine functions, read as programs of expressions are: derivatives are the same everywhere, and nothing bends."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ....envs.systems.agents import LinearAgent
from ...relations.grids import FloatArray


@dataclass(frozen=True, eq=False)
class AffineForms:
    """Functions ``matrix z + offset`` of variables z (v,), for a matrix (p, v) and an offset (p,)."""

    matrix: FloatArray
    offset: FloatArray

    @classmethod
    def of_motion(cls, agent: LinearAgent, mean: FloatArray) -> AffineForms:
        """Return the mean of the next state, of states and inputs, under noise with a mean (d,)."""
        return cls(np.hstack([agent.A, agent.B]), agent.offset + mean)

    @classmethod
    def of_outputs(cls, agent: LinearAgent) -> AffineForms:
        """Return the outputs, of states."""
        return cls(agent.output_matrix, np.zeros(agent.n_outputs))

    def values(self, variables: FloatArray) -> FloatArray:
        """Return the values (p, n) at variables (v, n)."""
        return np.asarray(self.matrix @ variables + self.offset[:, None])

    def slopes(self, variables: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the values (p, n) at variables (v, n), and the derivatives (p, v, 1)."""
        return self.values(variables), self.matrix[:, :, None]

    def curved(self, box: FloatArray) -> list[tuple[dict[int, FloatArray], dict[tuple[int, int], FloatArray]]]:
        """Return that no function has second derivatives, on any boxes."""
        return [({}, {}) for _ in self.offset]
