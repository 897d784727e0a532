"""The value tree of a certificate, grown again vertex by vertex.

This module uses no code of the search. Policies and the list of kept vertices come from the certificate, the kernel is
built anew from the complementary error function, and united terms are regrown by a rule that is sound for any choice,
``a x b + a' x b' >= min(a, a') x (b + b')``. The sum over any set of vertices is a lower bound.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from ...envs.agents import AnyAgent
from ..cells import FloatArray, linear_agent
from ..certificates import AgentPart, Certificate, axis_tables, smooth
from ..values import Merges, Terms
from .boxes_check import box_tables, box_values
from .execution import execution_of
from .forward_mass import mass_at_start
from .linear_check import linear_values, masks_of, places_of
from .linear_tables import LinearTables, linear_tables
from .written_linear import MatrixMaps, WrittenTables, state_maps, written_tables

KEPT = 1.0 - 1e-9
"""Share of a factor that a remainder is taken from where steps are not additive, as in the search: how a difference of
nearly equal factors bends is decided by digits that rounding has lost, and a larger remainder may bend more."""


class BrokenTreeError(ValueError):
    """A certificate's tree is not a tree of its guards."""


def regrow(certificate: Certificate, each: Callable[[int, Terms], None] | None = None) -> Terms:
    """Grow the value tree again from the policies and the list of its vertices: value function at time 0.

    ``each(t, terms)`` is called with the value function at every time t = T - 1 .. 0 as it is grown.
    """
    accepting = certificate.problem.automaton.accepting
    n_agents = len(certificate.agents)
    tables: dict[tuple[bytes, ...], list[FloatArray]] = {}
    pairs = list(zip(certificate.problem.agents, certificate.agents, strict=True))
    kernels = [axis_tables(a, p, tables) if p.is_additive else [] for a, p in pairs]
    linear = _linear_tables_once(certificate)
    boxes = [
        box_tables(a, p, execution_of(a, p, p.relation_of(a)).mean, tables) if p.relation["kind"] == "boxes" else None
        for a, p in pairs
    ]
    masks, is_robust = [masks_of(part, part.masks) for part in certificate.agents], certificate.bound == "robust tree"
    ones = [np.ones((1, places_of(part))) for part in certificate.agents]
    deltas = [controller.relation.delta for controller in certificate.controller.agents]
    factors, index = ones, [np.zeros((int(a), n_agents), dtype=np.int64) for a in accepting]
    for t, step in reversed(list(enumerate(certificate.skeleton))):
        stacks, rows = [list(ones) for ones in zip(ones, strict=True)], []
        for q, kept in enumerate(step.kept):
            if certificate.problem.automaton.finished[q]:
                rows.append(np.zeros((1, n_agents), dtype=np.int64))
                continue
            rows.append(np.zeros((len(kept), n_agents), dtype=np.int64))
            vertices = vertices_of(certificate, t, q, Terms(tuple(factors), tuple(index)), masks)
            smoothed, of_linear = dict[object, FloatArray](), dict[object, tuple[FloatArray, NDArray[np.bool_]]]()
            for i, (part, vertex) in enumerate(zip(certificate.agents, vertices, strict=True)):
                distinct, where = _distinct(vertex, kept)
                tables_of_agent, tables_of_boxes = linear[i], boxes[i]
                if tables_of_agent is not None:
                    stored = None
                    if t == 0 and certificate.terms is not None and len(certificate.terms.index[q]) == len(kept):
                        # The stored factors need not be those that are best here, but must be below the truth.
                        distinct, where = vertex[kept], np.arange(len(kept))
                        stored = certificate.terms.factors[i][certificate.terms.index[q][:, i]]
                    agent = certificate.problem.agents[i]
                    read = (id(tables_of_agent), distinct.tobytes(), None if stored is None else stored.tobytes())
                    if read not in of_linear:
                        of_linear[read] = linear_values(agent, part, tables_of_agent, distinct, t, q, stored)
                    values, proved = of_linear[read]
                    if not np.all(proved):
                        raise BrokenTreeError(
                            f"a stored factor of agent `{agent.name}` is not proved to be a lower bound"
                        )
                elif tables_of_boxes is not None:
                    values = box_values(certificate.problem.agents[i], part, tables_of_boxes, distinct, t, q)
                else:
                    # Agents with one kernel whose factors are equal are smoothed once.
                    alike = (id(kernels[i]), distinct.tobytes())
                    if alike not in smoothed:
                        smoothed[alike] = smooth(distinct, kernels[i])
                    values = _at_targets(part, smoothed[alike], distinct, deltas[i] if is_robust else None, (t, q))
                rows[-1][:, i] = where + sum(len(s) for s in stacks[i])
                stacks[i].append(values)
        factors, index = [np.concatenate(s) for s in stacks], rows
        if each is not None:
            each(t, Terms(tuple(factors), tuple(index)))
    return Terms(tuple(factors), tuple(index))


def _at_targets(
    part: AgentPart, smoothed: FloatArray, factors: FloatArray, lost: float | None, when: tuple[int, int]
) -> FloatArray:
    """Smoothed factors (n, Z) at the lattice points of a policy; less what lost relations take from ``factors``."""
    points = part.points(*when)
    values = smoothed[:, np.maximum(points, 0)]
    if lost is not None:
        values = np.maximum(0.0, values - lost * factors.max(axis=1, initial=0.0)[:, None])
    return np.asarray(values * (points >= 0))


def _linear_tables_once(certificate: Certificate) -> list[LinearTables | WrittenTables | None]:
    """Tables of all agents under the relation ``linear``; those that are equal, policies included, share them."""
    found, known = list[LinearTables | WrittenTables | None](), dict[object, LinearTables | WrittenTables]()
    for agent, part in zip(certificate.problem.agents, certificate.agents, strict=True):
        arrays = (*part.grid.edges, *part.lattice, part.coordinates, part.policy)
        key = (agent.model_key, repr(part.relation), *((a.shape, a.tobytes()) for a in arrays))
        if part.is_linear and key not in known:
            known[key] = _linear_tables(agent, part)
        found.append(known[key] if part.is_linear else None)
    return found


def _linear_tables(agent: AnyAgent, part: AgentPart) -> LinearTables | WrittenTables:
    """Tables of an agent under the relation ``linear``."""
    if "reach" in part.relation:
        return written_tables(agent, part, execution_of(agent, part, part.relation_of(agent)).mean)
    linear = linear_agent(agent, "linear")
    if len(part.relation["menu"]):
        # What maps are off by moves positions on the lattice by less than its points may be off.
        pitch = np.array([(axis[-1] - axis[0]) / (len(axis) - 1) for axis in part.lattice])
        state_maps(linear, part, MatrixMaps(linear, part, np.zeros(len(pitch))).at, 1e-9 * pitch)
    return linear_tables(linear, part)


def vertices_of(
    certificate: Certificate, t: int, q: int, later: Terms, masks: Sequence[NDArray[np.bool_]]
) -> Iterator[FloatArray]:
    """Yield, agent by agent, the factors (N, places) of the vertices of time t before they are smoothed.

    They are the factors of ``later``, the value function at time t + 1, masked by guards and united as the tree says.
    The sum of the products of the vertices that are kept, read at the next state, is at most the value there.

    Raises
    ------
    BrokenTreeError
        If the certificate's tree is not a tree of its guards.
    """
    step = certificate.skeleton[t]
    origin, merges, kept = step.origin[q], step.merges[q], step.kept[q]
    guard, child = origin[:, 0], origin[:, 1]
    if np.any(guard >= len(certificate.guard_source)) or np.any(certificate.guard_source[guard] != q):
        raise BrokenTreeError("its tree uses a guard of another automaton state")
    if len(np.unique(origin, axis=0)) != len(origin):
        raise BrokenTreeError("its tree lists a vertex twice")
    below = _children(list(later.index), certificate.guard_target[guard], child, len(certificate.agents))
    _check_merges(merges, kept)
    for i, part in enumerate(certificate.agents):
        keys = np.stack([certificate.guard_mask[guard, i], below[:, i]], axis=1)
        yield _unite(masks[i], later.factors[i], keys, merges, i, 1.0 if part.is_additive else KEPT)


def tree_start_value(certificate: Certificate, terms: Terms) -> float:
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
