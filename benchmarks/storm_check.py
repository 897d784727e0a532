"""Bounded reachability of explicit models by the model checker Storm (extra `storm`)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from explicit_product import Explicit

Ends = NDArray[np.float64]


def storm_model(explicit: Explicit) -> object:
    """Return the model in Storm's sparse storage."""
    from stormpy.datastructures import BitVector, SparseMatrixBuilder
    from stormpy.models import SparseDtmc, SparseMdp, SparseModelComponents, StateLabeling

    matrix, n_states = explicit.transitions.tocsr(), len(explicit.goal)
    matrix.sort_indices()
    is_chain = matrix.shape[0] == n_states
    rows = np.repeat(np.arange(matrix.shape[0]), np.diff(matrix.indptr)).tolist()
    groups = [] if is_chain else explicit.first[:-1].tolist()
    shape = {"rows": matrix.shape[0], "columns": n_states, "entries": matrix.nnz}
    if not is_chain:
        shape |= {"has_custom_row_grouping": True, "row_groups": n_states}
    builder = SparseMatrixBuilder[float](**shape)
    builder.add_next_values(rows, matrix.indices.tolist(), matrix.data.tolist(), groups)
    labels = StateLabeling(n_states)
    labels.add_label("goal")
    labels.set_states("goal", BitVector(n_states, np.flatnonzero(explicit.goal).tolist()))
    parts = SparseModelComponents[float](transition_matrix=builder.build(), state_labeling=labels)
    return (SparseDtmc if is_chain else SparseMdp)[float](parts)


def storm_reach_within(model: object, steps: int) -> NDArray[np.float64]:
    """Return the largest probability (states,) to reach the goal within so many steps."""
    import stormpy

    kind = "P" if "Dtmc" in type(model).__name__ else "Pmax"
    formula = stormpy.parse_property(f'{kind}=? [F<={steps} "goal"]')
    result = stormpy.model_checking(model, formula)
    return np.array(result.get_value_vector(), dtype=float)


def storm_intervals(lower: Ends, upper: Ends, goal: NDArray[np.bool_], stop: NDArray[np.bool_]) -> object:
    """Return an interval model (states, choices, states) in Storm's sparse storage.

    Parameters
    ----------
    lower, upper : (N, A, N) arrays
        Ends of the probabilities of each choice. Entries whose upper end is 0 are left out.
    goal, stop : (N,) bool arrays
        States of the goal, and states that are left no more; all choices of these lead back to them.
    """
    import stormpy
    from stormpy.datastructures import BitVector, SparseMatrixBuilder
    from stormpy.models import SparseMdp, SparseModelComponents, StateLabeling

    interval, (n, choices, _) = stormpy.Interval, lower.shape
    kept = [np.argwhere(upper[s] > 0.0) for s in range(n)]
    still = goal | stop
    n_rows = int(np.where(still, 1, choices).sum())
    n_entries = sum(1 if still[s] else len(kept[s]) for s in range(n))
    shape = {"rows": n_rows, "columns": n, "entries": n_entries}
    builder = SparseMatrixBuilder[interval](**shape, has_custom_row_grouping=True, row_groups=n)
    row = 0
    for s in range(n):
        builder.new_row_group(row)
        if still[s]:
            builder.add_next_value(row, s, interval(1.0, 1.0))
            row += 1
            continue
        for a, target in kept[s].tolist():
            builder.add_next_value(row + a, target, interval(float(lower[s, a, target]), float(upper[s, a, target])))
        row += choices
    labels = StateLabeling(n)
    labels.add_label("goal")
    labels.set_states("goal", BitVector(n, np.flatnonzero(goal).tolist()))
    parts = SparseModelComponents[interval](transition_matrix=builder.build(), state_labeling=labels)
    return SparseMdp[interval](parts)


def storm_robust_within(model: object, steps: int) -> NDArray[np.float64]:
    """Return the largest probability (states,) to reach the goal so soon, if the intervals are resolved worst."""
    import stormpy

    formula = stormpy.parse_property(f'Pmax=? [F<={steps} "goal"]')
    worst = stormpy.UncertaintyResolutionMode.ROBUST
    result = stormpy.model_checking(model, formula, uncertainty_resolution_mode=worst)
    return np.array(result.get_value_vector(), dtype=float)
