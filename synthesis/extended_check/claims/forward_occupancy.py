"""The closed loop pushed forward in time, for checks: where the probability mass is at every time.

This module uses no code of the search. The undecided mass of each automaton state is a sum of products, one factor per
agent, like the value. Products that differ in one agent only are united, and the smallest products are dropped and
counted. The mass accepted by the end, plus all that was dropped or lost, is an upper bound on what the policies attain
on the cells. It is computed forward in time, independently of the value, which is computed backward.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import reduce
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

from ...certificates.cell_probabilities import axis_tables
from ...certificates.proofs import OnGrid, start_of_claim
from ...relations.grids import FloatArray
from ..steps import hat_weights, masks_of, start_shares

if TYPE_CHECKING:
    pass


class TooManyProducts(RuntimeError):
    """The mass has more products than can be handled in reasonable time."""


@dataclass
class Mass:
    """Mass of the runs that are still undecided, and what became of the rest.

    Parameters
    ----------
    factors : list of (K_i, S_i) arrays
        Distinct factors of each agent.
    index : (N, I) int array
        Factors of each product.
    states : (N,) int array
        Automaton state of each product.
    accepted, dropped, stranded : float
        Mass that was accepted, that was dropped because it was small, and that was in cells without a choice.
    """

    factors: list[FloatArray]
    index: NDArray[np.int64]
    states: NDArray[np.int64]
    accepted: float = 0.0
    dropped: float = 0.0
    deadlocked: float = 0.0
    totals: FloatArray = field(init=False)

    def __post_init__(self) -> None:
        self.totals = self._products([own.sum(axis=1) for own in self.factors])

    def _products(self, numbers: Sequence[FloatArray]) -> FloatArray:
        """(N,) products of one number (K_i,) per factor."""
        return reduce(np.multiply, (own[rows] for own, rows in zip(numbers, self.index.T, strict=True)))

    @property
    def alive(self) -> float:
        """Total mass of the runs that are still undecided."""
        return float(self.totals.sum())


def masses(certificate: OnGrid, share: float, most: int) -> Iterator[Mass]:
    """Yield the mass at times 0 .. T; each step drops at most ``share`` and keeps at most ``most`` products.

    Raises
    ------
    TooManyProducts
        If there are more.
    """
    problem, agents = certificate.problem, certificate.proof.agents
    tables: dict[tuple[bytes, ...], list[FloatArray]] = {}
    kernels = [axis_tables(a, p, tables) for a, p in zip(problem.agents, agents, strict=True)]
    mass = _settled(certificate, mass_at_start(certificate), share, most)
    yield mass
    for t in range(problem.horizon):
        mass = _settled(certificate, _step(certificate, kernels, mass, t), share, most)
        yield mass


def mass_at_start(certificate: OnGrid) -> Mass:
    """Mass before the first step, the first letter read."""
    problem, agents = certificate.problem, certificate.proof.agents
    shares = [
        (hat_weights(a, p) if p.relation["kind"] == "linear" else start_shares(a, p))[None]
        for a, p in zip(problem.agents, agents, strict=True)
    ]
    automaton, point = problem.automaton, start_of_claim(certificate) == "point"
    if point or (automaton.finished[automaton.initial]):  # no letter is asked
        q = problem.initial_q if point else automaton.initial
        known = [] if q is None else [q]
        return Mass(shares, np.zeros((len(known), len(agents)), dtype=np.int64), np.array(known, dtype=np.int64))
    factors = [masks_of(part, part.start_masks) * own for part, own in zip(agents, shares, strict=True)]
    return Mass(factors, certificate.proof.start_mask.astype(np.int64), certificate.proof.start_target.astype(np.int64))


def _step(certificate: OnGrid, kernels: list[list[FloatArray]], mass: Mass, t: int) -> Mass:
    """Mass one step later, its letter read."""
    factors: list[list[FloatArray]] = [[np.zeros((0, part.grid.n_cells))] for part in certificate.proof.agents]
    index, states, deadlocked = [], [], mass.deadlocked
    first, known = np.zeros(len(factors), dtype=np.int64), dict[object, FloatArray]()
    for q in np.unique(mass.states):
        own = mass.index[mass.states == q]
        guards = np.flatnonzero(certificate.proof.guard_source == q)
        columns, left = [], np.ones(len(own))
        for i, (part, axes) in enumerate(zip(certificate.proof.agents, kernels, strict=True)):
            used, place = np.unique(own[:, i], return_inverse=True)
            rows, points = mass.factors[i][used], part.points(t, int(q))
            left *= rows[:, points >= 0].sum(axis=1)[place]
            # Agents in equal places under equal policies move alike.
            alike = (id(axes), len(rows), rows.tobytes(), points.tobytes())
            if alike not in known:
                known[alike] = moved(rows, points, axes)
            pushed = known[alike]
            names, which = np.unique(certificate.proof.guard_mask[guards, i], return_inverse=True)
            masked = (pushed[:, None] * part.masks[names]).reshape(-1, part.grid.n_cells)
            columns.append(first[i] + place[:, None] * len(names) + which[None])
            factors[i].append(masked)
            first[i] += len(masked)
        deadlocked += max(0.0, float(mass.totals[mass.states == q].sum() - left.sum()))
        index.append(np.stack(columns, axis=-1).reshape(-1, len(factors)))
        states.append(np.tile(certificate.proof.guard_target[guards], len(own)))
    whole = [np.concatenate(own) for own in factors]
    empty = [np.zeros((0, len(factors)), dtype=np.int64)]
    rows, targets = np.concatenate(empty + index), np.concatenate([np.zeros(0, dtype=np.int64), *states])
    return Mass(whole, rows, targets, mass.accepted, mass.dropped, deadlocked)


def moved(rows: FloatArray, points: NDArray[np.integer], tables: list[FloatArray]) -> FloatArray:
    """Factors (n, S) one step later: gathered at lattice points (S,), -1 for none, and spread by the noise."""
    shape = tuple(len(table) for table in tables)
    cells = np.flatnonzero(points >= 0)
    where = (np.ones(len(cells)), (cells, points[cells]))
    gathered = csr_matrix(where, shape=(len(points), int(np.prod(shape)))).T @ rows.T
    spread = np.asarray(gathered).T.reshape(len(rows), *shape)
    for axis, table in enumerate(tables, start=1):
        spread = np.moveaxis(np.tensordot(spread, table, axes=(axis, 0)), -1, axis)
    return spread.reshape(len(rows), -1)


def _settled(certificate: OnGrid, mass: Mass, share: float, most: int) -> Mass:
    """Return the mass that is still undecided, with similar products united and small ones dropped."""
    automaton = certificate.problem.automaton
    accepted = mass.accepted + float(mass.totals[automaton.finished[mass.states]].sum())
    open_ = (mass.totals > 0) & ~automaton.absorbing[mass.states]
    order = np.flatnonzero(open_)[np.argsort(mass.totals[open_])]
    small = np.cumsum(mass.totals[order]) <= share
    kept = np.sort(order[~small])
    factors, index, states = _united(mass.factors, mass.index[kept], mass.states[kept], most)
    dropped = mass.dropped + float(mass.totals[order[small]].sum())
    return Mass(factors, index, states, accepted, dropped, mass.deadlocked)


def _united(
    factors: list[FloatArray], index: NDArray[np.int64], states: NDArray[np.int64], most: int
) -> tuple[list[FloatArray], NDArray[np.int64], NDArray[np.int64]]:
    """Return the same mass as fewer products: those that differ in one agent's factor are summed."""
    factors, index = list(factors), index.copy()
    before = -1
    while before != len(index):
        if len(index) > 10 * most:  # before uniting them takes too long
            raise TooManyProducts(f"{len(index)} products")
        before = len(index)
        for i in range(index.shape[1]):
            factors[i], index[:, i] = _distinct(factors[i], index[:, i])
        for i in range(index.shape[1] if len(index) > 1 else 0):
            # Columns that are the same in all products tell none of them apart.
            varying = np.any(index != index[0], axis=0)
            varying[i] = False
            others = np.column_stack([index[:, varying], states])
            groups, first, place = np.unique(others, axis=0, return_index=True, return_inverse=True)
            if len(groups) < len(index):
                rows = (np.ones(len(index)), (place.ravel(), index[:, i]))
                summed = csr_matrix(rows, shape=(len(groups), len(factors[i]))) @ factors[i]
                index, states = index[first], states[first]
                factors[i], index[:, i] = _distinct(np.asarray(summed), np.arange(len(groups)))
    if len(index) > most:
        raise TooManyProducts(f"{len(index)} products")
    return factors, index, states


def _distinct(factors: FloatArray, used: NDArray[np.int64]) -> tuple[FloatArray, NDArray[np.int64]]:
    """The factors in use, each once, and where each of ``used`` is among them."""
    number: dict[bytes, int] = {}
    names, place = np.unique(used, return_inverse=True)
    renamed = np.array([number.setdefault(factors[k].tobytes(), len(number)) for k in names], dtype=np.int64)
    _, first = np.unique(renamed, return_index=True)
    return factors[names[first]], renamed[place] if len(names) else used
