"""One step of a closed loop, with mismatch and saturation.

Actuators saturate: an input beyond the input box acts as the nearest admissible one. Controllers of certificates never
ask for that.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..envs import dynamics as core
from ..envs.dynamics import Dynamics, Worlds
from .loop import Loop
from .mismatch import disturbed


def step(
    loop: Loop, dynamics: Dynamics, worlds: Worlds, inputs: Sequence[NDArray[Any]], normals: Sequence[NDArray[Any]]
) -> tuple[Worlds, NDArray[np.bool_] | None]:
    """The worlds one step later, and whether any agent asked for an inadmissible input (None: nowhere)."""
    beyond = _beyond(dynamics, inputs)
    if loop.mismatch is not None:
        inputs, normals = disturbed(dynamics, loop.mismatch, inputs, normals)
    if loop.mismatch is not None or beyond is not None:
        inputs = _saturated(dynamics, inputs)
    return core.transition(dynamics, worlds, inputs, normals), beyond


def _beyond(dynamics: Dynamics, inputs: Sequence[NDArray[Any]]) -> NDArray[np.bool_] | None:
    """Whether any agent asks for an input outside its box (not a number counts), per world; None if none does."""
    pairs = list(zip(dynamics.blocks, inputs, strict=True))
    if all(_admissible(u, *block.input_range) for block, u in pairs):
        return None
    result = np.zeros(inputs[0].shape[-1], dtype=bool)
    for block, u in pairs:
        result |= ~((block.input_low <= u) & (u <= block.input_high)).all(axis=(0, 1))
    return result if result.any() else None


def _admissible(u: NDArray[Any], low: float, high: float) -> bool:
    """Whether all numbers lie in an interval; not a number lies in none."""
    return bool(low <= u.min()) and bool(u.max() <= high)


def _saturated(dynamics: Dynamics, inputs: Sequence[NDArray[Any]]) -> tuple[NDArray[Any], ...]:
    return tuple(
        np.minimum(np.maximum(u, block.input_low), block.input_high)
        for block, u in zip(dynamics.blocks, inputs, strict=True)
    )
