"""The noise of an agent along the axes of its grid, which are its states."""

from __future__ import annotations

import numpy as np

from ....envs.systems.agents import AnyAgent
from ....envs.systems.distributions import Gaussian, Law
from .grid import FloatArray


def grid_laws(agent: AnyAgent) -> tuple[Law, ...]:
    """Return the laws of the noise along the grid axes, which are independent there."""
    if agent.laws is not None:
        return agent.laws
    return tuple(Gaussian(float(deviation)) for deviation in np.sqrt(np.diag(agent.noise_covariance)))


def sharpness(agent: AnyAgent) -> FloatArray:
    """Return deviations (d,) of Gaussian noise that moves as little mass, when it is shifted, as the noise at most.

    A shift by ``off`` changes independent noise by ``sum_k off_k * height_k`` in total variation, at most.
    """
    if agent.laws is None:
        return np.asarray(np.sqrt(np.diag(agent.noise_covariance)))
    heights = np.array([law.height for law in agent.laws])
    return 0.39 / (heights * np.sqrt(len(heights)))
