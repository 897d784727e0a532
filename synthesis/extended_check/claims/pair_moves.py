"""How agents move between cells as far as pairs ask, for the check: to lattice points, give or take a reach.

Under the relation ``exact`` means are lattice points. A network leads from a cell to means in a box that the check has
made itself: the lattice point nearest to its middle stands for it, and the reach says how far the box goes beyond it.
Cells then get the largest mass that any mean within reach gives them (docs/theory/pairs.md, "Under networks").
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.special import erfc

from ....envs.systems.agents import AnyAgent, with_expressions, with_matrices
from ...certificates.cell_probabilities import AgentRecord, axis_tables, lost_to_rounding
from ...relations.grids import FloatArray
from ..steps import cell_boxes, execution_of, network_maps, networked_maps

UP, OFF = 1.0 + 1e-13, 4e-15
"""What masses are rounded up by: the complementary error function is accurate to a few units."""


@dataclass(frozen=True, eq=False)
class ExactMoves:
    """Moves of an agent whose means are lattice points; masses are from below, and lack ``loss`` per step."""

    agent: AnyAgent
    part: AgentRecord
    tables: list[FloatArray]

    @property
    def loss(self) -> float:
        """What masses lack, per step."""
        return lost_to_rounding(self.agent, self.part)

    def step(self, t: int, q: int) -> tuple[NDArray[np.integer], FloatArray]:
        """Lattice points (S,) that cells move to, -1 for none, and how far (d,) means are from them."""
        return self.part.points(t, q), np.zeros(len(self.part.lattice))

    def masses(self, reach: FloatArray) -> list[FloatArray]:
        """Masses (Z, S) of cells around lattice points, per axis."""
        return self.tables


@dataclass(frozen=True, eq=False)
class NetworkMoves:
    """Moves of an agent under a network: all masses are from above."""

    agent: AnyAgent
    part: AgentRecord
    loss = 0.0
    known: dict[tuple[int, int], tuple[NDArray[np.integer], FloatArray]] = field(default_factory=dict)
    made: dict[bytes, list[FloatArray]] = field(default_factory=dict)

    def step(self, t: int, q: int) -> tuple[NDArray[np.integer], FloatArray]:
        """Lattice points (S,) that cells move to, -1 for none, and how far (d,) means may be from them."""
        if (t, q) not in self.known:
            self.known[t, q] = self._step(self.part.policy[min(t, len(self.part.policy) - 1), q])
        return self.known[t, q]

    def _step(self, policy: NDArray[np.integer]) -> tuple[NDArray[np.integer], FloatArray]:
        points, reach = np.full(len(policy), -1, dtype=np.int64), np.zeros(len(self.part.lattice))
        for mode in np.unique(policy[policy >= 0]).tolist():
            cells = np.flatnonzero(policy == mode)
            low, high = self._ends(cells, mode)
            index = []
            for k, axis in enumerate(self.part.lattice):
                place = np.rint((0.5 * (low[:, k] + high[:, k]) - axis[0]) / ((axis[-1] - axis[0]) / (len(axis) - 1)))
                index.append(np.clip(place, 0, len(axis) - 1).astype(np.int64))
                at = axis[index[-1]]
                reach[k] = max(reach[k], float(np.max(high[:, k] - at)), float(np.max(at - low[:, k])))
            points[cells] = np.ravel_multi_index(tuple(index), tuple(len(axis) for axis in self.part.lattice))
        return points, reach

    def _ends(self, cells: NDArray[np.int64], mode: int) -> tuple[FloatArray, FloatArray]:
        """Corners (C, d) of boxes around the means from closed cells under a mode."""
        agent, part = self.agent, self.part
        off = execution_of(agent, part, part.relation_of(agent)).mean
        first, last = (corner[cells] for corner in cell_boxes(part))
        if agent.is_affine:
            z, gain, rho = network_maps(with_matrices(agent), part, cells, mode)
        else:
            z, gain, rho = networked_maps(with_expressions(agent), part, (first, last), mode)
        spread = np.einsum("ckj,cj->ck", np.abs(gain), 0.5 * (last - first) * (1.0 + 1e-13)) + rho + off
        return z - spread, z + spread

    def masses(self, reach: FloatArray) -> list[FloatArray]:
        """The largest masses (Z, S) of cells under means within reach of lattice points, per axis."""
        key = reach.tobytes()
        if key not in self.made:
            scales = np.sqrt(2.0 * np.diag(self.agent.noise_covariance))
            self.made[key] = [
                _largest(axis, edges, float(scale), float(most))
                for axis, edges, scale, most in zip(self.part.lattice, self.part.grid.edges, scales, reach, strict=True)
            ]
        return self.made[key]


def _largest(axis: FloatArray, edges: FloatArray, scale: float, reach: float) -> FloatArray:
    """Masses (Z, S) of intervals under the mean within reach of a point that is nearest to their middles."""
    middle = 0.5 * (edges[1:] + edges[:-1])
    at = np.minimum(np.maximum(middle, axis[:, None] - reach), axis[:, None] + reach)
    below, above = (edges[:-1] - at) / scale, (edges[1:] - at) / scale
    right, left = 0.5 * (erfc(below) - erfc(above)), 0.5 * (erfc(-above) - erfc(-below))
    return np.asarray(np.clip(np.where(below > 0.0, right, left) * UP + OFF, 0.0, 1.0))


def moves_of(
    agent: AnyAgent, part: AgentRecord, known: dict[tuple[bytes, ...], list[FloatArray]]
) -> ExactMoves | NetworkMoves:
    """How an agent moves."""
    if "network" in part.relation:
        return NetworkMoves(agent, part)
    return ExactMoves(agent, part, axis_tables(agent, part, known))


def wrong_moves(agent: AnyAgent, part: AgentRecord) -> str:
    """Why nothing is known of how an agent moves between lattice points; empty if it is."""
    if agent.angles:
        return f"agent `{agent.name}` has an angle, whose turns are not in what pairs may spoil"
    if "network" in part.relation:
        return ""
    if part.relation["kind"] != "exact" or part.input_set is not None:
        return f"the relation of agent `{agent.name}` is not exact, so pairs cannot be subtracted"
    return ""
