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
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...abstraction.models import JointModel, Policies, StepPolicy
from ...certificates.value_functions import (
    UNIT,
    Guards,
    IndexArray,
    Occupancy,
    Terms,
    compress,
    distinct,
    merge_rows,
    term_masses,
)
from ...relations.grids import FloatArray
from .limits import Limits
from .uniting import rows_behind, unite_again

MANY_ALIKE = 2
"""Agents with one model from which equal numbers are looked for: comparing takes less than pushing."""

NOTHING = 1e-100
"""Masses below this are set to 0: weights that decide nothing, and products with them are denormal numbers, which take
a hundred times as long."""

STORED = 1 << 28
"""Bytes of masses that are kept while values go back in time; beyond, some times are computed anew."""


def forward(joint: JointModel, policies: Policies, start: Occupancy, limits: Limits) -> list[Occupancy]:
    """Return the alive mass at times 0 .. T - 1, from below, as arrays of numpy."""
    mass = AliveMass(joint, policies, start, limits)
    return [mass.pop() for _ in range(joint.horizon)][::-1]


@dataclass(frozen=True, eq=False)
class _Packed:
    """Factors (n, S) most of whose numbers are 0: where they are not, one bit each, and what they are there."""

    shape: tuple[int, ...]
    bits: NDArray[np.uint8]
    numbers: NDArray[Any]

    @property
    def nbytes(self) -> int:
        """Bytes that it takes."""
        return self.bits.nbytes + self.numbers.nbytes

    def unpacked(self) -> NDArray[Any]:
        """Return the factors as they were."""
        factors = np.zeros(self.shape, dtype=self.numbers.dtype)
        factors[np.unpackbits(self.bits, count=factors.size).view(bool).reshape(self.shape)] = self.numbers
        return factors


def _packed(factors: Any) -> Any:
    """Return factors packed."""
    present = factors != 0
    return _Packed(factors.shape, np.packbits(present), factors[present])


def _unpacked(factors: Any) -> Any:
    """Return factors as they were before they were packed."""
    return factors.unpacked() if isinstance(factors, _Packed) else factors


class AliveMass:
    """The alive mass at times T - 1, .., 0, from below, one after the other.

    Fine cells and many terms make gigabytes of it. What is kept is packed; where that is more than ``STORED``, times
    are left out, first every second one, and pushed again from the time before them when they are asked for.

    Parameters
    ----------
    joint : JointModel
    policies : Policies
        They may change from the time on that was asked for last.
    start : Occupancy
        At time 0.
    limits : Limits
    """

    def __init__(self, joint: JointModel, policies: Policies, start: Occupancy, limits: Limits) -> None:
        self.joint, self.policies, self.limits = joint, policies, limits
        self.time, self.stored, self.stride = joint.horizon, dict[int, Occupancy](), 1
        occupancy = start
        for t in range(joint.horizon):
            occupancy = self._after(occupancy, t - 1) if t else occupancy
            # The last one is asked for first.
            if t % self.stride == 0 or t == joint.horizon - 1:
                self._keep(t, occupancy)

    def pop(self) -> Occupancy:
        """Return the alive mass at the latest time that was not asked for yet."""
        self.time -= 1
        before = max(t for t in self.stored if t <= self.time)
        occupancy = self._kept(before)
        for t in range(before + 1, self.time + 1):
            occupancy = self._after(occupancy, t - 1)
            if t < self.time:
                self.stored[t] = _with_factors(occupancy, _packed)
        self.stored.pop(self.time, None)
        return occupancy

    def _after(self, occupancy: Occupancy, t: int) -> Occupancy:
        """Return the alive mass one step after time t."""
        return propagate(
            occupancy, [policy[t] for policy in self.policies], self.joint, self.limits.mass, self.limits.rank
        )

    def _kept(self, t: int) -> Occupancy:
        return _with_factors(self.stored[t], _unpacked)

    def _keep(self, t: int, occupancy: Occupancy) -> None:
        """Store the alive mass of time t, and leave out others where too much is stored."""
        self.stored[t] = _with_factors(occupancy, _packed)
        while self.stride < self.joint.horizon and self._bytes() > STORED:
            self.stride *= 2
            self.stored = {time: kept for time, kept in self.stored.items() if time % self.stride == 0 or time == t}

    def _bytes(self) -> int:
        factors = (each for kept in self.stored.values() for each in kept.terms.factors)
        return sum(int(getattr(each, "nbytes", 0)) for each in factors)


def _with_factors(occupancy: Occupancy, form: Callable[[Any], Any]) -> Occupancy:
    """Return the same mass with all factors in another form."""
    terms = occupancy.terms
    return Occupancy(Terms(tuple(form(factors) for factors in terms.factors), terms.index), occupancy.leftover)


def nowhere(joint: JointModel) -> Occupancy:
    """Return an occupancy without any mass."""
    rows = np.zeros((0, len(joint.models)), dtype=np.int64)
    return Occupancy(Terms(tuple(np.zeros((0, n)) for n in joint.n_cells), (rows,) * joint.n_states), 0.0)


def propagate(
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
    # Pair every guard with every term of its source, push the factors, and see what masks leave of each.
    rows = _pair(guards, terms)
    factors: list[_Masked] = []
    # Agents with one model whose numbers are the same, too, are pushed once.
    users, known = Counter(id(model) for model in joint.models), dict[object, tuple[_Masked, IndexArray]]()
    for i, model in enumerate(joint.models):
        key: object = i
        if users[id(model)] >= MANY_ALIKE:
            shared = (joint.masks[i], *policies[i], terms.factors[i], rows[:, 2 + i])
            key = id(model), *(array.tobytes() for array in shared), guards.mask[:, i].tobytes()
        if key not in known:
            masked = _step(joint, i, policies[i], terms.factors[i], rows)
            known[key] = masked, distinct(rows[:, 2 + i])[1]
        masked, rows[:, 2 + i] = known[key]
        factors.append(masked)
    # Of most pairs nothing is left: guards are many, and mass is somewhere.
    rows = rows[np.all([masked.sums[rows[:, 2 + i], 0] > 0.0 for i, masked in enumerate(factors)], axis=0)]
    guard, index = rows[:, 0], rows[:, 2:].copy()
    target = guards.target[guard].astype(np.int64)
    # Unite what is equal. Only sums of factors are needed to see which terms are left in the end.
    sums = [masked.sums for masked in factors]
    remaining, united, merges = merge_rows(sums, index, target)
    # Drop the smallest terms; their mass is added to what is missing already.
    mass = term_masses(sums, united[remaining])
    chosen, dropped = _largest(mass, target[remaining], tolerance, max_rank)
    remaining = remaining[chosen]
    whole, merges, place = rows_behind(remaining, len(index), merges)
    index, made = index[whole], list[NDArray]()
    for i, masked in enumerate(factors):
        array, index[:, i] = masked.made(index[:, i])
        made.append(array)
    index = unite_again(made, index, merges)[place]
    for i in range(n_agents):
        made[i], index[:, i] = compress(made[i], index[:, i])
    per_state = tuple(index[target[remaining] == q] for q in range(n_states))
    # Sums over cells may be too small by a unit for each of them.
    missing = dropped * (1.0 + 2.0 * UNIT * sum(joint.n_cells)) + NOTHING * sum(joint.n_cells)
    return Occupancy(Terms(tuple(made), per_state), (occupancy.leftover + missing) * (1 + 1e-12))


@dataclass(frozen=True, eq=False)
class _Masked:
    """Products of pushed factors and masks that are made when they are needed; until then their sums are known.

    Parameters
    ----------
    pushed : (n, S) array
    masks : (K, S) bool array
    source, mask : (m,) int arrays
        Which factor and which mask each product is of.
    sums : (m, 1) array
        Of the numbers of each product, on the host.
    """

    propagated: Any
    masks: Any
    source: IndexArray
    mask: IndexArray
    sums: FloatArray

    def made(self, numbers: IndexArray) -> tuple[Any, IndexArray]:
        """Return the distinct ones of some products, and which of them each number stands for."""
        used, place = distinct(numbers)
        return self.propagated[self.source[used]] * self.masks[self.mask[used]], place


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
) -> _Masked:
    """Push and mask the distinct (state, factor, mask) combinations of agent i; renumber its column of ``rows``."""
    model, guards, masks = joint.models[i], joint.guards, joint.masks[i]
    column = 2 + i
    n_factors, n_masks = max(1, len(factors)), max(1, len(masks))
    # The policy depends on the state, the push on state and factor: push each such pair once.
    key = guards.source[rows[:, 0]].astype(np.int64) * n_factors + rows[:, column]
    pushes, pushed_row = distinct(key)
    state, factor = np.divmod(pushes, n_factors)
    propagated = np.empty((len(pushes), model.n_cells), dtype=factors.dtype)
    for q in set(state.tolist()):
        here = state == q
        propagated[here] = model.kernel.propagate(factors[factor[here]], model.choices.points(policies[q]))
    propagated[propagated < NOTHING] = 0.0
    key = pushed_row * n_masks + guards.mask[rows[:, 0], i]
    rows[:, column] = key
    source, mask = np.divmod(distinct(key)[0], n_masks)
    # Masks are true and false; products with fractions stay fractions.
    shares = masks.astype(propagated.dtype)
    sums = (propagated @ shares.T)[source, mask]
    return _Masked(propagated, masks, source, mask, sums[:, None])


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
