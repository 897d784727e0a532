"""The value tree: backward dynamic programming on sums of products.

With ``t`` steps to go, ``V_q,t`` is a sum of products over agents. One step back under policies pi is
(docs/theory/tree.md, "The recursion")

    V_q,t+1 = sum over (guard, q') out of q, over terms z of V_q',t :  prod_i P_i^{pi_i(q,.)} [ mask_guard,i * v_z,i ] .

The step is done in two halves; the first one holds everything that does not depend on the policy:

``candidates``  pairs guards with terms, masks the factors, unites equal ones, smooths each once: the value of *every*
                target mean;
``gather``      reads the smoothed factors at the targets that a policy chooses.

Everything is batched over terms; factors are distinct per agent and smoothed for all agents of one kernel at once. The
code also runs on arrays of ``fractions.Fraction``; so the tests compare it with dense joint programming.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...abstraction.models import AgentModel
from ...certificates.value_functions import Guards, IndexArray, Merges, Terms, compress, distinct, merge_rows
from .pruning_schedule import Arrivals, pruning_schedules

SMOOTHED_AT_ONCE = 256
"""Factors of several agents that are smoothed in one product: enough for a fast one, few enough for memory."""

Loss = Callable[[AgentModel, NDArray, NDArray], NDArray]
"""What turns smoothed factors into lower bounds in spite of lost relations: of a model, masked and smoothed factors."""


@dataclass(frozen=True, eq=False)
class Candidates:
    """Masked and smoothed next-step terms of every automaton state, before a policy is chosen.

    Parameters
    ----------
    smoothed : tuple of (n_i, Z_i) arrays
        Distinct smoothed factors of each agent: value of each lattice point.
    index : tuple of (L_q, I) int64 arrays
        Terms per state, pointing at ``backed_up``.
    origin : tuple of (N_q, 2) int64 arrays
        (guard, term of the target state) of every row that was combined, united ones included.
    merges : tuple of Merges
        How the rows of ``origin`` were united; numbers are rows of ``origin``.
    row : tuple of (L_q,) int64 arrays
        Row of ``origin`` that each term stands for.
    """

    backed_up: tuple[NDArray, ...]
    index: tuple[IndexArray, ...]
    origin: tuple[IndexArray, ...]
    merges: tuple[Merges, ...]
    row: tuple[IndexArray, ...]


def terminal_terms(accepting: NDArray[np.bool_], n_cells: Sequence[int], dtype: type = float) -> Terms:
    """Return the value with no step to go: 1 in accepting states, 0 elsewhere (exact)."""
    n_agents = len(n_cells)
    ones: tuple[NDArray, ...] = tuple(np.ones((1, s), dtype=dtype) for s in n_cells)
    rows = [np.zeros((int(accepted), n_agents), dtype=np.int64) for accepted in accepting]
    return Terms(ones, tuple(rows))


def candidates(
    guards: Guards,
    masks: Sequence[NDArray],
    models: Sequence[AgentModel],
    value: Terms,
    loss: Loss | None = None,
    arrivals: Arrivals | None = None,
    spent: float = 0.0,
    finds_alike: bool = False,
) -> Candidates:
    """Return all products of a guard with a term of its target state, masked, united where possible, and smoothed.

    Nothing is lost, but for the kernel's lower bounds and what ``loss`` takes off: it turns a smoothed factor into a
    lower bound that holds in spite of lost relations (docs/theory/bounds.md, "Robust tree"), and is called with an
    agent's model, the masked factors (n, S) and the smoothed ones (n, Z). With ``arrivals``, terms are also united from
    below, which may lose a share ``spent`` (``pruning_schedules``). With ``finds_alike`` terms are united whose factors
    are equal without being the same.
    """
    # Every guard with every term of its target: row r is the pair (guard[r], child[r]).
    n_states, n_agents = len(value.index), len(models)
    counts = np.array([len(value.index[q]) for q in guards.target], dtype=np.int64)
    guard = np.repeat(np.arange(len(counts)), counts)
    child = np.concatenate([np.arange(n) for n in counts]) if len(counts) else np.zeros(0, dtype=np.int64)
    below = [value.index[q] for q in guards.target]
    child_rows = np.concatenate(below) if below else np.zeros((0, n_agents), dtype=np.int64)

    # Mask each distinct pair (mask, factor) of an agent once; products with an empty factor are 0 and die here.
    factors: list[NDArray] = []
    rows = np.zeros((len(guard), n_agents), dtype=np.int64)
    alive = np.ones(len(guard), dtype=bool)
    for i in range(n_agents):
        key = guards.mask[guard, i].astype(np.int64) * len(value.factors[i]) + child_rows[:, i]
        pairs, rows[:, i] = distinct(key)
        mask, factor = np.divmod(pairs, max(1, len(value.factors[i])))
        masked = masks[i][mask] * value.factors[i][factor]
        factors.append(masked)
        alive &= np.any(masked != 0, axis=1)[rows[:, i]]

    # Unite before smoothing: sums of factors are smoothed as one.
    guard, child, rows = guard[alive], child[alive], rows[alive]
    groups = guards.source[guard].astype(np.int64)
    remaining, rows, merges = merge_rows(factors, rows, groups)
    if finds_alike:
        remaining, merges = _united_alike(factors, rows, groups, remaining, merges)
    if arrivals is not None and n_agents > 1:
        merges = merges.followed_by(pruning_schedules(factors, rows, remaining, guards.source[guard], arrivals, spent))
    for i in range(n_agents):
        factors[i], rows[remaining, i] = compress(factors[i], rows[remaining, i])
    backed_up = _backup(models, factors)
    if loss is not None:
        backed_up = tuple(loss(m, before, after) for m, before, after in zip(models, factors, backed_up, strict=True))
    table = _Rows(guard, child, rows, remaining, merges)
    return _per_state(backed_up, n_states, guards.source[guard], table)


def _united_alike(
    factors: list[NDArray], rows: IndexArray, groups: IndexArray, remaining: IndexArray, merges: Merges
) -> tuple[IndexArray, Merges]:
    """Unite further terms whose factors are equal without being the same; return the rows left and all merges.

    The parts of a factor on a set of cells and on all others add up to the factor itself: a task that only looks at the
    end has one term at all times. ``rows`` is changed in place, ``factors`` extended.
    """
    if not 1 < len(remaining) <= FEW_TERMS or any(own.dtype != np.float64 for own in factors[:1]):
        return remaining, merges
    while len(remaining) > 1:
        # Give equal factors the number of the first of them.
        alike = rows[remaining].copy()
        for i, own in enumerate(factors):
            first: dict[bytes, int] = {}
            numbers = {int(k): first.setdefault(own[k].tobytes(), int(k)) for k in np.unique(alike[:, i])}
            alike[:, i] = [numbers[int(k)] for k in alike[:, i]]
        if np.array_equal(alike, rows[remaining]):
            break
        kept, alike, more = merge_rows(factors, alike, groups[remaining])
        rows[remaining[kept]] = alike[kept]
        merges = merges.followed_by(Merges(remaining[more.into], remaining[more.absorbed], more.agent))
        if len(kept) == len(remaining):
            break
        remaining = remaining[kept]
    return remaining, merges


@dataclass(frozen=True)
class _Rows:
    """Rows of all states: guard and term of each, its factors, which rows remain, and how the others were united."""

    guard: IndexArray
    child: IndexArray
    factors: IndexArray
    remaining: IndexArray
    merges: Merges


def _per_state(backed_up: tuple[NDArray, ...], n_states: int, source: IndexArray, rows: _Rows) -> Candidates:
    """Sort the rows of all states, each with the state it is out of, into one table per state."""
    position = np.zeros(len(rows.guard), dtype=np.int64)
    origin, index, row, united = [], [], [], []
    for q in range(n_states):
        # From here on rows are numbered within their state.
        of_state = np.flatnonzero(source == q)
        position[of_state] = np.arange(len(of_state))
        origin.append(np.stack([rows.guard[of_state], rows.child[of_state]], axis=1))
        terms = rows.remaining[source[rows.remaining] == q]
        index.append(rows.factors[terms])
        row.append(position[terms])
        merged = source[rows.merges.into] == q
        into, absorbed = rows.merges.into[merged], rows.merges.absorbed[merged]
        rest = None if rows.merges.rest is None else rows.merges.rest[merged]
        united.append(Merges(position[into], position[absorbed], rows.merges.agent[merged], rest))
    return Candidates(backed_up, tuple(index), tuple(origin), tuple(united), tuple(row))


def _backup(models: Sequence[AgentModel], factors: Sequence[NDArray]) -> tuple[NDArray, ...]:
    """Smooth the factors of all agents, those of agents with one kernel in common products."""
    backed_up: list[NDArray | None] = [None] * len(models)
    for kernel in {id(m.kernel): m.kernel for m in models}.values():
        users = [i for i, m in enumerate(models) if m.kernel is kernel]
        for batch in _batches(users, factors):
            stacked = kernel.backup(
                np.concatenate([factors[i] for i in batch]) if len(batch) > 1 else factors[batch[0]]
            )
            first = 0
            for i in batch:
                backed_up[i] = stacked[first : first + len(factors[i])]
                first += len(factors[i])
    return tuple(rows for rows in backed_up if rows is not None)


def _batches(users: list[int], factors: Sequence[NDArray]) -> list[list[int]]:
    """Return agents in batches of up to ``SMOOTHED_AT_ONCE`` factors; an agent with more is a batch by itself."""
    batches: list[list[int]] = []
    size = 0
    for i in users:
        if not batches or size + len(factors[i]) > SMOOTHED_AT_ONCE:
            batches.append([])
            size = 0
        batches[-1].append(i)
        size += len(factors[i])
    return batches


FEW_TERMS = 64
"""Terms up to which equal factors are looked for: trees that could stay small are small when they start to grow."""

FEW_FACTORS = 32
"""Factors of an agent in one automaton state up to which equal ones of other states are looked for: trees that are
alike in all states start small, and once their factors are shared they unite and stay small."""


def shared(parts: Sequence[tuple[Sequence[NDArray], IndexArray]]) -> list[tuple[Sequence[NDArray], IndexArray]]:
    """Return the parts, those states whose factors and rows are equal to others' made to hold the very same arrays."""
    known: dict[object, tuple[Sequence[NDArray], IndexArray]] = {}
    result = []
    for factors, rows in parts:
        if not len(rows) or not all(isinstance(own, np.ndarray) and len(own) <= FEW_FACTORS for own in factors):
            result.append((factors, rows))
            continue
        key = (rows.tobytes(), *(own.tobytes() for own in factors))
        result.append(known.setdefault(key, (factors, rows)))
    return result


def assemble(
    parts: Sequence[tuple[Sequence[NDArray], IndexArray]], n_cells: Sequence[int], dtype: type = float
) -> Terms:
    """Return terms from the (factors of each agent, rows) of every state, renumbered into one list per agent."""
    n_agents = len(n_cells)
    offsets = np.zeros(n_agents, dtype=np.int64)
    stacks: list[list[NDArray]] = [[] for _ in range(n_agents)]
    index: list[IndexArray] = []
    numbered: dict[int, IndexArray] = {}
    for factors, rows in parts:
        if len(rows) and id(rows) in numbered:  # a state like one before it: the same terms
            index.append(numbered[id(rows)])
            continue
        index.append(rows + offsets if len(rows) else np.zeros((0, n_agents), dtype=np.int64))
        numbered[id(rows)] = index[-1]
        if len(rows):
            for i in range(n_agents):
                stacks[i].append(factors[i])
                offsets[i] += len(factors[i])
    merged = (
        np.concatenate(stack) if stack else np.zeros((0, n), dtype=dtype)
        for stack, n in zip(stacks, n_cells, strict=True)
    )
    return Terms(tuple(merged), tuple(index))
