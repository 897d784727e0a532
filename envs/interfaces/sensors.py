"""Noisy sensors: what agents see are readings of the states, each with a Gaussian error of its own.

A state component x with the standard deviation s is read as x + s z, z standard normal, drawn anew for every
observation. A state is read once per step, and all who look at it see the same reading. Motion, labels, rewards
and verdicts are those of the true states; the automaton state and the time are known exactly.

The errors come from a generator that is spawned from the one of the environment, so the motion for a seed is the same
with and without noisy sensors.

A certificate is about controllers that see the true states. So infos of noisy environments hold the key `READING`, at
which certified controllers and shields refuse.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ..tasks.problem import Problem

READING = "reading"
"""Key of infos that only environments with noisy sensors have: what was read in place of the state."""


class Sensors:
    """Sensors of all state components of a problem.

    Parameters
    ----------
    problem : Problem
    noise : float or sequence of D floats
        Standard deviation of the errors, in the units of the states: one for all components, or one for each component
        of the joint state. 0: exact sensors, which draw nothing.

    Raises
    ------
    ValueError
        If the noise is negative, not finite or of another length.
    """

    def __init__(self, problem: Problem, noise: Any) -> None:
        self.deviations = checked_noise(problem, noise)
        self.is_exact = not self.deviations.any()
        self._source: np.random.Generator | None = None
        self._rng: np.random.Generator | None = None

    def readings(self, states: np.ndarray, source: np.random.Generator) -> np.ndarray:
        """Return what is read of joint states, both (M, D); `source` is the generator of the environment."""
        if self.is_exact:
            return states
        # An environment that is reset with a seed has a new generator, and so have its sensors.
        if self._rng is None or source is not self._source:
            self._source, self._rng = source, source.spawn(1)[0]
        return states + self.deviations * self._rng.standard_normal(states.shape)


def checked_noise(problem: Problem, value: Any) -> np.ndarray:
    """Return the standard deviations (D,) of sensors, or raise ValueError."""
    try:
        deviations = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        deviations = np.array(np.nan)
    if deviations.shape not in ((), (problem.n_states,)) or not (np.isfinite(deviations) & (deviations >= 0.0)).all():
        raise ValueError(
            f"`sensor_noise`: expected a standard deviation of at least 0, or one for each of the {problem.n_states} "
            f"components of the joint state, got {value!r}"
        )
    return np.broadcast_to(deviations, (problem.n_states,))
