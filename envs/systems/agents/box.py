"""Axis-parallel boxes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ..arguments import box_text, float_array, for_all_axes, read_only, shown


@dataclass(frozen=True, eq=False, init=False, repr=False)
class Box:
    """An axis-parallel box with finite corners (exact). Its users say whether its faces belong to it.

    Attributes
    ----------
    low, high : np.ndarray, shape (d,)
        Corners, read-only float64. `low < high` on every axis, or `low <= high` for a box made with `allow_flat`.

    Raises
    ------
    ValueError
        If a corner is not finite, the lengths differ, or the corners are not in order.

    Examples
    --------
    >>> Box([-1.0, 0.0], [1.0, 4.0]).center
    array([0., 2.])
    """

    low: np.ndarray
    high: np.ndarray

    def __init__(
        self,
        low: Any,
        high: Any,
        *,
        allow_flat: bool = False,
        names: tuple[str, str] = ("low", "high"),
        length: int | None = None,
    ) -> None:
        # An example of the right length, for the errors of `float_array`.
        example = f"[{', '.join(['0.0'] * (length or 1))}]"
        for name, corner in zip(names, (low, high), strict=True):
            if corner is None:
                raise ValueError(f"`{name}` is missing; give one number for each axis, such as {example}")
        low, high = for_all_axes(low, length), for_all_axes(high, length)
        object.__setattr__(self, "low", float_array(low, names[0], (length,), example))
        object.__setattr__(self, "high", float_array(high, names[1], (self.low.size,), example))
        # Name the first axis on which the corners are not in order.
        wrong = self.low > self.high if allow_flat else self.low >= self.high
        if wrong.any():
            axis = int(np.argmax(wrong))
            relation = "at most" if allow_flat else "less than"
            raise ValueError(
                f"`{names[0]}`: expected numbers {relation} `{names[1]}`, got {shown(float(self.low[axis]))} and "
                f"{shown(float(self.high[axis]))} on axis {axis}; exchange or correct the two"
            )

    def __setstate__(self, state: dict[str, Any]) -> None:
        for key, value in state.items():
            object.__setattr__(self, key, read_only(value))  # a pickled array comes back writable

    def __repr__(self) -> str:
        return f"Box({box_text(self.low, self.high)})"

    @classmethod
    def point(cls, x: Any, name: str = "point", length: int | None = None) -> Box:
        """Return the box that holds the single point `x`, shape (d,)."""
        return cls(x, x, allow_flat=True, names=(name, name), length=length)

    @property
    def dimension(self) -> int:
        """Number of axes d."""
        return int(self.low.size)

    @property
    def center(self) -> np.ndarray:
        """Midpoint, shape (d,), rounded to nearest."""
        return 0.5 * self.low + 0.5 * self.high

    @property
    def half_width(self) -> np.ndarray:
        """Half the edge lengths, shape (d,), rounded to nearest."""
        return 0.5 * self.high - 0.5 * self.low

    @property
    def is_point(self) -> bool:
        """Whether every edge has length zero."""
        return bool((self.low == self.high).all())
