"""Corners of boxes, which are numbers or expressions in the time `t`, the number of control steps taken.

Corners that move are rounded to twelve decimals, so that they are the same numbers on every machine, whose sines differ
in their last digits; a check that needs more encloses their trees itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ...systems.agents import TIME, Box
from ...systems.arguments import float_array, shown
from ...systems.expressions import Number, Tree, computed, names_in, read_expression

DECIMALS = 12
"""Decimals to which corners that move are rounded."""

Corner = tuple[float | str, ...]
"""Numbers and expressions in `t`, one for each output."""


def read_corners(low: Any, high: Any) -> dict[str, Any]:
    """Return what a region keeps of its corners: numbers, or expressions in the time and their trees."""
    if not (_is_written(low) or _is_written(high)):
        box = Box(low, high)
        return {"low": box.low, "high": box.high, "corners": None}
    corners = _corner(low, "low"), _corner(high, "high")
    if len(corners[0]) != len(corners[1]):
        raise ValueError(f"`high`: expected {len(corners[0])} entries, as `low` has, got {len(corners[1])}")
    trees = tuple(read_ends(corner, name) for corner, name in zip(corners, ("low", "high"), strict=True))
    if any(names_in(tree) for own in trees for tree in own):
        return {"corners": corners, "trees": trees}
    # Expressions of numbers alone are numbers.
    box = Box(*(np.concatenate(computed(own, {})) for own in trees))
    return {"low": box.low, "high": box.high, "corners": None}


def values_over(trees: Sequence[Tree], times: np.ndarray) -> np.ndarray:
    """Return the values (p, n) of expressions at times (n,), rounded, with the same bits for one time and for many."""
    values = {TIME: np.asarray(times, dtype=float)}
    return np.round(np.array([np.broadcast_to(row, len(times)) for row in computed(trees, values)]), DECIMALS)


def _is_written(value: Any) -> bool:
    """Return whether a corner has expressions."""
    return isinstance(value, str) or (isinstance(value, Sequence) and any(isinstance(entry, str) for entry in value))


def _corner(value: Any, name: str) -> Corner:
    """Return numbers and expressions, as they are."""
    if isinstance(value, str) or not isinstance(value, Sequence | np.ndarray) or not len(value):
        raise ValueError(f"`{name}`: expected a list of numbers and expressions in `t`, got {shown(value)}")
    return tuple(
        entry if isinstance(entry, str) else float(float_array([entry], f"{name}[{k}]", (1,), "0.0")[0])
        for k, entry in enumerate(value)
    )


def read_ends(corner: Corner, name: str) -> tuple[Tree, ...]:
    """Return numbers and expressions as trees; ValueError names the entry."""
    trees = []
    for k, entry in enumerate(corner):
        try:
            trees.append(read_expression(entry, (TIME,)) if isinstance(entry, str) else Number(entry))
        except ValueError as error:
            raise ValueError(f"`{name}[{k}]`: {error}") from None
    return tuple(trees)
