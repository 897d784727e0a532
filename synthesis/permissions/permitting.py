"""The search for menus: the largest tolerance that keeps a probability.

Backwards in time, a choice comes on the menu of its cell if no factor of the value loses more than a share eps by it,
against the choice of the certificate. The value of a factor is then the least over the menu, and earlier menus are
judged by these lower values. The value at the start falls as eps grows; bisection finds the largest eps for which it
stays above the probability that is asked for. Nothing of this has to be right: ``check_permission`` computes the bound
again.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...envs.agents import AnyAgent
from ...envs.arrays import on_one_thread
from ..cells import FloatArray
from ..certificates import OnGrid, certificate_on_grids, on_cells, rounded_down
from ..checking import standing
from ..masses import AgentPart
from ..relations import ExactRelation, WrittenTargets
from ..step_checking import Reading, by_cell, execution_of, reading_of
from .permission import Menus, Permission, count_of_choices, in_layers
from .permission_check import KINDS, least_on_menus, read_in_layers, value_under

HALVINGS = 14
"""Halvings of the tolerance: it is found to 1e-4."""

RESERVE = 1e-11
"""What is taken off the bound beside the certificate's own reserve, for a check that sums in another order."""


@on_one_thread
def permit(certificate: Any, *, probability: float) -> Permission:
    """Return menus within which any behaviour succeeds with a probability of at least ``probability``.

    The certificate is checked first, once; ``check_permission`` verifies certificate and menus.

    Parameters
    ----------
    certificate : Synthesis, certificate or path
        With a value tree, of one task or of a joint agent, whose menus it then has; relations ``exact``, ``boxes`` or
        ``linear``, without inputs that are chosen in common.
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
    >>> permission.lower_bound >= 0.7, bool(cg.check(permission))
    (True, True)
    """
    certificate = certificate_on_grids(certificate)
    _checked(certificate)
    certificate = _checked(standing(certificate))
    if isinstance(probability, bool) or not isinstance(probability, int | float) or not 0.0 < probability <= 1.0:
        raise ValueError(f"`probability`: expected a number above 0 and at most 1, got {probability!r}")
    offered = [
        _offered(agent, part) for agent, part in zip(certificate.problem.agents, certificate.proof.agents, strict=True)
    ]
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


def _checked(certificate: Any) -> OnGrid:
    """Return a certificate that has menus, or raise ValueError with what to do."""
    certificate = on_cells(certificate)  # the menus of a team are those of its joint agent
    if certificate is None:
        raise ValueError("`certificate`: expected that of one task; give one of its `.proof.parts`")
    if certificate.proof.terms is None:
        raise ValueError(
            "`certificate`: expected one with a value tree, got tensor trains, whose factors have both signs: the "
            "least over a menu is not the product of the least factors; grow a tree of the same policies, "
            '`synthesize(problem, start=certificate, value="tree")`'
        )
    kinds = {part.relation["kind"] for part in certificate.proof.agents} - set(KINDS)
    if kinds:
        raise ValueError(
            "`certificate`: expected the relation 'exact', 'boxes' or 'linear' for all agents, got "
            f"{', '.join(sorted(kinds))}; synthesize with one of these"
        )
    if any(part.is_linear and not part.relation["menu"] for part in certificate.proof.agents):
        raise ValueError("`certificate`: expected linear cells with inputs, got those of 0.2; synthesize it anew")
    if any("common" in part.relation for part in certificate.proof.agents):
        raise ValueError(
            "`certificate`: expected one without inputs that are chosen in common, which leave nothing to choose cell "
            "by cell; synthesize with `common=False`"
        )
    return certificate


def _offered(agent: AnyAgent, part: AgentPart) -> NDArray[np.int32]:
    """Return what may come on menus, in layers (K, S): targets that all of a cell reaches, or inputs of its menu."""
    relation: Any = part.relation_of(agent)
    cells = np.arange(part.grid.n_cells)
    if "menu" not in part.relation:
        return in_layers(*_admissible(part, relation), len(cells))
    return np.broadcast_to(
        np.arange(len(part.relation["menu"]), dtype=np.int32)[:, None], (len(part.relation["menu"]), len(cells))
    )


def _admissible(
    part: AgentPart, relation: ExactRelation | WrittenTargets
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return all pairs of cells (N,) and lattice points (N,) that inputs reach from the whole cell, cell by cell."""
    asked = relation.on(part.grid)
    means, reach = asked.means, asked.reach
    cells, points = [], []
    for cell in np.flatnonzero(asked.known):
        # Lattice points in the box around all reachable means; then those that are reachable themselves.
        ranges = [
            np.arange(*np.searchsorted(axis, (m - r, m + r + 1e-300)))
            for axis, m, r in zip(part.lattice, means[cell], reach[cell], strict=True)
        ]
        index = [grid.ravel() for grid in np.meshgrid(*ranges, indexing="ij")]
        targets = np.stack([axis[k] for axis, k in zip(part.lattice, index, strict=True)], axis=1)
        inside = asked.fits(np.full(len(targets), cell), targets)
        flat = np.ravel_multi_index(tuple(index), part.lattice_shape)[inside]
        cells.append(np.full(len(flat), cell))
        points.append(flat)
    nothing = np.zeros(0, dtype=np.int64)
    return np.concatenate([nothing, *cells]), np.concatenate([nothing, *points])


def _pass(certificate: OnGrid, offered: list[NDArray[np.int32]], eps: float) -> tuple[tuple[Menus, ...], float]:
    """Return the menus of a tolerance, and what they keep from the start: a lower bound."""
    problem, known = certificate.problem, dict[tuple[bytes, ...], list[FloatArray]]()
    pairs = list(zip(problem.agents, certificate.proof.agents, strict=True))
    readings = [
        reading_of(agent, _with_offered(part, layers), known, False)
        for (agent, part), layers in zip(pairs, offered, strict=True)
    ]
    shape = problem.horizon, problem.automaton.n_states
    counts = [np.zeros((*shape, part.grid.n_cells), np.int32) for part in certificate.proof.agents]
    chosen: list[dict[tuple[int, int], NDArray[np.int32]]] = [{} for _ in pairs]

    def step(i: int, factors: FloatArray, t: int, q: int) -> FloatArray:
        part, reading = certificate.proof.agents[i], readings[i]
        own = part.policy[min(t, len(part.policy) - 1), q]
        cells, choices = _on_the_menu(reading, part, own, offered[i], factors, eps)
        counts[i][t, q] = np.bincount(cells, minlength=part.grid.n_cells)
        chosen[i][t, q] = choices.astype(np.int32)
        return least_on_menus(reading, part, in_layers(cells, choices, part.grid.n_cells), factors)

    value = value_under(certificate, step)
    loss = sum(
        execution_of(agent, _with_offered(part, layers), part.relation_of(agent)).loss
        for (agent, part), layers in zip(pairs, offered, strict=True)
    )
    value = (value - loss * problem.horizon) * (1.0 - certificate.proof.relative_rounding) - RESERVE
    nothing = np.zeros(0, dtype=np.int32)
    menus = tuple(
        Menus(count, np.concatenate([nothing, *(steps[key] for key in sorted(steps))]))
        for count, steps in zip(counts, chosen, strict=True)
    )
    return menus, value


def _with_offered(part: AgentPart, layers: NDArray[np.int32]) -> AgentPart:
    """Return an agent's part whose policy has all that is offered, and all that the certificate chooses."""
    own = part.policy.reshape(-1, part.grid.n_cells)
    return replace(part, policy=np.concatenate([layers, own])[None])


def _on_the_menu(
    reading: Reading,
    part: AgentPart,
    own: NDArray[Any],
    offered: NDArray[np.int32],
    factors: FloatArray,
    eps: float,
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return cells and choices by which no factor loses more than a share, cell by cell; choices rise in each.

    ``factors`` (n, places) are those of the step, ``own`` (S,) the choices of the certificate, which are on their menus
    in any case. Cells without a choice have no menu, and where all is lost already there is the own choice alone.
    """
    ((base, _),) = read_in_layers(reading, part, own[None].astype(np.int32), factors)
    wanted = (1.0 - eps) * base
    pairs = [_pairs(np.flatnonzero(own >= 0), own[own >= 0], part)]
    open_cells = (own >= 0) & _by_cell(part, np.asarray((base > 0.0).any(axis=0))).any(axis=1)
    for layer, (values, _) in zip(offered, read_in_layers(reading, part, offered, factors), strict=True):
        enough = _by_cell(part, np.asarray(np.all(values >= wanted, axis=0))).all(axis=1) & (layer >= 0) & open_cells
        pairs.append(_pairs(np.flatnonzero(enough), layer[enough], part))
    cells, choices = np.divmod(np.unique(np.concatenate(pairs)), count_of_choices(part))
    return cells, choices


def _pairs(cells: NDArray[np.int64], choices: NDArray[Any], part: AgentPart) -> NDArray[np.int64]:
    """Return numbers of pairs of cells and choices."""
    return cells * count_of_choices(part) + choices


def _by_cell(part: AgentPart, places: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return what is true at places (places,) cell by cell (S, K): in each cell, or at its K corners."""
    return by_cell(places[None], part.grid.shape)[0] if part.is_linear else places[:, None]
