"""Alive mass forward in time, as sums of products.

``mu_t,q`` is the sub-distribution of the abstract joint state at time t with the automaton in state q and the task not
yet decided. It starts as a product over agents, and a step under decentralised policies keeps it a sum of products:
push every factor through its kernel, then multiply by the masks of a guard (docs/theory/tree.md, "Dropping terms"). It
says how much a decision matters at a cell (``ascent``) and what a term contributes at the start (pruning).

Terms may be dropped; ``leftover`` then bounds the dropped mass from above, so that contributions have upper bounds too.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from ..models import JointModel, Policies, StepPolicy
from ..values import Guards, Occupancy, Terms, beside, compress, distinct, empty, merge_rows, take, term_masses, to_host
from .limits import Limits

MANY_ALIKE = 2
"""Agents with one model from which equal numbers are looked for: comparing takes less than pushing."""

NOTHING = 1e-100
"""Masses below this are set to 0: weights that decide nothing, and products with them are denormal numbers, which take
a hundred times as long."""


def forward(joint: JointModel, policies: Policies, start: Occupancy, limits: Limits) -> list[Occupancy]:
    """Return the alive mass at times 0 .. T - 1, from below, as arrays of numpy."""
    on_device = forward_on_device(joint, policies, start, limits)
    return [Occupancy(put_everywhere(occupancy.terms, to_host), occupancy.leftover) for occupancy in on_device]


def put_everywhere(terms: Terms, put: Callable[[NDArray], NDArray]) -> Terms:
    """Return the same terms with all factors put elsewhere."""
    return Terms(tuple(put(factors) for factors in terms.factors), terms.index)


def forward_on_device(joint: JointModel, policies: Policies, start: Occupancy, limits: Limits) -> list[Occupancy]:
    """Return the alive mass at times 0 .. T - 1, from below, on the device."""
    occupancies = [Occupancy(put_everywhere(start.terms, joint.put), start.leftover)]
    for t in range(joint.horizon - 1):
        step = [policy[t] for policy in policies]
        occupancies.append(push(occupancies[-1], step, joint, limits.mass, limits.rank))
    return occupancies


def nowhere(joint: JointModel) -> Occupancy:
    """Return an occupancy without any mass."""
    rows = np.zeros((0, len(joint.models)), dtype=np.int64)
    return Occupancy(Terms(tuple(np.zeros((0, n)) for n in joint.n_cells), (rows,) * joint.n_states), 0.0)


def push(
    occupancy: Occupancy,
    policies: Sequence[Sequence[StepPolicy]],
    joint: JointModel,
    tolerance: float,
    max_rank: int,
) -> Occupancy:
    """Return the alive mass one step later: from below, its ``leftover`` being an upper bound on what is missing.

    Parameters
    ----------
    occupancy : Occupancy
    policies : sequence of sequence of (S_i,) int32 arrays
        ``policies[i][q]`` is the choice of each cell of agent i in automaton state q.
    joint : JointModel
    tolerance : float
        Share of the mass at hand that may be dropped, the smallest terms first.
    max_rank : int
        Most terms per state; further ones are dropped, too.
    """
    terms, guards = occupancy.terms, joint.guards
    n_agents, n_states = len(joint.models), len(terms.index)
    # Pair every guard with every term of its source, push and mask the factors, and unite what is equal.
    rows = _pair(guards, terms)
    factors: list[NDArray] = []
    # Agents with one model whose numbers are the same, too, are pushed once.
    users, known = Counter(id(model) for model in joint.models), dict[object, tuple[NDArray, NDArray[np.int64]]]()
    for i, model in enumerate(joint.models):
        key: object = i
        if users[id(model)] >= MANY_ALIKE:
            shared = (joint.masks[i], *policies[i], to_host(terms.factors[i]), rows[:, 2 + i])
            key = id(model), *(array.tobytes() for array in shared), guards.mask[:, i].tobytes()
        if key not in known:
            pushed = _step(joint, i, policies[i], terms.factors[i], rows)
            known[key] = pushed, distinct(rows[:, 2 + i])[1]
        pushed, rows[:, 2 + i] = known[key]
        factors.append(pushed)
    guard, index = rows[:, 0], rows[:, 2:].copy()
    target = guards.target[guard].astype(np.int64)
    remaining, index, _ = merge_rows(factors, index, target)
    # Drop the smallest terms; their mass is added to what is missing already.
    mass = term_masses(factors, index[remaining])
    chosen, dropped = _largest(mass, target[remaining], tolerance, max_rank)
    remaining = remaining[chosen]
    for i in range(n_agents):
        factors[i], index[remaining, i] = compress(factors[i], index[remaining, i])
    per_state = tuple(index[remaining[target[remaining] == q]] for q in range(n_states))
    missing = dropped + NOTHING * sum(joint.n_cells)
    return Occupancy(Terms(tuple(factors), per_state), (occupancy.leftover + missing) * (1 + 1e-12))


def _pair(guards: Guards, terms: Terms) -> NDArray[np.int64]:
    """Return rows (guard, term, factor of each agent) of every guard with every term of its source state."""
    counts = np.array([len(terms.index[q]) for q in guards.source], dtype=np.int64)
    n_agents = len(terms.factors)
    rows = np.zeros((int(counts.sum()), 2 + n_agents), dtype=np.int64)
    rows[:, 0] = np.repeat(np.arange(len(counts)), counts)
    if len(rows):
        rows[:, 1] = np.concatenate([np.arange(n) for n in counts])
        rows[:, 2:] = np.concatenate([terms.index[q] for q in guards.source])
    return rows


def _step(
    joint: JointModel, i: int, policies: Sequence[StepPolicy], factors: NDArray, rows: NDArray[np.int64]
) -> NDArray:
    """Push and mask the distinct (state, factor, mask) combinations of agent i; renumber its column of ``rows``."""
    model, guards, masks = joint.models[i], joint.guards, joint.masks[i]
    column = 2 + i
    n_factors, n_masks = max(1, len(factors)), max(1, len(masks))
    # The policy depends on the state, the push on state and factor: push each such pair once.
    key = guards.source[rows[:, 0]].astype(np.int64) * n_factors + rows[:, column]
    pushes, pushed_row = distinct(key)
    state, factor = np.divmod(pushes, n_factors)
    pushed = empty((len(pushes), model.n_cells), factors)
    for q in set(state.tolist()):
        here = state == q
        pushed[beside(here, pushed)] = model.kernel.push(take(factors, factor[here]), model.choices.points(policies[q]))
    pushed[pushed < NOTHING] = 0.0
    key = pushed_row * n_masks + guards.mask[rows[:, 0], i]
    rows[:, column] = key
    source, mask = np.divmod(distinct(key)[0], n_masks)
    return take(pushed, source) * take(model.residents.beside(masks, pushed), mask)


def _largest(
    mass: NDArray[np.float64], state: NDArray[np.int64], tolerance: float, max_rank: int
) -> tuple[NDArray[np.int64], float]:
    """Return the rows to keep, in order, and the mass of the others."""
    order = np.argsort(mass, kind="stable")
    small = np.cumsum(mass[order]) <= tolerance * mass.sum()
    drop = np.zeros(len(mass), dtype=bool)
    drop[order[small]] = True
    drop |= mass == 0.0
    for q in np.unique(state):
        left = np.flatnonzero((state == q) & ~drop)
        if len(left) > max_rank:
            drop[left[np.argsort(mass[left], kind="stable")[: len(left) - max_rank]]] = True
    return np.flatnonzero(~drop), float(mass[drop].sum())
