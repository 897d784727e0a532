"""What a certificate stores of one agent."""

from __future__ import annotations

import json
from dataclasses import dataclass
from hashlib import sha256
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....envs.systems.agents import AnyAgent
from ....envs.systems.arguments import tree_text
from ...relations.grids import FloatArray, Grid, hat_share, hats, shape_text, spread
from ...relations.kinds import Relation, relation_from

ENCLOSING = ("parts", "cuts", "reach", "blocks")
"""Numbers of relations by which means around a state are enclosed: into how many parts, and how far differences go."""


@dataclass(frozen=True, eq=False, repr=False)
class AgentRecord:
    """What a certificate stores of one agent: grid, relation, lattice, guards' masks on the cells, policy.

    Parameters
    ----------
    grid : Grid
    relation : dict
        Kind and numbers, see ``relations.description``.
    lattice : tuple of (Z_k,) arrays
        Means per axis.
    masks, start_masks : (K, S), (K0, S) bool arrays
        Factors of the guards on the cells, for arriving and for starting in them.
    policy : (T, Q, S) int32 array, or (1, Q, S) for a stationary policy
        Choice of each cell, -1 for none: a lattice point (``exact``), an input or, beyond their number, a lattice point
        (``linear``), or an input (all others).
    menu : (S, A) int32 array or None
        Lattice point that each input of each cell leads to.
    """

    grid: Grid
    relation: dict[str, Any]
    lattice: tuple[FloatArray, ...]
    masks: NDArray[np.bool_]
    start_masks: NDArray[np.bool_]
    policy: NDArray[np.int32]
    input_set: NDArray[np.int32] | None = None

    def __repr__(self) -> str:
        times, states, _ = self.policy.shape
        choices = "lattice points" if self.input_set is None else f"{self.input_set.shape[1]} inputs"
        rows = [
            ("grid", self.grid),
            ("lattice", f"{shape_text(self.lattice_shape)} means"),
            ("policy", f"{times} times, {states} automaton states; choices are {choices}"),
            ("masks", f"{len(self.masks)} for arriving, {len(self.start_masks)} for starting"),
        ]
        return tree_text(f"AgentPart: {self.relation['kind']} relation", rows)

    def relation_of(self, agent: AnyAgent) -> Relation:
        """Return the relation of ``agent`` that is described, its numbers computed anew."""
        return relation_from(self.relation, agent, self.grid)

    @property
    def acting(self) -> dict[str, Any]:
        """What the relation says of inputs: without the numbers by which means are enclosed, on which none depends."""
        enclosing = ENCLOSING if self.relation["kind"] in ("boxes", "linear") else ()
        return {name: entry for name, entry in self.relation.items() if name not in enclosing}

    def sharing_key(self, agent: AnyAgent) -> tuple[object, ...]:
        """Return what the relation of ``agent`` and its motions are made of, apart from cells and policies.

        Agents that differ in none of it may share what is computed from it.
        """
        return (*agent.model_key, json.dumps(self.relation, sort_keys=True))

    def content_digest(self) -> bytes:
        """Return the SHA-256 of cells, lattice, policy and inputs, types and shapes included."""
        digest, inputs = sha256(), [] if self.input_set is None else [self.input_set]
        for array in (*self.grid.edges, *self.lattice, self.policy, *inputs):
            digest.update(f"{array.dtype.str}{array.shape}".encode())
            digest.update(np.ascontiguousarray(array).data)
        return digest.digest()

    def points(self, t: int, q: int) -> NDArray[Any]:
        """Return the lattice point (S,) that each cell leads to at time t in automaton state q; -1 for none."""
        policy = self.policy[min(t, len(self.policy) - 1), q]
        if self.input_set is None:
            return policy
        chosen = np.take_along_axis(self.input_set, np.maximum(policy, 0)[:, None].astype(np.int64), axis=1)[:, 0]
        return np.where(policy < 0, -1, chosen)

    @property
    def is_linear(self) -> bool:
        """Whether factors have values at the corners of cells."""
        return bool(self.relation["kind"] == "linear")

    @property
    def is_additive(self) -> bool:
        """Whether a step takes a sum of factors to the sum of what it takes each to (see ``AgentModel``)."""
        return self.relation["kind"] not in ("boxes", "linear")

    @property
    def n_places(self) -> int:
        """Number of places at which factors have values: the cells S, or their 2^d S corners (``linear``)."""
        return self.grid.n_cells * (2 ** len(self.lattice) if self.is_linear else 1)

    def places_at(self, points: FloatArray) -> tuple[NDArray[np.int64], FloatArray]:
        """Return the places (M, K) of which factors at points (d, M) of the grid are means, and their weights."""
        if self.is_linear:
            return hats(self.grid, points)
        cells = self.grid.cell_of(points)[:, None]
        return cells, np.ones(cells.shape)

    def share(self, low: FloatArray, high: FloatArray) -> FloatArray:
        """Return the share of a box of states, or of a point, in each cell or at each place, up to rounding."""
        return hat_share(self.grid, low, high) if self.is_linear else self.grid.overlap(low, high)

    @property
    def masks_at_start(self) -> NDArray[np.bool_]:
        """``start_masks`` at the places of factors."""
        return spread(self.start_masks, self.grid.shape) if self.is_linear else self.start_masks

    @property
    def lattice_shape(self) -> tuple[int, ...]:
        """Lattice points per axis."""
        return tuple(len(axis) for axis in self.lattice)
