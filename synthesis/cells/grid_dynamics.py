"""The dynamics of an agent in the coordinates of its grid, ``x = coordinates @ x_grid``."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...envs.agents import AnyAgent, LinearAgent
from .grid import FloatArray


@dataclass(frozen=True, eq=False)
class GridDynamics:
    """``x_grid' = A x_grid + B u + offset + w``, ``w ~ N(0, covariance)``.

    Parameters
    ----------
    A, B : (d, d), (d, m) arrays
    offset : (d,) array
    covariance : (d, d) array
        Of the noise; diagonal up to rounding where the coordinates were chosen for that.
    inverse : (d, d) array
        From state to grid coordinates.
    """

    A: FloatArray
    B: FloatArray
    offset: FloatArray
    covariance: FloatArray
    inverse: FloatArray


def grid_covariance(agent: AnyAgent, coordinates: FloatArray) -> FloatArray:
    """Return the covariance (d, d) of the noise of any agent in grid coordinates (exact up to rounding)."""
    inverse = np.linalg.inv(coordinates)
    return np.asarray(inverse @ agent.noise_covariance @ inverse.T)


def in_grid_coordinates(agent: LinearAgent, coordinates: FloatArray) -> GridDynamics:
    """Return the dynamics of ``agent`` in grid coordinates (exact up to rounding)."""
    inverse = np.linalg.inv(coordinates)
    return GridDynamics(
        A=inverse @ agent.A @ coordinates,
        B=inverse @ agent.B,
        offset=inverse @ agent.offset,
        covariance=inverse @ agent.noise_covariance @ inverse.T,
        inverse=inverse,
    )
