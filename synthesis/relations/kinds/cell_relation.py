"""What relations share: what they lack by default."""

from __future__ import annotations

from typing import Any

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
