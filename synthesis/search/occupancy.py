"""Alive mass forward in time, as sums of products.

``mu_t,q`` is the sub-distribution of the abstract joint state at time t with the automaton in state q and the task not
yet decided. It starts as a product over agents, and a step under decentralised policies keeps it a sum of products:
push every factor through its kernel, multiply by the masks of a guard (THEORY section 5). It weighs what a decision
matters at a cell (``ascent``) and what a term contributes at the start (pruning).

Terms may be dropped; ``leftover`` then bounds the dropped mass from above, so that contributions have upper bounds too.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..models import AgentModel, StepPolicy
from ..values import Guards, Occupancy, Terms, beside, compress, distinct, empty, merge_rows, take, term_masses


def push(
    occupancy: Occupancy,
    policies: Sequence[Sequence[StepPolicy]],
    guards: Guards,
    masks: Sequence[NDArray],
    models: Sequence[AgentModel],
    tolerance: float,
    max_rank: int,
) -> Occupancy:
    """Alive mass one step later under ``policies[i][q]``, the target of each cell of agent i in automaton state q.

    Terms are dropped from the smallest on while they amount to at most ``tolerance`` of the mass at hand, or until
    ``max_rank`` terms are left per state.
    """
    terms = occupancy.terms
    n_agents, n_states = len(models), len(terms.index)
    rows = _pair(guards, terms)
    factors: list[NDArray] = []
    for i, model in enumerate(models):
        factors.append(_step(model, policies[i], terms.factors[i], masks[i], rows, guards, i))
        _, rows[:, 2 + i] = distinct(rows[:, 2 + i])
    guard, index = rows[:, 0], rows[:, 2:].copy()
    target = guards.target[guard].astype(np.int64)
    kept, index, _ = merge_rows(factors, index, target)
    mass = term_masses(factors, index[kept])
    chosen, dropped = _largest(mass, target[kept], tolerance, max_rank)
    kept = kept[chosen]
    for i in range(n_agents):
        factors[i], index[kept, i] = compress(factors[i], index[kept, i])
    per_state = tuple(index[kept[target[kept] == q]] for q in range(n_states))
    return Occupancy(Terms(tuple(factors), per_state), (occupancy.leftover + dropped) * (1 + 1e-12))


def _pair(guards: Guards, terms: Terms) -> NDArray[np.int64]:
    """Rows (guard, term, factor of each agent) of every guard with every term of its source state."""
    counts = np.array([len(terms.index[q]) for q in guards.source], dtype=np.int64)
    n_agents = len(terms.factors)
    rows = np.zeros((int(counts.sum()), 2 + n_agents), dtype=np.int64)
    rows[:, 0] = np.repeat(np.arange(len(counts)), counts)
    if len(rows):
        rows[:, 1] = np.concatenate([np.arange(n) for n in counts])
        rows[:, 2:] = np.concatenate([terms.index[q] for q in guards.source])
    return rows


def _step(
    model: AgentModel,
    policies: Sequence[StepPolicy],
    factors: NDArray,
    masks: NDArray,
    rows: NDArray,
    guards: Guards,
    i: int,
) -> NDArray:
    """Push and mask the distinct (state, factor, mask) combinations of agent i; renumbers its column of ``rows``."""
    column = 2 + i
    n_factors, n_masks = max(1, len(factors)), max(1, len(masks))
    key = guards.source[rows[:, 0]].astype(np.int64) * n_factors + rows[:, column]
    pushes, pushed_row = distinct(key)
    state, factor = np.divmod(pushes, n_factors)
    pushed = empty((len(pushes), model.n_cells), factors)
    for q in set(state.tolist()):
        here = state == q
        pushed[beside(here, pushed)] = model.kernel.push(take(factors, factor[here]), model.choices.points(policies[q]))
    key = pushed_row * n_masks + guards.mask[rows[:, 0], i]
    rows[:, column] = key
    source, mask = np.divmod(distinct(key)[0], n_masks)
    return take(pushed, source) * take(model.residents.beside(masks, pushed), mask)


def _largest(
    mass: NDArray[np.float64], state: NDArray[np.int64], tolerance: float, max_rank: int
) -> tuple[NDArray[np.int64], float]:
    """Rows to keep, in order, and the mass of the others."""
    order = np.argsort(mass, kind="stable")
    small = np.cumsum(mass[order]) <= tolerance * mass.sum()
    drop = np.zeros(len(mass), dtype=bool)
    drop[order[small]] = True
    drop |= mass == 0.0
    for q in np.unique(state):
        own = np.flatnonzero((state == q) & ~drop)
        if len(own) > max_rank:
            drop[own[np.argsort(mass[own], kind="stable")[: len(own) - max_rank]]] = True
    return np.flatnonzero(~drop), float(mass[drop].sum())
