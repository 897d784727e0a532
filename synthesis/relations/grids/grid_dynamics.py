"""The dynamics of an agent in the coordinates of its grid, ``x = coordinates @ x_grid``."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ....envs.systems.agents import AnyAgent, LinearAgent
from ....envs.systems.distributions import Gaussian, Law
from .grid import FloatArray


@dataclass(frozen=True, eq=False)
class GridDynamics:
    """``x_grid' = A x_grid + B u + offset + w``, w with a covariance.

    Parameters
    ----------
    A, B : (d, d), (d, m) arrays
    offset : (d,) array
    covariance : (d, d) array
        Of the noise; diagonal up to rounding where the coordinates were chosen for that.
    inverse : (d, d) array
        From state to grid coordinates.
    is_lawful : bool
        Whether the noise has other laws than the normal one.
    """

    A: FloatArray
    B: FloatArray
    offset: FloatArray
    covariance: FloatArray
    inverse: FloatArray
    is_non_gaussian: bool


def grid_laws(agent: AnyAgent, coordinates: FloatArray) -> tuple[Law, ...]:
    """Return the laws of the noise along the grid axes, which are independent there."""
    if agent.laws is not None:
        return agent.laws
    return tuple(Gaussian(float(deviation)) for deviation in np.sqrt(np.diag(grid_covariance(agent, coordinates))))


def sharpness(agent: AnyAgent, coordinates: FloatArray) -> FloatArray:
    """Return deviations (d,) of Gaussian noise that moves as little mass, when it is shifted, as the noise at most.

    A shift by ``off`` changes independent noise by ``sum_k off_k * height_k`` in total variation, at most.
    """
    if agent.laws is None:
        return np.asarray(np.sqrt(np.diag(grid_covariance(agent, coordinates))))
    heights = np.array([law.height for law in agent.laws])
    return 0.39 / (heights * np.sqrt(len(heights)))


def grid_covariance(agent: AnyAgent, coordinates: FloatArray) -> FloatArray:
    """Return the covariance (d, d) of the noise of any agent in grid coordinates (exact up to rounding)."""
    if agent.laws is not None and np.array_equal(coordinates, agent.noise_axes):
        return np.diag([law.std**2 for law in agent.laws])
    inverse = np.linalg.inv(coordinates)
    return np.asarray(inverse @ agent.noise_covariance @ inverse.T)


def in_grid_coordinates(agent: LinearAgent, coordinates: FloatArray) -> GridDynamics:
    """Return the dynamics of ``agent`` in grid coordinates (exact up to rounding)."""
    inverse = np.linalg.inv(coordinates)
    return GridDynamics(
        A=inverse @ agent.A @ coordinates,
        B=inverse @ agent.B,
        offset=inverse @ agent.offset,
        covariance=grid_covariance(agent, coordinates),
        inverse=inverse,
        is_non_gaussian=agent.laws is not None,
    )
