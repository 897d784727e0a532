"""What is true of an ellipsoid of errors, decided from its matrices alone: no solver, every comparison restrictive.

``E = {e : e'D e <= epsilon^2}`` is invariant, ``M E + W inside E`` for a box W, if ``(M e + v)'D(M e + v) <=
epsilon^2`` for all e in E and every vertex v of W. With ``D = L L'``, ``N = L'M L'^-1`` and ``b = L'v / epsilon`` this
says: ``|N z + b|^2 <= 1`` whenever ``|z| <= 1``. By the S-lemma, which loses nothing here, it holds if and only if

    [ lambda I - N'N      -N'b          ]
    [ -b'N                1 - lambda - b'b ]

is positive semidefinite for some lambda >= 0 (docs/theory/relations.md, "Ellipsoids"). Any lambda that passes is a
proof, so that the search for it need not be trusted: the smallest eigenvalue is concave in lambda, and a golden section
finds the best one. Opposite vertices share their lambda, so that half of them suffice.
"""

from __future__ import annotations

import itertools

import numpy as np
from scipy.linalg import solve_triangular
from scipy.special import erf

from ..grids import FloatArray

UNIT = 2.0**-53
"""Unit roundoff u of double precision."""

LARGEST_CONDITION = 1e6
"""Ellipsoids are refused if their matrix, scaled to a unit diagonal, is worse conditioned than this."""

UPWARDS = 1.0 + 1e-9 / 4
"""Factor on support and distance: above their rounding, and below the 1e-9 by which relations are enlarged, so that a
right relation passes."""

SECTIONS = 80
"""Steps of the golden section: it ends at the precision of double numbers."""


def ellipsoid_factor(shape: FloatArray) -> FloatArray | None:
    """Return L (d, d) with ``D = L L'``; None if D is not symmetric, positive definite and well conditioned."""
    if shape.ndim != 2 or shape.shape[0] != shape.shape[1] or not np.all(np.isfinite(shape)):
        return None
    if not np.array_equal(shape, shape.T) or np.any(np.diag(shape) <= 0):
        return None
    scale = np.sqrt(np.diag(shape))
    eigenvalues = np.linalg.eigvalsh(shape / np.outer(scale, scale))
    if eigenvalues[0] * LARGEST_CONDITION < eigenvalues[-1]:
        return None
    return np.asarray(np.linalg.cholesky(shape))


def ellipsoid_is_invariant(shape: FloatArray, epsilon: float, closed: FloatArray, half: FloatArray) -> bool:
    """Return whether ``closed E + W inside E`` was proved, W being the box ``|beta| <= half``.

    Parameters
    ----------
    shape : (d, d) array
        D, in grid coordinates.
    epsilon : float
    closed : (d, d) array
        ``A + B K - F``.
    half : (d,) array
        Half widths of W, positive.

    Notes
    -----
    The margin on the smallest eigenvalue is a thousand units of the size that enters the products, the factorisation of
    D and the eigenvalue: far more than these can be off by.
    """
    factor = ellipsoid_factor(shape)
    if factor is None or not epsilon > 0:
        return False
    # A unit diagonal makes the margin independent of the units of the states.
    scale = np.sqrt(np.diag(shape))
    plain = factor / scale[:, None]
    inverse = solve_triangular(plain, np.eye(len(plain)), lower=True)
    inner = scale[:, None] * closed / scale
    moved = plain.T @ inner @ inverse.T
    size = np.linalg.norm(plain) * np.linalg.norm(inner) * np.linalg.norm(inverse)
    margin = float(1000.0 * UNIT * ((1.0 + size) ** 2 + np.linalg.norm(inverse) ** 2))
    # One of each pair of opposite vertices: the first component is positive.
    for signs in itertools.product((1.0, -1.0), repeat=len(half) - 1):
        vertex = plain.T @ (scale * half * np.array([1.0, *signs])) / epsilon
        if not _is_mapped_inside(moved, vertex, margin):
            return False
    return True


def _is_mapped_inside(moved: FloatArray, shift: FloatArray, margin: float) -> bool:
    """Return whether ``|moved z + shift| <= 1`` on the unit ball was proved, with eigenvalues above ``margin``."""
    if not (np.all(np.isfinite(moved)) and np.all(np.isfinite(shift))):
        return False
    d = len(shift)
    square, cross, corner = moved.T @ moved, moved.T @ shift, 1.0 - float(shift @ shift)

    def smallest(multiplier: float) -> float:
        """Return the smallest eigenvalue of the matrix of the S-lemma."""
        matrix = np.empty((d + 1, d + 1))
        matrix[:d, :d] = multiplier * np.eye(d) - square
        matrix[:d, d] = matrix[d, :d] = -cross
        matrix[d, d] = corner - multiplier
        return float(np.linalg.eigvalsh(matrix)[0])

    # Golden section over lambda in [0, 1]: the last diagonal entry rules out larger ones.
    low, high, ratio = 0.0, 1.0, 0.5 * (np.sqrt(5.0) - 1.0)
    left, right = high - ratio * (high - low), low + ratio * (high - low)
    at_left, at_right = smallest(left), smallest(right)
    for _ in range(SECTIONS):
        if max(at_left, at_right) >= margin:
            return True
        if at_left < at_right:
            low, left, at_left = left, right, at_right
            right = low + ratio * (high - low)
            at_right = smallest(right)
        else:
            high, right, at_right = right, left, at_left
            left = high - ratio * (high - low)
            at_left = smallest(left)
    return False


def ellipsoid_support(shape: FloatArray, epsilon: float, rows: FloatArray) -> FloatArray:
    """Return upper bounds (n,) on ``rows @ e`` over E, rows (n, d): ``epsilon sqrt(row D^-1 row')``."""
    factor = np.linalg.cholesky(shape)
    scaled = solve_triangular(factor, rows.T, lower=True)
    return np.asarray(epsilon * np.sqrt(np.sum(scaled**2, axis=0)) * UPWARDS)


def ellipsoid_failure(shape: FloatArray, epsilon: float, coupling: FloatArray, variances: FloatArray) -> float:
    """Return an upper bound on the probability that the coupling fails, over all errors of E.

    It is ``2 Phi(r / 2) - 1`` with r the largest ``|Sigma^(-1/2) F e|``, an eigenvalue of ``F' Sigma^-1 F`` against D
    (docs/theory/relations.md, "Ellipsoids"), and 1 if an axis that F uses has no noise.
    """
    if not np.any(coupling):
        return 0.0
    if np.any(variances <= 0):
        return 1.0
    scaled = coupling / np.sqrt(variances)[:, None]
    rows = solve_triangular(np.linalg.cholesky(shape), scaled.T, lower=True).T
    distance = epsilon * float(np.sqrt(np.max(np.linalg.eigvalsh(rows @ rows.T)))) * UPWARDS
    return min(1.0, float(erf(distance / (2.0 * np.sqrt(2.0)))) * (1.0 + 1e-14))
