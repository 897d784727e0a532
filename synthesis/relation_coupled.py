"""Relations in which the controller remembers the abstract state (``paper``, ``tube`` and ``ellipsoid``).

Error ``e = x - xhat`` in grid coordinates, interface ``u = uhat + K e``, noise coupling ``what = w + F e``:

    e' = (A + B K - F) e + beta,      |beta| <= half a cell (+ half a lattice spacing where means are snapped).

A set E with ``(A + B K - F) E + beta inside E`` gives the relation ``x - xhat in E``; what bounds it, why it is
invariant, and how likely the coupling fails is the business of ``relation_paper``, ``relation_tube`` and
``relation_ellipsoid``.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from .relation_exact import apply

FloatArray = NDArray[Any]


@dataclass(frozen=True, eq=False)
class CoupledRelation:
    """Interface and coupling between an agent and its finite model, in grid coordinates.

    Parameters
    ----------
    kind : str
        ``"paper"``, ``"tube"`` or ``"ellipsoid"``.
    A, B : (d, d), (d, m) arrays
    drift : (d,) array
        Affine term.
    covariance : (d,) array
        Variances of the noise along the grid axes.
    feedback, coupling : (m, d), (d, d) arrays
        K and F.
    reach : (d,) array
        Half widths of the box around E.
    state_reach : (d,) array
        Half widths of the box around E in state coordinates, for labels.
    delta : float
        Upper bound on the probability, per step, that the coupling fails.
    inputs : (A, m) array
        Abstract inputs uhat, all in U less K E.
    input_low, input_high : (m,) arrays
        Input box.
    coordinates : (d, d) array
        Grid coordinates to state.
    is_cell : bool
        Whether related states lie in the same cell.
    snap : (d,) array
        Half lattice spacings that means may be rounded by.
    shape : (d, d) array or None
        D of an ellipsoid ``E = {e'D e <= epsilon^2}``; None where E is judged by the box around it.
    epsilon : float
        Radius of the ellipsoid; 0 where there is none.
    """

    kind: str
    A: FloatArray
    B: FloatArray
    drift: FloatArray
    covariance: FloatArray
    feedback: FloatArray
    coupling: FloatArray
    reach: FloatArray
    state_reach: FloatArray
    delta: float
    inputs: FloatArray
    input_low: FloatArray
    input_high: FloatArray
    coordinates: FloatArray
    is_cell: bool = False
    snap: FloatArray = field(default_factory=lambda: np.zeros(1))
    shape: FloatArray | None = None
    epsilon: float = 0.0

    @property
    def has_state_coordinates(self) -> bool:
        """Whether grid coordinates are the state itself."""
        return bool(np.array_equal(self.coordinates, np.eye(len(self.coordinates))))

    @property
    def arrays(self) -> tuple[FloatArray, ...]:
        """All numbers, for comparing relations."""
        return (self.A, self.B, self.drift, self.covariance, self.feedback, self.coupling, self.reach, self.inputs,
                self.input_low, self.input_high, self.coordinates, np.array([self.delta, self.epsilon]),
                np.zeros((0, 0)) if self.shape is None else self.shape)  # fmt: skip

    def to_grid(self, states: FloatArray) -> FloatArray:
        """Grid coordinates (d, ...) of states (d, ...), a new array."""
        if self.has_state_coordinates:
            return np.array(states, dtype=float)
        return apply(np.linalg.inv(self.coordinates), states)

    def means(self, centres: FloatArray) -> FloatArray:
        """(S, A, d) mean of the abstract successor of each cell centre (S, d) under each input."""
        return (centres @ self.A.T + self.drift)[:, None, :] + (self.inputs @ self.B.T)[None]

    def related(self, error: FloatArray) -> NDArray[np.bool_]:
        """Whether errors (d, ...) lie in the ellipsoid, or in the box around E, which is E for scalar agents.

        The last digits are forgiven: labels and inputs allow for a set larger by ``1e-9``.
        """
        if self.shape is not None:
            return np.asarray(np.sum(error * apply(self.shape, error), axis=0) <= self.epsilon**2 * (1 + 1e-12))
        reach = self.reach.reshape(-1, *[1] * (error.ndim - 1)) * (1 + 1e-12)
        return np.asarray(np.all(np.abs(error) <= reach, axis=0))


def coupling_failure(distance: float) -> float:
    """Upper bound on the total variation distance of two standard normal laws whose means are ``distance`` apart.

    ``2 Phi(distance / 2) - 1``, rounded up.

    Examples
    --------
    >>> round(coupling_failure(0.005), 7)
    0.0019947
    """
    if distance == 0.0:
        return 0.0
    return min(1.0, (1.0 - 2.0 * float(ndtr(-0.5 * distance))) * (1 + 1e-12) + 1e-15)


def couple(whitened: FloatArray, move: FloatArray, uniform: FloatArray) -> FloatArray:
    """Standard normal noise (d, ...) of the abstract system, equal to ``whitened + move`` as often as can be.

    Maximal coupling by reflection: ``whitened + move`` is accepted with probability ``min(1, phi(whitened + move) /
    phi(whitened))``, otherwise the noise is mirrored at 0 along ``move``.
    """
    along = np.sum(whitened * move, axis=0)
    length = np.sum(move * move, axis=0)
    accepted = np.log(np.maximum(uniform, 1e-300)) <= -(along + 0.5 * length)
    mirrored = whitened - 2.0 * move * (along / np.where(length > 0, length, 1.0))
    return np.where(accepted, whitened + move, mirrored)
