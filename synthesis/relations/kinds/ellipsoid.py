"""Ellipsoid relation: a fixed part of the error may be paid for in probability.

Error ``e = x - xhat``, interface ``u = uhat + K e``, noise coupling ``what = w + F e``, everything in grid coordinates:

    e' = (A + B K - F) e + beta,    beta in W (half the largest cell, plus what snapping adds),
    E = {e : e'D e <= epsilon^2},   (A + B K - F) E + W  inside  E,
    delta = sup over E of 2 Phi(|Sigma^(-1/2) F e| / 2) - 1  =  2 Phi(r / 2) - 1,

with r^2 = epsilon^2 times the largest generalised eigenvalue of ``F' Sigma^-1 F`` against D (docs/theory/relations.md,
"Ellipsoids"). F = 0 gives delta = 0. The price: abstract inputs lie in U less K E (support ``epsilon sqrt(K_j D^-1
K_j')`` of input j), and labels and workspace shrink by the box around E. That box serves margins only; it need not be
invariant.

D, K and F come from ``ellipsoid_search`` (a solver of linear matrix inequalities). Nothing here needs a solver, nor
does anything that reads or checks a certificate. Source: van Huijgevoort and Haesaert, "Similarity quantification for
linear stochastic systems: a coupling compensator approach", Automatica 144, 2022 (arXiv 2007.09052), with its
compensator F; feedback K on the error is added here.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ....envs.systems.agents import LinearAgent
from ..grids import FloatArray, Grid, RelationRefused, in_grid_coordinates
from .coupled import CoupledRelation, coupling_failure
from .rounding import error_rounding, feedback_rounding, sizes_of
from .tube import ENLARGEMENT, disturbance_of, input_grid, refuse_rounding


@dataclass(frozen=True, eq=False)
class Ellipsoid:
    """A set of errors ``e'D e <= epsilon^2`` with the gains that keep errors in it, in grid coordinates.

    Parameters
    ----------
    shape : (d, d) array
        D, symmetric positive definite.
    epsilon : float
        With D scaled as ``ellipsoid_search`` does it, the largest distance of related outputs, in output units.
    feedback, coupling : (m, d), (d, d) arrays
        K and F.
    """

    shape: FloatArray
    epsilon: float
    feedback: FloatArray
    coupling: FloatArray

    def support(self, rows: FloatArray) -> FloatArray:
        """Return upper bounds (n,) on ``rows @ e`` over the set, rows (n, d)."""
        spread = rows @ np.linalg.solve(self.shape, rows.T)
        return np.asarray(self.epsilon * np.sqrt(np.maximum(np.diag(spread), 0.0)) * ENLARGEMENT)


def ellipsoid_relation(
    agent: LinearAgent,
    grid: Grid,
    coordinates: FloatArray,
    ellipsoid: Ellipsoid,
    inputs: FloatArray | None = None,
    snap: FloatArray | None = None,
    delta: float | None = None,
) -> CoupledRelation:
    """Return the relation of an agent and its finite model for a given ellipsoid; its margins are upper bounds.

    Whether the ellipsoid is invariant is not decided here (see ``ellipsoid_is_invariant``).

    Parameters
    ----------
    agent : LinearAgent
    grid : Grid
        Cells in grid coordinates.
    coordinates : (d, d) array
        Grid coordinates to state.
    ellipsoid : Ellipsoid
    inputs : (A, m) array, optional
        Abstract inputs; default: a grid over the reduced input box whose steps move the mean by cells.
    snap : (d,) array, optional
        Half lattice spacings that means are rounded by; default 0.
    delta : float, optional
        A failure probability above that of the ellipsoid, to be used in its place.

    Returns
    -------
    CoupledRelation
        Margins and delta are upper bounds.

    Raises
    ------
    ValueError
        If the inputs are used up, the noise of an axis that F uses is 0, or ``delta`` is smaller than what F costs.
    """
    moves = in_grid_coordinates(agent, coordinates)
    B, variances = moves.B, np.diag(moves.covariance).copy()
    sizes = sizes_of(agent, coordinates)
    reserve = ellipsoid.support(ellipsoid.feedback) + feedback_rounding(sizes, ellipsoid.feedback)
    rounding = error_rounding(sizes, ellipsoid.feedback, ellipsoid.coupling)
    refuse_rounding(agent, disturbance_of(grid, snap), rounding)
    low, high = agent.input_box.low + reserve, agent.input_box.high - reserve
    if np.any(low > high):
        raise RelationRefused(
            f"agent `{agent.name}`: expected an ellipsoid whose input reserve fits into `input_low`, `input_high`, got "
            f"a reserve of {reserve.tolist()}; ask for more `cells` or a larger `delta`"
        )
    # A claim below what F costs would be false; one above it is sound.
    least = _failure(agent, ellipsoid, variances)
    if delta is not None and not least <= delta <= 1:
        raise RelationRefused(f"`delta`: expected a number from {least:.7g} (what F costs) to 1, got {delta!r}")
    widths = np.array([float(np.max(np.diff(edges))) for edges in grid.edges])
    return CoupledRelation(
        kind="ellipsoid",
        A=moves.A,
        B=B,
        drift=moves.offset,
        covariance=variances,
        feedback=ellipsoid.feedback,
        coupling=ellipsoid.coupling,
        reach=ellipsoid.support(np.eye(len(coordinates))),
        state_reach=ellipsoid.support(coordinates),
        delta=least if delta is None else float(delta),
        inputs=input_grid(low, high, B, widths) if inputs is None else inputs,
        input_low=agent.input_box.low,
        input_high=agent.input_box.high,
        coordinates=coordinates,
        snap=np.zeros(len(coordinates)) if snap is None else snap,
        shape=ellipsoid.shape,
        epsilon=ellipsoid.epsilon,
    )


def _failure(agent: LinearAgent, ellipsoid: Ellipsoid, variances: FloatArray) -> float:
    """Return an upper bound on delta: the longest whitened shift of the noise is an eigenvalue of F D^-1 F'."""
    if not np.any(ellipsoid.coupling):
        return 0.0
    if np.any(variances <= 0):
        raise RelationRefused(
            f"agent `{agent.name}`: a coupling F needs a positive definite `noise_covariance`, got a singular one; "
            "give every state some noise or ask for `delta` = 0"
        )
    scaled = ellipsoid.coupling / np.sqrt(variances)[:, None]
    largest = float(np.max(np.linalg.eigvalsh(scaled @ np.linalg.solve(ellipsoid.shape, scaled.T))))
    return coupling_failure(ellipsoid.epsilon * float(np.sqrt(max(largest, 0.0))) * ENLARGEMENT)
