"""The search for menus: the largest tolerance that keeps a probability.

Backwards in time, a choice comes on the menu of its cell if no factor of the value loses more than a share eps by it,
against the choice of the certificate. The value of a factor is then the least over the menu, and earlier menus are
judged by these lower values. The value at the start falls as eps grows; bisection finds the largest eps for which it
stays above the probability that is asked for. Nothing of this has to be right: ``check_permission`` computes the bound
again.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..cells import FloatArray
from ..certificates import AgentPart, Certificate, as_certificate, axis_tables, rounded_down, smooth
from ..checking import execution_of, masks_of, standing, tree_start_value, vertices_of
from ..relations import ExactRelation, WrittenTargets
from ..values import Terms
from .permission import Menus, Permission

Aimed = ExactRelation | WrittenTargets
"""Relations of exact targets."""

HALVINGS = 14
"""Halvings of the tolerance: it is found to 1e-4."""

AT_ONCE = 4_000_000
"""Most numbers that are compared at once."""

RESERVE = 1e-11
"""What is taken off the bound beside the certificate's own reserve, for a check that sums in another order."""


def permit(certificate: Any, *, probability: float) -> Permission:
    """Return menus within which any behaviour succeeds with a probability of at least ``probability``.

    The certificate is checked first, once; ``check_permission`` verifies certificate and menus.

    Parameters
    ----------
    certificate : Synthesis, Certificate or path
        Of one task, with a value tree, all agents with the relation ``exact``.
    probability : float
        Success probability to keep, above 0 and at most the certified bound.

    Raises
    ------
    ValueError
        If the certificate has no menus, ``check`` refuses it, or the probability is out of range.

    Examples
    --------
    >>> import certigym as cg
    >>> problem = cg.make_problem("reach-avoid-v0", horizon=5)
    >>> certificate = cg.synthesize(problem, 60, relation="exact").certificate
    >>> permission = cg.permit(certificate, probability=0.7)
    >>> permission.lower_bound >= 0.7, bool(cg.check_permission(permission))
    (True, True)
    """
    certificate = standing(_checked(as_certificate(certificate)))
    if isinstance(probability, bool) or not isinstance(probability, int | float) or not 0.0 < probability <= 1.0:
        raise ValueError(f"`probability`: expected a number above 0 and at most 1, got {probability!r}")
    offered = [_admissible(part, relation) for part, relation in _pairs(certificate)]
    menus, bound = _pass(certificate, offered, 0.0)
    if bound < probability:
        raise ValueError(
            f"`probability`: expected at most {rounded_down(max(bound, 0.0), 6)}, what the certificate promises less "
            f"rounding, got {probability:.6g}; take less, or a better certificate (more cells)"
        )
    low, high = 0.0, 1.0
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        tried, value = _pass(certificate, offered, middle)
        if value >= probability:
            low, menus, bound = middle, tried, value
        else:
            high = middle
    return Permission(certificate, menus, bound)


def _checked(certificate: Any) -> Certificate:
    """Return a certificate that has menus, or raise ValueError with what to do."""
    if not isinstance(certificate, Certificate):
        raise ValueError("`certificate`: expected that of one task; give one of its `.parts`")
    if certificate.terms is None:
        raise ValueError('`certificate`: expected one with a value tree; synthesize with `value="tree"`')
    kinds = {part.relation["kind"] for part in certificate.agents} - {"exact"}
    if kinds:
        raise ValueError(
            f"`certificate`: expected the relation 'exact' for all agents, got {', '.join(sorted(kinds))}; synthesize "
            'with `relation="exact"`'
        )
    return certificate


def _pairs(certificate: Certificate) -> list[tuple[AgentPart, Aimed]]:
    """Return every agent's part and relation."""
    found = []
    for agent, part in zip(certificate.problem.agents, certificate.agents, strict=True):
        relation = part.relation_of(agent)
        assert isinstance(relation, Aimed)
        found.append((part, relation))
    return found


def _admissible(part: AgentPart, relation: Aimed) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return all pairs of cells (N,) and lattice points (N,) that inputs reach from the whole cell, cell by cell."""
    centres = part.grid.centres
    if isinstance(relation, WrittenTargets):
        asked = relation.asked_on(part.grid.edges)
        means, reach = asked.centre, relation.reach(centres)
        some = np.all(np.isfinite(asked.middle), axis=(0, 2))
    else:
        reserve = relation.reserve(part.grid.half_widths)
        means, reach = relation.means(centres), np.maximum(reserve, 0.0) @ np.abs(relation.B).T
        some = np.all(reserve > 0.0, axis=1)
    cells, points = [], []
    for cell in np.flatnonzero(some):
        # Lattice points in the box around all reachable means; then those that are reachable themselves.
        ranges = [
            np.arange(*np.searchsorted(axis, (m - r, m + r + 1e-300)))
            for axis, m, r in zip(part.lattice, means[cell], reach[cell], strict=True)
        ]
        index = [grid.ravel() for grid in np.meshgrid(*ranges, indexing="ij")]
        targets = np.stack([axis[k] for axis, k in zip(part.lattice, index, strict=True)], axis=1)
        if isinstance(relation, WrittenTargets):
            inside = relation.fits(asked.of(np.full(len(targets), cell), targets))
        else:
            inside = np.all(np.abs((targets - means[cell]) @ relation.right_inverse.T) <= reserve[cell], axis=1)
        flat = np.ravel_multi_index(tuple(index), part.lattice_shape)[inside]
        cells.append(np.full(len(flat), cell))
        points.append(flat)
    nothing = np.zeros(0, dtype=np.int64)
    return np.concatenate([nothing, *cells]), np.concatenate([nothing, *points])


def _pass(
    certificate: Certificate, offered: list[tuple[NDArray[np.int64], NDArray[np.int64]]], eps: float
) -> tuple[tuple[Menus, ...], float]:
    """Return the menus of a tolerance, and what they keep from the start: a lower bound."""
    problem, automaton, n_agents = certificate.problem, certificate.problem.automaton, len(certificate.agents)
    known: dict[tuple[bytes, ...], list[FloatArray]] = {}
    pairs = list(zip(problem.agents, certificate.agents, strict=True))
    kernels = [axis_tables(agent, part, known) for agent, part in pairs]
    masks = [masks_of(part, part.masks) for part in certificate.agents]
    ones = tuple(np.ones((1, part.n_places)) for part in certificate.agents)
    terms = Terms(ones, tuple(np.zeros((int(a), n_agents), dtype=np.int64) for a in automaton.accepting))
    counts = [
        np.zeros((problem.horizon, automaton.n_states, part.grid.n_cells), np.int32) for part in certificate.agents
    ]
    chosen: list[dict[tuple[int, int], NDArray[np.int32]]] = [{} for _ in pairs]
    for t in reversed(range(problem.horizon)):
        stacks: list[list[FloatArray]] = [[one] for one in ones]
        index: list[Any] = []
        for q, kept in enumerate(certificate.skeleton[t].kept):
            if automaton.finished[q]:
                index.append(np.zeros((1, n_agents), dtype=np.int64))
                continue
            rows = np.zeros((len(kept), n_agents), dtype=np.int64)
            for i, vertex in enumerate(vertices_of(certificate, t, q, terms, masks)):
                table = smooth(vertex[kept], kernels[i])
                cells, points = _on_the_menu(table, certificate.agents[i].points(t, q), offered[i], eps)
                counts[i][t, q] = np.bincount(cells, minlength=counts[i].shape[2])
                chosen[i][t, q] = points.astype(np.int32)
                values = np.zeros((len(kept), counts[i].shape[2]))
                if len(points) and len(kept):
                    there, begin = np.unique(cells, return_index=True)
                    values[:, there] = np.minimum.reduceat(table[:, points], begin, axis=1)
                rows[:, i] = sum(map(len, stacks[i])) + np.arange(len(kept))
                stacks[i].append(values)
            index.append(rows)
        terms = Terms(tuple(np.concatenate(stack) for stack in stacks), tuple(index))
    loss = sum(execution_of(agent, part, part.relation_of(agent)).loss for agent, part in pairs) * problem.horizon
    value = (tree_start_value(certificate, terms) - loss) * (1.0 - certificate.relative_rounding) - RESERVE
    nothing = np.zeros(0, dtype=np.int32)
    menus = tuple(
        Menus(count, np.concatenate([nothing, *(steps[key] for key in sorted(steps))]))
        for count, steps in zip(counts, chosen, strict=True)
    )
    return menus, value


def _on_the_menu(
    table: FloatArray,
    policy: NDArray[Any],
    offered: tuple[NDArray[np.int64], NDArray[np.int64]],
    eps: float,
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return cells and lattice points of choices by which no factor loses more than a share, cell by cell.

    ``table`` (n, Z) are the factors around lattice points, ``policy`` (S,) the choices of the certificate, which are
    on their menus in any case. Cells without a choice have no menu.
    """
    cells, points = offered
    base = table[:, np.maximum(policy, 0)]
    allowed = (policy[cells] >= 0) & (points == policy[cells])
    for some in np.array_split(np.arange(len(cells)), len(cells) * len(table) // AT_ONCE + 1):
        enough = table[:, points[some]] >= (1.0 - eps) * base[:, cells[some]]
        allowed[some] |= np.all(enough, axis=0) & (policy[cells[some]] >= 0)
    # A choice of the certificate that the window leaves out by rounding is put on its menu as well.
    cells, points = cells[allowed], points[allowed]
    missing = np.setdiff1d(np.flatnonzero(policy >= 0), cells[points == policy[cells]])
    order = np.argsort(np.concatenate([cells, missing]), kind="stable")
    return np.concatenate([cells, missing])[order], np.concatenate([points, policy[missing]])[order]
