"""What relations share that read states in grid coordinates."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np

from ..cells import FloatArray


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

    @cached_property
    def has_state_coordinates(self) -> bool:
        """Whether grid coordinates are the state itself."""
        return bool(np.array_equal(self.coordinates, np.eye(len(self.coordinates))))
