"""Bounded reachability of explicit models by the model checker Storm (extra `storm`)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from explicit_product import Explicit


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
