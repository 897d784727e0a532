"""Values of a grid of vertices at every time: backups once more, of which all are kept.

They are lower bounds like the claim, by its theorem (``vertex_grids.backups``), of the problem in the checker's form.
"""

from __future__ import annotations

import itertools
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from ...certificates.controllers import interpolated
from ...certificates.proofs import Certificate, VertexProof, canonical_problem
from ...checker import read_problem
from ...relations.grids import FloatArray
from ..vertex_grids import Backups, independent, numbers_in

SIDES: Final[tuple[Literal["left", "right"], ...]] = ("left", "right")


class VertexValues:
    """Values of a certificate on a grid of vertices, at states, automaton states and times that are left.

    ``tables`` are numbers (Q, n_1 + 1, ..) at vertices, and which cells (Q, n_1, ..) are 0, by steps that are left.
    """

    def __init__(self, certificate: Certificate[VertexProof]) -> None:
        proof, problem = certificate.proof, certificate.problem
        checked = independent(read_problem({"problem": canonical_problem(problem)}))
        grid = proof.grid
        own = grid.edges, grid.jumps, grid.near, problem.agents[0].laws, grid.window
        self.steps, self.matrix = Backups(checked, *own), grid.matrix
        with np.errstate(all="ignore"):
            values, given_up = self.steps.at_end()
            self.tables = [(values, given_up)]
            for t in range(problem.horizon - 1, -1, -1):
                values, given_up = self.steps.backup(values, given_up, grid.inputs[grid.laws[t]], t)
                self.tables.append((values, given_up))

    def at(self, states: FloatArray, q: NDArray[np.int64], left: NDArray[np.int64]) -> FloatArray:
        """Return values (M,) at states (M, d) in automaton states with so many steps left; 0 outside of the grid."""
        result, z = np.zeros(len(states)), states.T if self.matrix is None else self.matrix @ states.T
        turning = [k for k, name in enumerate(self.steps.agent.states) if name in self.steps.agent.angles]
        for steps_left in np.unique(left).tolist():
            here, edges = left == steps_left, self.steps.edges_at(len(self.tables) - 1 - steps_left)
            x = np.array(z[:, here])
            for k in turning:
                x[k] = numbers_in(x[k], 0.5 * (edges[k][0] + edges[k][-1]))
            inside = np.all([(axis[0] <= own) & (own <= axis[-1]) for axis, own in zip(edges, x, strict=True)], axis=0)
            values, given_up = self.tables[steps_left]
            read = interpolated(edges, values.reshape(len(values), -1, 1), x, q[here])[0]
            # on an edge no cell on either side may be 0
            places = [
                [np.clip(np.searchsorted(axis, own, side=side) - 1, 0, len(axis) - 2) for side in SIDES]
                for axis, own in zip(edges, x, strict=True)
            ]
            nothing = np.any([given_up[(q[here], *place)] for place in itertools.product(*places)], axis=0)
            result[here] = np.where(inside & ~nothing, read, 0.0)
        return result
