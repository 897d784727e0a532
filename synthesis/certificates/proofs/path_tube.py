"""The tube along a nominal path: where agents are meant to be, and how far noise takes them from there.

It is drawn, and nothing is certified from it: what is certified are the inequalities of the path.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import ndtri

from ....envs.systems.distributions import Gaussian
from ...relations.grids import FloatArray
from ..controllers import covariances_along
from .certificate import member_agents, members_of, path_under
from .path_proof import AlongPath

KEPT = 0.99
"""Probability with which what is drawn stays in its tube at all times, as long as no input is cut off."""


@dataclass(frozen=True, eq=False)
class Tube:
    """Nominal values of one or two linear functions of the joint state, and how they vary.

    Parameters
    ----------
    middle : (S + 1, k) array
        Nominal values at times 0 to S.
    covariances : (S + 1, k, k) array
        Covariances of the deviations (rounded); where dynamics are not linear those of the linear ones.
    is_linear : bool
        Whether these are all deviations. Dynamics that are not linear drift from them: certified, and not drawn.
    is_normal : bool
        Whether all noise is normal, so that linear deviations keep within the radius as often as ``KEPT`` says.
    """

    middle: FloatArray
    covariances: FloatArray
    is_linear: bool = True
    is_normal: bool = True

    @property
    def radius(self) -> float:
        """Radius in deviations of the intervals or ellipses that normal ones keep with probability .99 (rounded).

        All times together: they are symmetric and convex, and by the Gaussian correlation inequality it is enough that
        each of the S is kept with the S-th root of that.
        """
        each = KEPT ** (1.0 / max(1, len(self.middle) - 1))
        if self.middle.shape[1] == 1:
            return float(ndtri(0.5 + 0.5 * each))
        return float(np.sqrt(-2.0 * np.log1p(-each)))

    def half_widths(self) -> FloatArray:
        """Return half the widths (S + 1, k) of the tube along each function."""
        return self.radius * np.sqrt(np.maximum(np.diagonal(self.covariances, axis1=1, axis2=2), 0.0))

    def outlines(self, points: int = 48) -> FloatArray:
        """Return points (S + 1, points, 2) on the ellipses of a tube of two functions."""
        angles = 2.0 * np.pi * np.arange(points) / points
        circle = np.stack([np.cos(angles), np.sin(angles)])
        # Symmetric roots exist for singular covariances as well, which Cholesky factors do not.
        values, vectors = np.linalg.eigh(self.covariances)
        roots = np.einsum("tij,tj->tij", vectors, np.sqrt(np.maximum(values, 0.0)))
        return np.asarray(self.middle[:, None, :] + self.radius * np.einsum("tij,jp->tpi", roots, circle))


def tube_along(certificate: Any, rows: FloatArray) -> Tube | None:
    """Return the tube of linear functions (k, D) of the joint state; None if these agents follow no nominal path.

    Parameters
    ----------
    certificate : Certificate of any kind
    rows : (k, D) array
        What is drawn: one row over time, or two on a map.
    """
    paths = _paths_of(certificate)
    problem = certificate.problem
    moved = [i for i, columns in enumerate(problem.columns) if np.any(rows[:, columns])]
    if not moved or any(i not in paths for i in moved):
        return None
    # Independent tasks may have paths of different lengths: what is drawn ends with the shortest.
    steps = min(paths[i][0].proof.n_steps for i in moved)
    middle = np.zeros((steps + 1, len(rows)))
    covariances = np.zeros((steps + 1, len(rows), len(rows)))
    for i in moved:
        part, k = paths[i]
        agent, own, path = problem.agents[i], rows[:, problem.columns[i]], part.proof.paths[k]
        nominal = part.controller.nominal[k]
        middle += nominal[: steps + 1] @ own.T
        deviations = covariances_along(agent, nominal, path.inputs, path.gains)[: steps + 1]
        covariances += np.einsum("kd,tde,le->tkl", own, deviations, own)
    is_linear = all(problem.agents[i].is_affine and paths[i][0].proof.networks is None for i in moved)
    laws = [law for i in moved for law in problem.agents[i].laws or ()]
    return Tube(middle, covariances, is_linear, all(isinstance(law, Gaussian) for law in laws))


def _paths_of(certificate: Any) -> dict[int, tuple[AlongPath, int]]:
    """Return, for every agent with a nominal path, the certificate along it and the agent's number there."""
    pairs = zip(member_agents(certificate), members_of(certificate), strict=True)
    return {i: (member, k) for agents, member in pairs if path_under(member) is member for k, i in enumerate(agents)}
