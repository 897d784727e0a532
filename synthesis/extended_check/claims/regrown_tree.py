"""The value tree of a certificate, grown again vertex by vertex.

This module uses no code of the search. Policies and the list of kept vertices come from the certificate, the kernel is
built anew from the complementary error function, and united terms are regrown by a rule that is sound for any choice,
``a x b + a' x b' >= min(a, a') x (b + b')``. The sum over any set of vertices is a lower bound.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from ...certificates.proofs import OnGrid
from ...certificates.value_functions import Merges, Terms
from ...relations.grids import FloatArray
from ..steps import masks_of, places_of, step_backups_of
from .forward_occupancy import mass_at_start

KEPT = 1.0 - 1e-9
"""Share of a factor that a remainder is taken from where steps are not additive, as in the search: how a difference of
nearly equal factors bends is decided by digits that rounding has lost, and a larger remainder may bend more."""


class BrokenTreeError(ValueError):
    """A certificate's tree is not a tree of its guards."""


def regrow(certificate: OnGrid, each: Callable[[int, Terms], None] | None = None) -> Terms:
    """Grow the value tree again from the policies and the list of its vertices: value function at time 0.

    ``each(t, terms)`` is called with the value function at every time t = T - 1 .. 0 as it is grown.
    """
    accepting = certificate.problem.automaton.accepting
    n_agents, backups = len(certificate.proof.agents), step_backups_of(certificate)
    masks = [masks_of(part, part.masks) for part in certificate.proof.agents]
    ones = [np.ones((1, places_of(part))) for part in certificate.proof.agents]
    factors, index = ones, [np.zeros((int(a), n_agents), dtype=np.int64) for a in accepting]
    for t, step in reversed(list(enumerate(certificate.proof.merge_log))):
        stacks, rows = [list(ones) for ones in zip(ones, strict=True)], []
        for q, kept in enumerate(step.kept):
            if certificate.problem.automaton.finished[q]:
                rows.append(np.zeros((1, n_agents), dtype=np.int64))
                continue
            rows.append(np.zeros((len(kept), n_agents), dtype=np.int64))
            vertices = vertices_of(certificate, t, q, Terms(tuple(factors), tuple(index)), masks)
            # Agents with one kernel whose factors are equal are smoothed once, and those that are alike read once.
            backed_up, known = dict[object, FloatArray](), dict[object, FloatArray]()
            for i, (part, backup, vertex) in enumerate(zip(certificate.proof.agents, backups, vertices, strict=True)):
                distinct, where = _distinct(vertex, kept)
                if backup.proves_given and t == 0 and certificate.proof.terms is not None:
                    given = certificate.proof.terms.index[q][:, i]
                    if len(given) == len(kept):
                        distinct, where = vertex[kept], np.arange(len(kept))
                        if not backup.proved(part, distinct, (t, q), certificate.proof.terms.factors[i][given]):
                            raise BrokenTreeError(
                                f"a stored factor of agent `{certificate.problem.agents[i].name}` is not proved to be "
                                "a lower bound"
                            )
                read = (id(backup), distinct.tobytes())
                if read not in known:
                    (known[read],) = backup.values(part, distinct, [(t, q)], backed_up)
                rows[-1][:, i] = where + sum(len(s) for s in stacks[i])
                stacks[i].append(known[read])
        factors, index = [np.concatenate(s) for s in stacks], rows
        if each is not None:
            each(t, Terms(tuple(factors), tuple(index)))
    return Terms(tuple(factors), tuple(index))


def vertices_of(
    certificate: OnGrid, t: int, q: int, later: Terms, masks: Sequence[NDArray[np.bool_]]
) -> Iterator[FloatArray]:
    """Yield, agent by agent, the factors (N, places) of the vertices of time t before they are smoothed.

    They are the factors of ``later``, the value function at time t + 1, masked by guards and united as the tree says.
    The sum of the products of the vertices that are kept, read at the next state, is at most the value there.

    Raises
    ------
    BrokenTreeError
        If the certificate's tree is not a tree of its guards.
    """
    step = certificate.proof.merge_log[t]
    origin, merges, kept = step.origin[q], step.merges[q], step.kept[q]
    guard, child = origin[:, 0], origin[:, 1]
    if np.any(guard >= len(certificate.proof.guard_source)) or np.any(certificate.proof.guard_source[guard] != q):
        raise BrokenTreeError("its tree uses a guard of another automaton state")
    if len(np.unique(origin, axis=0)) != len(origin):
        raise BrokenTreeError("its tree lists a vertex twice")
    below = _children(list(later.index), certificate.proof.guard_target[guard], child, len(certificate.proof.agents))
    _check_merges(merges, kept)
    for i, part in enumerate(certificate.proof.agents):
        keys = np.stack([certificate.proof.guard_mask[guard, i], below[:, i]], axis=1)
        yield _unite(masks[i], later.factors[i], keys, merges, i, 1.0 if part.is_additive else KEPT)


def tree_start_value(certificate: OnGrid, terms: Terms) -> float:
    """Value at the start of the problem, over the products that the start falls into."""
    start = mass_at_start(certificate)
    shares = [own @ factors.T for own, factors in zip(start.factors, terms.factors, strict=True)]  # (K_i, terms)
    total = 0.0
    for q, row in zip(start.states.tolist(), start.index, strict=True):
        rows = terms.index[q]
        read = [own[k][rows[:, i]] for i, (own, k) in enumerate(zip(shares, row, strict=True))]
        total += float(np.prod(read, axis=0).sum()) if len(rows) else 0.0
    return total


def _children(index: list[NDArray[np.int64]], target: NDArray, child: NDArray, n_agents: int) -> NDArray[np.int64]:
    """Factor indices (N, I) of the terms ``child`` of the states ``target``."""
    below = np.zeros((len(child), n_agents), dtype=np.int64)
    for q in np.unique(target):
        here = target == q
        if np.any(child[here] >= len(index[q])) or np.any(child[here] < 0):
            raise BrokenTreeError("its tree names a vertex that is not there")
        below[here] = index[q][child[here]]
    return below


def _check_merges(merges: Merges, kept: NDArray[np.int64]) -> None:
    """No vertex may be counted twice: absorbed once at most, never used afterwards, kept once at most.

    A vertex that a remainder takes the place of goes on as that remainder.
    """
    gone: set[int] = set()
    for a, b, rest in zip(merges.into.tolist(), merges.absorbed.tolist(), merges.rests.tolist(), strict=True):
        if a == b or a in gone or b in gone:
            raise BrokenTreeError("its tree counts a vertex twice")
        if rest == 0:
            gone.add(b)
    if np.any((merges.rests != 0) & (np.abs(merges.rests) - 1 == merges.agent)):
        raise BrokenTreeError("its tree keeps a remainder that is none")
    if len(np.unique(kept)) != len(kept) or gone & set(kept.tolist()):
        raise BrokenTreeError("its tree counts a vertex twice")


def _unite(
    masks: NDArray[np.bool_], factors: FloatArray, keys: NDArray, merges: Merges, i: int, share: float = 1.0
) -> FloatArray:
    """Factors (N, S) of agent i of the vertices before smoothing: masked, and united as the tree says.

    ``a x b + a' x b' >= (a + a') x m + a x (b - m)`` with m the minimum of b and b': the last product, or that of the
    other vertex, may stay as a remainder. Where products have more factors, m stands in all but one of them. Of b only
    a ``share`` is kept before m is taken off, for less is sound as well.
    """
    vertex = masks[keys[:, 0]] * factors[keys[:, 1]]
    columns = (merges.into, merges.absorbed, merges.agent, merges.rests)
    for a, b, agent, rest in zip(*(column.tolist() for column in columns), strict=True):
        first, second = vertex[a].copy(), vertex[b].copy()
        kept = first if rest > 0 else second
        least = np.minimum(first, second)
        vertex[a] = first + second if agent == i else least
        if rest:
            remainder = np.maximum(kept * share - least, 0.0)
            vertex[b] = kept if agent == i else (remainder if abs(rest) - 1 == i else least)
    return vertex


def _distinct(vertex: FloatArray, kept: NDArray[np.int64]) -> tuple[FloatArray, NDArray[np.int64]]:
    """Distinct rows among the kept ones, and which of them each is."""
    number: dict[bytes, int] = {}
    where = np.array([number.setdefault(vertex[k].tobytes(), len(number)) for k in kept], dtype=np.int64)
    first = np.zeros(len(number), dtype=np.int64)
    first[where[::-1]] = kept[::-1]
    return vertex[first], where
