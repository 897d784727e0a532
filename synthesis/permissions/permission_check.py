"""The check of a permissive certificate: its menus, and its bound computed again.

The certificate inside is checked as ever: grids, relations, guards and tree. What is new is that a cell has several
choices. Each must be admissible on its whole cell, which the check of relations verifies for all of them at once; and a
factor is worth the least over its menu. The search for menus is not used.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from ...envs.agents import AnyAgent
from ..cells import FloatArray
from ..certificates import AgentPart, axis_tables, smooth
from ..checking import (
    BrokenTreeError,
    CheckReport,
    check,
    execution_of,
    masks_of,
    tree_start_value,
    verify_relation,
    vertices_of,
)
from ..values import Terms
from .permission import Menus, Permission


def check_permission(permission: Permission) -> CheckReport:
    """Verify a permissive certificate: menus and lower bound.

    Returns
    -------
    CheckReport
        Truthy if every behaviour within the menus was proved to keep the bound.
    """
    certificate = permission.certificate
    failures = list(check(certificate).failures)
    failures = failures or _wrong_form(permission)
    loss = 0.0
    if not failures:
        for agent, part, menus in zip(certificate.problem.agents, certificate.agents, permission.menus, strict=True):
            wrong, lost = _wrong_menus(agent, part, menus)
            failures += wrong
            loss += lost
    recomputed = float("nan")
    if not failures:
        try:
            recomputed = permitted_value(permission) - loss * certificate.problem.horizon
        except BrokenTreeError as error:
            failures.append(str(error))
    if not failures and not permission.lower_bound <= recomputed * (1.0 - certificate.relative_rounding):
        failures.append(f"the bound {permission.lower_bound:.12g} exceeds the recomputed value {recomputed:.12g}")
    return CheckReport(not failures, permission.lower_bound, recomputed, tuple(failures))


def _wrong_form(permission: Permission) -> list[str]:
    """What is wrong with the sizes of menus."""
    certificate = permission.certificate
    if len(permission.menus) != len(certificate.agents):
        return ["it has not one set of menus for each agent"]
    shape = certificate.problem.horizon, certificate.problem.automaton.n_states
    for part, menus in zip(certificate.agents, permission.menus, strict=True):
        if part.relation["kind"] != "exact":
            return ["it has menus for an agent whose relation is not exact"]
        if menus.counts.shape != (*shape, part.grid.n_cells) or np.any(menus.counts < 0):
            return ["its menus do not fit its cells"]
        if menus.choices.shape != (int(menus.counts.sum(dtype=np.int64)),):
            return ["its menus have not as many choices as they say"]
        n_points = int(np.prod(part.lattice_shape))
        if menus.choices.size and not (menus.choices.min() >= 0 and menus.choices.max() < n_points):
            return ["its menus name lattice points that are not there"]
    return []


def _wrong_menus(agent: AnyAgent, part: AgentPart, menus: Menus) -> tuple[list[str], float]:
    """Choices that are not admissible on their whole cell, and what carrying them out costs per step."""
    places, n_points = np.arange(menus.counts.size) % part.grid.n_cells, int(np.prod(part.lattice_shape))
    pairs = np.unique(np.repeat(places, menus.counts.reshape(-1)) * n_points + menus.choices)
    cells, choices = np.divmod(pairs, n_points)
    # The k-th distinct choice of every cell is a policy of one step; each is verified as one.
    number = np.arange(len(cells)) - np.searchsorted(cells, cells, side="left")
    layers = np.full((1, int(number.max(initial=0)) + 1, part.grid.n_cells), -1, dtype=np.int32)
    layers[0, number, cells] = choices
    layered = replace(part, policy=layers)
    relation = part.relation_of(agent)
    execution = execution_of(agent, layered, relation)
    wrong = verify_relation(agent, layered, relation, execution)
    return [f"agent `{agent.name}`: {text}" for text in wrong], execution.loss


def permitted_value(permission: Permission) -> float:
    """Value at the start under the worst behaviour within the menus, a lower bound up to rounding."""
    certificate = permission.certificate
    automaton, n_agents = certificate.problem.automaton, len(certificate.agents)
    pairs = zip(certificate.problem.agents, certificate.agents, strict=True)
    known: dict[tuple[bytes, ...], list[FloatArray]] = {}
    kernels = [axis_tables(agent, part, known) for agent, part in pairs]
    masks = [masks_of(part, part.masks) for part in certificate.agents]
    ones = tuple(np.ones((1, part.n_places)) for part in certificate.agents)
    terms = Terms(ones, tuple(np.zeros((int(a), n_agents), dtype=np.int64) for a in automaton.accepting))
    for t in reversed(range(certificate.problem.horizon)):
        stacks: list[list[FloatArray]] = [[one] for one in ones]
        index: list[Any] = []
        for q, kept in enumerate(certificate.skeleton[t].kept):
            if automaton.finished[q]:
                index.append(np.zeros((1, n_agents), dtype=np.int64))
                continue
            rows = np.zeros((len(kept), n_agents), dtype=np.int64)
            for i, vertex in enumerate(vertices_of(certificate, t, q, terms, masks)):
                rows[:, i] = sum(map(len, stacks[i])) + np.arange(len(kept))
                stacks[i].append(least_on_menus(smooth(vertex[kept], kernels[i]), permission.menus[i], t, q))
            index.append(rows)
        terms = Terms(tuple(np.concatenate(stack) for stack in stacks), tuple(index))
    return tree_start_value(certificate, terms)


def least_on_menus(table: FloatArray, menus: Menus, t: int, q: int) -> FloatArray:
    """Least value (n, S) over the menu of each cell of values (n, Z) at lattice points; 0 where a menu is empty."""
    counts = menus.counts[t, q]
    result = np.zeros((len(table), len(counts)))
    _, choices = menus.of_step(t, q)
    cells = np.flatnonzero(counts)
    if len(cells) and len(table):
        begin = (np.cumsum(counts, dtype=np.int64) - counts)[cells]
        result[:, cells] = np.minimum.reduceat(table[:, choices], begin, axis=1)
    return result
