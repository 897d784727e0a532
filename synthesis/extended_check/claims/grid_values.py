"""Values of a grid of vertices at every time: backups once more, of which all are kept.

They are lower bounds like the claim, by its theorem (``vertex_grids.backups``), of the problem in the checker's form.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...certificates.proofs import Certificate, VertexProof, canonical_problem
from ...checker import read_problem
from ...relations.grids import FloatArray
from ..vertex_grids import Backups, independent, numbers_in


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
            # on an edge the least of what is said on either side
            ways = itertools.product(("right", "left"), repeat=len(edges))
            values, given_up = self.tables[steps_left]
            least = np.minimum.reduce([_read(values, given_up, edges, x, q[here], way) for way in ways])
            result[here] = np.where(inside, least, 0.0)
        return result


def _read(
    values: FloatArray,
    given_up: NDArray[np.bool_],
    edges: tuple[FloatArray, ...],
    x: FloatArray,
    q: NDArray[np.int64],
    sides: Sequence[Any],
) -> FloatArray:
    """Return multilinear interpolations (M,) at states (d, M), of states on edges in the cells on these sides."""
    places, shares = list[NDArray[np.int64]](), list[FloatArray]()
    for axis, own, side in zip(edges, x, sides, strict=True):
        place = np.clip(np.searchsorted(axis, own, side=side) - 1, 0, len(axis) - 2)
        places.append(place)
        shares.append(np.clip((own - axis[place]) / (axis[place + 1] - axis[place]), 0.0, 1.0))
    result = np.zeros(x.shape[1])
    for corner in itertools.product((0, 1), repeat=len(edges)):
        weight = np.prod([s if up else 1.0 - s for up, s in zip(corner, shares, strict=True)], axis=0)
        result += weight * values[(q, *(place + up for up, place in zip(corner, places, strict=True)))]
    return np.where(given_up[(q, *places)], 0.0, result)
