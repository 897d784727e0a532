"""Convex sets of starts with one certificate: a certificate along a path for every corner, and for all between them.

For a start that is a mixture of the corners, the controller mixes their nominal inputs with the same weights. The
nominal path is then the same mixture of the nominal paths, and every distance to a limit is at least that mixture of
distances: the bound at the worst corner holds everywhere between them (docs/theory/paths.md, "Sets of starts").
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linprog
from scipy.spatial import ConvexHull

from ...envs.agents import tree_text
from ...envs.problem import Problem
from ..cells import FloatArray
from .archive import Pool
from .path_certificate import AgentPath, PathCertificate, kept_in


@dataclass(frozen=True, eq=False, repr=False)
class StartHull:
    """A convex set of starts of one agent, from all of which the task is satisfied with a certified probability.

    Parameters
    ----------
    problem : Problem
        Of one agent; its own start counts for the states that are not among ``axes`` alone.
    axes : tuple of int
        States that differ between the corners.
    corners : (n, d) array
        Starts.
    inputs : (n, S, m) array
        Nominal inputs of each corner.
    gain : (m, d) array
        Feedback K, the same for all.
    letters, faces : (S + 1, P) arrays
        As in ``PathCertificate``, the same for all.
    failure : float
        Upper bound on the probability, from any start in the hull, that the task is not satisfied.
    """

    problem: Problem
    axes: tuple[int, ...]
    corners: FloatArray
    inputs: FloatArray
    gain: FloatArray
    letters: NDArray[np.int8]
    faces: NDArray[np.int64]
    failure: float

    def __repr__(self) -> str:
        rows = [
            ("corners", str(len(self.corners))),
            ("share", f"{self.share:.4f} of the workspace"),
            ("failure", f"at most {self.failure:.3g}"),
        ]
        return tree_text(f"StartHull of {self.problem.name!r}", rows)

    def written(self, pool: Pool) -> dict[str, Any]:
        """Return the entries of its file."""
        arrays = {name: pool.put(getattr(self, name)) for name in ("letters", "faces", "corners", "inputs")}
        return {
            "failure": float(self.failure),
            "hull": {"axes": [int(axis) for axis in self.axes], "gain": pool.put(self.gain), **arrays},
        }

    gap = None

    @property
    def lower_bound(self) -> float:
        """Certified lower bound on the probability of the task from every start in the hull, rounded down."""
        return max(0.0, math.nextafter(1.0 - self.failure, 0.0))

    @property
    def fingerprint(self) -> str:
        """Fingerprint of the problem."""
        return self.problem.fingerprint

    @property
    def share(self) -> float:
        """Volume of the hull as a share of that of the workspace, over the axes (rounded)."""
        axes, agent = list(self.axes), self.problem.agents[0]
        corners = self.corners[:, axes]
        # In one dimension, which the library does not know, it is the length between the ends.
        volume = np.ptp(corners) if len(axes) == 1 else ConvexHull(corners).volume
        return float(volume / np.prod((agent.state_high - agent.state_low)[axes]))

    def corner(self, i: int) -> PathCertificate:
        """Return the certificate along the path from corner i."""
        return self._from(self.corners[i], self.inputs[i])

    def at(self, start: FloatArray) -> PathCertificate:
        """Return the certificate along a path from a start (d,) in the hull, whose nominal inputs are mixed.

        It claims what the hull claims: ``check`` of the hull, or of the certificate that is returned, verifies it.

        Raises
        ------
        ValueError
            If the start is not in the hull.
        """
        n = len(self.corners)
        equal = np.vstack([self.corners.T, np.ones(n)])
        solved = linprog(np.zeros(n), A_eq=equal, b_eq=np.append(start, 1.0), bounds=(0.0, 1.0), method="highs")
        if solved.status != 0:
            raise ValueError("`start`: expected one in the hull of the corners, got one outside; take one nearer")
        weights = np.maximum(solved.x, 0.0)
        agent = self.problem.agents[0]
        mixed = np.tensordot(weights / weights.sum(), self.inputs, axes=1)  # rounding may leave the box
        return self._from(np.asarray(start, dtype=float), np.clip(mixed, agent.input_low, agent.input_high))

    def _from(self, start: FloatArray, inputs: FloatArray) -> PathCertificate:
        problem = self.problem.replace(initial_state={self.problem.agents[0].name: start.tolist()})
        path = AgentPath(inputs, self.gain)
        return PathCertificate(problem, (path,), self.letters, self.faces, self.failure, {"relation": "path"})


def hull_in(header: dict[str, Any], arrays: dict[str, NDArray[Any]]) -> StartHull:
    """Return the set of starts that a header and its arrays describe; raise ValueError if they do not."""
    entry = header["hull"]
    problem, failure, letters, faces = kept_in(header, entry, arrays)
    if problem.n_agents != 1:
        raise ValueError("a set of starts is about one agent")
    agent = problem.agents[0]
    corners, inputs, gain = (
        np.asarray(arrays[str(int(entry[name]))], dtype=float) for name in ("corners", "inputs", "gain")
    )
    n = len(corners)
    wanted = (n, agent.n_states), (n, len(letters) - 1, agent.n_inputs), (agent.n_inputs, agent.n_states)
    if (corners.shape, inputs.shape, gain.shape) != wanted or n == 0:
        raise ValueError("its corners and inputs do not fit")
    if not all(np.all(np.isfinite(array)) for array in (corners, inputs, gain)):
        raise ValueError("its corners or inputs are no numbers")
    axes = tuple(int(axis) for axis in entry["axes"])
    return StartHull(problem, axes, corners, inputs, gain, letters, faces, failure)
