"""The check of a permissive certificate: its menus, and its bound computed again.

The certificate inside is checked as ever: grids, relations, guards and tree. What is new is that a cell has several
choices. Each must be admissible on its whole cell, which the check of relations verifies for all of them at once; and a
factor is worth the least over its menu. The search for menus is not used.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...envs.agents import AnyAgent
from ..cells import FloatArray
from ..certificates import CheckReport, OnGrid
from ..checking import BrokenTreeError, check, tree_start_value, vertices_of
from ..masses import AgentPart
from ..step_checking import Reading, execution_of, masks_of, reading_of, verify_relation
from ..values import Terms
from .permission import Menus, Permission, count_of_choices, in_layers

KINDS = ("exact", "boxes", "linear")
"""Relations that have menus: those without memory that are never lost."""

LAYERS_AT_ONCE = 32
"""Policies that are read at once around factors that are smoothed once."""


def check_permission(permission: Permission, problem: Any = None) -> CheckReport:
    """Verify a permissive certificate: menus and lower bound, for a problem (by default the one inside it).

    Returns
    -------
    CheckReport
        Truthy if every behaviour within the menus was proved to keep the bound.
    """
    certificate = permission.certificate
    failures = list(check(certificate, problem).failures)
    failures = failures or _wrong_form(permission)
    loss = 0.0
    if not failures:
        for agent, part, menus in zip(
            certificate.problem.agents, certificate.proof.agents, permission.menus, strict=True
        ):
            wrong, lost = _wrong_menus(agent, part, menus)
            failures += wrong
            loss += lost
    recomputed = float("nan")
    if not failures:
        try:
            recomputed = permitted_value(permission) - loss * certificate.problem.horizon
        except BrokenTreeError as error:
            failures.append(str(error))
    if not failures and not permission.lower_bound <= recomputed * (1.0 - certificate.proof.relative_rounding):
        failures.append(f"the bound {permission.lower_bound:.12g} exceeds the recomputed value {recomputed:.12g}")
    return CheckReport(not failures, permission.lower_bound, recomputed, tuple(failures))


def _wrong_form(permission: Permission) -> list[str]:
    """What is wrong with the sizes of menus."""
    certificate = permission.certificate
    if len(permission.menus) != len(certificate.proof.agents):
        return ["it has not one set of menus for each agent"]
    shape = certificate.problem.horizon, certificate.problem.automaton.n_states
    for part, menus in zip(certificate.proof.agents, permission.menus, strict=True):
        if part.relation["kind"] not in KINDS or "common" in part.relation:
            return ["it has menus for an agent whose relation has none"]
        if menus.counts.shape != (*shape, part.grid.n_cells) or np.any(menus.counts < 0):
            return ["its menus do not fit its cells"]
        if menus.choices.shape != (int(menus.counts.sum(dtype=np.int64)),):
            return ["its menus have not as many choices as they say"]
        if menus.choices.size and not (menus.choices.min() >= 0 and menus.choices.max() < count_of_choices(part)):
            return ["its menus name choices that are not there"]
    return []


def _wrong_menus(agent: AnyAgent, part: AgentPart, menus: Menus) -> tuple[list[str], float]:
    """Choices that are not admissible on their whole cell, and what carrying them out costs per step."""
    layered = with_all_choices(part, menus)
    relation = part.relation_of(agent)
    execution = execution_of(agent, layered, relation)
    wrong = verify_relation(agent, layered, relation, execution)
    return [f"agent `{agent.name}`: {text}" for text in wrong], execution.loss


def with_all_choices(part: AgentPart, menus: Menus) -> AgentPart:
    """Return an agent's part whose policy has every choice that is on a menu of each cell, at any time.

    The k-th distinct choice of every cell stands at automaton state k of one time.
    """
    places, n_choices = np.arange(menus.counts.size) % part.grid.n_cells, count_of_choices(part)
    pairs = np.unique(np.repeat(places, menus.counts.reshape(-1)) * n_choices + menus.choices)
    layers = in_layers(*np.divmod(pairs, n_choices), part.grid.n_cells)
    return replace(part, policy=layers[None] if len(layers) else np.full((1, 1, part.grid.n_cells), -1, np.int32))


def permitted_value(permission: Permission) -> float:
    """Value at the start under the worst behaviour within the menus, a lower bound up to rounding."""
    certificate = permission.certificate
    known: dict[tuple[bytes, ...], list[FloatArray]] = {}
    parts = [with_all_choices(*pair) for pair in zip(certificate.proof.agents, permission.menus, strict=True)]
    readings = [
        reading_of(agent, part, known, False) for agent, part in zip(certificate.problem.agents, parts, strict=True)
    ]

    def step(i: int, factors: FloatArray, t: int, q: int) -> FloatArray:
        return least_on_menus(readings[i], certificate.proof.agents[i], permission.menus[i].layers(t, q), factors)

    return value_under(certificate, step)


def value_under(certificate: OnGrid, step: Callable[[int, FloatArray, int, int], FloatArray]) -> float:
    """Value at the start if ``step(i, factors, t, q)`` takes factors (n, places) of agent i one step back."""
    automaton, n_agents = certificate.problem.automaton, len(certificate.proof.agents)
    masks = [masks_of(part, part.masks) for part in certificate.proof.agents]
    ones = tuple(np.ones((1, part.n_places)) for part in certificate.proof.agents)
    terms = Terms(ones, tuple(np.zeros((int(a), n_agents), dtype=np.int64) for a in automaton.accepting))
    for t in reversed(range(certificate.problem.horizon)):
        stacks: list[list[FloatArray]] = [[one] for one in ones]
        index: list[Any] = []
        for q, kept in enumerate(certificate.proof.skeleton[t].kept):
            if automaton.finished[q]:
                index.append(np.zeros((1, n_agents), dtype=np.int64))
                continue
            rows = np.zeros((len(kept), n_agents), dtype=np.int64)
            for i, vertex in enumerate(vertices_of(certificate, t, q, terms, masks)):
                rows[:, i] = sum(map(len, stacks[i])) + np.arange(len(kept))
                stacks[i].append(step(i, vertex[kept], t, q))
            index.append(rows)
        terms = Terms(tuple(np.concatenate(stack) for stack in stacks), tuple(index))
    return tree_start_value(certificate, terms)


def least_on_menus(reading: Reading, part: AgentPart, layers: NDArray[np.int32], factors: FloatArray) -> FloatArray:
    """Least of what is below factors (n, places) one step earlier, over the menus that are given in layers (K, S).

    Where a menu is empty it is 0. At corners the least is taken corner by corner: what is multilinear between the least
    numbers is below each of the functions.
    """
    found = np.full((len(factors), part.n_places), np.inf)
    for values, has in read_in_layers(reading, part, layers, factors):
        np.minimum(found, values, out=found, where=has)
    return np.where(np.isfinite(found), found, 0.0)


def read_in_layers(
    reading: Reading, part: AgentPart, layers: NDArray[np.int32], factors: FloatArray
) -> Iterator[tuple[FloatArray, NDArray[np.bool_]]]:
    """Yield, layer by layer, factors (n, places) one step earlier, and the places (places,) that have a choice."""
    known: dict[object, FloatArray] = {}
    for some in np.array_split(np.arange(len(layers)), -(-len(layers) // LAYERS_AT_ONCE)) if len(layers) else []:
        policy = replace(part, policy=layers[some][None])
        found = reading.values(policy, factors, [(0, k) for k in range(len(some))], known)
        yield from zip(found, masks_of(part, layers[some] >= 0), strict=True)
