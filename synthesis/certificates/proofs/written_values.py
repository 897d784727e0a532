"""Entries of a file for what certificates on cells hold: agents, value trees, and how trains were rounded."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..cell_probabilities import AgentRecord
from ..value_functions import MergeLog, Merges, Rounding, Terms
from .archive import Pool


def put_agent(pool: Pool, part: AgentRecord) -> dict[str, Any]:
    """Return the entry of an agent, its arrays put into the pool."""
    return {
        "edges": [pool.put(a) for a in part.grid.edges],
        "lattice": [pool.put(a) for a in part.lattice],
        "relation": part.relation,
        "masks": pool.put(part.masks),
        "start_masks": pool.put(part.start_masks),
        "law": pool.put(part.policy),
        "menu": None if part.input_set is None else pool.put(part.input_set),
    }


def put_terms(pool: Pool, terms: Terms) -> dict[str, Any]:
    """Return the entry of a value tree, its arrays put into the pool."""
    return {"factors": [pool.put(a) for a in terms.factors], "index": [pool.put(a) for a in terms.index]}


def put_rounding(pool: Pool, rounding: Rounding) -> dict[str, Any]:
    """Return the entry of how trains were rounded, its arrays put into the pool."""
    visited = [
        None if cells is None else [pool.put(numbers.astype(np.int32)) for numbers in cells]
        for cells in rounding.visited
    ]
    return {"tolerance": rounding.tolerance, "visited": visited}


def _rests(merges: Merges) -> list[NDArray[Any]]:
    """Return the remainders of unions as one array, where there are any."""
    return [merges.rests] if np.any(merges.rests) else []


def put_skeleton(pool: Pool, step: MergeLog) -> list[list[int]]:
    """Return the entry of one time of the tree, its arrays put into the pool."""
    states = zip(step.origin, step.merges, step.kept, strict=True)
    small = np.int32
    return [
        [pool.put(a.astype(small)) for a in (origin, merges.into, merges.absorbed, merges.agent, kept, *_rests(merges))]
        for origin, merges, kept in states
    ]
