"""How bounded disturbances behave in a simulation: by a name, or by a function that is asked at every step.

Certificates hold for everything that disturbances may do without knowing the noise of the step. A simulation needs one
behaviour:

- ``zero``: every disturbance is the number of its interval that is nearest to 0;
- ``random``: uniform in its interval, at every step anew;
- ``periodic``: a sine of ``PERIOD`` steps between the ends, each disturbance a quarter of a turn after the one before;
- a function (`Against`), such as a greedy one, which sees states and inputs but no noise.
"""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
from scipy.special import ndtr

from ..agents import Agent

BEHAVIOURS = ("zero", "random", "periodic")
"""Behaviours that have a name."""

PERIOD = 8
"""Steps of a turn: each quarter of it is two steps, so that both ends are met."""


class Against(Protocol):
    """A behaviour that is asked at every step; it must not know the noise of the step."""

    def __call__(self, dynamics: Any, worlds: Any, inputs: Any) -> tuple[np.ndarray | None, ...]:
        """Return disturbances (k, n, M) per block of the dynamics; None for blocks without any."""


Behaviour = str | Against


def checked_behaviour(value: Any) -> Behaviour:
    """Return a behaviour, or raise ValueError."""
    if value in BEHAVIOURS or callable(value):
        return value
    raise ValueError(f"`disturbance`: expected one of {', '.join(BEHAVIOURS)} or a function, got {value!r:.60}")


def named_disturbances(agent: Agent, behaviour: str, time: Any, normals: np.ndarray) -> np.ndarray:
    """Return disturbances (k, *S) of an agent by the name of a behaviour: the same bits for one world and for many.

    Parameters
    ----------
    agent : Agent
    behaviour : str
        One of ``BEHAVIOURS``.
    time : int, or array that broadcasts to (*S)
        Control steps taken.
    normals : np.ndarray, shape (k, *S)
        Standard normal numbers; only "random" reads them.
    """
    extra = (1,) * (normals.ndim - 1)
    low, high = (end.reshape(-1, *extra) for end in (agent.disturbance_low, agent.disturbance_high))
    if behaviour == "random":
        share = ndtr(normals)
    elif behaviour == "periodic":
        turns = np.asarray(time) / PERIOD + 0.25 * np.arange(len(low)).reshape(-1, *extra)
        share = 0.5 + 0.5 * np.sin(2.0 * np.pi * np.broadcast_to(turns, normals.shape).copy())
    else:
        return np.broadcast_to(np.clip(0.0, low, high), normals.shape)
    # Rounding must not carry a disturbance out of its interval.
    return np.asarray(np.clip(low + (high - low) * share, low, high))
