"""What relations share that read states in grid coordinates, and the means that their boxes are put around."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..grids import FloatArray
from .rows import product, rows_of


class ReadsCoordinates:
    """States read in ``coordinates`` (d, d), which lead from grid coordinates to the state."""

    coordinates: FloatArray

    has_memory = False
    """Whether controllers remember an abstract state; those that do not read the cell of their own one."""

    is_cell = True
    """Whether related states are those of the same cell."""

    @property
    def network(self) -> Any:
        """The network whose modes are choices; None for all others."""
        return None

    def to_grid(self, states: FloatArray) -> FloatArray:
        """Return the grid coordinates (d, ...) of states (d, ...) as a new array."""
        if self.has_state_coordinates:
            return np.array(states, dtype=float)
        return np.tensordot(np.linalg.inv(self.coordinates), states, axes=(1, 0))

    @property
    def matrices(self) -> tuple[Any, FloatArray] | None:
        """The exact relation, or None, and the inputs (A, m) that are choices, where these are all there is to it."""
        return None

    @cached_property
    def has_state_coordinates(self) -> bool:
        """Whether grid coordinates are the state itself."""
        return bool(np.array_equal(self.coordinates, np.eye(len(self.coordinates))))


class Unsteered:
    """What means share that are under inputs alone, with noise that is the same everywhere."""

    def scales(self, low: FloatArray, high: FloatArray, input_set: FloatArray) -> tuple[FloatArray, FloatArray] | None:
        """Return None: the noise is the same everywhere."""
        return None

    def steered(
        self, choices: NDArray[np.intp], points: FloatArray, centres: FloatArray, inputs: FloatArray, beside: Any
    ) -> FloatArray:
        """Return inputs (m, ...) of choices (...) as they are: none steers."""
        return inputs


class ReadsByRows(ReadsCoordinates):
    """States read row by row: the same bits in a batch and for one state."""

    def to_grid(self, states: FloatArray) -> FloatArray:
        """Return the grid coordinates (d, ...) of states (d, ...) as a new array."""
        if self.has_state_coordinates:
            return np.array(states, dtype=float)
        return product(rows_of(np.linalg.inv(self.coordinates)), states)
