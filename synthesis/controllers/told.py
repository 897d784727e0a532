"""What infos tell a certified controller: the true state, the automaton state and the time."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

READING = "reading"
"""Key of infos that only environments with noisy sensors have; a test compares it with theirs."""


def told(infos: Mapping[str, Any] | None, name: str) -> Any:
    """Return the info of an agent if it tells the state, else None.

    Raises
    ------
    ValueError
        If the environment has noisy sensors: the info holds the true state, but the agent does not know it.
    """
    info = infos.get(name) if infos is not None else None
    if info is None:
        return None
    if READING in info:
        raise ValueError(
            f"`infos`: expected those of an environment with exact sensors, got noisy readings for {name!r}; the "
            "certificate is about controllers that see the true states, and says nothing about noisy ones: leave out "
            "`sensor_noise`, or use a learned policy"
        )
    return info if "state" in info else None
