"""Policies carried over from coarse cells to finer ones that do about the same (starts of a search, no guarantee)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from ..models import Abstraction, AgentModel, CornerChoices, Policies, StepPolicy, TargetWindows
from ..relations import BoxRelation, CoupledRelation


def carried_over(coarse: Abstraction, fine: Abstraction, policies: Policies) -> Policies:
    """Return policies on finer cells that do what those on coarser cells did, under the same relations."""
    triples = zip(coarse.models, fine.models, policies, strict=True)
    return tuple(_carried(before, after, policy) for before, after, policy in triples)


def _carried(before: AgentModel, after: AgentModel, policy: NDArray[np.int32]) -> NDArray[np.int32]:
    """Return the policy (T, Q, S') of one agent."""
    old, new = before.choices, after.choices
    cell = before.grid.cell_of(after.grid.centres.T)
    choices = policy[..., cell]
    if isinstance(old, TargetWindows) and isinstance(new, TargetWindows):
        return _each_time(lambda chosen: _targets(old, new, chosen), choices)
    if isinstance(old, CornerChoices) and isinstance(new, CornerChoices) and old.windows and new.windows:
        # Menus are the same on all grids; targets are those nearest.
        first, coarse, fine = old.n_inputs, old.windows, new.windows
        aims = _each_time(lambda chosen: _targets(coarse, fine, chosen), np.where(choices < first, -1, choices - first))
        aimed = np.where(aims >= 0, aims + new.n_inputs, new.resting_choice)
        return np.where((choices < 0) | (choices >= first), aimed, choices).astype(np.int32)
    if isinstance(after.relation, CoupledRelation | BoxRelation):
        # Which inputs are offered, and with which feedback, may depend on the cells.
        alike = after.relation.nearest_choices(before.relation)  # type: ignore[arg-type]  # of one kind on all cells
        choices = np.where(choices >= 0, alike[np.maximum(choices, 0)], -1)
    # Menus of linear cells are the same on all grids.
    return np.where(choices >= 0, choices, new.resting_choice).astype(np.int32)


def _each_time(carry: Callable[[StepPolicy], StepPolicy], choices: NDArray[np.int32]) -> NDArray[np.int32]:
    """Return choices (T, Q, S') carried over, one time and automaton state after the other to spare memory."""
    carried = np.empty_like(choices)
    for t, q in np.ndindex(choices.shape[:2]):
        carried[t, q] = carry(choices[t, q])
    return carried


def _targets(old: TargetWindows, new: TargetWindows, choices: StepPolicy) -> StepPolicy:
    """Return the admissible targets (S',) nearest to coarse targets (S',)."""
    index = np.unravel_index(np.maximum(choices, 0), old.shape)
    nearest = np.empty((len(choices), len(new.lattice)), dtype=np.int64)
    for k, (axis, coarse) in enumerate(zip(new.lattice, old.lattice, strict=True)):
        target = coarse[index[k]]
        after = np.clip(np.searchsorted(axis, target), 1, len(axis) - 1)
        nearest[:, k] = after - (target - axis[after - 1] < axis[after] - target)
    clipped = np.clip(nearest, new.low, np.maximum(new.high - 1, new.low))
    flat = np.ravel_multi_index(tuple(np.clip(clipped, 0, np.array(new.shape) - 1).T), new.shape)
    fits = (choices >= 0) & np.all(new.low < new.high, axis=1)
    fits &= new.admissible(np.arange(len(flat)), flat)
    return np.where(fits, flat, new.resting_choice).astype(np.int32)
