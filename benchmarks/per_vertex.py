"""The paper's algorithm, word by word: one vertex of the tree after the other, with nothing shared and nothing batched.

It is only a yardstick: `validation.paper.heuristics` computes the same, and a test compares both. Tables are dense, the
factors of every vertex are smoothed separately, and policies weight vertices by the 1-norms of the other agents'
factors.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from certigym.synthesis.bounds.certified import plain_loss
from certigym.synthesis.models.input_menu import InputMenu
from certigym.synthesis.models.joint import JointModel
from certigym.validation.paper.heuristics import ALIVE

Array = NDArray[np.float64]
Vertex = tuple[Array, ...]
"""One factor (S_i,) per agent."""


def per_vertex_steps(joint: JointModel, robust: bool) -> Iterator[list[list[Vertex]]]:
    """Yield the vertices of every automaton state for 1, 2, .. steps to go: the base heuristic, or the robust tree."""
    tables = [model.kernel.tables[0].toarray() for model in joint.models]
    ones = tuple(np.ones(n) for n in joint.n_cells)
    vertices = [[ones] if accepted else [] for accepted in joint.accepting]
    policies = [[np.zeros(n, dtype=np.int64) for n in joint.n_cells] for _ in range(joint.n_states)]
    for _ in range(joint.horizon):
        grown = []
        for q in range(joint.n_states):
            if joint.absorbing[q]:
                grown.append([ones] if joint.accepting[q] else [])
                continue
            smoothed = list(_children(joint, tables, vertices, q, robust))
            policies[q] = _heuristic(joint, smoothed, policies[q])
            at = [_at(joint, policies[q], vertex) for vertex in smoothed]
            grown.append([own for own in at if _largest(own) > ALIVE])
        vertices = grown
        yield vertices


def value_at(vertices: list[Vertex], cells: NDArray[np.int64]) -> Array:
    """Return the values (M,) at joint cells (M, I)."""
    total = np.zeros(len(cells))
    for vertex in vertices:
        total += np.prod([own[cells[:, i]] for i, own in enumerate(vertex)], axis=0)
    return total


def _children(
    joint: JointModel, tables: list[Array], vertices: list[list[Vertex]], q: int, robust: bool
) -> Iterator[Vertex]:
    """Return the masked and smoothed child of every vertex behind every guard out of q."""
    guards = joint.guards
    for g in np.flatnonzero(guards.source == q):
        for vertex in vertices[guards.target[g]]:
            masked = [joint.masks[i][guards.mask[g, i]] * own for i, own in enumerate(vertex)]
            if all(own.any() for own in masked):
                moved = [table @ own for table, own in zip(tables, masked)]
                if robust:
                    triples = zip(joint.models, masked, moved)
                    moved = [plain_loss(model, own[None], new[None])[0] for model, own, new in triples]
                yield tuple(moved)


def _menus(joint: JointModel) -> list[NDArray[np.int64]]:
    menus = []
    for model in joint.models:
        assert isinstance(model.choices, InputMenu)
        menus.append(np.asarray(model.choices.leads_to, dtype=np.int64))
    return menus


def _at(joint: JointModel, policies: list[NDArray[np.int64]], vertex: Vertex) -> Vertex:
    """Return the factors of a vertex under the policies, read at the lattice points to which the policies lead."""
    pairs = zip(vertex, _menus(joint), policies)
    return tuple(own[menu[np.arange(len(policy)), policy]] for own, menu, policy in pairs)


def _largest(vertex: Vertex) -> float:
    return float(np.prod([own.max() for own in vertex]))


def _heuristic(joint: JointModel, smoothed: list[Vertex], policies: list[NDArray[np.int64]]) -> list[NDArray[np.int64]]:
    """Return the new policy of every agent; the weights are the other agents' 1-norms under the old policies."""
    old = [_at(joint, policies, vertex) for vertex in smoothed]
    chosen = []
    for i, menu in enumerate(_menus(joint)):
        objective = np.zeros(menu.shape)
        for vertex, before in zip(smoothed, old):
            if _largest(before) > ALIVE:
                weight = np.prod([own.sum() for j, own in enumerate(before) if j != i])
                objective += weight * vertex[i][menu]
        chosen.append(np.argmax(objective, axis=1))
    return chosen
