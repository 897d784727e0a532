"""The tube along a nominal path: where agents are meant to be, and how far noise takes them from there.

It is drawn, and nothing is certified from it: what is certified are the inequalities of the path.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import brentq
from scipy.special import ndtri

from ...envs.agents import AnyAgent, Majorant, Tail
from ..cells import FloatArray
from ..controllers import covariances_along
from .path_certificate import PathCertificate
from .product import ProductCertificate

KEPT = 0.99
"""Probability with which what is drawn stays in its tube at all times, as long as no input is cut off."""

NORMAL = Majorant(0.0, 1.0, Tail.NORMAL)
"""Noise that has the tails of its own deviations."""


@dataclass(frozen=True, eq=False)
class Tube:
    """Nominal values of one or two linear functions of the joint state, and how they vary.

    Parameters
    ----------
    middle : (S + 1, k) array
        Nominal values at times 0 to S.
    covariances : (S + 1, k, k) array
        Covariances of the deviations (rounded); along a nonlinear path those of the linear ones.
    is_linear : bool
        Whether these are all deviations. Along a nonlinear path dynamics drift from them: certified, and not drawn.
    noise : Majorant
        What is above the noise of all agents: its ``deviation`` as a multiple of theirs, and what is ``lost`` per step.
    """

    middle: FloatArray
    covariances: FloatArray
    is_linear: bool = True
    noise: Majorant = NORMAL

    @property
    def radius(self) -> float:
        """Radius in deviations of the intervals or ellipses that linear deviations keep with probability .99 (rounded).

        All times together: they are symmetric and convex, and by the Gaussian correlation inequality it is enough that
        each of the S is kept with the S-th root of that. Noise of other laws has tails by its exponential moments, and
        the two sides of all axes and times are added up.
        """
        steps, axes = max(1, len(self.middle) - 1), self.middle.shape[1]
        if self.noise.tail != Tail.NORMAL:
            share = (1.0 - KEPT - steps * self.noise.lost) / (2.0 * steps * axes)
            return self.noise.deviation * float(np.sqrt(axes)) * _distance(share, self.noise.tail)
        each = KEPT ** (1.0 / steps)
        if axes == 1:
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


def _distance(share: float, tail: Tail) -> float:
    """Return how many deviations are exceeded with a probability of at most ``share``, by exponential moments."""
    if tail == Tail.LIGHT:
        return float(np.sqrt(-2.0 * np.log(share)))
    root = brentq(lambda r: np.log(0.5 * (1.0 + r)) + 1.0 - r - np.log(share), 1.0, 10.0 - 2.0 * np.log(share))
    return float(np.sqrt(0.5 * (root * root - 1.0)))


def _above(agents: Sequence[AnyAgent]) -> Majorant:
    """Return what is above the noise of all of these agents, in units of its own deviations."""
    pairs = [(law.majorant, law.std) for agent in agents for law in agent.laws or ()]
    known = [(found, std) for found, std in pairs if found is not None]
    tail = max((found.tail for found, _ in known), default=Tail.NORMAL)
    widest = max((found.deviation / std for found, std in known if std > 0.0), default=1.0)
    return Majorant(0.0, widest, tail, sum(found.lost for found, _ in known))


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
    steps = min(paths[i][0].n_steps for i in moved)
    middle = np.zeros((steps + 1, len(rows)))
    covariances = np.zeros((steps + 1, len(rows), len(rows)))
    for i in moved:
        part, k = paths[i]
        agent, own, path = problem.agents[i], rows[:, problem.columns[i]], part.paths[k]
        nominal = part.controller.nominal[k]
        middle += nominal[: steps + 1] @ own.T
        deviations = covariances_along(agent, nominal, path.inputs, path.gains)[: steps + 1]
        covariances += np.einsum("kd,tde,le->tkl", own, deviations, own)
    is_linear = all(part.paths[k].states is None for part, k in (paths[i] for i in moved))
    return Tube(middle, covariances, is_linear, _above([problem.agents[i] for i in moved]))


def _paths_of(certificate: Any) -> dict[int, tuple[PathCertificate, int]]:
    """Return, for every agent with a nominal path, the certificate along it and the agent's number there."""
    if isinstance(certificate, PathCertificate):
        return {i: (certificate, i) for i in range(certificate.problem.n_agents)}
    if not isinstance(certificate, ProductCertificate):
        return {}
    pairs = zip(certificate.problem.groups, certificate.parts, strict=True)
    along = ((group, part) for group, part in pairs if isinstance(part, PathCertificate))
    return {i: (part, k) for group, part in along for k, i in enumerate(group.agents)}  # type: ignore[misc]
