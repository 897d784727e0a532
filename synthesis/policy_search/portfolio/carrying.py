"""Policies carried over from coarse cells to finer ones that do about the same (starts of a search, no guarantee)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...abstraction.models import Abstraction, AgentModel, Policies


def carried_over(coarse: Abstraction, fine: Abstraction, policies: Policies) -> Policies:
    """Return policies on finer cells that do what those on coarser cells did, under the same relations."""
    triples = zip(coarse.models, fine.models, policies, strict=True)
    return tuple(_carried(before, after, policy) for before, after, policy in triples)


def _carried(before: AgentModel, after: AgentModel, policy: NDArray[np.int32]) -> NDArray[np.int32]:
    """Return the policy (T, Q, S') of one agent."""
    cell = before.grid.cell_of(after.grid.centres.T)
    return after.choices.carried(before.choices, policy[..., cell])
