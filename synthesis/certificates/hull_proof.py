"""Proofs for convex sets of starts: a path from every corner, and with them one from every start between them.

For a start that is a mixture of the corners, the controller mixes their nominal inputs with the same weights. The
nominal path is then the same mixture of the nominal paths, and every distance to a limit is at least that mixture of
distances: the bound at the worst corner holds everywhere between them (docs/theory/paths.md, "Sets of starts").
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linprog
from scipy.spatial import ConvexHull

from ...envs.problem import Problem
from ..cells import FloatArray
from .archive import Pool, Stored
from .certificate import Certificate
from .digits import significant_up
from .path_proof import AgentPath, AlongPath, PathProof, kept_in
from .proof import Offer, Proof

MANY_STARTS = (
    "a set of starts; it can be checked, and `validate(certificate, initial_state=x)` is about a start in it (on the "
    "command line: `certigym validate HULL --initial-state X`)"
)
"""What certificates of sets of starts answer to whoever asks for one run."""


@dataclass(frozen=True, eq=False, repr=False)
class HullProof(Proof):
    """A bound from every start of one agent in a convex set.

    Its problem has one agent, whose own start counts for the states that are not among ``axes`` alone.

    Parameters
    ----------
    axes : tuple of int
        States that differ between the corners.
    corners : (n, d) array
        Starts.
    inputs : (n, S, m) array
        Nominal inputs of each corner.
    gain : (m, d) array
        Feedback K, the same for all.
    letters, faces : (S + 1, P) arrays
        As in ``PathProof``, the same for all.
    failure : float
        Upper bound on the probability, from any start in the hull, that the task is not satisfied.
    """

    axes: tuple[int, ...]
    corners: FloatArray
    inputs: FloatArray
    gain: FloatArray
    letters: NDArray[np.int8]
    faces: NDArray[np.int64]
    failure: float

    kind = "hull"
    lacks = MappingProxyType(dict.fromkeys((Offer.ONE_START, Offer.VALUES, Offer.OTHER_STARTS), MANY_STARTS))
    bound = "hull"
    gap = None
    rank = 1
    parts = ()

    def begun(self, certificate: Any, start: Any) -> tuple[Any, Any]:
        """Return the certificate along the path from a start of the set, which has a controller of its own."""
        if start is None:
            return certificate, start
        name = certificate.problem.agent_names[0]
        return from_start(certificate, start[name] if isinstance(start, Mapping) and name in start else start), None

    @property
    def lower_bound(self) -> float:
        """Certified lower bound on the probability of the task from every start in the hull, rounded down."""
        return max(0.0, math.nextafter(1.0 - self.failure, 0.0))

    @property
    def method(self) -> str:
        """How the bound was found, in words."""
        return f"nominal paths of {len(self.letters) - 1} steps from {len(self.corners)} corners, and all between them"

    @property
    def about(self) -> dict[str, str]:  # type: ignore[override]
        """What summaries say of it besides: how it may fail."""
        return {"failure": f"at most {significant_up(self.failure, 3)}"}

    def share(self, problem: Problem) -> float:
        """Return the volume of the hull as a share of that of the workspace, over the axes (rounded)."""
        axes, agent = list(self.axes), problem.agents[0]
        corners = self.corners[:, axes]
        # In one dimension, which the library does not know, it is the length between the ends.
        volume = np.ptp(corners) if len(axes) == 1 else ConvexHull(corners).volume
        return float(volume / np.prod((agent.state_high - agent.state_low)[axes]))

    def path(self, inputs: FloatArray) -> PathProof:
        """Return the proof along the path with nominal inputs (S, m)."""
        return PathProof((AgentPath(inputs, self.gain),), self.letters, self.faces, self.failure)

    def written(self, pool: Pool) -> dict[str, Any]:
        """Return the entries of its file."""
        arrays = {name: pool.put(getattr(self, name)) for name in ("letters", "faces", "corners", "inputs", "gain")}
        return {"failure": float(self.failure), "axes": [int(axis) for axis in self.axes], **arrays}

    @classmethod
    def read(cls, problem: Problem, stored: Stored) -> Self:
        """Return the proof in a file; raise ValueError if there is none."""
        failure, letters, faces = kept_in(problem, stored)
        if problem.n_agents != 1:
            raise ValueError("a set of starts is about one agent")
        agent = problem.agents[0]
        corners, inputs, gain = (stored.numbers(stored.entry[name]) for name in ("corners", "inputs", "gain"))
        n = len(corners)
        wanted = (n, agent.n_states), (n, len(letters) - 1, agent.n_inputs), (agent.n_inputs, agent.n_states)
        if (corners.shape, inputs.shape, gain.shape) != wanted or n == 0:
            raise ValueError("its corners and inputs do not fit")
        if not all(np.all(np.isfinite(array)) for array in (corners, inputs, gain)):
            raise ValueError("its corners or inputs are no numbers")
        axes = tuple(int(axis) for axis in stored.entry["axes"])
        return cls(axes, corners, inputs, gain, letters, faces, failure)


def corner(hull: Certificate[HullProof], i: int) -> AlongPath:
    """Return the certificate along the path from corner i of a set of starts."""
    return _begun(hull, hull.proof.corners[i], hull.proof.inputs[i])


def from_start(hull: Certificate[HullProof], start: Any) -> AlongPath:
    """Return the certificate along a path from a start (d,) in a set of starts, whose nominal inputs are mixed.

    It claims what the set claims: ``check`` of the set, or of the certificate that is returned, verifies it.

    Raises
    ------
    ValueError
        If the start is not in the hull.
    """
    corners, agent = hull.proof.corners, hull.problem.agents[0]
    equal = np.vstack([corners.T, np.ones(len(corners))])
    limits: Any = np.append(start, 1.0)
    solved = linprog(np.zeros(len(corners)), A_eq=equal, b_eq=limits, bounds=(0.0, 1.0), method="highs")
    if solved.status != 0:
        raise ValueError("`start`: expected one in the hull of the corners, got one outside; take one nearer")
    weights = np.maximum(solved.x, 0.0)
    mixed = np.tensordot(weights / weights.sum(), hull.proof.inputs, axes=1)  # rounding may leave the box
    return _begun(hull, np.asarray(start, dtype=float), np.clip(mixed, agent.input_low, agent.input_high))


def _begun(hull: Certificate[HullProof], start: FloatArray, inputs: FloatArray) -> AlongPath:
    """Return the certificate along the path from a start, with these nominal inputs."""
    problem = hull.problem.replace(initial_state={hull.problem.agents[0].name: start.tolist()})
    return Certificate(problem, hull.proof.path(inputs), {"relation": "path"})
