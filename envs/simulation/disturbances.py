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

from ..systems.backends import double, is_host, namespace, special

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


def named_disturbances(low: Any, high: Any, behaviour: str, time: Any, normals: Any) -> Any:
    """Return disturbances (k, *S) of an agent by the name of a behaviour: the same bits for one world and for many.

    Parameters
    ----------
    low, high : array, shape (k,) followed by axes of length 1
        Ends of their intervals.
    behaviour : str
        One of ``BEHAVIOURS``.
    time : int, or array that broadcasts to (*S)
        Control steps taken.
    normals : np.ndarray, shape (k, *S)
        Standard normal numbers; only "random" reads them.
    """
    xp = namespace(normals)
    if behaviour == "random":
        share = special(normals).ndtr(normals)
    elif behaviour == "periodic":
        # numpy's loops, and with them the last bits, are those of contiguous arrays.
        rows = [xp.broadcast_to(double(time) / PERIOD + 0.25 * k, normals.shape[1:]) for k in range(len(low))]
        share = 0.5 + 0.5 * xp.sin(2.0 * np.pi * xp.stack(rows))
    else:
        return xp.broadcast_to(xp.maximum(xp.minimum(xp.zeros_like(low), high), low), normals.shape)
    # Rounding must not carry a disturbance out of its interval.
    result = xp.maximum(xp.minimum(low + (high - low) * share, high), low)
    return np.asarray(result) if is_host(result) else result
