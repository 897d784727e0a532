"""What relations share: what they lack by default, and the means that their boxes are put around."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..grids import FloatArray


class ReadsCells:
    """Relations whose controllers read the cell of the state that they see."""

    has_memory = False
    """Whether controllers remember an abstract state; those that do not read the cell of their own one."""

    is_cell = True
    """Whether related states are those of the same cell."""

    @property
    def network(self) -> Any:
        """The network whose modes are choices; None for all others."""
        return None

    @property
    def matrices(self) -> tuple[Any, FloatArray] | None:
        """The exact relation, or None, and the inputs (A, m) that are choices, where these are all there is to it."""
        return None


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
