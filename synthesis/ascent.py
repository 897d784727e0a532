"""Occupancy-weighted coordinate ascent on decentralised policies.

A sweep goes forward once under the current policies, keeping the alive mass ``mu_t,q = sum_k prod_i m_k,i``, and then
backward through the value tree. With the masked next-step terms ``g_l`` of state q, agent i's exact best response at
time t is, for every cell s (THEORY section 5),

    argmax_u  sum_l omega_l(s) (P_u g_l,i)(s),     omega_l(s) = sum_k m_k,i(s) prod_{j != i} < m_k,j , P_j^pi g_l,j > .

Agents answer in turn. Without pruning the value at the start never falls; with pruning it may, so callers keep the
best policy and evaluate it with frozen laws before reporting anything (``sweep(..., improve=False)``).

Terms are pruned by contribution, ``<mu_t,q , term>``; what is dropped is charged with the leftover mass of a truncated
occupancy included, so that ``dropped`` is an upper bound on the loss at the start.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .arrays import to_host
from .joint import JointModel
from .occupancy import Occupancy, push
from .stage import Limits, Stage, inner_products
from .terms import IndexArray, Merges, Terms
from .value import Loss, assemble, candidates, terminal_terms

Laws = tuple[NDArray[np.int32], ...]
"""Per agent (T, Q, S_i): target of each cell by time and automaton state; -1 where none is admissible."""


@dataclass(frozen=True, eq=False)
class Skeleton:
    """Which vertices the value tree kept at one time, enough to grow it again (see ``check``).

    Per automaton state: rows (guard, term of the next step), how rows were united, and which rows became terms.
    """

    origin: tuple[IndexArray, ...]
    merges: tuple[Merges, ...]
    kept: tuple[IndexArray, ...]


@dataclass(frozen=True, eq=False)
class Sweep:
    """Outcome of one pass over all times.

    Parameters
    ----------
    laws : Laws
        Policies the value belongs to.
    terms : Terms
        Value function at time 0.
    value : float
        Value at the start (a lower bound up to rounding).
    dropped : float
        Upper bound on what pruning took from ``value``.
    rank : int
        Largest number of terms of one state at any time.
    skeleton : tuple of Skeleton
        The tree, by time.
    """

    laws: Laws
    terms: Terms
    value: float
    dropped: float
    rank: int
    skeleton: tuple[Skeleton, ...]


def resting_laws(joint: JointModel) -> Laws:
    """Every agent stays where it is, at all times and states."""
    shape = (joint.horizon, joint.n_states, 1)
    return tuple(np.tile(model.choices.resting_law, shape) for model in joint.models)


def forward(joint: JointModel, laws: Laws, start: Occupancy, limits: Limits) -> list[Occupancy]:
    """Alive mass at times 0 .. T - 1, held by numpy."""
    there = _forward(joint, laws, start, limits)
    return [Occupancy(_everywhere(one.terms, to_host), one.leftover) for one in there]


def _everywhere(terms: Terms, put: Callable[[NDArray], NDArray]) -> Terms:
    """The same terms with all factors put elsewhere."""
    return Terms(tuple(put(own) for own in terms.factors), terms.index)


def _forward(joint: JointModel, laws: Laws, start: Occupancy, limits: Limits) -> list[Occupancy]:
    """Alive mass at times 0 .. T - 1, on the device."""
    occupancies = [Occupancy(_everywhere(start.terms, joint.put), start.leftover)]
    for t in range(joint.horizon - 1):
        step = [law[t] for law in laws]
        last = occupancies[-1]
        occupancies.append(push(last, step, joint.guards, joint.masks, joint.models, limits.mass, limits.rank))
    return occupancies


def start_value(start: Occupancy, terms: Terms) -> float:
    """``sum_q <mu_0,q , V_q>``."""
    total = 0.0
    for q, rows in enumerate(start.terms.index):
        if len(rows) and len(terms.index[q]):
            inner = [m @ v.T for m, v in zip(start.terms.factors, terms.factors, strict=True)]
            total += float(inner_products(inner, rows, terms.index[q]).sum())
    return total


def sweep(
    joint: JointModel, laws: Laws, start: Occupancy | None, limits: Limits, improve: bool, loss: Loss | None = None,
    watch: Callable[[Stage], None] | None = None,
) -> Sweep:  # fmt: skip
    """One pass: alive mass forward under ``laws``, value backward, every agent answering on the way if ``improve``.

    Without a ``start`` every cell counts alike at all times and states (the paper's heuristic weights, without its
    norms); the value is then reported as 0. ``watch`` is shown every (time, automaton state) once its laws are set.
    """
    nowhere = Terms(
        tuple(np.zeros((0, n)) for n in joint.n_cells),
        ((np.zeros((0, len(joint.models)), dtype=np.int64)),) * joint.n_states,
    )
    if start is None:
        occupancies = [Occupancy(nowhere, 0.0)] * joint.horizon
    else:
        occupancies = _forward(joint, laws, start, limits)
    laws = tuple(law.copy() for law in laws)
    terms = _everywhere(terminal_terms(joint.accepting, joint.n_cells), joint.put)
    dropped, rank, skeletons = 0.0, terms.rank, []
    ones = [joint.put(np.ones((1, n))) for n in joint.n_cells]
    for t in reversed(range(joint.horizon)):
        occupancy = occupancies.pop()  # and forget it: early times have many terms, late ones much mass
        options = candidates(joint.guards, joint.masks, joint.models, terms, loss)
        parts, kept = [], []
        for q in range(joint.n_states):
            if joint.absorbing[q]:
                rows = np.zeros((int(joint.accepting[q]), len(joint.models)), dtype=np.int64)
                parts.append((ones, rows))
                kept.append(np.zeros(0, dtype=np.int64))
                continue
            stage = Stage(joint, options, occupancy, q, [law[t, q] for law in laws])
            if improve and len(stage.rows):
                stage.improve()
                for law, better in zip(laws, stage.laws, strict=True):
                    law[t, q] = better
            if watch is not None:
                watch(stage)
            keep, charge = stage.prune(limits)
            dropped += charge
            parts.append(stage.part(keep))
            kept.append(options.row[q][keep])
            del stage  # tables of the next time are made while these would still be held
        terms = assemble(parts, joint.n_cells)
        rank = max(rank, terms.rank)
        skeletons.append(Skeleton(options.origin, options.merges, tuple(kept)))
        del options
    terms = _everywhere(terms, to_host)
    value = 0.0 if start is None else start_value(start, terms)
    return Sweep(laws, terms, value, dropped * (1 + 1e-9), rank, tuple(reversed(skeletons)))
